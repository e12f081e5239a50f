# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Make demonstrations of path following by touch, for train-policy.

An expert that knows where the indenter is moves the simulated sensor against a ball along the
paths, with errors injected, and between them. Each motion is seen by several cameras, lights and
coats drawn at random. OUT gets one episode a file and demonstrations.json; an interrupted run
resumes where it stopped. One core makes about 15 frames a second, each seen by all looks.

example:
  dotsim_ros demonstrate --sensor densetact2 --out out/demonstrations
  dotsim_ros demonstrate --paths line press --episodes 4 --frames 100 --out out/few
  dotsim_ros demonstrate --policy out/policy --wander 0 --episodes 12 --seed 1 --out out/driven
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from dotsim_ros.cli._workers import add_worker_arguments, crew_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--sensor", default="densetact2", metavar="FILE", help="the sensor's file, or its name")
    add("--indenter", default="sphere_4mm", metavar="FILE", help="a ball's name or definition")
    add("--paths", nargs="+", metavar="PATH", help="line, arc, figure_eight, press (all)")
    add("--episodes", type=int, default=24, metavar="N", help="motions (24)")
    add(
        "--frames", type=int, default=250, metavar="N", help="frames of each motion, at 25 Hz (250)"
    )
    add("--looks", type=int, default=2, metavar="N", help="cameras that see each motion (2)")
    add(
        "--wander",
        type=float,
        default=0.5,
        metavar="SHARE",
        help="share of motions off the paths (0.5)",
    )
    add("--policy", type=Path, metavar="DIR", help="policy that drives in the expert's place")
    add("--seed", type=int, default=0, help="seed of all draws (0)")
    add_worker_arguments(parser)
    add("--out", type=Path, default=Path("out/demonstrations"), metavar="DIR")
    add("--json", type=Path, metavar="FILE", help="write what was made to this file as well")


def run(arguments: argparse.Namespace) -> int:
    """Make the demonstrations."""
    from dotsim_ros.control.policy.demonstration import Plan, demonstrate, read_card
    from dotsim_ros.control.policy.paths import PATHS, reference_path
    from dotsim_ros.geometry.indenter import load_indenter
    from dotsim_ros.io.files import write_json
    from dotsim_ros.specification import load_sensor

    paths = tuple(arguments.paths or PATHS)
    for name in paths:
        reference_path(name)
    sensor = load_sensor(arguments.sensor)
    plan = Plan(
        sensor=sensor.name,
        paths=paths,
        episode_count=arguments.episodes,
        frame_count=arguments.frames,
        look_count=arguments.looks,
        wander_share=arguments.wander,
        seed=arguments.seed,
        policy="" if arguments.policy is None else str(arguments.policy),
    )
    begun_s = time.monotonic()

    def show(done: int, count: int) -> None:
        spent_s = time.monotonic() - begun_s
        left_min = spent_s * (count - done) / done / 60.0
        print(f"episode {done}/{count}  {left_min:.1f} min left", file=sys.stderr, flush=True)

    indenter = load_indenter(arguments.indenter)
    frames = demonstrate(
        sensor, indenter, plan, arguments.out, progress=show, workers=crew_of(arguments)
    )
    if arguments.json is not None:
        write_json(arguments.json, {"frames": frames, **read_card(arguments.out)})
    print(
        f"{plan.episode_count} episodes, {frames} images of {', '.join(paths)} in {arguments.out}"
    )
    return 0
