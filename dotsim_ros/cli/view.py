# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Turn a bag into a video and a contact sheet of image, depth, skin and force.

Writes NAME.mp4 (or NAME.gif) and NAME.png, where NAME is the bag's. Topics are found by how their
names end; name them where a bag has several or others. A recording that was cut short is shown up
to its end; a bag whose checksums do not match is refused. --rerun writes a recording for the
viewer of rerun (rerun.io) instead: image, depth, moving skin, indenter, and wrench over time.

example:
  dotsim_ros view recordings/press --out images
  dotsim_ros view recordings/press --rerun out/press.rrd
  dotsim_ros view recordings/press --format gif --speed 0.5 --image /RunCamera/image_raw_1
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dotsim_ros.cli._options import NoSeed, say, within

SLOWEST_FPS, FASTEST_FPS = 0.1, 240.0
LEAST_SPEED, GREATEST_SPEED = 1e-3, 1e3
LARGEST_COLUMN_COUNT = 24


def run(
    bag: Path,
    /,
    *,
    out: Path = Path("out"),
    video: Annotated[Literal["mp4", "gif", "both", "none"], Parameter(name="--format")] = "mp4",
    fps: Annotated[float | None, within(SLOWEST_FPS, FASTEST_FPS)] = None,
    speed: Annotated[float, within(LEAST_SPEED, GREATEST_SPEED)] = 1.0,
    columns: Annotated[int, within(1, LARGEST_COLUMN_COUNT, int)] = 6,
    rest: Path | None = None,
    seed: NoSeed = 0,
    image: str | None = None,
    depth: str | None = None,
    points: str | None = None,
    wrench: str | None = None,
    pose: str | None = None,
    rerun: str | None = None,
) -> int:
    """Write the files and print their paths.

    Args:
        bag: folder of a ROS 2 bag.
        out: folder of the files.
        video: format of the video.
        fps: frames a second; without it those of the bag.
        speed: seconds of the bag in one of the video.
        columns: of the contact sheet.
        rest: .npz with rest_position_m (V, 3) of the skin.
        image: topic of the image.
        depth: topic of the depth.
        points: topic of the points.
        wrench: topic of the wrench.
        pose: topic of the indenter's pose, shown with --rerun.
        rerun: in place of video and contact sheet, write this .rrd file, or show the bag in the
            running viewer of this URL.
    """
    from dotsim_ros.view.bag import view_bag
    from dotsim_ros.view.timeline import ViewTopics

    def warn(words: str) -> None:
        say(f"dotsim_ros view: {words}")

    topics = ViewTopics(image=image, depth=depth, points=points, wrench=wrench, pose=pose)
    if rerun is not None:
        from dotsim_ros.view.rerun_log import write_rerun

        write_rerun(bag, rerun, warn, topics=topics, rest=rest)
        print(rerun)
        return 0
    paths = view_bag(
        bag,
        out,
        warn,
        topics=topics,
        formats=_FORMATS[video],
        fps=fps,
        speed=speed,
        column_count=columns,
        rest=rest,
    )
    for path in paths:
        print(path)
    return 0


_FORMATS = {"mp4": ("mp4",), "gif": ("gif",), "both": ("mp4", "gif"), "none": ()}
