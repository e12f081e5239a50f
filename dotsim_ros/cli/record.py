# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Make a bag of a recording that was cut short or damaged.

Recording itself needs ROS: ros2 run dotsim_ros tactile_record. While it runs, its bag lies in
OUTPUT.partial; where it is killed, that folder stays, without an index. This command copies what
can be read of it, or of any damaged bag (mcap), into a bag with an index and metadata.yaml, and
says what is missing. The damaged one is left as it is; remove it once you have what you want.

example:
  dotsim_ros record --repair recordings/press.partial
  dotsim_ros record --repair recordings/press --out /other/disk/press
"""

from __future__ import annotations

from pathlib import Path

from dotsim_ros.cli._options import NoSeed, say


def run(
    *, repair: Path, out: Path | None = None, json: Path | None = None, seed: NoSeed = 0
) -> int:
    """Make the bag, and say what is in it and what is not.

    Args:
        repair: folder of the bag, or its .mcap file.
        out: folder of the new bag, which must not exist; without it BAG without .partial, else
            BAG_repaired.
        json: write what became of it here.
    """
    from dotsim_ros.data.repair import repair_bag
    from dotsim_ros.io.files import write_json

    repaired = repair_bag(repair, out)
    for words in repaired.damage:
        say(f"dotsim_ros record: {words}")
    counts = ", ".join(f"{topic} {count}" for topic, count in repaired.counts.items())
    print(f"{repaired.bag}: {sum(repaired.counts.values())} messages ({counts})")
    if json is not None:
        write_json(
            json,
            {
                "bag": str(repaired.bag),
                "messages": dict(repaired.counts),
                "damage": list(repaired.damage),
            },
        )
    return 0
