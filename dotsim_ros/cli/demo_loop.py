# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Let a policy follow a path by touch, record it, and show what it did.

Starts tactile_sim, tactile_policy, xarm_sim and tactile_record as processes of their own, which
talk over DDS, and enables the policy until it has made its laps. In simulated time, the default,
the nodes go on in steps together: what comes out does not depend on what else the machine does.
Leaves the bag OUT/loop, the image of the path OUT/path.png, the figures of the bag in
OUT/report.json, and the report OUT/report.html and OUT/report.md.
Needs ROS 2. DDS stays on this machine unless the environment names a Fast DDS profile.

example:
  dotsim_ros demo-loop --out out/demo-loop
  dotsim_ros demo-loop --policy out/policy --path line --laps 4 --out out/line
  dotsim_ros demo-loop --clock realtime --out out/realtime
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from dotsim_ros.cli._made import recreated

POLICY = "densetact2_sphere"
MOTIONS = ("line", "arc", "figure_eight", "press")
CLOCKS = ("simulated", "realtime")
MOST_LAPS = 1e4
PATIENCE = 2.0
"""Times that a lap takes the expert, after which the policy is not waited for any more."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--out", type=Path, default=Path("out/demo-loop"), help="folder (out/demo-loop)")
    add("--policy", default=POLICY, help=f"folder or name of the policy ({POLICY})")
    add("--path", choices=MOTIONS, default="figure_eight", help="path to follow (figure_eight)")
    add("--laps", type=float, default=2.0, help="how many laps to make (2)")
    add("--clock", choices=CLOCKS, default=CLOCKS[0], help="how time passes (simulated)")
    add("--one-process", action="store_true", help="sensor, arm and policy in one process")
    add("--sensor", help="name or file of the sensor (the one that the policy was trained on)")
    add("--seed", type=int, default=0, help="seed of the start (0)")
    add("--json", type=Path, help="file to write the figures to")


def run(arguments: argparse.Namespace) -> int:
    """Run the demonstration and print the paths of its files."""
    import numpy as np

    from dotsim_ros.control.loop.judge import judge, summary_of, trial_start
    from dotsim_ros.control.loop.recording import LoopRecording, read_loop_bag
    from dotsim_ros.control.loop.report import path_image, trial_report
    from dotsim_ros.control.policy.demonstration import contact_of
    from dotsim_ros.control.policy.network import read_policy
    from dotsim_ros.control.policy.paths import reference_path
    from dotsim_ros.control.policy.rollout import APPROACH_S
    from dotsim_ros.data.bag import bag_sha256
    from dotsim_ros.geometry.indenter import load_indenter
    from dotsim_ros.io.files import beside, write_json
    from dotsim_ros.io.page import write_page
    from dotsim_ros.io.progress import bar
    from dotsim_ros.io.provenance import provenance
    from dotsim_ros.nodes.common.transport import stay_local
    from dotsim_ros.nodes.loop.closed_loop import (
        SENSOR,
        ClosedLoop,
        LoopSetup,
        loop_parameters,
        policy_name,
    )
    from dotsim_ros.nodes.tactile_policy.files import policy_folder
    from dotsim_ros.specification import load_sensor

    if not (0.0 < arguments.laps < MOST_LAPS):
        raise ValueError(f"--laps is {arguments.laps:g}, expected more than 0, under {MOST_LAPS:g}")
    stay_local()
    folder = policy_folder(arguments.policy)
    card, _ = read_policy(folder)
    sensor = arguments.sensor or card.sensor
    contact = contact_of(load_sensor(sensor), load_indenter(loop_parameters(SENSOR)["indenter"]))
    path = reference_path(arguments.path, contact)
    bag: Path = arguments.out / "loop"
    setup = LoopSetup(
        policy_name(folder),
        sensor=sensor,
        one_process=arguments.one_process,
    )

    def laps_are_made(recording: LoopRecording) -> bool:
        done = judge(recording, path, setup.limits()).get("laps", 0.0)
        made = float(np.ptp(recording.pose_s)) / (time.monotonic() - begun_s)
        note = f"{done:.2f} of {arguments.laps:g} laps, {made:.2f} times real time"
        print(bar(done / arguments.laps, note), file=sys.stderr, flush=True)
        return bool(done >= arguments.laps)

    with (
        recreated(arguments.out, "loop"),
        ClosedLoop(setup, contact=contact, clock=arguments.clock) as loop,
    ):
        loop.start(path.name)
        start_m = trial_start(path, contact, seed=arguments.seed, number=0)
        longest_s = APPROACH_S + PATIENCE * arguments.laps * path.lap_s
        begun_s = time.monotonic()
        observed = loop.trial(start_m, longest_s, bag=bag, is_done=laps_are_made)
        statuses = loop.close()
    failed = [f"{name} ended with status {status}" for name, status in statuses.items() if status]
    if failed:
        raise OSError("; ".join(failed))
    recording = read_loop_bag(bag, notes=observed.notes)
    row = judge(recording, path, setup.limits())
    row |= {
        "laps_asked": arguments.laps,
        "clock": arguments.clock,
        "frames_per_second": row.get("frame_rate_hz"),
        "bag_sha256": bag_sha256(bag),
        "speed_factor": round(loop.led_speed_factor, 3),
    }
    image = path_image(path.name, [recording], name="path")
    page = trial_report(
        row,
        setup.limits(),
        image,
        path=path.name,
        policy=card.name,
        sensor=beside(setup.sensor, "", replaces=(".yaml", ".yml")).name,
        origin=provenance(),
    )
    write_page(arguments.out, page)
    for file in filter(None, (arguments.out / "report.json", arguments.json)):
        write_json(file, row | {"provenance": provenance()})
    print(summary_of(row))
    print(f"{row['speed_factor']:g} times real time, bag {row['bag_sha256']}")
    for name in ("loop", "path.png", "report.html", "report.md", "report.json"):
        print(arguments.out / name)
    return 0
