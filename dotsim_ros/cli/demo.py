# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Replay real presses through the running node, record it, and show what it published.

Starts tactile_sim, tactile_record and indenter_player as processes of their own, which talk over
DDS. They go on in steps of simulated time together: what comes out does not depend on what else the
machine does. Leaves the bag OUT/presses, the video OUT/presses.mp4 and the contact sheet
OUT/presses.png. Needs ROS 2. DDS stays on this machine unless the environment names a Fast DDS
profile.

example:
  dotsim_ros demo --out out/demo
  dotsim_ros demo --presses 8 --depth-mm 2 --out out/deep
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

from dotsim_ros.cli._options import NoSeed, Whole

SENSOR, RECORDER, PLAYER = "tactile_sim", "tactile_record", "indenter_player"
START_TIMEOUT_S = 180.0
"""A first start compiles the gel's kernels."""
LAST_FRAMES_S = 0.5
"""Simulated time after the last pose, for the frames that show it."""


def run(
    *,
    out: Path = Path("out/demo"),
    presses: Whole = 4,
    depth_mm: float = 3.0,
    seed: NoSeed = 0,
) -> int:
    """Run the demonstration and print the paths of its files.

    Args:
        out: folder.
        presses: how many of the 12 shipped.
        depth_mm: depth at which presses turn.
    """
    from dotsim_ros.data.bag import bag_sha256
    from dotsim_ros.io.progress import PrintedProgress
    from dotsim_ros.io.replacement import recreated
    from dotsim_ros.nodes.common.processes import NodeProcess
    from dotsim_ros.nodes.common.transport import stay_local
    from dotsim_ros.nodes.indenter_player.parameters import PlayerParameters
    from dotsim_ros.nodes.indenter_player.program import program_of
    from dotsim_ros.nodes.loop.observer import LoopObserver
    from dotsim_ros.nodes.simulated_time.participants import Participant
    from dotsim_ros.nodes.simulated_time.stepper import Stepper, StepperSettings
    from dotsim_ros.view.bag import view_bag

    stay_local()
    bag = out / "presses"
    numbers, depth_m = list(range(presses)), 1e-3 * depth_mm
    played = PlayerParameters(source="presses", press_numbers=tuple(numbers), depth_limit_m=depth_m)
    duration_s = program_of(played).motion.duration_s
    parameters: dict[str, dict[str, Any]] = {
        SENSOR: {},
        RECORDER: {"output": bag},
        PLAYER: {"source": "presses", "press_numbers": numbers, "depth_limit_m": depth_m},
    }
    told = PrintedProgress()
    with recreated(out, "presses"), ExitStack() as stack:
        processes = {}
        for name, own in parameters.items():
            processes[name] = NodeProcess(name, {**own, "use_sim_time": True, "stepped": True})
            stack.callback(processes[name].stop)
        for name, line in ((SENSOR, "ready:"), (RECORDER, "recording /"), (PLAYER, "ready:")):
            processes[name].wait_for_line(line, timeout_s=START_TIMEOUT_S)
        observer = LoopObserver({})
        stack.callback(observer.close)
        stepper = Stepper(
            observer.beside, dict.fromkeys(processes, Participant()), StepperSettings()
        )
        stepper.advance(
            duration_s + LAST_FRAMES_S, lambda share: told("presses, %", int(100 * share), 100)
        )
        statuses = {name: node.stop() for name, node in reversed(processes.items())}
    failed = [f"{name} ended with status {status}" for name, status in statuses.items() if status]
    if failed:
        raise OSError("; ".join(failed))
    shown = view_bag(bag, out, print)
    print(f"bag {bag_sha256(bag)}")
    for path in [bag, *shown]:
        print(path)
    return 0
