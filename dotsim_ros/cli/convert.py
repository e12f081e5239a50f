# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Turn bags into a data set of LeRobot, or such a data set into bags.

Bags of a sensor, real or simulated, with the joints of its arm, become the episodes of a
LeRobotDataset v3.0; a data set becomes a bag for each episode. A frame holds an image and the
newest pose, wrench, skin and state of the joints at its stamp; both ways together give every
message that a frame shows bit for bit, images as PNG. What is left out is said.

example:
  dotsim_ros convert recordings/press recordings/slide --out touches --task "press and slide"
  dotsim_ros convert touches --out bags
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal

from dotsim_ros.cli._options import NoSeed, say


def run(
    *sources: Path,
    out: Path,
    images: Literal["png", "mp4"] = "png",
    task: str = "touch",
    image: str | None = None,
    points: str | None = None,
    wrench: str | None = None,
    pose: str | None = None,
    joints: str | None = None,
    seed: NoSeed = 0,
) -> int:
    """Write the data set or the bags, and say what they hold.

    Args:
        sources: bags, an episode each; or the folder of one data set.
        out: folder of the data set, which must not exist; or of the bags.
        images: of a data set: png keeps every bit, mp4 is small.
        task: what is done, in words.
        image: topic of the image.
        points: topic of the points.
        wrench: topic of the wrench.
        pose: topic of the indenter's pose.
        joints: topic of the joints' states.
    """
    from dotsim_ros.data.lerobot.bags import bags_to_lerobot, lerobot_to_bags
    from dotsim_ros.data.lerobot.writer import INFO
    from dotsim_ros.view.timeline import ViewTopics, bag_topics

    def warn(words: str) -> None:
        say(f"dotsim_ros convert: {words}")

    if not sources:
        raise ValueError("nothing to convert; name bags or the folder of a data set")
    if (sources[0] / INFO).is_file():
        if len(sources) > 1:
            raise ValueError(f"{sources[0]} is a data set, expected one, or bags alone")
        for path in lerobot_to_bags(sources[0], out, warn):
            print(path)
        return 0

    given = ViewTopics(image=image, points=points, wrench=wrench, pose=pose)
    count = bags_to_lerobot(
        sources,
        out,
        warn,
        topics=partial(bag_topics, given=given),
        joints=joints,
        is_video=images == "mp4",
        task=task,
    )
    print(f"{out}: {len(sources)} episodes, {count} frames")
    return 0
