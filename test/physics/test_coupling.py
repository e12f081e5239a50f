# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel in a MuJoCo world: weight, momentum, stability and refinement of the coupling."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dotsim_ros.gel.implicit.gel import PressTooDeepError
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SolverSpecification, load_sensor
from dotsim_ros.tasks.environments.coupling import MujocoCoupling

APEX_M = 15.75e-3
GRAVITY_M_S2 = 9.81


@pytest.fixture(scope="module")
def sensor() -> TactileSensor:
    solver = SolverSpecification(grid_spacing_m=3.6e-3, refined=False)
    return TactileSensor.load(replace(load_sensor("densetact2"), solver=solver))


def world(
    geom: str,
    *,
    mass_kg: float,
    height_m: float,
    gravity: float = GRAVITY_M_S2,
    joint: str = "slide",
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a world with a body above a sensor that stands on the ground."""
    joints = {
        "slide": '<joint name="up" type="slide" axis="0 0 1"/>',
        "free": '<freejoint name="up"/>',
    }
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
          <option timestep="0.001" gravity="0 0 {-gravity}" integrator="implicitfast"/>
          <worldbody>
            <body name="sensor">
              {
            '<freejoint/><inertial mass="0.3" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/>'
            if joint == "free"
            else ""
        }
            </body>
            <body name="thing" pos="0 0 {height_m}">
              {joints[joint]}
              <geom name="thing" {geom} mass="{mass_kg}" contype="0" conaffinity="0"/>
            </body>
          </worldbody>
        </mujoco>"""
    )
    return model, mujoco.MjData(model)


def on_top(sensor: TactileSensor, geom: str, **given: float | str) -> MujocoCoupling:
    coupling_s = float(given.pop("coupling_s", 0.01))
    model, data = world(geom, **given)  # type: ignore[arg-type]
    return MujocoCoupling(
        model, data, sensor, sensor_body="sensor", pressed_geom="thing", coupling_s=coupling_s
    )


BALL = 'type="sphere" size="0.004"'
BLOCK = 'type="box" size="0.006 0.006 0.004"'


@pytest.mark.parametrize("geom", [BALL, BLOCK], ids=["ball", "box"])
@pytest.mark.parametrize("mass_kg", [0.01, 0.1])
def test_a_body_comes_to_rest_where_the_gel_carries_its_weight(
    sensor: TactileSensor, geom: str, mass_kg: float
) -> None:
    coupling = on_top(sensor, geom, mass_kg=mass_kg, height_m=APEX_M + 4.1e-3)
    forces = []
    for _ in range(60):
        coupling.step()
        forces.append(coupling.wrench().force_n[2])
    assert np.mean(forces[-10:]) == pytest.approx(mass_kg * GRAVITY_M_S2, rel=0.01)
    assert abs(coupling.data.qvel[0]) < 1e-3


def test_momentum_of_two_free_bodies_is_kept(sensor: TactileSensor) -> None:
    coupling = on_top(
        sensor, BALL, mass_kg=0.05, height_m=APEX_M + 4.2e-3, gravity=0.0, joint="free"
    )
    data = coupling.data
    # Six of each free joint: the sensor's, then the ball's. Beside the axis, so that both turn.
    data.qpos[7] = 1.0e-3
    data.qvel[8] = -0.05
    coupling.reset()
    masses = coupling.model.body_mass

    def momentum() -> np.ndarray:
        mujoco.mj_subtreeVel(coupling.model, data)
        linear = sum(masses[body] * data.subtree_linvel[body] for body in (1, 2))
        angular = sum(
            data.subtree_angmom[body]
            + masses[body] * np.cross(data.subtree_com[body], data.subtree_linvel[body])
            for body in (1, 2)
        )
        return np.concatenate([linear, angular])

    begun, largest_n = momentum(), 0.0
    for _ in range(15):
        coupling.step()
        largest_n = max(largest_n, float(np.linalg.norm(coupling.wrench().force_n)))
    assert largest_n > 0.1
    scale = 0.05 * 0.05
    assert momentum()[:3] == pytest.approx(begun[:3], abs=1e-6 * scale)
    assert momentum()[3:] == pytest.approx(begun[3:], abs=0.01 * scale * APEX_M)


def test_a_shorter_coupling_time_gives_the_same_motion(sensor: TactileSensor) -> None:
    heights = []
    for coupling_s in (0.02, 0.01, 0.005):
        coupling = on_top(
            sensor, BALL, mass_kg=0.05, height_m=APEX_M + 4.1e-3, coupling_s=coupling_s
        )
        for _ in range(round(0.12 / coupling_s)):
            coupling.step()
        heights.append(float(coupling.data.qpos[0]))
    coarse, middle, fine = heights
    assert abs(coarse - fine) < 0.05e-3
    assert abs(middle - fine) < 0.03e-3


def test_the_stiffness_is_the_derivative_of_the_wrench(sensor: TactileSensor) -> None:
    coupling = on_top(sensor, BALL, mass_kg=0.05, height_m=APEX_M + 3.2e-3)
    pose = coupling.indenter_pose()
    stiffness = sensor.wrench_stiffness()
    at_n = sensor.press(pose).wrench.force_n[2]
    lower = Pose(pose.position_m - [0.0, 0.0, 20e-6], pose.quaternion_xyzw)
    change_n = sensor.press(lower).wrench.force_n[2] - at_n
    assert change_n / 20e-6 == pytest.approx(stiffness[2, 2], rel=0.1)


def test_the_stiffness_is_the_derivative_where_markers_slip(sensor: TactileSensor) -> None:
    sensor.set_indenter(load_indenter("sphere_4mm"))
    stiffness, force_n = {}, {}
    # As in a slide that is half way to the limit, and next to it; then all of them slip.
    for slid_um in (0, 50, 100, 150, 200, 250, 300, 350, 355, 400, 450, 500, 505, 550, 600):
        pose = Pose(np.array([1e-6 * slid_um, 0.0, APEX_M - 0.5e-3]))
        force_n[slid_um] = sensor.press(pose).wrench.force_n[0]
        stiffness[slid_um] = sensor.wrench_stiffness()[0, 0]
    for slid_um in (350, 500):
        change_n = force_n[slid_um] - force_n[slid_um + 5]
        assert change_n / 5e-6 == pytest.approx(stiffness[slid_um], rel=0.05)
    assert stiffness[350] < 0.9 * stiffness[0]
    assert abs(stiffness[600]) < 0.1 * stiffness[0]


def test_a_body_that_is_pushed_through_the_gel_is_refused(sensor: TactileSensor) -> None:
    coupling = on_top(sensor, BALL, mass_kg=5.0, height_m=APEX_M + 4.1e-3)

    def fall() -> None:
        for _ in range(60):
            coupling.step()

    with pytest.raises(PressTooDeepError, match="press less deep"):
        fall()


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ({"sensor_body": "palm"}, "no body named 'palm'; it has sensor, thing, world"),
        ({"pressed_geom": "cup"}, "no geom named 'cup'; it has thing"),
        ({"coupling_s": 0.0105}, "expected a multiple of MuJoCo's time step of 0.001"),
    ],
)
def test_what_the_model_lacks_is_named(
    sensor: TactileSensor, names: dict[str, str | float], said: str
) -> None:
    model, data = world(BALL, mass_kg=0.1, height_m=0.03)
    given = {"sensor_body": "sensor", "pressed_geom": "thing"} | names
    with pytest.raises(ValueError, match=said):
        MujocoCoupling(model, data, sensor, **given)  # type: ignore[arg-type]


def test_a_plane_cannot_press(sensor: TactileSensor) -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="sensor"/><geom name="floor" type="plane" size="1 1 1"/>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(ValueError, match="floor is a plane, expected a sphere"):
        MujocoCoupling(
            model,
            mujoco.MjData(model),
            sensor,
            sensor_body="sensor",
            pressed_geom="floor",
        )
