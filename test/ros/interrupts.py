# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Whether every node ends at its first SIGINT, whenever that comes, and how long it takes.

python test/ros/interrupts.py --count 100 --heavy 20 --json interrupts.json

Each node is started anew for each signal, in a namespace of its own. At a random moment after it
has said that it is ready it gets one SIGINT, and then 30 s to end with status 0. The sensor and the
policy take seconds to start, so they have a count of their own. `xarm_adapter` is left out where
xarm_msgs is not installed. The nodes' logs go to stderr.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import random
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from dotsim_ros.files import write_json
from dotsim_ros.nodes.common.processes import NodeProcess
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.provenance import provenance

START_TIMEOUT_S = 300.0
LONGEST_WAIT_S = 1.0
"""After ready: some periods of every timer of the nodes that wakes them."""


@dataclass(frozen=True)
class Start:
    """How a node is started.

    Attributes:
        parameters: of ROS.
        ready: what its log says once it works.
        is_heavy: it takes seconds to start.
        writes: it is given the folder of a bag as `output`.
    """

    parameters: Mapping[str, Any] = field(default_factory=dict)
    ready: str = "ready:"
    is_heavy: bool = False
    writes: bool = False


STARTS = {
    "indenter_player": Start({"loop": "true", "wait_for_subscriber_s": 0.0}),
    "tactile_record": Start({"topics": "['wrench']"}, ready="recording", writes=True),
    "xarm_sim": Start(),
    "xarm_adapter": Start(),
    "tactile_policy": Start({"policy": "densetact2_sphere"}, is_heavy=True),
    "tactile_sim": Start({"grid_spacing_m": 0.0048}, is_heavy=True),
}


@dataclass(frozen=True)
class Interrupt:
    """One SIGINT.

    Attributes:
        status: with which the node ended; negative where it had to be killed.
        wait_s: from ready to the signal.
        took_s: from the signal to the end.
    """

    status: int
    wait_s: float
    took_s: float


def interrupt(name: str, wait_s: float, place: str, folder: Path) -> Interrupt:
    """Start a node, send it one SIGINT and see it end.

    Args:
        name: of the node.
        wait_s: from ready to the signal.
        place: a name that no other run has.
        folder: for what it writes.

    Raises:
        OSError: it does not start.
    """
    start = STARTS[name]
    parameters = dict(start.parameters)
    if start.writes:
        parameters["output"] = str(folder / place)
    process = NodeProcess(name, parameters, arguments=("-r", f"__ns:=/{place}"))
    try:
        process.wait_for_line(start.ready, timeout_s=START_TIMEOUT_S)
        time.sleep(wait_s)
        begun_s = time.monotonic()
    finally:
        status = process.stop()
    return Interrupt(status, wait_s, time.monotonic() - begun_s)


def interrupt_all(
    counts: Mapping[str, int], *, at_once: int, seed: int
) -> Iterator[tuple[str, list[Interrupt]]]:
    """Yield the interrupts of each node in turn.

    Args:
        counts: how many, by node.
        at_once: how many processes run beside each other.
        seed: of the moments.
    """
    moments = random.Random(seed)
    numbers = itertools.count()
    with (
        tempfile.TemporaryDirectory() as folder,
        ThreadPoolExecutor(at_once) as threads,
    ):
        for name, count in counts.items():
            runs = [
                threads.submit(
                    interrupt,
                    name,
                    moments.uniform(0.0, LONGEST_WAIT_S),
                    f"run_{next(numbers)}",
                    Path(folder),
                )
                for _ in range(count)
            ]
            yield name, [run.result() for run in runs]


def summarize(found: list[Interrupt]) -> dict[str, Any]:
    """Return how many ended at once, with status 0, and how long they took."""
    return {
        "count": len(found),
        "ended": sum(each.status == 0 for each in found),
        "median_s": round(median(each.took_s for each in found), 3),
        "slowest_s": round(max(each.took_s for each in found), 3),
        "others": [vars(each) for each in found if each.status != 0],
    }


def main() -> int:
    """Run, print, write; return 1 where a node did not end at its first SIGINT."""
    parser = argparse.ArgumentParser(
        description="Whether every node ends at its first SIGINT.",
        epilog="example: python test/ros/interrupts.py --count 100 --json interrupts.json",
    )
    add = parser.add_argument
    add("--count", type=int, default=100, help="signals for each node (100)")
    add("--heavy", type=int, default=20, help="for each that takes seconds to start (20)")
    add("--nodes", nargs="+", choices=STARTS, default=list(STARTS), help="which (all)")
    add("--at-once", type=int, default=2, help="processes beside each other (2)")
    add("--seed", type=int, default=0, help="of the moments (0)")
    add("--json", type=Path, help="file to write the figures to")
    arguments = parser.parse_args()
    if min(arguments.count, arguments.heavy, arguments.at_once) < 1:
        parser.error("--count, --heavy and --at-once must be 1 or more")
    names = [
        name
        for name in arguments.nodes
        if name != "xarm_adapter" or importlib.util.find_spec("xarm_msgs") is not None
    ]
    for name in set(arguments.nodes) - set(names):
        print(f"{name}: left out, xarm_msgs is not installed")
    stay_local()
    counts = {name: arguments.heavy if STARTS[name].is_heavy else arguments.count for name in names}
    figures = {}
    for name, found in interrupt_all(counts, at_once=arguments.at_once, seed=arguments.seed):
        row = figures[name] = summarize(found)
        print(
            f"{name}: {row['ended']} of {row['count']} ended at the first SIGINT, "
            f"median {row['median_s']:.2f} s, slowest {row['slowest_s']:.2f} s",
            flush=True,
        )
        for other in row["others"]:
            print(f"  status {other['status']} {other['wait_s']:.3f} s after ready")
    if arguments.json:
        given = {"seed": str(arguments.seed), "at_once": str(arguments.at_once)}
        write_json(arguments.json, {"nodes": figures, "provenance": provenance() | given})
    return 0 if all(row["ended"] == row["count"] for row in figures.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
