# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The measured frames of a data set next to what a sensor renders for them, and what some rows get
in place of the calibrated gel by the idle image: the geometry that Tacto shades, and a refined idle
image."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from dotsim_ros.data.data_set import DataSet, find_indenter, read_data_set
from dotsim_ros.data.reading import read_bag
from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.learning.pattern import with_learned_pattern
from dotsim_ros.optics.idle import lights_of
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification, load_sensor
from dotsim_ros.twin.footage import (
    FilmedData,
    OpticalData,
    OpticalPress,
    camera_for,
    read_filmed_data,
    render_filmed,
)
from studies.optics.judge import frames_by_press, with_frames
from studies.optics.split import FrameKey
from studies.rivals.optics.clipped import clipped_press


@dataclass(frozen=True)
class Footage:
    """The measured frames next to what a sensor renders for them.

    Attributes:
        source: where poses and indenters are.
        sensor: whose gel, camera and lights.
        filmed: images and skins.
        data: the same frames by the idle image as it was taken.
    """

    source: DataSet
    sensor: SensorSpecification
    filmed: FilmedData
    data: OpticalData

    def rendered(self, filmed: FilmedData) -> OpticalData:
        """Return what the sensor renders for other footage."""
        return _rendered(filmed, self.sensor, self.data.camera)

    def clipped(self, data: OpticalData | None = None) -> dict[str, OpticalPress]:
        """Return the presses by name, with what the camera sees of the sensor's skin, clipped.

        Args:
            data: the presses; None for all as they are rendered.

        Raises:
            FileNotFoundError: no mesh of an indenter.
            ValueError: a trajectory without one pose for each image.
        """
        renderer = SkinRenderer(self.data.camera, skin_of(self.sensor.gel))
        entries = {entry.name: entry for entry in self.source.entries}
        indenters: dict[str, Indenter] = {}
        presses = {}
        for press in (data or self.data).presses:
            if press.indenter not in indenters:
                indenters[press.indenter] = find_indenter(self.source, press.indenter)
            poses = read_bag(entries[press.name], channels=("pose",)).press().poses
            presses[press.name] = clipped_press(press, poses, indenters[press.indenter], renderer)
        return presses

    def refined(self, train: Iterable[FrameKey]) -> FilmedData:
        """Return the footage with an idle image that some of its frames refine, and no others, with
        samples between its pixels, as `train-optics` makes it."""
        presses = {press.name: press for press in self.filmed.presses}
        to_fit = [with_frames(presses[name], f) for name, f in frames_by_press(train).items()]
        lighting, vignetting = lights_of(self.sensor)
        learned = with_learned_pattern(
            replace(self.filmed, presses=tuple(to_fit)),
            self.data.camera,
            lighting=lighting,
            vignetting=vignetting,
        )
        return replace(learned, presses=self.filmed.presses)


def read_footage(data: Path, sensor: str | Path) -> Footage:
    """Read a data set's images and render the same frames.

    Args:
        data: folder of the data set.
        sensor: name or file of the sensor.

    Raises:
        FileNotFoundError: no data set or no sensor.
        ValueError: a trajectory or a sensor that is not valid.
    """
    given = load_sensor(sensor)
    filmed = read_filmed_data(data, given, progress=print)
    rendered = _rendered(filmed, given, camera_for(given, filmed.idle, str(data)))
    return Footage(read_data_set(data), given, filmed, rendered)


def _rendered(filmed: FilmedData, sensor: SensorSpecification, camera: Camera) -> OpticalData:
    lighting, vignetting = lights_of(sensor)
    return render_filmed(filmed, camera, lighting=lighting, vignetting=vignetting)
