"""Turn a bag into a video and a contact sheet of image, depth, skin and force.

Writes NAME.mp4 (or NAME.gif) and NAME.png, where NAME is the bag's. Topics are found by how their
names end; name them where a bag has several or others.

example:
  dotsim_ros view recordings/press --out images
  dotsim_ros view recordings/press --format gif --speed 0.5 --image /RunCamera/image_raw_1
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path


def _positive(text: str) -> float:
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return value


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 24:
        raise argparse.ArgumentTypeError(f"{text} is not a number from 1 to 24")
    return value


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument("bag", type=Path, help="folder of a ROS 2 bag")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of the files (out)")
    parser.add_argument(
        "--format",
        choices=("mp4", "gif", "both", "none"),
        default="mp4",
        help="format of the video (mp4)",
    )
    parser.add_argument("--fps", type=_positive, help="frames a second (those of the bag)")
    parser.add_argument(
        "--speed", type=_positive, default=1.0, help="seconds of the bag in one of the video (1)"
    )
    parser.add_argument(
        "--columns", type=_count, default=6, help="columns of the contact sheet (6)"
    )
    parser.add_argument("--rest", type=Path, help=".npz with rest_position_m (V, 3) of the skin")
    parser.add_argument("--seed", type=int, default=0, help="accepted; nothing here is random")
    for name in ("image", "depth", "points", "wrench"):
        parser.add_argument(f"--{name}", metavar="TOPIC", help=f"topic of the {name}")


def run(arguments: argparse.Namespace) -> int:
    """Write the files and print their paths."""
    from dotsim_ros.view.bag import ViewRequest, view_bag
    from dotsim_ros.view.timeline import ViewTopics

    topics = ViewTopics(
        image=arguments.image,
        depth=arguments.depth,
        points=arguments.points,
        wrench=arguments.wrench,
    )
    request = ViewRequest(
        bag=arguments.bag,
        out=arguments.out,
        topics=topics,
        formats=_FORMATS[arguments.format],
        fps=arguments.fps,
        speed=arguments.speed,
        column_count=arguments.columns,
        rest=arguments.rest,
    )
    for path in view_bag(request):
        print(path)
    return 0


_FORMATS = {"mp4": ("mp4",), "gif": ("gif",), "both": ("mp4", "gif"), "none": ()}
