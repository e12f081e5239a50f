# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fit the gel's constants to measured presses, and report which of them the data identify.

Reads a data set (dataset.yaml and one bag a trajectory), fits each trajectory by itself and all
together, and judges the result on trajectories that were held out. Writes the sensor's file that
tactile_sim loads, and a report beside it: OUT without its suffix plus `_report/`, with report.html,
report.json and the run's files, from which an interrupted run resumes.

example:
  dotsim_ros calibrate --data measured/sensor_a --out params.yaml
  dotsim_ros calibrate --data measured/sensor_a --out params.yaml --fit E nu friction c20
  dotsim_ros calibrate --data measured/sensor_a --out 2_cone.yaml --leave-out 2_cone
  dotsim_ros calibrate --guided photographs --ball-diameter-mm 4.7 --out pad.yaml

With `--guided` it makes the sensor's file from a folder of photographs of a ball instead, without
force and without a stage: idle image, scale, shading, and a report that says what photographs do
not tell. With `--data` next to it, the gel's constants are then fitted to presses with force.
docs/calibration.md walks through it.
"""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from dotsim_ros.cli._workers import add_worker_arguments, crew_of, show_stage

if TYPE_CHECKING:
    from dotsim_ros.calibration.loss import LossNoise
    from dotsim_ros.data.trajectory import Topics

LOSSES = ("points", "chamfer", "force")
HELD_OUT_COUNT = 9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument("--data", type=Path, help="folder of the data set")
    parser.add_argument("--out", type=Path, required=True, help="sensor's file to write (.yaml)")
    _add_guided_arguments(parser)
    parser.add_argument(
        "--sensor",
        default="densetact2",
        help="sensor before the fit, a name or a file: geometry, and where the priors are centred",
    )
    parser.add_argument(
        "--fit",
        nargs="+",
        default=["E", "nu", "friction"],
        metavar="NAME",
        help="E, nu (or bulk_modulus), friction, c20, c30 (of Yeoh), thickness, offset (of the "
        "indenter, six numbers a press) (E nu friction)",
    )
    parser.add_argument(
        "--loss",
        nargs="+",
        choices=LOSSES,
        help="points: vertex to vertex; chamfer: the paper's, without correspondence; force "
        "(points force; chamfer force where the data set has no skin_mesh.npz)",
    )
    judged = parser.add_mutually_exclusive_group()
    judged.add_argument(
        "--hold-out",
        type=int,
        metavar="N",
        help=f"trajectories to judge on, drawn by the seed; 0 for none ({HELD_OUT_COUNT})",
    )
    judged.add_argument("--leave-out", metavar="INDENTER", help="judge on all of one indenter")
    parser.add_argument(
        "--trajectories", nargs="+", metavar="NAME", help="use these alone (all of the data set)"
    )
    parser.add_argument(
        "--indenters",
        type=Path,
        metavar="DIR",
        help="folder of the indenters' meshes (in the data set, then next to it)",
    )
    parser.add_argument(
        "--run",
        type=Path,
        metavar="DIR",
        help="folder of the run's files (OUT_report/run); fits of other splits of the same data "
        "that name the same one share the fits of single presses",
    )
    parser.add_argument(
        "--joint-steps",
        type=int,
        default=2,
        choices=range(5),
        help="Gauss-Newton steps of the joint fit; with 0 it weighs the fits of single presses by "
        "their information and needs no solve of its own (2)",
    )
    parser.add_argument(
        "--solves",
        type=int,
        default=40,
        metavar="N",
        help="most solves of a press; few, with --joint-steps 0 and a --sensor that is fitted "
        "already, take one step from there for each split (40)",
    )
    parser.add_argument("--name", help="of the calibrated sensor (the file's stem)")
    add_worker_arguments(parser)
    parser.add_argument("--seed", type=int, default=0, help="of what is held out and drawn (0)")
    parser.add_argument("--json", type=Path, help="copy the figures to this file as well")
    for channel in ("pose", "wrench", "skin"):
        parser.add_argument(f"--{channel}-topic", metavar="TOPIC", help=f"of the {channel}")
    for name, what in _NOISES.items():
        parser.add_argument(f"--noise-{name}", type=float, metavar="SIGMA", help=what)


def _add_guided_arguments(parser: argparse.ArgumentParser) -> None:
    guided = parser.add_argument_group("from photographs of a ball")
    guided.add_argument(
        "--guided", type=Path, metavar="FOLDER", help="of the photographs, one without contact"
    )
    guided.add_argument("--ball-diameter-mm", type=float, metavar="MM", help="of the ball")
    guided.add_argument(
        "--pixels-per-mm",
        type=float,
        metavar="PX",
        help="of the flat gel, measured with a calliper pressed on it (assumed from the circles)",
    )
    guided.add_argument(
        "--pad-size-mm",
        type=float,
        nargs=3,
        metavar="MM",
        help="of the pad along the image's x and y, and its thickness (what is seen, 4 thick)",
    )


_NOISES = {
    "skin-m": "white noise of a skin point, an axis, m (0.04e-3)",
    "skin-discretisation-m": "error of the skin that a patch has in common, m (0.1e-3)",
    "force-n": "white noise of the force, an axis, N (0.015)",
    "force-discretisation": "relative error of the force (0.06)",
    "pose-m": "of the indenter's position, an axis, m (0.015e-3)",
    "pose-rad": "of the indenter's rotation, an axis, rad (1.5e-3)",
}


def run(arguments: argparse.Namespace) -> int:
    """Calibrate, write the files, and print the figures."""
    if arguments.guided is None and arguments.data is None:
        raise ValueError(
            "nothing to calibrate from; name a data set with --data, or a folder of photographs of "
            "a ball with --guided"
        )
    if arguments.guided is not None:
        _run_guided(arguments)
    if arguments.data is not None:
        _run_presses(arguments, arguments.out if arguments.guided else arguments.sensor)
    return 0


def _run_guided(arguments: argparse.Namespace) -> None:
    from dotsim_ros.io.files import write_text

    try:
        from dotsim_ros.calibration.calibrate import report_folder
        from dotsim_ros.calibration.guided.fit import GuidedRequest, calibrate_guided
        from dotsim_ros.calibration.guided.report import (
            FIGURES,
            PAGE,
            summary_lines,
            write_guided_report,
        )
    except ModuleNotFoundError as error:
        raise ValueError(
            f"--guided needs {error.name}, which is not installed; install dotsim_ros[learning]"
        ) from error
    if arguments.ball_diameter_mm is None:
        raise ValueError("--guided needs the ball's diameter; give it with --ball-diameter-mm")
    scale, pad = arguments.pixels_per_mm, arguments.pad_size_mm
    request = GuidedRequest(
        arguments.guided,
        arguments.out,
        1e-3 * arguments.ball_diameter_mm,
        pixels_per_metre=None if scale is None else 1e3 * scale,
        pad_size_m=None if pad is None else (1e-3 * pad[0], 1e-3 * pad[1], 1e-3 * pad[2]),
        name=arguments.name,
        seed=arguments.seed,
    )
    found = calibrate_guided(request, progress=print)
    report = report_folder(arguments.out)
    write_guided_report(report, found)
    if arguments.json is not None:
        write_text(arguments.json, (report / FIGURES).read_text(encoding="utf-8"))
    lines = summary_lines(found)
    print("\n".join([*lines, f"sensor: {arguments.out}", f"report: {report / PAGE}"]))


def _run_presses(arguments: argparse.Namespace, sensor: str | Path) -> None:
    from dotsim_ros.calibration.calibrate import calibrate, report_folder
    from dotsim_ros.calibration.report import FIGURES, PAGE, summary_lines
    from dotsim_ros.io.files import write_text

    calibration = calibrate(
        arguments.data,
        sensor=sensor,
        out=arguments.out,
        fit=arguments.fit,
        losses=arguments.loss,
        hold_out=arguments.hold_out,
        leave_out=arguments.leave_out,
        trajectories=arguments.trajectories,
        indenters=arguments.indenters,
        run_folder=arguments.run,
        joint_steps=arguments.joint_steps,
        solves=arguments.solves,
        name=arguments.name,
        workers=crew_of(arguments),
        seed=arguments.seed,
        noise=_noise(arguments),
        topics=_topics(arguments),
        progress=show_stage,
    )
    report = report_folder(arguments.out)
    if arguments.json is not None:
        write_text(arguments.json, (report / FIGURES).read_text(encoding="utf-8"))
    lines = summary_lines(calibration)
    print("\n".join([*lines, f"sensor: {arguments.out}", f"report: {report / PAGE}"]))


def _noise(arguments: argparse.Namespace) -> LossNoise:
    from dotsim_ros.calibration.loss import LossNoise

    given = {
        field.name: getattr(arguments, f"noise_{field.name}", None) for field in fields(LossNoise)
    }
    return LossNoise(**{name: value for name, value in given.items() if value is not None})


def _topics(arguments: argparse.Namespace) -> Topics:
    from dotsim_ros.data.trajectory import Topics

    given = {name: getattr(arguments, f"{name}_topic") for name in ("pose", "wrench", "skin")}
    return Topics(**{name: topic for name, topic in given.items() if topic is not None})
