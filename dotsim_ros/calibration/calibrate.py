# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole calibration in one call: what `dotsim_ros calibrate` does."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dotsim_ros.calibration.idle_files import (
    DescribedImage,
    described_image,
    write_lowered_copy,
)
from dotsim_ros.calibration.loss import CHAMFER, FORCE, POINTS, LossNoise
from dotsim_ros.calibration.parameters import chosen_parameters
from dotsim_ros.calibration.report import summary_lines, write_report
from dotsim_ros.calibration.run import (
    JOINT_STEPS,
    SOLVE_BUDGET,
    Calibration,
    CalibrationRequest,
    Progress,
    face_drop_m,
    run_calibration,
)
from dotsim_ros.data.data_set import DataSet, read_data_set
from dotsim_ros.data.split import split_of
from dotsim_ros.data.trajectory import MEASURED_TOPICS, Topics
from dotsim_ros.io.cores import single_threaded
from dotsim_ros.io.files import check_output_file, check_output_folder
from dotsim_ros.io.worker_pool.pool import Crew, check_workers
from dotsim_ros.specification import SensorSpecification, given_sensor, write_sensor

LOSSES = (POINTS, CHAMFER, FORCE)
FITTED = ("E", "nu", "friction")
OFFSET = "offset"
"""The name by which an offset of the indenter is fitted, which is a press's own."""
THICKNESS = "thickness"
MOST_JOINT_STEPS = 4


@single_threaded()
def calibrate(
    data: str | Path | DataSet,
    *,
    sensor: str | Path | SensorSpecification = "densetact2",
    out: str | Path | None = None,
    fit: Sequence[str] = FITTED,
    losses: Sequence[str] | None = None,
    hold_out: int | None = None,
    leave_out: str | None = None,
    trajectories: Sequence[str] | None = None,
    indenters: str | Path | None = None,
    run_folder: str | Path | None = None,
    joint_steps: int = JOINT_STEPS,
    solves: int = SOLVE_BUDGET,
    name: str | None = None,
    workers: Crew = 2,
    seed: int = 0,
    noise: LossNoise | None = None,
    topics: Topics = MEASURED_TOPICS,
    progress: Progress | None = None,
) -> Calibration:
    """Fit the gel's constants to measured presses, and say which of them the data identify.

    It starts processes, so a script calls it below `if __name__ == "__main__":`.

    Args:
        data: folder of the data set, or the data set.
        sensor: before the fit, a name, a YAML file or a specification: geometry, and where the
            priors are centred.
        out: file (.yaml) to write the calibrated sensor to, with the report in a folder next to it:
            `report_folder(out)`. Where a pad's thickness is fitted and a file beside its idle image
            states the lights, a copy of both, with the lights moved along, lies there too. None
            writes nothing.
        fit: of "E", "nu" (or "bulk_modulus"), "friction", "contact_stiffness", "c20", "c30",
            "thickness", and "offset", which is of the indenter, six numbers a press.
        losses: of "points" (vertex to vertex), "chamfer" (without correspondence) and "force"; by
            default points and force, chamfer and force where the data set has no skin_mesh.npz.
        hold_out: trajectories to judge on, drawn by the seed; 0 for none; by default nine of more
            than nine.
        leave_out: name of an indenter; judge on all of its trajectories instead.
        trajectories: names of those to use; by default all of the data set.
        indenters: folder of the indenters' meshes; by default looked for in the data set, then
            next to it.
        run_folder: of the run's files, from which an interrupted run resumes; by default
            `run` in the report's folder, and where nothing is written, none is kept.
        joint_steps: Gauss-Newton steps of the joint fit, 0 to 4. With 0 it weighs the fits of
            single presses by their information and needs no solve of its own.
        solves: most solves of a press.
        name: of the calibrated sensor; by default the file's stem, or the sensor's own.
        workers: how many processes, or workers of Ray.
        seed: of what is held out and drawn.
        noise: of the measurement; by default as `LossNoise` has it.
        topics: where the channels lie in the bags.
        progress: called with the stage, how many presses of it are done, and of how many.

    Returns:
        What was found; `specification` is the calibrated sensor.

    Raises:
        FileNotFoundError: no data set or sensor there.
        OSError: `out` cannot be written, before anything is solved.
        ValueError: an argument that is out of range or names nothing, before anything is read of
            the bags or written; or no trajectory that can be fitted.
    """
    out = None if out is None else Path(out)
    if out is not None and out.suffix not in (".yaml", ".yml"):
        raise ValueError(f"out is {out}, expected a file that ends in .yaml")
    parameters = tuple(parameter for parameter in fit if parameter != OFFSET)
    chosen_parameters(parameters)
    check_workers(workers)
    _check_at_least(1, solves=solves)
    _check_at_least(0, hold_out=hold_out or 0, joint_steps=joint_steps, seed=seed)
    if joint_steps > MOST_JOINT_STEPS:
        raise ValueError(f"joint_steps is {joint_steps}, expected 0 to {MOST_JOINT_STEPS}")
    data_set = data if isinstance(data, DataSet) else read_data_set(data)
    specification = given_sensor(sensor)
    if indenters is not None and not Path(indenters).is_dir():
        raise FileNotFoundError(f"there is no folder {indenters}, expected one of meshes, NAME.stl")
    if leave_out is not None and hold_out is not None:
        raise ValueError("either hold out trajectories or leave out an indenter, not both")
    train, held_out = split_of(
        data_set.entries if trajectories is None else data_set.named(trajectories),
        leave_out=() if leave_out is None else (leave_out,),
        hold_out=hold_out,
        seed=seed,
    )
    used = _losses(data_set, losses)
    if out is not None:
        check_output_file(out)
        check_output_folder(report_folder(out))
    if run_folder is not None:
        check_output_folder(run_folder)
    moves = THICKNESS in parameters and specification.gel.shape != "dome"
    described = described_image(specification) if moves else None
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) if out is None else report_folder(out) / "run"
        calibration = run_calibration(
            CalibrationRequest(
                data_set=data_set,
                sensor=specification,
                train=train,
                held_out=held_out,
                fit=parameters,
                with_offset=OFFSET in fit,
                losses=used,
                noise=LossNoise() if noise is None else noise,
                topics=topics,
                directory=folder if run_folder is None else Path(run_folder),
                workers=workers,
                seed=seed,
                joint_steps=joint_steps,
                solve_budget=solves,
                indenters=None if indenters is None else Path(indenters),
            ),
            progress or (lambda _stage, _done, _total: None),
        )
    named = name or (specification.name if out is None else out.stem)
    calibration = replace(calibration, specification=calibration.named(named))
    calibration = _as_lit_before(calibration, specification, described, out)
    if out is not None:
        # The sensor first: it is what all the solves were for.
        write_sensor(out, calibration.specification, "\n".join(summary_lines(calibration)))
        try:
            write_report(report_folder(out), calibration, seed=seed)
        except (OSError, ValueError, RuntimeError) as error:
            raise OSError(
                f"{out} holds the calibrated sensor, but its report could not be written to "
                f"{report_folder(out)}: {error}; mend that and give the same command again, which "
                "solves nothing again"
            ) from error
    return calibration


def _as_lit_before(
    calibration: Calibration,
    before: SensorSpecification,
    described: DescribedImage | None,
    out: Path | None,
) -> Calibration:
    """Return a calibration whose sensor has its lights as far from a pad's face as before, with
    remarks on what its file has otherwise than the sensor before.

    Lights that stand next to the idle image, `described`, come before the sensor's own; a copy of
    them is written next to the sensor's file, where one is written.
    """
    sensor, remarks = calibration.specification, []
    if before.camera.residual and not sensor.camera.residual:
        remarks.append(
            f"network: {before.camera.residual} is for the name and the camera of the sensor "
            "before, and this sensor names none; train one with dotsim_ros train-optics"
        )
    drop_m = face_drop_m(sensor, before)
    if described is not None and drop_m != 0.0:
        beside = described.image.with_suffix(".yaml")
        if out is None:
            remarks.append(
                f"lights: {beside} has them where they were, and comes before this sensor's own; "
                "give a file to write the sensor to, and a copy has them as far from the face as "
                "before"
            )
        else:
            name = write_lowered_copy(described, drop_m, out)
            sensor = replace(sensor, camera=replace(sensor.camera, idle_image=name))
            remarks.append(
                f"lights: as far from the face as before, beside a copy of the idle image, {name}; "
                f"{beside} has them where they were"
            )
    return replace(calibration, specification=sensor, remarks=tuple(remarks))


def report_folder(out: Path) -> Path:
    """Return the folder of the report that belongs to a calibrated sensor's file."""
    return out.with_name(f"{out.stem}_report")


def _check_at_least(least: int, **counts: int) -> None:
    for name, count in counts.items():
        if count < least:
            raise ValueError(f"{name} is {count}, expected {least} or more")


def _losses(data_set: DataSet, losses: Sequence[str] | None) -> tuple[str, ...]:
    """Return the losses to use.

    Raises:
        ValueError: an unknown one, or none.
    """
    if losses is None:
        return (POINTS if data_set.has_skin_mesh else CHAMFER), FORCE
    unknown = sorted(set(losses) - set(LOSSES))
    if unknown or not losses:
        raise ValueError(
            f"losses are {', '.join(losses) or 'none'}, expected of {', '.join(LOSSES)}"
        )
    return tuple(losses)
