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

import argparse
import sys
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument(
        "--repair",
        type=Path,
        required=True,
        metavar="BAG",
        help="folder of the bag, or its .mcap file",
    )
    parser.add_argument(
        "--out",
        type=Path,
        help="folder of the new bag, which must not exist (BAG without .partial, else "
        "BAG_repaired)",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what became of it here")
    parser.add_argument("--seed", type=int, default=0, help="accepted; nothing here is random")


def run(arguments: argparse.Namespace) -> int:
    """Make the bag, and say what is in it and what is not."""
    from dotsim_ros.data.repair import repair_bag
    from dotsim_ros.io.files import write_json

    repaired = repair_bag(arguments.repair, arguments.out)
    for words in repaired.damage:
        print(f"dotsim_ros record: {words}", file=sys.stderr)
    counts = ", ".join(f"{topic} {count}" for topic, count in repaired.counts.items())
    print(f"{repaired.bag}: {sum(repaired.counts.values())} messages ({counts})")
    if arguments.json is not None:
        write_json(
            arguments.json,
            {
                "bag": str(repaired.bag),
                "messages": dict(repaired.counts),
                "damage": list(repaired.damage),
            },
        )
    return 0
