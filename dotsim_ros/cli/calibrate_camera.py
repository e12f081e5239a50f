# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fit the camera and its lights to the images of measured presses.

Reads a data set with images (dataset.yaml, bags, idle_*.png) and a sensor whose gel is calibrated;
fits centre, tilt, focal length, radial term, LEDs, gloss and vignetting on the presses that are not
held out, and judges the warped image on all. Writes the sensor's file with the fitted camera, the
mean idle image with its lights next to it, and a report: OUT without its suffix plus
`_camera_report/`, with report.json and sheet.png. docs/camera.md says what the figures mean.

example:
  dotsim_ros calibrate-camera --data measured/sensor_a --sensor params.yaml --out params.yaml
  dotsim_ros calibrate-camera --data DIR --sensor params.yaml --out hard.yaml --leave-out 1_sphere
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from dotsim_ros.cli._options import Judged, Whole, say, topics_of

if TYPE_CHECKING:
    from dotsim_ros.io.arrays import ImageArray
    from dotsim_ros.specification import SensorSpecification
    from dotsim_ros.twin.footage import FilmedData

MARK = "camera: "
"""Begins the lines of a sensor's file that describe this fit."""


def run(
    *,
    data: Path,
    out: Path,
    sensor: str,
    stated: str = "densetact2",
    hold_out: Annotated[Whole | None, Parameter(group=Judged)] = None,
    leave_out: Annotated[tuple[str, ...], Parameter(group=Judged)] = (),
    trajectories: tuple[str, ...] = (),
    skin: Literal["measured", "gel"] | None = None,
    position: bool = False,
    seed: Whole = 0,
    json: Path | None = None,
    image_topic: str | None = None,
    pose_topic: str | None = None,
) -> int:
    """Fit, judge, write the files, and print the figures.

    Args:
        data: folder of the data set.
        out: sensor's file to write (.yaml).
        sensor: name or file of the sensor whose gel is calibrated.
        stated: name or file of the sensor whose camera and lights the fit starts from, and that its
            priors are centred on; of the projection and aspect ratio of --sensor's.
        hold_out: trajectories to judge on, drawn by the seed; 0 for none; without it 9.
        leave_out: judge on all of these indenters.
        trajectories: use these alone; without it all with images.
        skin: shape of the skin that the lens is fitted with; without it measured where the data set
            has it. Lights and scores always take the gel's.
        position: fit the camera's place as well, within 0.2 mm.
        seed: of the split.
        json: write the figures to this file as well.
        image_topic: of the image.
        pose_topic: of the indenter's pose.
    """
    from dotsim_ros.calibration.camera.fit import fit_camera
    from dotsim_ros.calibration.camera.model import (
        LENS,
        POSITION,
        CameraModel,
        camera_section,
        describe_lights,
        read_lights,
    )
    from dotsim_ros.calibration.camera.report import (
        draw_sheet,
        fit_figures,
        summary_lines,
    )
    from dotsim_ros.calibration.camera.score import score_frames
    from dotsim_ros.calibration.idle_files import idle_image_of
    from dotsim_ros.data.data_set import read_data_set
    from dotsim_ros.data.split import split_of
    from dotsim_ros.geometry.camera import Camera
    from dotsim_ros.io.files import write_image, write_json
    from dotsim_ros.io.provenance import provenance
    from dotsim_ros.specification import load_sensor, read_comment, sensor_path, write_sensor
    from dotsim_ros.twin.footage import read_filmed_data, with_measured_skin

    if out.suffix not in (".yaml", ".yml"):
        raise ValueError(f"--out is {out}, expected a file that ends in .yaml")
    data_set = read_data_set(data)
    specification, start_from = load_sensor(sensor), load_sensor(stated)
    check_stated(stated, start_from, specification)
    train, held_out = split_of(
        data_set.filmed(trajectories), leave_out=leave_out, hold_out=hold_out, seed=seed
    )
    topics = topics_of(image=image_topic, pose=pose_topic)
    filmed = read_filmed_data(
        data, specification, presses=[*train, *held_out], progress=say, topics=topics
    )
    height, width = filmed.idle.shape[:2]
    lights, falloff = read_lights(start_from)
    start = CameraModel(
        Camera.from_specification(start_from.camera).scaled(width, height), lights, falloff
    )
    to_fit = _only(filmed, train)
    lens_skin = to_fit
    if skin != "gel" and (skin == "measured" or data_set.has_skin_mesh):
        lens_skin = with_measured_skin(to_fit, data, topics=topics)
    lens = (*LENS, *POSITION) if position else LENS
    fit = fit_camera(to_fit, start, lens_filmed=lens_skin, lens=lens, progress=say)
    # What no file of a sensor takes is refused before one is written.
    lights_found = describe_lights(fit.model)
    section = camera_section(fit.model, specification.camera, idle_image_of(out)[1])
    fitted = replace(specification, name=out.stem, camera=section)
    models = {
        "before": start,
        "lens": CameraModel(fit.model.camera, start.lights, start.falloff),
        "after": fit.model,
    }
    scores = {}
    for name, model in models.items():
        say(f"judging the camera {name}")
        scores[name] = {
            "train": score_frames(to_fit, model),
            "held_out": score_frames(_only(filmed, held_out), model),
        }
    figures = fit_figures(fit, scores)
    lines = summary_lines(figures)
    figures |= {
        "train": train,
        "held_out": held_out,
        "lens_fitted_with": "gel" if lens_skin is to_fit else "measured skin",
        "provenance": provenance() | {"data": data.name, "sensor": specification.name},
    }
    directory = out.with_name(f"{out.stem}_camera_report")
    write_image(directory / "sheet.png", draw_sheet(_only(filmed, held_out or train), fit.model))
    for path in filter(None, (directory / "report.json", json)):
        write_json(path, figures)
    command = (
        f"dotsim_ros calibrate-camera --data {data.name} --sensor {specification.name} "
        f"--out {out.name}"
    )
    description = (
        f"The mean idle image of the data set {data.name}; LEDs, coat and vignetting "
        f"as fitted by\n  {command}"
    )
    _write_idle_image(out.resolve(), filmed.idle, lights_found, description)
    # What an earlier fit of the camera said gives way.
    before = read_comment(sensor_path(sensor))
    comment = [line for line in before if not line.startswith(MARK)]
    comment += [f"{MARK}{line}" for line in (command, *lines)]
    write_sensor(out.resolve(), fitted, "\n".join(comment))
    print("\n".join([*lines, f"sensor: {out}", f"report: {directory}"]))
    return 0


def check_stated(name: str, stated: SensorSpecification, sensor: SensorSpecification) -> None:
    """Refuse a stated camera that cannot stand in for that of the sensor.

    Raises:
        ValueError: their projections or their aspect ratios differ.
    """
    from dotsim_ros.geometry.camera import Camera

    start, own = stated.camera, sensor.camera
    try:
        Camera.from_specification(start).scaled(own.width, own.height)
    except ValueError:
        is_alike = False
    else:
        is_alike = start.projection == own.projection
    if not is_alike:
        raise ValueError(
            f"--stated {name} has a camera of the projection {start.projection} and "
            f"{start.width}x{start.height} pixels, and the sensor {sensor.name} one of the "
            f"projection {own.projection} and {own.width}x{own.height}: the fit starts from the "
            "one and is written as the other; expected the same projection and aspect ratio: name "
            "with --stated the sensor as its maker states it, or --sensor's own file"
        )


def _only(filmed: FilmedData, names: Sequence[str]) -> FilmedData:
    return replace(filmed, presses=tuple(p for p in filmed.presses if p.name in names))


def _write_idle_image(
    sensor_file: Path, idle: ImageArray, lights: dict[str, dict[str, Any]], description: str
) -> None:
    """Write the idle image next to a sensor's file, and then its description."""
    from dotsim_ros.calibration.idle_files import idle_image_of, write_description
    from dotsim_ros.io.files import write_image
    from dotsim_ros.optics.idle import fine_path

    image, _ = idle_image_of(sensor_file)
    write_image(image, idle)
    # Samples between the pixels of the image that was there before.
    fine_path(image).unlink(missing_ok=True)
    write_description(image, lights, description)
