"""Fit the gel's constants to measured presses, and say which of them the data can tell.

Reads a data set (dataset.yaml and one bag a trajectory), fits each trajectory by itself and all
together, and judges the result on trajectories that were held out. Writes the sensor's file that
tactile_sim loads, and a report beside it: OUT without its suffix plus `_report/`, with report.html,
report.json and the run's files, from which a killed run goes on when called again.

example:
  dotsim_ros calibrate --data measured/sensor_a --out params.yaml
  dotsim_ros calibrate --data measured/sensor_a --out params.yaml --fit E nu friction c20
  dotsim_ros calibrate --data measured/sensor_a --out 2_cone.yaml --leave-out 2_cone
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dotsim_ros.calibration.loss import LossNoise
    from dotsim_ros.measured.trajectory import Topics

LOSSES = ("points", "chamfer", "force")
WORKER_COUNT = 2
HELD_OUT_COUNT = 9


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--out", type=Path, required=True, help="sensor's file to write (.yaml)")
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
    parser.add_argument("--workers", type=int, default=WORKER_COUNT, help="processes (2)")
    parser.add_argument("--seed", type=int, default=0, help="of what is held out and drawn (0)")
    parser.add_argument("--json", type=Path, help="copy the figures to this file as well")
    for channel in ("pose", "wrench", "skin"):
        parser.add_argument(f"--{channel}-topic", metavar="TOPIC", help=f"of the {channel}")
    for name, what in _NOISES.items():
        parser.add_argument(f"--noise-{name}", type=float, metavar="SIGMA", help=what)


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
    from dotsim_ros.calibration.report import summary_lines, write_report
    from dotsim_ros.calibration.run import CalibrationRequest, calibrate
    from dotsim_ros.files import write_text
    from dotsim_ros.measured.data_set import read_data_set
    from dotsim_ros.measured.split import hold_out_of_protocols
    from dotsim_ros.specification import load_sensor, write_sensor

    out: Path = arguments.out
    if out.suffix not in (".yaml", ".yml"):
        raise ValueError(f"--out is {out}, expected a file that ends in .yaml")
    data_set = read_data_set(arguments.data)
    indenter_of = {entry.name: entry.indenter for entry in data_set.entries}
    names = sorted(arguments.trajectories or indenter_of)
    unknown = sorted(set(names) - set(indenter_of))
    if unknown:
        raise ValueError(f"{arguments.data} has no trajectory {', '.join(unknown)}")
    if arguments.leave_out is not None:
        train = tuple(n for n in names if indenter_of[n] != arguments.leave_out)
        held_out = tuple(n for n in names if indenter_of[n] == arguments.leave_out)
        if not train or not held_out:
            raise ValueError(
                f"--leave-out {arguments.leave_out} leaves {len(train)} trajectories to fit on and "
                f"{len(held_out)} to judge on; indenters are {sorted(set(indenter_of.values()))}"
            )
    else:
        count = arguments.hold_out
        if count is None:
            count = HELD_OUT_COUNT if len(names) > HELD_OUT_COUNT else 0
        train, held_out = tuple(names), ()
        if count:
            train, held_out = hold_out_of_protocols(names, count, arguments.seed)
    has_mesh = (data_set.directory / "skin_mesh.npz").is_file()
    directory = out.with_name(f"{out.stem}_report")
    calibration = calibrate(
        CalibrationRequest(
            data_set=data_set,
            sensor=load_sensor(arguments.sensor),
            train=train,
            held_out=held_out,
            fit=tuple(name for name in arguments.fit if name != "offset"),
            with_offset="offset" in arguments.fit,
            losses=tuple(arguments.loss or (("points" if has_mesh else "chamfer"), "force")),
            noise=_noise(arguments),
            topics=_topics(arguments),
            directory=arguments.run or directory / "run",
            workers=arguments.workers,
            seed=arguments.seed,
            joint_steps=arguments.joint_steps,
            solve_budget=arguments.solves,
        ),
        _show,
    )
    report = write_report(directory, calibration, seed=arguments.seed)
    lines = summary_lines(calibration)
    write_sensor(out, calibration.named(arguments.name or out.stem), "\n".join(lines))
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        write_text(arguments.json, (directory / "report.json").read_text(encoding="utf-8"))
    print("\n".join([*lines, f"sensor: {out}", f"report: {report}"]))
    return 0


def _noise(arguments: argparse.Namespace) -> LossNoise:
    from dotsim_ros.calibration.loss import LossNoise

    given = {
        field.name: getattr(arguments, f"noise_{field.name}", None) for field in fields(LossNoise)
    }
    return LossNoise(**{name: value for name, value in given.items() if value is not None})


def _topics(arguments: argparse.Namespace) -> Topics:
    from dotsim_ros.measured.trajectory import Topics

    given = {name: getattr(arguments, f"{name}_topic") for name in ("pose", "wrench", "skin")}
    return Topics(**{name: topic for name, topic in given.items() if topic is not None})


def _show(stage: str, done: int, total: int) -> None:
    """Draw a bar on a terminal; elsewhere print each stage's beginning and end."""
    if sys.stderr.isatty():
        filled = 30 * done // max(total, 1)
        end = "\n" if done == total else ""
        print(f"\r{stage:<10} [{'#' * filled:<30}] {done}/{total}", end=end, file=sys.stderr)
    elif done in (0, total):
        print(f"{stage}: {done}/{total}", file=sys.stderr, flush=True)
