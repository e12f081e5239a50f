# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What some rows get instead of the calibrated gel by the idle image: the geometry that Tacto
shades, and a refined idle image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from dotsim_ros.data.data_set import DataSet, find_indenter
from dotsim_ros.data.reading import read_bag
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.learning.pattern import with_learned_pattern
from dotsim_ros.optics.idle import lights_of
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.footage import (
    FilmedData,
    OpticalData,
    OpticalPress,
    render_filmed,
)
from studies.optics.judge import frames_by_press, with_frames
from studies.optics.split import FrameKey, OpticalSplit
from studies.rivals.optics.clipped import clipped_press


def clipped_presses(
    data_set: DataSet, sensor: SensorSpecification, data: OpticalData
) -> dict[str, OpticalPress]:
    """Return the presses by name, with what the camera sees of the sensor's skin, clipped.

    Args:
        data_set: where poses and indenters are.
        sensor: whose skin is clipped.
        data: the presses, and the camera.

    Raises:
        FileNotFoundError: no mesh of an indenter.
        ValueError: a trajectory without one pose for each image.
    """
    renderer = SkinRenderer(data.camera, skin_of(sensor.gel))
    entries = {entry.name: entry for entry in data_set.entries}
    indenters: dict[str, Indenter] = {}
    presses = {}
    for press in data.presses:
        if press.indenter not in indenters:
            indenters[press.indenter] = find_indenter(data_set, press.indenter)
        poses = read_bag(entries[press.name], channels=("pose",)).press().poses
        presses[press.name] = clipped_press(press, poses, indenters[press.indenter], renderer)
    return presses


def refined_data(
    filmed: FilmedData, sensor: SensorSpecification, data: OpticalData, split: OpticalSplit
) -> OpticalData:
    """Return the presses by an idle image that the frames to fit on refine.

    Args:
        filmed: images and skins.
        sensor: whose camera and lights.
        data: the same frames by the idle image as it was taken.
        split: no frame that it judges plays a part in the idle image.
    """
    lighting, vignetting = lights_of(sensor)
    return render_filmed(
        refined_footage(filmed, sensor, data, split.train),
        data.camera,
        lighting=lighting,
        vignetting=vignetting,
    )


def refined_footage(
    filmed: FilmedData,
    sensor: SensorSpecification,
    data: OpticalData,
    train: Iterable[FrameKey],
) -> FilmedData:
    """Return the footage with an idle image that some of its frames refine, with samples between
    its pixels, as `train-optics` makes it.

    Args:
        filmed: images and skins.
        sensor: whose camera and lights.
        data: the same frames by the idle image as it was taken.
        train: the frames that refine it.
    """
    presses = {press.name: press for press in filmed.presses}
    to_fit = [with_frames(presses[name], frames) for name, frames in frames_by_press(train).items()]
    lighting, vignetting = lights_of(sensor)
    learned = with_learned_pattern(
        replace(filmed, presses=tuple(to_fit)),
        data.camera,
        lighting=lighting,
        vignetting=vignetting,
    )
    return replace(learned, presses=filmed.presses)
