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

import time
from pathlib import Path
from typing import Literal

from dotsim_ros.cli._options import Whole, say

POLICY = "densetact2_sphere"
Motion = Literal["line", "arc", "figure_eight", "press"]
Clock = Literal["simulated", "realtime"]
MOST_LAPS = 1e4
PATIENCE = 2.0
"""Times that a lap takes the expert, after which the policy is not waited for any more."""


def run(
    *,
    out: Path = Path("out/demo-loop"),
    policy: str = POLICY,
    path: Motion = "figure_eight",
    laps: float = 2.0,
    clock: Clock = "simulated",
    one_process: bool = False,
    sensor: str | None = None,
    seed: Whole = 0,
    json: Path | None = None,
) -> int:
    """Run the demonstration and print the paths of its files.

    Args:
        out: folder.
        policy: folder or name of the policy.
        path: to follow.
        laps: how many to make.
        clock: how time passes.
        one_process: sensor, arm and policy in one process.
        sensor: name or file of the sensor; without it the one that the policy was trained on.
        seed: of the start.
        json: file to write the figures to.
    """
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
    from dotsim_ros.io.replacement import recreated
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

    if not (0.0 < laps < MOST_LAPS):
        raise ValueError(f"--laps is {laps:g}, expected more than 0, under {MOST_LAPS:g}")
    stay_local()
    folder = policy_folder(policy)
    card, _ = read_policy(folder)
    sensor = sensor or card.sensor
    contact = contact_of(load_sensor(sensor), load_indenter(loop_parameters(SENSOR)["indenter"]))
    reference = reference_path(path, contact)
    bag = out / "loop"
    setup = LoopSetup(
        policy_name(folder),
        sensor=sensor,
        one_process=one_process,
    )

    def laps_are_made(recording: LoopRecording) -> bool:
        done = judge(recording, reference, setup.limits()).get("laps", 0.0)
        made = float(np.ptp(recording.pose_s)) / (time.monotonic() - begun_s)
        note = f"{done:.2f} of {laps:g} laps, {made:.2f} times real time"
        say(bar(done / laps, note))
        return bool(done >= laps)

    with (
        recreated(out, "loop"),
        ClosedLoop(setup, contact=contact, clock=clock) as loop,
    ):
        loop.start(reference.name)
        start_m = trial_start(reference, contact, seed=seed, number=0)
        longest_s = APPROACH_S + PATIENCE * laps * reference.lap_s
        begun_s = time.monotonic()
        observed = loop.trial(start_m, longest_s, bag=bag, is_done=laps_are_made)
        statuses = loop.close()
    failed = [f"{name} ended with status {status}" for name, status in statuses.items() if status]
    if failed:
        raise OSError("; ".join(failed))
    recording = read_loop_bag(bag, notes=observed.notes)
    row = judge(recording, reference, setup.limits())
    row |= {
        "laps_asked": laps,
        "clock": clock,
        "frames_per_second": row.get("frame_rate_hz"),
        "bag_sha256": bag_sha256(bag),
        "speed_factor": round(loop.led_speed_factor, 3),
    }
    image = path_image(path, [recording], name="path")
    page = trial_report(
        row,
        setup.limits(),
        image,
        path=path,
        policy=card.name,
        sensor=beside(setup.sensor, "", replaces=(".yaml", ".yml")).name,
        origin=provenance(),
    )
    write_page(out, page)
    for file in filter(None, (out / "report.json", json)):
        write_json(file, row | {"provenance": provenance()})
    print(summary_of(row))
    print(f"{row['speed_factor']:g} times real time, bag {row['bag_sha256']}")
    for name in ("loop", "path.png", "report.html", "report.md", "report.json"):
        print(out / name)
    return 0
