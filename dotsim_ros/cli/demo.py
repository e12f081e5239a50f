# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Replay real presses through the running node, record it, and show what it published.

Starts tactile_sim, tactile_record and indenter_player as processes of their own, which talk over
DDS. Leaves the bag OUT/presses, the video OUT/presses.mp4 and the contact sheet OUT/presses.png.
Needs ROS 2.
DDS stays on this machine unless the environment names a Fast DDS profile.

example:
  dotsim_ros demo --out out/demo
  dotsim_ros demo --presses 8 --depth-mm 2 --out out/deep
"""

from __future__ import annotations

import argparse
from contextlib import ExitStack
from pathlib import Path

from dotsim_ros.cli._made import made_anew

START_TIMEOUT_S = 180.0
"""A first start compiles the gel's kernels."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder (out/demo)")
    parser.add_argument("--presses", type=int, default=4, help="how many of the 12 shipped (4)")
    parser.add_argument(
        "--depth-mm", type=float, default=3.0, help="depth at which presses turn (3)"
    )
    parser.add_argument("--seed", type=int, default=0, help="accepted; nothing here is random")


def run(arguments: argparse.Namespace) -> int:
    """Run the demonstration and print the paths of its files."""
    from dotsim_ros.nodes.common.processes import NodeProcess
    from dotsim_ros.nodes.common.transport import stay_local
    from dotsim_ros.view.bag import ViewRequest, view_bag
    from dotsim_ros.view.timeline import ViewTopics

    stay_local()
    bag: Path = arguments.out / "presses"
    with made_anew(arguments.out, "presses"), ExitStack() as stack:
        sensor = NodeProcess("tactile_sim", {})
        stack.callback(sensor.stop)
        sensor.wait_for_line("ready:", timeout_s=START_TIMEOUT_S)
        recorder = NodeProcess("tactile_record", {"output": bag})
        stack.callback(recorder.stop)
        recorder.wait_for_line("receiving /image_raw", timeout_s=START_TIMEOUT_S)
        player = NodeProcess(
            "indenter_player",
            {
                "source": "presses",
                "subscriber_count": 2,
                "press_numbers": str(list(range(arguments.presses))),
                "depth_limit_m": 1e-3 * arguments.depth_mm,
                "exit_at_end": "true",
            },
        )
        stack.callback(player.stop)
        statuses = {player.executable: player.wait()}
        statuses |= {node.executable: node.stop() for node in (recorder, sensor)}
    failed = [f"{name} ended with status {status}" for name, status in statuses.items() if status]
    if failed:
        raise OSError("; ".join(failed))
    request = ViewRequest(
        bag=bag,
        out=arguments.out,
        topics=ViewTopics(),
        formats=("mp4",),
        fps=None,
        speed=1.0,
        column_count=6,
        rest=None,
    )
    for path in [bag, *view_bag(request, print)]:
        print(path)
    return 0
