# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sensor's description for robots, against the sensor that it describes.

xacro comes with a ROS installation only: the macro is expanded here, by its one parameter.
"""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from dotsim_ros.nodes.tactile_sim.parameters import FrameParameters
from dotsim_ros.specification import load_sensor

FOLDER = Path(__file__).parents[2] / "urdf"
XACRO = "{http://www.ros.org/wiki/xacro}"


def expanded(prefix: str) -> ElementTree.Element:
    """Return the sensor by itself as xacro would."""
    text = (FOLDER / "densetact2_macro.xacro").read_text().replace("${prefix}", prefix)
    (macro,) = ElementTree.fromstring(text).iter(f"{XACRO}macro")
    robot = ElementTree.Element("robot", name=macro.attrib["name"])
    robot.extend(list(macro))
    return robot


def test_frames_and_dome_are_those_of_the_sensor() -> None:
    sensor, frames = load_sensor("densetact2"), FrameParameters(frame_prefix="left_").prefixed()
    robot = expanded("left_")
    model = pinocchio.buildModelFromXML(ElementTree.tostring(robot, encoding="unicode"))
    assert model.existFrame(frames.base_frame)
    assert model.existFrame(frames.optical_frame)
    base = model.frames[model.getFrameId(frames.base_frame)].placement
    optical = model.frames[model.getFrameId(frames.optical_frame)].placement
    camera = base.actInv(optical)
    assert camera.translation == pytest.approx(sensor.camera.position_m)
    quaternion = pinocchio.Quaternion(camera.rotation).coeffs()
    assert quaternion == pytest.approx(sensor.camera.quaternion_xyzw)
    radii = {float(sphere.attrib["radius"]) for sphere in robot.iter("sphere")}
    assert radii == {sensor.gel.outer_radius_m}


def test_mass_and_inertia_of_the_gel_follow_from_the_sensor() -> None:
    sensor = load_sensor("densetact2")
    (inertial,) = expanded("").findall("link[@name='densetact_base']/inertial")

    def number(element: str, name: str) -> float:
        (found,) = inertial.findall(element)
        return float(found.attrib[name].split()[-1])

    radii = np.array([sensor.gel.core_radius_m, sensor.gel.outer_radius_m])
    half_sphere = 2.0 / 3.0 * np.pi * sensor.material.density_kg_m3
    mass = np.diff(half_sphere * radii**3).item()
    height = np.diff(0.375 * half_sphere * radii**4).item() / mass
    about_base = np.diff(0.4 * half_sphere * radii**5).item()
    assert number("mass", "value") == pytest.approx(mass, rel=1e-3)
    assert number("origin", "xyz") == pytest.approx(height, rel=1e-3)
    assert number("inertia", "izz") == pytest.approx(about_base, rel=1e-3)
    assert number("inertia", "ixx") == pytest.approx(about_base - mass * height**2, rel=1e-3)


def test_the_file_for_the_sensor_by_itself_uses_the_macro() -> None:
    robot = ElementTree.parse(FOLDER / "densetact2.urdf.xacro").getroot()
    (included,) = robot.iter(f"{XACRO}include")
    assert (FOLDER / included.attrib["filename"]).is_file()
    (called,) = robot.iter(f"{XACRO}densetact2")
    assert called.attrib == {"prefix": "$(arg prefix)"}
