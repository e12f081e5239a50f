# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fit the gel's constants to measured presses, and report which of them the data identify.

Reads a data set (dataset.yaml and one bag a trajectory), fits each trajectory by itself and all
together, and judges the result on trajectories that were held out. Writes the sensor's file that
tactile_sim loads, and a report next to it: OUT without its suffix plus `_report/`, with
report.html, report.json and the run's files, from which an interrupted run resumes.

With `--guided` it makes the sensor's file from a folder of photographs of a ball instead, without
force and without a stage: idle image, scale, shading, and a report that says what photographs do
not tell. With `--data` next to it, the gel's constants are then fitted to presses with force.
docs/calibration.md walks through it.

example:
  dotsim_ros calibrate --data measured/sensor_a --out params.yaml
  dotsim_ros calibrate --data measured/sensor_a --out params.yaml --fit E nu friction c20
  dotsim_ros calibrate --data measured/sensor_a --out 2_cone.yaml --leave-out 2_cone
  dotsim_ros calibrate --guided photographs --ball-diameter-mm 4.7 --out pad.yaml
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from dotsim_ros.cli._options import (
    HERE,
    Judged,
    Meshes,
    Whole,
    WorkerOptions,
    show_stage,
    topics_of,
    within,
)

if TYPE_CHECKING:
    from dotsim_ros.calibration.loss import LossNoise

GUIDED = Parameter(group=Group("From photographs of a ball"))


@Parameter(name="*")
@dataclass(frozen=True)
class NoiseOptions:
    """Standard deviations of the measurement's errors.

    Attributes:
        noise_skin_m: white noise of a skin point, an axis, m; without it 0.04e-3.
        noise_skin_discretisation_m: error of the skin that a patch has in common, m; without it
            0.1e-3.
        noise_force_n: white noise of the force, an axis, N; without it 0.015.
        noise_force_discretisation: relative error of the force; without it 0.06.
        noise_pose_m: of the indenter's position, an axis, m; without it 0.015e-3.
        noise_pose_rad: of the indenter's rotation, an axis, rad; without it 1.5e-3.
    """

    noise_skin_m: float | None = None
    noise_skin_discretisation_m: float | None = None
    noise_force_n: float | None = None
    noise_force_discretisation: float | None = None
    noise_pose_m: float | None = None
    noise_pose_rad: float | None = None

    def loss_noise(self) -> LossNoise:
        """Return the noise, the usual one where none is given."""
        from dotsim_ros.calibration.loss import LossNoise

        given = {name: value for name, value in asdict(self).items() if value is not None}
        return LossNoise(**{name.removeprefix("noise_"): value for name, value in given.items()})


def run(
    *,
    out: Path,
    data: Path | None = None,
    sensor: str = "densetact2",
    fit: tuple[str, ...] = ("E", "nu", "friction"),
    loss: tuple[Literal["points", "chamfer", "force"], ...] = (),
    hold_out: Annotated[Whole | None, Parameter(group=Judged)] = None,
    leave_out: Annotated[str | None, Parameter(group=Judged)] = None,
    trajectories: tuple[str, ...] = (),
    indenters: Meshes = None,
    run_folder: Annotated[Path | None, Parameter(name="--run")] = None,
    joint_steps: Annotated[int, within(0, 4, int)] = 2,
    solves: Whole = 40,
    name: str | None = None,
    workers: WorkerOptions = HERE,
    seed: Whole = 0,
    json: Path | None = None,
    pose_topic: str | None = None,
    wrench_topic: str | None = None,
    skin_topic: str | None = None,
    noise: NoiseOptions = NoiseOptions(),
    guided: Annotated[Path | None, GUIDED] = None,
    ball_diameter_mm: Annotated[float | None, GUIDED] = None,
    pixels_per_mm: Annotated[float | None, GUIDED] = None,
    pad_size_mm: Annotated[tuple[float, float, float] | None, GUIDED] = None,
) -> int:
    """Calibrate, write the files, and print the figures.

    Args:
        out: sensor's file to write (.yaml).
        data: folder of the data set.
        sensor: before the fit, a name or a file: geometry, and where the priors are centred.
        fit: E, nu (or bulk_modulus), friction, c20, c30 (of Yeoh), thickness, offset (of the
            indenter, six numbers a press).
        loss: points, vertex to vertex; chamfer, the paper's, without correspondence; force. Without
            it points force, or chamfer force where the data set has no skin_mesh.npz.
        hold_out: trajectories to judge on, drawn by the seed; 0 for none; without it 9.
        leave_out: judge on all of one indenter.
        trajectories: use these alone; without it all of the data set.
        run_folder: folder of the run's files, without it OUT_report/run; fits of other splits of
            the same data that name the same one share the fits of single presses.
        joint_steps: Gauss-Newton steps of the joint fit; with 0 it weighs the fits of single
            presses by their information and needs no solve of its own.
        solves: most solves of a press; few, with --joint-steps 0 and a --sensor that is fitted
            already, take one step from there for each split.
        name: of the calibrated sensor; without it the file's stem.
        seed: of what is held out and drawn.
        json: copy the figures to this file as well.
        pose_topic: of the pose.
        wrench_topic: of the wrench.
        skin_topic: of the skin.
        guided: folder of the photographs, one without contact.
        ball_diameter_mm: of the ball.
        pixels_per_mm: of the flat gel, measured with a calliper pressed on it; without it assumed
            from the circles.
        pad_size_mm: of the pad along the image's x and y, and its thickness; without it what is
            seen, 4 thick.
    """
    if guided is None and data is None:
        raise ValueError(
            "nothing to calibrate from; name a data set with --data, or a folder of photographs of "
            "a ball with --guided"
        )
    if guided is not None:
        from dotsim_ros.calibration.calibrate import report_folder
        from dotsim_ros.io.extras import extra_needed

        with extra_needed("--guided", "learning"):
            from dotsim_ros.calibration.guided import report as guided_report
            from dotsim_ros.calibration.guided.fit import GuidedRequest, calibrate_guided
        if ball_diameter_mm is None:
            raise ValueError("--guided needs the ball's diameter; give it with --ball-diameter-mm")
        pad = pad_size_mm
        request = GuidedRequest(
            guided,
            out,
            1e-3 * ball_diameter_mm,
            pixels_per_metre=None if pixels_per_mm is None else 1e3 * pixels_per_mm,
            pad_size_m=None if pad is None else (1e-3 * pad[0], 1e-3 * pad[1], 1e-3 * pad[2]),
            name=name,
            seed=seed,
        )
        found = calibrate_guided(request, progress=print)
        guided_report.write_guided_report(report_folder(out), found)
        lines = guided_report.summary_lines(found)
        _show(lines, out, guided_report.PAGE, guided_report.FIGURES, json)
    if data is not None:
        from dotsim_ros.calibration.calibrate import calibrate
        from dotsim_ros.calibration.report import FIGURES, PAGE, summary_lines

        calibration = calibrate(
            data,
            sensor=out if guided else sensor,
            out=out,
            fit=fit,
            losses=loss or None,
            hold_out=hold_out,
            leave_out=leave_out,
            trajectories=trajectories or None,
            indenters=indenters,
            run_folder=run_folder,
            joint_steps=joint_steps,
            solves=solves,
            name=name,
            workers=workers.crew(),
            seed=seed,
            noise=noise.loss_noise(),
            topics=topics_of(pose=pose_topic, wrench=wrench_topic, skin=skin_topic),
            progress=show_stage,
        )
        _show(summary_lines(calibration), out, PAGE, FIGURES, json)
    return 0


def _show(lines: Iterable[str], out: Path, page: str, figures: str, copy: Path | None) -> None:
    """Print what was found and where its files are, and copy the figures."""
    from dotsim_ros.calibration.calibrate import report_folder
    from dotsim_ros.io.files import write_text

    report = report_folder(out)
    if copy is not None:
        write_text(copy, (report / figures).read_text(encoding="utf-8"))
    print("\n".join([*lines, f"sensor: {out}", f"report: {report / page}"]))
