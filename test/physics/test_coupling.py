# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel in a MuJoCo world: weight, momentum, stability and refinement of the coupling."""

import re
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dotsim_ros.control.environments.coupling import Finger, MujocoCoupling, MujocoGripper
from dotsim_ros.gel.implicit.gel import PressTooDeepError
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SolverSpecification, load_sensor

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
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a world with a body above a sensor that stands on the ground."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
          <option timestep="0.001" gravity="0 0 {-gravity}" integrator="implicitfast"/>
          <worldbody>
            <geom name="floor" type="plane" size="1 1 1" contype="0" conaffinity="0"/>
            <body name="sensor"/>
            <body name="thing" pos="0 0 {height_m}">
              <joint name="up" type="slide" axis="0 0 1"/>
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


@pytest.mark.parametrize(("geom", "mass_kg"), [(BALL, 0.1), (BLOCK, 0.01)], ids=["ball", "box"])
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


def test_the_stiffness_is_the_derivative_where_markers_slip(sensor: TactileSensor) -> None:
    # Over 5 um the force changes by a third of what the sensor's own tolerance leaves of it.
    solver = replace(sensor.specification.solver, tolerance_m=1.0e-7, iterations=50)
    sensor = TactileSensor.load(
        replace(sensor.specification, solver=solver), indenter=load_indenter("sphere_4mm")
    )
    stiffness, force_n = {}, {}
    # As in a slide that is half way to the limit, and next to it; then all of them slip.
    for slid_um in (0, 50, 100, 150, 200, 250, 300, 350, 355, 400, 450, 500, 505, 550, 600):
        pose = Pose(np.array([1e-6 * slid_um, 0.0, APEX_M - 0.5e-3]))
        force_n[slid_um] = sensor.press(pose).wrench.force_n[0]
        stiffness[slid_um] = sensor.wrench_stiffness()[0, 0]
    for slid_um in (350, 500):
        change_n = force_n[slid_um] - force_n[slid_um + 5]
        assert change_n / 5e-6 == pytest.approx(stiffness[slid_um], rel=0.05)
    assert stiffness[500] < 0.5 * stiffness[350] < 0.475 * stiffness[0]
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
        ({"pressed_geom": "cup"}, "no geom named 'cup'; it has floor, thing"),
        ({"pressed_geom": "floor"}, "floor is a plane, expected a sphere"),
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


BALL_M, BALL_KG = 6.0e-3, 0.02
TWO = ("left", "right")


@pytest.fixture(scope="module")
def pair(sensor: TactileSensor) -> list[TactileSensor]:
    return [sensor, TactileSensor.load(sensor.specification)]


def ball_between(
    gap_m: float, *, finger: str = "", gravity: float = GRAVITY_M_S2
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a world with a free ball between two domes, and so wide a gap at each of them."""
    away_m = APEX_M + BALL_M + gap_m
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
          <option timestep="0.001" gravity="0 0 {-gravity}" integrator="implicitfast"/>
          <worldbody>
            <body name="ball">
              <freejoint/>
              <geom name="ball" type="sphere" size="{BALL_M}" mass="{BALL_KG}"/>
            </body>
            <body name="left" pos="{-away_m} 0 0" zaxis="1 0 0">{finger}</body>
            <body name="right" pos="{away_m} 0 0" zaxis="-1 0 0">{finger}</body>
          </worldbody>
        </mujoco>"""
    )
    return model, mujoco.MjData(model)


def gripper(
    sensors: list[TactileSensor], model: mujoco.MjModel, data: mujoco.MjData
) -> MujocoGripper:
    fingers = [Finger(each, name, "ball") for each, name in zip(sensors, TWO, strict=True)]
    return MujocoGripper(model, data, fingers)


def force_on_the_ball(held: MujocoGripper) -> np.ndarray:
    """Return the force of all gels (3,) in the world."""
    return np.sum([f.base_pose().rotation() @ f.wrench().force_n for f in held.fingers], axis=0)


def test_two_sensors_hold_a_ball_by_friction_in_one_world(pair: list[TactileSensor]) -> None:
    model, data = ball_between(-0.4e-3)
    held = gripper(pair, model, data)
    # What the caller puts there acts too, and stays.
    data.xfrc_applied[1, 1] = 0.05
    given = data.xfrc_applied.copy()
    for _ in range(30):
        gels = held.step()
    assert data.time == pytest.approx(0.3)
    weight_n = BALL_KG * GRAVITY_M_S2
    assert force_on_the_ball(held) == pytest.approx([0.0, -0.05, weight_n], abs=0.01 * weight_n)
    squeeze_n = [gel.wrench.force_n[2] for gel in gels]
    assert squeeze_n[0] == pytest.approx(squeeze_n[1], rel=0.01)
    assert 0.5 < squeeze_n[0] < 1.0
    assert np.array_equal(data.xfrc_applied, given)
    # It hangs on the sheared gels, and has not slipped.
    assert -0.2e-3 < data.qpos[2] < -0.02e-3
    assert np.abs(data.qvel[:3]).max() < 1e-4


def test_a_ball_slips_from_two_sensors_with_too_little_friction(pair: list[TactileSensor]) -> None:
    contact = replace(pair[0].specification.contact, friction_coefficient=0.1)
    smooth = [TactileSensor.load(replace(each.specification, contact=contact)) for each in pair]
    model, data = ball_between(-0.4e-3)
    held = gripper(smooth, model, data)
    for _ in range(20):
        held.step()
    assert data.qpos[2] < -10e-3
    assert not force_on_the_ball(held).any()


def test_a_ball_and_two_fingers_keep_momentum_and_give_energy_to_the_gels(
    pair: list[TactileSensor],
) -> None:
    finger = '<freejoint/><inertial mass="0.1" pos="0 0 0.005" diaginertia="1e-5 1e-5 1e-5"/>'
    model, data = ball_between(0.2e-3, finger=finger, gravity=0.0)
    # Next to the axis, so that all turn; each moves towards the ball.
    data.qpos[1] = 1.0e-3
    data.qvel[6], data.qvel[12] = 0.05, -0.03
    held = gripper(pair, model, data)

    def momentum() -> np.ndarray:
        mujoco.mj_subtreeVel(model, data)
        linear = [model.body_mass[body] * data.subtree_linvel[body] for body in (1, 2, 3)]
        turning = [
            data.subtree_angmom[body] + np.cross(data.subtree_com[body], linear[body - 1])
            for body in (1, 2, 3)
        ]
        return np.concatenate([np.sum(linear, axis=0), np.sum(turning, axis=0)])

    def kinetic_j() -> float:
        mujoco.mj_energyVel(model, data)
        return float(data.energy[1])

    begun, begun_j, largest_n = momentum(), kinetic_j(), np.zeros(2)
    for _ in range(15):
        forces_n = [np.linalg.norm(gel.wrench.force_n) for gel in held.step()]
        largest_n = np.maximum(largest_n, forces_n)
    assert np.all(largest_n > 0.1)
    scale = 0.1 * 0.05
    assert momentum()[:3] == pytest.approx(begun[:3], abs=1e-5 * scale)
    assert momentum()[3:] == pytest.approx(begun[3:], abs=0.01 * scale * APEX_M)
    given_j = [-finger.work_j for finger in held.fingers]
    assert min(given_j) > 0.0
    assert sum(given_j) == pytest.approx(begun_j - kinetic_j(), abs=0.01 * begun_j)


@pytest.mark.fault("environments", "a coupling for each of two sensors of one MuJoCo world")
def test_a_second_coupling_of_a_world_is_refused(
    pair: list[TactileSensor], answered: Callable[..., None]
) -> None:
    model, data = ball_between(-0.4e-3)

    def couple(name: str) -> MujocoCoupling:
        return MujocoCoupling(model, data, pair[0], sensor_body=name, pressed_geom="ball")

    first = couple("left")
    with pytest.raises(ValueError, match=r"a coupling already.* make one MujocoGripper") as refused:
        couple("right")
    answered(str(refused.value))
    first.step()
    assert data.time == pytest.approx(0.01)
    del first
    couple("right").step()
    assert data.time == pytest.approx(0.02)


def test_fingers_need_sensors_of_their_own(pair: list[TactileSensor]) -> None:
    model, data = ball_between(-0.4e-3)
    with pytest.raises(ValueError, match="2 fingers have 1 sensors"):
        gripper([pair[0], pair[0]], model, data)
    with pytest.raises(ValueError, match="one or more fingers"):
        MujocoGripper(model, data, [])


def test_a_time_step_that_is_too_long_is_warned_of(sensor: TactileSensor) -> None:
    mass_kg = 0.001
    light = on_top(sensor, BALL, mass_kg=mass_kg, height_m=APEX_M + 3.5e-3)
    stiffness_n_m = sensor.wrench_stiffness()[2, 2]
    with pytest.warns(UserWarning, match="time step of 1 ms is too long") as warned:
        light.step()
    assert len(warned) == 1
    stated_s = 1e-3 * float(re.findall(r"less than ([\d.]+) ms", str(warned[0].message))[0])
    # h (h + 2 c) K / m is 4, with c of 2 ms.
    assert stated_s * (stated_s + 4e-3) * stiffness_n_m / mass_kg == pytest.approx(4.0, rel=0.02)
