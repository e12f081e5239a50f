"""The presses of a data set with the geometry that Tacto shades."""

from __future__ import annotations

from dotsim_ros.baselines.optics.clipped import clipped_press
from dotsim_ros.evaluation.presses import read_press
from dotsim_ros.geometry.indenter import Indenter, load_mesh
from dotsim_ros.geometry.specification import SensorSpecification
from dotsim_ros.measured.data_set import DataSet
from dotsim_ros.optics.frames import OpticalData, OpticalPress
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.sensor import skin_of


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
            indenters[press.indenter] = load_mesh(data_set.indenter_mesh(press.indenter))
        poses = read_press(entries[press.name]).poses
        presses[press.name] = clipped_press(press, poses, indenters[press.indenter], renderer)
    return presses
