# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Turn a bag into a video and a contact sheet of image, depth, skin and force.

Writes NAME.mp4 (or NAME.gif) and NAME.png, where NAME is the bag's. Topics are found by how their
names end; name them where a bag has several or others. A recording that was cut short is shown up
to its end; a bag whose checksums do not match is refused.

example:
  dotsim_ros view recordings/press --out images
  dotsim_ros view recordings/press --format gif --speed 0.5 --image /RunCamera/image_raw_1
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path

SLOWEST_FPS, FASTEST_FPS = 0.1, 240.0
LEAST_SPEED, GREATEST_SPEED = 1e-3, 1e3
LARGEST_COLUMN_COUNT = 24


def _within(least: float, greatest: float) -> Callable[[str], float]:
    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= greatest:
            raise argparse.ArgumentTypeError(
                f"{text} is not a number from {least:g} to {greatest:g}"
            )
        return value

    return number


def _count(text: str) -> int:
    if not (text.isascii() and text.isdigit() and 1 <= int(text[:4]) <= LARGEST_COLUMN_COUNT):
        raise argparse.ArgumentTypeError(
            f"{text} is not a whole number from 1 to {LARGEST_COLUMN_COUNT}"
        )
    return int(text)


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
    parser.add_argument(
        "--fps",
        type=_within(SLOWEST_FPS, FASTEST_FPS),
        help=f"frames a second, {SLOWEST_FPS:g} to {FASTEST_FPS:g} (those of the bag)",
    )
    parser.add_argument(
        "--speed",
        type=_within(LEAST_SPEED, GREATEST_SPEED),
        default=1.0,
        help=f"seconds of the bag in one of the video, {LEAST_SPEED:g} to {GREATEST_SPEED:g} (1)",
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
    from dotsim_ros.view.bag import view_bag
    from dotsim_ros.view.timeline import ViewTopics

    paths = view_bag(
        arguments.bag,
        arguments.out,
        lambda words: print(f"dotsim_ros view: {words}", file=sys.stderr),
        topics=ViewTopics(arguments.image, arguments.depth, arguments.points, arguments.wrench),
        formats=_FORMATS[arguments.format],
        fps=arguments.fps,
        speed=arguments.speed,
        column_count=arguments.columns,
        rest=arguments.rest,
    )
    for path in paths:
        print(path)
    return 0


_FORMATS = {"mp4": ("mp4",), "gif": ("gif",), "both": ("mp4", "gif"), "none": ()}
