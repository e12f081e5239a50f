# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Lets a policy drive simulated sensors along its paths, in lockstep, without ROS.

    python benchmarks/policy_rollout.py --sensor densetact2 --json rollout.json
    python benchmarks/policy_rollout.py --looks drawn --trials 4

The arm is a first-order one that answers 60 ms after an image. For each path and trial: the
distance from the path (mean, 95th percentile, largest) after the first two seconds, and the laps
beside those of the expert in that time, since a policy that stands still makes no error.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.arrays import ImageArray
from dotsim_ros.files import write_json
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.provenance import provenance
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.tasks.policy.demonstration import approach, contact_of, within_bounds
from dotsim_ros.tasks.policy.looks import Look, LookRanges
from dotsim_ros.tasks.policy.network import Policy, load_policy
from dotsim_ros.tasks.policy.paths import reference_path
from dotsim_ros.tasks.policy.rollout import RollOut, follow

SHIFTED = LookRanges(gain=(0.6, 0.6), gamma=(1.0, 1.0), noise_levels=2.0)


def roll_out(
    policy: Policy, sensor: TactileSensor, *, look: Look | None, seconds: float, seed: int
) -> tuple[RollOut, list[float]]:
    """Return what a policy does on a sensor, seen by its own camera or by another look, and how
    unlike the training images each image was."""
    random = np.random.default_rng([seed, policy.paths.index(policy.path)])
    contact = contact_of(sensor.specification, sensor.indenter)
    path = reference_path(policy.path, contact)
    start = path.position_m[int(random.integers(len(path.position_m)))]
    start = within_bounds(start + 0.4e-3 * random.standard_normal(3), contact)
    dt_s = 1.0 / policy.rate_hz
    distances: list[float] = []
    idle = sensor.idle_image if look is None else look.idle

    def press(pose: Pose) -> ImageArray:
        gel = sensor.press(pose, dt_s)
        seen = sensor.see(gel, pose).image if look is None else look.image(gel.skin_position_m)
        distances.append(policy.image_distance(seen, idle))
        return seen

    sensor.reset()
    for place in approach(start, contact):
        sensor.press(Pose(place), dt_s)
    result = follow(
        policy,
        press,
        idle,
        path,
        Pose(start),
        frame_count=round(seconds * policy.rate_hz),
        rate_hz=policy.rate_hz,
    )
    return result, distances


def measure(
    folder: Path,
    specification: SensorSpecification,
    *,
    paths: list[str],
    trials: int,
    seconds: float,
    seed: int,
    looks: LookRanges | None,
) -> list[dict[str, Any]]:
    """Return a row for each path and trial."""
    sensor = TactileSensor(specification, indenter=load_indenter("sphere_4mm"))
    rows = []
    for name in paths or list(load_policy(folder).paths):
        policy = load_policy(folder, name, thread_count=1)
        for trial in range(trials):
            look = None
            if looks is not None:
                random = np.random.default_rng([seed, trial, 7])
                look = Look(specification, sensor.skin, looks, random)
            result, distances = roll_out(
                policy, sensor, look=look, seconds=seconds, seed=seed + trial
            )
            row = {"path": name, "trial": trial, **result.figures()}
            row["largest_image_distance"] = round(max(distances), 3)
            print(row, flush=True)
            rows.append(row)
    return rows


def main() -> None:
    """Print a row for each path and trial, and write them as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Let a policy drive simulated sensors along its paths, without ROS.",
        epilog="example: python benchmarks/policy_rollout.py --paths line --trials 3",
    )
    add = parser.add_argument
    add("--policy", type=Path, default=Path("params/policies/densetact2_sphere"), metavar="DIR")
    add("--sensor", default="densetact2", help="name or YAML file of the sensor")
    add("--paths", nargs="+", default=[], metavar="PATH", help="(all)")
    add("--trials", type=int, default=1, help="of each path (1)")
    add("--seconds", type=float, default=12.0, help="of each trial (12)")
    add("--seed", type=int, default=1000, help="of starts and looks (1000)")
    add(
        "--looks",
        choices=("own", "shifted", "drawn"),
        default="own",
        help="the sensor's own; 10 %% stiffer, darker, tilted and noisy; or drawn as in training",
    )
    add("--json", type=Path, metavar="FILE", help="file to write the figures to")
    arguments = parser.parse_args()
    sensor = load_sensor(arguments.sensor)
    if arguments.looks == "shifted":
        stiffer = replace(
            sensor.material, youngs_modulus_pa=1.1 * sensor.material.youngs_modulus_pa
        )
        sensor = replace(sensor, material=stiffer)
    rows = measure(
        arguments.policy,
        sensor,
        paths=arguments.paths,
        trials=arguments.trials,
        seconds=arguments.seconds,
        seed=arguments.seed,
        looks={"own": None, "shifted": SHIFTED, "drawn": LookRanges()}[arguments.looks],
    )
    if arguments.json:
        write_json(arguments.json, {"rows": rows, "provenance": provenance()})


if __name__ == "__main__":
    main()
