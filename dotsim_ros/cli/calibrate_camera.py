# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Fit the camera and its lights to the images of measured presses.

Reads a data set with images (dataset.yaml, bags, idle_*.png) and a sensor whose gel is calibrated;
fits centre, tilt, focal length, radial term, LEDs, gloss and vignetting on the presses that are not
held out, and judges the warped image on all. Writes the sensor's file with the fitted camera, the
mean idle image with its lights next to it, and a report: OUT without its suffix plus
`_camera_report/`, with report.json and sheet.png. docs/camera.md says what the figures mean.

examples:
  dotsim_ros calibrate-camera --data measured/sensor_a --sensor params.yaml --out params.yaml
  dotsim_ros calibrate-camera --data DIR --sensor params.yaml --out hard.yaml --leave-out 1_sphere
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dotsim_ros.data.data_set import DataSet
    from dotsim_ros.specification import SensorSpecification
    from dotsim_ros.twin.footage import FilmedData

HELD_OUT_COUNT = 9
MARK = "camera: "
"""Begins the lines of a sensor's file that describe this fit."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the verb takes."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--out", type=Path, required=True, help="sensor's file to write (.yaml)")
    parser.add_argument(
        "--sensor", required=True, help="name or file of the sensor whose gel is calibrated"
    )
    parser.add_argument(
        "--stated",
        default="densetact2",
        help="name or file of the sensor whose camera and lights the fit starts from, and that its "
        "priors are centred on; of the projection and aspect ratio of --sensor's (densetact2)",
    )
    judged = parser.add_mutually_exclusive_group()
    judged.add_argument(
        "--hold-out",
        type=int,
        metavar="N",
        help=f"trajectories to judge on, drawn by the seed; 0 for none ({HELD_OUT_COUNT})",
    )
    judged.add_argument(
        "--leave-out", nargs="+", metavar="INDENTER", help="judge on all of these indenters"
    )
    parser.add_argument(
        "--trajectories", nargs="+", metavar="NAME", help="use these alone (all with images)"
    )
    parser.add_argument(
        "--skin",
        choices=("measured", "gel"),
        help="shape of the skin that the lens is fitted with (measured where the data set has it); "
        "lights and scores always take the gel's",
    )
    parser.add_argument(
        "--position", action="store_true", help="fit the camera's place as well, within 0.2 mm"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the split (0)")
    parser.add_argument("--json", type=Path, help="write the figures to this file as well")
    parser.add_argument("--image-topic", metavar="TOPIC", help="topic of the image")
    parser.add_argument("--pose-topic", metavar="TOPIC", help="topic of the indenter's pose")


def run(arguments: argparse.Namespace) -> int:
    """Fit, judge, write the files, and print the figures."""
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
    from dotsim_ros.data.trajectory import Topics
    from dotsim_ros.geometry.camera import Camera
    from dotsim_ros.io.files import write_image, write_json
    from dotsim_ros.io.provenance import provenance
    from dotsim_ros.specification import load_sensor
    from dotsim_ros.twin.footage import read_filmed_data, with_measured_skin

    out: Path = arguments.out
    if out.suffix not in (".yaml", ".yml"):
        raise ValueError(f"--out is {out}, expected a file that ends in .yaml")
    data_set = read_data_set(arguments.data)
    sensor, stated = load_sensor(arguments.sensor), load_sensor(arguments.stated)
    check_stated(arguments, stated, sensor)
    train, held_out = split(data_set, arguments)
    given = {"image": arguments.image_topic, "pose": arguments.pose_topic}
    topics = Topics(**{name: topic for name, topic in given.items() if topic is not None})
    filmed = read_filmed_data(
        arguments.data, sensor, presses=[*train, *held_out], progress=_say, topics=topics
    )
    height, width = filmed.idle.shape[:2]
    lights, falloff = read_lights(stated)
    start = CameraModel(
        Camera.from_specification(stated.camera).scaled(width, height), lights, falloff
    )
    to_fit = _only(filmed, train)
    lens_skin = to_fit
    if arguments.skin != "gel" and (arguments.skin == "measured" or data_set.has_skin_mesh):
        lens_skin = with_measured_skin(to_fit, arguments.data, topics=topics)
    lens = (*LENS, *POSITION) if arguments.position else LENS
    fit = fit_camera(to_fit, start, lens_filmed=lens_skin, lens=lens, progress=_say)
    # What no file of a sensor takes is refused before one is written.
    lights_found = describe_lights(fit.model)
    section = camera_section(fit.model, sensor.camera, idle_image_of(out)[1])
    fitted = replace(sensor, name=out.stem, camera=section)
    models = {
        "before": start,
        "lens": CameraModel(fit.model.camera, start.lights, start.falloff),
        "after": fit.model,
    }
    scores = {}
    for name, model in models.items():
        _say(f"judging the camera {name}")
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
        "provenance": provenance() | {"data": arguments.data.name, "sensor": sensor.name},
    }
    directory = out.with_name(f"{out.stem}_camera_report")
    write_image(directory / "sheet.png", draw_sheet(_only(filmed, held_out or train), fit.model))
    for path in filter(None, (directory / "report.json", arguments.json)):
        write_json(path, figures)
    _write_sensor(arguments, sensor, fitted, lights_found, filmed, lines)
    print("\n".join([*lines, f"sensor: {out}", f"report: {directory}"]))
    return 0


def check_stated(
    arguments: argparse.Namespace, stated: SensorSpecification, sensor: SensorSpecification
) -> None:
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
            f"--stated {arguments.stated} has a camera of the projection {start.projection} and "
            f"{start.width}x{start.height} pixels, and the sensor {sensor.name} one of the "
            f"projection {own.projection} and {own.width}x{own.height}: the fit starts from the "
            "one and is written as the other; expected the same projection and aspect ratio: name "
            "with --stated the sensor as its maker states it, or --sensor's own file"
        )


def split(data_set: DataSet, arguments: argparse.Namespace) -> tuple[list[str], list[str]]:
    """Return the names of the trajectories to fit on and to judge on.

    Raises:
        ValueError: no images, an unknown trajectory or indenter, or nothing left to fit on.
    """
    from dotsim_ros.data.split import hold_out_of_protocols

    indenter_of = {entry.name: entry.indenter for entry in data_set.entries if entry.has_images}
    if not indenter_of:
        raise ValueError(f"{arguments.data} says that none of its trajectories holds images")
    if arguments.trajectories:
        unknown = sorted(set(arguments.trajectories) - set(indenter_of))
        if unknown:
            raise ValueError(
                f"{arguments.data} has no trajectory with images named {', '.join(unknown)}"
            )
        indenter_of = {name: indenter_of[name] for name in sorted(arguments.trajectories)}
    if arguments.leave_out is not None:
        unknown = sorted(set(arguments.leave_out) - set(indenter_of.values()))
        if unknown:
            raise ValueError(
                f"--leave-out {' '.join(unknown)}: no images of it; indenters are "
                f"{', '.join(sorted(set(indenter_of.values())))}"
            )
        train = [name for name, used in indenter_of.items() if used not in arguments.leave_out]
        if not train:
            raise ValueError("--leave-out leaves no trajectory to fit on")
        return train, [name for name in indenter_of if name not in train]
    count = arguments.hold_out
    if count is None:
        count = HELD_OUT_COUNT if len(indenter_of) > HELD_OUT_COUNT else 0
    if not count:
        return sorted(indenter_of), []
    fitted, judged = hold_out_of_protocols(indenter_of, count, arguments.seed)
    return list(fitted), list(judged)


def _only(filmed: FilmedData, names: list[str]) -> FilmedData:
    return replace(filmed, presses=tuple(p for p in filmed.presses if p.name in names))


def _write_sensor(
    arguments: argparse.Namespace,
    sensor: SensorSpecification,
    fitted: SensorSpecification,
    lights: dict[str, dict[str, Any]],
    filmed: FilmedData,
    lines: list[str],
) -> None:
    """Write the idle image, its description and the sensor's file, in this order."""
    from dotsim_ros.calibration.idle_files import idle_image_of, write_description
    from dotsim_ros.io.files import write_image
    from dotsim_ros.optics.idle import fine_path
    from dotsim_ros.specification import read_comment, sensor_path, write_sensor

    out = arguments.out.resolve()
    image, _ = idle_image_of(out)
    write_image(image, filmed.idle)
    # Samples between the pixels of the image that was there before.
    fine_path(image).unlink(missing_ok=True)
    command = (
        f"dotsim_ros calibrate-camera --data {arguments.data.name} --sensor {sensor.name} "
        f"--out {out.name}"
    )
    write_description(
        image,
        lights,
        f"The mean idle image of the data set {arguments.data.name}; LEDs, coat and vignetting "
        f"as fitted by\n  {command}",
    )
    # What an earlier fit of the camera said gives way.
    before = read_comment(sensor_path(arguments.sensor))
    comment = [line for line in before if not line.startswith(MARK)]
    comment += [f"{MARK}{line}" for line in (command, *lines)]
    write_sensor(out, fitted, "\n".join(comment))


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
