# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""From a data set to a sensor with a trained network: what `dotsim_ros train-optics` does."""

from __future__ import annotations

import datetime
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.documents import read_yaml
from dotsim_ros.io.files import parameter_path, write_image, write_json, write_text
from dotsim_ros.io.provenance import provenance
from dotsim_ros.learning.export import write_network
from dotsim_ros.learning.fitting import FittedNetwork, check_width, fit_network
from dotsim_ros.learning.pattern import with_learned_pattern
from dotsim_ros.learning.recipe import check_epochs
from dotsim_ros.learning.training import TrainingProgress
from dotsim_ros.optics.idle import description_of, fine_path, lights_of
from dotsim_ros.optics.network.card import NetworkCard
from dotsim_ros.optics.picture import change_image, titled
from dotsim_ros.specification import SensorSpecification, write_sensor
from dotsim_ros.twin.footage import (
    FilmedData,
    OpticalData,
    OpticalPress,
    camera_for,
    read_filmed_data,
    render_filmed,
)
from dotsim_ros.twin.image_metrics import image_psnr_db

IDLE = "idle.png"
SENSOR = "sensor.yaml"
PREVIEW = "preview.png"
REPORT = "training.json"
ERROR_GAIN = 4.0


@dataclass(frozen=True)
class TrainOpticsRequest:
    """What to train.

    Attributes:
        data: folder of the data set.
        sensor: with calibrated gel and camera.
        train, held_out: names of the presses to train on, and to judge on (may be none).
        kind: of the network.
        seed: of the training.
        epochs: of the training; None for the network's own number.
        size: width of the network's images; None for the default.
        out: folder of what a sensor with the network needs.
        record: folder of the training's state, preview and report.
        sensor_file: of the sensor with the network.
        sensor_comment: that begins that file.
    """

    data: Path
    sensor: SensorSpecification
    train: tuple[str, ...]
    held_out: tuple[str, ...]
    kind: str
    seed: int
    epochs: int | None
    size: int | None
    out: Path
    record: Path
    sensor_file: Path
    sensor_comment: str


def scores(
    presses: tuple[OpticalPress, ...], predicted: list[ImageArray], idle: ImageArray
) -> dict[str, float]:
    """Return mean PSNR (dB) over all frames and over the deepest of each press, of three images."""
    every: dict[str, list[float]] = {"idle": [], "carried": [], "predicted": []}
    deepest: dict[str, list[float]] = {name: [] for name in every}
    for press, images in zip(presses, predicted, strict=True):
        deep = int(np.argmax(press.tip_depth_m))
        for frame, measured in enumerate(press.measured):
            shown = {"idle": idle, "carried": press.warped[frame], "predicted": images[frame]}
            for name, image in shown.items():
                score = image_psnr_db(image, measured)
                every[name].append(score)
                if frame == deep:
                    deepest[name].append(score)
    return {
        f"{name}_{which}_psnr_db": round(float(np.mean(values[name])), 3)
        for which, values in (("all", every), ("deepest", deepest))
        for name in every
    }


def read_presses(
    request: TrainOpticsRequest, say: Callable[[str], None]
) -> tuple[FilmedData, OpticalData]:
    """Return what was filmed, by an idle image that those trained on refine, and what the camera
    saw of it."""
    filmed = read_filmed_data(
        request.data, request.sensor, presses=[*request.train, *request.held_out], progress=say
    )
    camera = camera_for(request.sensor, filmed.idle, str(request.data))
    lighting, vignetting = lights_of(request.sensor)
    say("learning the pattern between the pixels")
    filmed = with_learned_pattern(
        filmed, camera, lighting=lighting, vignetting=vignetting, presses=request.train
    )
    return filmed, render_filmed(filmed, camera, lighting=lighting, vignetting=vignetting)


def train_optics(
    request: TrainOpticsRequest,
    *,
    say: Callable[[str], None],
    progress: Callable[[TrainingProgress], None],
) -> dict[str, Any]:
    """Train a network and write it with its idle image, its sensor, a preview and a report.

    Returns:
        What the report holds.

    Raises:
        ValueError: as `read_filmed_data` and `fit_network`.
    """
    # What cannot be trained is refused before the gel is solved for every frame.
    if request.size is not None:
        check_width(request.size)
    check_epochs(request.epochs)
    filmed, data = read_presses(request, say)
    by_name = {press.name: press for press in data.presses}
    train = [by_name[name] for name in request.train]
    network = fit_network(
        request.kind,
        train,
        data.rest,
        data.camera,
        seed=request.seed,
        epochs=request.epochs,
        size=request.size,
        directory=request.record,
        progress=progress,
    )
    judged = tuple(by_name[name] for name in request.held_out) or tuple(train)
    predicted = [network.predict(press, data.rest) for press in judged]
    metrics = scores(judged, predicted, data.rest.idle)
    origin = provenance()
    card = write_network(
        request.out, network.trained.network, _card(request, network, metrics, origin)
    )
    _write_sensor(request, filmed)
    write_preview(request.record / PREVIEW, judged, predicted)
    report = {
        "judged_on": list(request.held_out) or "the presses trained on: none was held out",
        "metrics": metrics,
        "epochs": network.trained.epochs,
        "minutes": round(network.trained.spent_s / 60.0, 2),
        "training_psnr_db": [round(value, 3) for value in network.trained.psnr_db],
        "weights_sha256": card.weights_sha256,
        "origin": origin,
    }
    write_json(request.record / REPORT, report)
    return report


def _card(
    request: TrainOpticsRequest,
    network: FittedNetwork,
    metrics: Mapping[str, float],
    origin: Mapping[str, str],
) -> NetworkCard:
    return replace(
        network.card(request.sensor.name),
        data={
            "name": request.data.resolve().name,
            "train": list(request.train),
            "held_out": list(request.held_out),
            "epochs": network.trained.epochs,
            "seed": request.seed,
        },
        commit=origin["commit"],
        date=datetime.date.today().isoformat(),
        command=" ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        metrics=dict(metrics),
    )


def _write_sensor(request: TrainOpticsRequest, filmed: FilmedData) -> None:
    """Write the idle image, what is known of its lights, and the sensor that uses both."""
    out = request.out.resolve()
    write_image(out / IDLE, filmed.idle)
    if filmed.fine is not None:
        write_image(fine_path(out / IDLE), filmed.fine)
    described = description_of(request.sensor)
    if described is not None:
        lights = read_yaml(described) or {}
        # The disc is that of another image: this one shows the camera's own view.
        lights.pop("disc", None)
        described_as = (out / IDLE).with_suffix(".yaml")
        write_text(described_as, yaml.safe_dump(lights, sort_keys=False))
    camera = replace(request.sensor.camera, idle_image=_named(out / IDLE), residual=_named(out))
    write_sensor(
        request.sensor_file, replace(request.sensor, camera=camera), request.sensor_comment
    )


def _named(path: Path) -> str:
    """Return how a sensor's file names a path: below `params/` where it lies there."""
    parameters = parameter_path("sensors").parent.resolve()
    if path.is_relative_to(parameters):
        return path.relative_to(parameters).as_posix()
    return str(path)


def write_preview(
    path: Path, presses: Sequence[OpticalPress], predicted: Sequence[ImageArray], *, rows: int = 6
) -> None:
    """Write the deepest frame of each press, a row each, as PNG.

    Args:
        path: of the file.
        presses: what was measured; presses beyond `rows` are thinned evenly.
        predicted: images (F, H, W, 3) of each press.
        rows: most rows.
    """
    chosen = np.unique(np.linspace(0, len(presses) - 1, min(rows, len(presses))).astype(int))
    lines = []
    for index in chosen:
        press = presses[index]
        frame = int(np.argmax(press.tip_depth_m))
        measured, warped = press.measured[frame], press.warped[frame]
        image = predicted[index][frame]
        shown = {
            f"{press.name}, frame {frame}: measured": measured,
            "warped": warped,
            "predicted": image,
            "error of warped x4": change_image(measured, warped, ERROR_GAIN),
            "error of predicted x4": change_image(measured, image, ERROR_GAIN),
        }
        lines.append(np.hstack([titled(pixels, title) for title, pixels in shown.items()]))
    write_image(path, np.vstack(lines))
