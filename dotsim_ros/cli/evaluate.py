# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measure how far a sensor's twin is from your recordings: skin, force and image.

The sensor follows the recorded poses of every trajectory of a data set. Writes into OUT report.html
and report.md, with the errors by indenter and by trajectory and the worst image, and errors.json.
A channel that was not recorded is left out. Judge a sensor on trajectories that it was not fitted
to; docs/calibration.md says how.

examples:
  dotsim_ros evaluate --data measured/mine --sensor mine.yaml --out out/evaluation
  dotsim_ros evaluate --data DIR --sensor sensor_a --trajectories 1_sphere_0 2_cone_0
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dotsim_ros.cli._workers import add_worker_arguments, crew_of, show_stage

FROM_DEPTH_MM = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    add = parser.add_argument
    add("--data", type=Path, required=True, metavar="DIR", help="folder of the data set")
    add("--sensor", required=True, metavar="NAME", help="the sensor's name, or its file")
    add("--out", type=Path, default=Path("out/evaluation"), metavar="DIR", help="folder to write")
    add("--trajectories", nargs="+", metavar="NAME", help="judge these alone (all)")
    add(
        "--from-depth-mm",
        type=float,
        default=FROM_DEPTH_MM,
        metavar="MM",
        help=f"judge frames whose tip is at least so deep ({FROM_DEPTH_MM:g})",
    )
    add(
        "--indenters",
        type=Path,
        metavar="DIR",
        help="folder of the indenters' meshes (in the data set, then next to it)",
    )
    add_worker_arguments(parser)
    add("--seed", type=int, default=0, help="of the noise of the simulated images (0)")
    add("--json", type=Path, metavar="FILE", help="copy the errors to this file as well")
    for channel in ("pose", "wrench", "skin", "image"):
        add(f"--{channel}-topic", metavar="TOPIC", help=f"of the {channel}")


def run(arguments: argparse.Namespace) -> int:
    """Judge, write the files, and print the errors."""
    from dotsim_ros.calibration.evaluation import (
        errors_of,
        evaluate_twin,
        page_of,
        table_of,
        write_evaluation,
    )
    from dotsim_ros.data.trajectory import Topics
    from dotsim_ros.io.files import write_json
    from dotsim_ros.io.page import HTML, block_markdown
    from dotsim_ros.io.printable import one_line

    given = {c: getattr(arguments, f"{c}_topic") for c in ("pose", "wrench", "skin", "image")}
    found = evaluate_twin(
        arguments.data,
        sensor=arguments.sensor,
        trajectories=arguments.trajectories,
        indenters=arguments.indenters,
        from_depth_m=1e-3 * arguments.from_depth_mm,
        workers=crew_of(arguments),
        seed=arguments.seed,
        topics=Topics(**{channel: topic for channel, topic in given.items() if topic is not None}),
        progress=show_stage,
    )
    errors = errors_of(found)
    page = page_of(found, errors)
    write_evaluation(arguments.out, page, errors)
    if arguments.json is not None:
        write_json(arguments.json, errors)
    print(block_markdown(table_of({"all": errors["all"], **errors["indenters"]})))
    left_out = [f"left out: {one_line(omission.reason)}" for omission in found.omissions]
    print("\n".join([*left_out, one_line(page.lead), f"report: {arguments.out / HTML}"]))
    return 0
