# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Do grasps hold: ten objects between two GelSight Minis in MuJoCo, by friction alone.

Each object stands on a narrow bench. The gripper closes with a force, lifts the object by 70 mm,
carries it by 50 mm, turns it by 90 degrees about the axis through both fingers and back, and sets
it down. Then it grips the object without gravity, which a growing force pulls along the pads until
it slips. Fingers have no geoms: the gels' friction is all that holds.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import mujoco
import numpy as np

from dotsim_ros.control.environments.coupling import Finger, MujocoGripper
from dotsim_ros.geometry.indenter import box
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.run import FAILED, expect_known, expect_positive

STEP_S, COUPLING_S = 0.1e-3, 0.02
GRAVITY_M_S2 = 9.81
LIFT_M, CARRY_M = 0.07, 0.05
"""So high that no object meets the bench when it is turned."""
OPEN_M = 0.5e-3
"""Between each pad and the object, before the grip."""
SQUEEZE_M = 2.0e-3
"""How far beyond the object's surface the fingers are sent, more than their force lets them go."""
Move = tuple[str, float, float, float]
"""Motor, start and end (s), and way (m or rad)."""
MOVES: tuple[Move, ...] = (
    ("grip", 0.0, 0.1, OPEN_M + SQUEEZE_M),
    ("lift", 0.16, 0.46, LIFT_M),
    ("carry", 0.46, 0.71, CARRY_M),
    ("turn", 0.71, 1.06, 0.5 * np.pi),
    ("turn", 1.06, 1.41, -0.5 * np.pi),
    ("lift", 1.41, 1.71, -LIFT_M),
    ("grip", 1.74, 1.8, -OPEN_M - SQUEEZE_M),
)
GRIPPED_S, SET_DOWN_S, END_S = 0.16, 1.72, 1.9
SLIPPING_M_S = 2.0e-3
"""Speed on the pads from which an object slips. The gel alone lets it creep a fifth as fast."""
CREPT_M, FACE_CREPT_M = 20e-6, 4e-6
"""From so far on the gels are solved again while they are pulled. A face comes loose all at once,
and its gel then gives way to the squeeze, too: by a tangent that holds it still the cube slipped at
0.90 of Coulomb's load after 20 um, at 0.94 after 4 um."""
LOADED_S, RESTED_S, PULL_S = 0.6, 0.66, 0.5
"""After the grip: the first load is on, has come to rest, and for how long the pull grows."""
PULL_SHARES = 0.9, 1.1
"""Of Coulomb's load, between which the pull grows in that time."""
MOST_MOVED_MM, MOST_TURNED_DEG, MOST_ASTRAY_MM = 1.0, 3.0, 1.0
MOST_GROWN = 0.02
"""Of the energy that lifts the object: that it grows by from where it was least."""
MOST_OFF_COULOMB, MOST_TANGENTIAL = 0.05, 1.0e-3
WORLD = """
<mujoco>
  <option timestep="{step_s}" integrator="Euler" cone="elliptic">
    <flag energy="enable" eulerdamp="disable"/>
  </option>
  <asset>{asset}</asset>
  <worldbody>
    <geom name="bench" type="box" pos="0 0 -.05" size=".003 .2 .05" condim="6" solref=".004 1"/>
    <body name="object" pos="0 0 {height}">
      <freejoint/>
      {geoms}
    </body>
    <body name="hand" pos="0 0 {height}" gravcomp="1">
      <joint name="carry" type="slide" axis="0 1 0"/>
      <joint name="lift" type="slide" axis="0 0 1"/>
      <joint name="turn" axis="1 0 0"/>
      <inertial pos="0 0 0" mass=".5" diaginertia="1e-3 1e-3 1e-3"/>
      <body name="left" pos="-{away} 0 0" zaxis="1 0 0" gravcomp="1">
        <joint name="left" type="slide" axis="0 0 1" damping="10"/>
        <inertial pos="0 0 0" mass=".1" diaginertia="1e-5 1e-5 1e-5"/>
      </body>
      <body name="right" pos="{away} 0 0" zaxis="-1 0 0" gravcomp="1">
        <joint name="right" type="slide" axis="0 0 1" damping="10"/>
        <inertial pos="0 0 0" mass=".1" diaginertia="1e-5 1e-5 1e-5"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="left" joint2="right"/></equality>
  <actuator>
    <position joint="carry" kp="5000" dampratio="1"/>
    <position joint="lift" kp="5000" dampratio="1"/>
    <position joint="turn" kp="50" dampratio="1"/>
    <position joint="left" kp="5000" dampratio="1" forcerange="-{grip} {grip}"/>
    <position joint="right" kp="5000" dampratio="1" forcerange="-{grip} {grip}"/>
  </actuator>
</mujoco>
"""
MOTORS = ("carry", "lift", "turn", "grip", "grip")


@dataclass(frozen=True)
class Object:
    """What is gripped: its geoms as MuJoCo has them, of which `gripped` is around its origin.

    Attributes:
        half_width_m: of what the fingers grip.
        height_m: of the origin above the bench.
        grip_n: force of each finger.
        is_wide: whether its face is flat and wider than 10 mm, for which the sensor's own grid
            would take 5 to 20 s a solution.
    """

    geoms: str
    half_width_m: float
    height_m: float
    grip_n: float
    asset: str = ""
    is_wide: bool = False


def _egg(length_m: float, width_m: float) -> tuple[str, float]:
    """Return the mesh of an egg that lies along y as it comes to rest, on a facet, one end more
    pointed than the other, and the height of its centre of mass, which is its origin."""
    turn = (np.arange(48) + 0.5) * (2.0 * np.pi / 48)
    along = np.cos(np.linspace(0.0, np.pi, 33))
    radius = np.sqrt(1.0 - along**2) * (1.0 + 0.1 * along)
    middle = np.average(along[1:-1], weights=(radius**2 * np.sqrt(1.0 - along**2))[1:-1])
    y = np.repeat(0.5 * length_m * (along - middle), len(turn))
    x, z = (0.5 * width_m * np.outer(radius, f(turn)).ravel() for f in (np.cos, np.sin))
    tilts = np.linspace(-0.2, 0.2, 401)
    height_m = -np.min(np.outer(np.sin(tilts), y) + np.outer(np.cos(tilts), z), axis=1)
    tilt = float(tilts[np.argmin(height_m)])
    points = x, np.cos(tilt) * y - np.sin(tilt) * z, np.sin(tilt) * y + np.cos(tilt) * z
    text = " ".join(f"{number:.7f}" for number in np.column_stack(points).ravel())
    return f'<mesh name="gripped" vertex="{text}"/>', float(height_m.min())


EGG, EGG_HEIGHT_M = _egg(0.057, 0.044)
RING = (
    '<mesh name="gripped" builtin="supertorus" params="48 .15 1 1" scale=".0095652 .0095652 '
    '.0095652"/>'
)
OBJECTS = {
    "ball": Object('<geom name="gripped" type="sphere" size=".01" mass=".001"/>', 0.01, 0.01, 0.3),
    "box": Object(
        '<geom name="gripped" type="box" size=".01 .0075 .02" mass=".1"/>',
        0.01,
        0.02,
        2.0,
        is_wide=True,
    ),
    "cylinder": Object(
        '<geom name="gripped" type="cylinder" size=".012 .02" mass=".15"/>', 0.012, 0.02, 3.0
    ),
    "mug handle": Object(
        '<geom name="gripped" type="capsule" size=".005 .012" mass=".02"/>'
        '<geom type="cylinder" pos="0 .03 0" size=".022 .025" mass=".06"/>',
        0.005,
        0.025,
        6.0,
    ),
    "cap": Object(
        '<geom name="gripped" type="cylinder" size=".014 .006" mass=".003"/>', 0.014, 0.006, 0.3
    ),
    # Gripped 20 mm from its middle: at 30 mm its weight and the turn twist it in the grip.
    "screwdriver": Object(
        '<geom name="gripped" type="capsule" pos="0 -.01 0" size=".012 .04" zaxis="0 1 0" '
        'mass=".04"/>'
        '<geom type="cylinder" pos="0 .08 0" size=".003 .04" zaxis="0 1 0" mass=".02"/>',
        0.012,
        0.012,
        7.0,
    ),
    "egg": Object(
        '<geom name="gripped" type="mesh" mesh="gripped" mass=".06"/>',
        0.022,
        EGG_HEIGHT_M,
        2.0,
        EGG,
    ),
    "ring": Object(
        '<geom name="gripped" type="mesh" mesh="gripped" mass=".005"/>',
        0.011,
        0.001435,
        0.5,
        RING,
    ),
    "pen": Object(
        '<geom name="gripped" type="capsule" size=".004 .065" zaxis="0 1 0" mass=".01"/>',
        0.004,
        0.004,
        1.0,
    ),
    "cube": Object(
        '<geom name="gripped" type="box" size=".0165 .0165 .0165" mass=".3"/>',
        0.0165,
        0.0165,
        4.0,
        is_wide=True,
    ),
}


def coarse_sensor(friction: float | None = None) -> SensorSpecification:
    """Return `gelsight_mini` on its grid of 2 mm without refinement, with skin markers every
    millimetre: a face that covers the pad takes a fiftieth of the time."""
    sensor = load_sensor("gelsight_mini")
    contact = sensor.contact
    if friction is not None:
        contact = replace(contact, friction_coefficient=friction)
    return replace(
        sensor,
        gel=replace(sensor.gel, skin_spacing_m=1.0e-3),
        solver=replace(sensor.solver, refined=False),
        contact=contact,
    )


class Grasp:
    """A gripper around an object that stands on the bench, with its balance of energy.

    Attributes:
        mass_kg: of the object.
        lost_j: for each of MuJoCo's steps, what MuJoCo's contacts have lost: the work of motors,
            dampers, weight and gels, less the kinetic energy.
    """

    def __init__(
        self,
        what: Object,
        sensors: Sequence[TactileSensor],
        moves: Sequence[Move],
        *,
        gravity_m_s2: float = GRAVITY_M_S2,
        move_m: float = 0.2e-3,
    ) -> None:
        text = WORLD.format(
            step_s=STEP_S,
            asset=what.asset,
            geoms=what.geoms.replace("<geom", '<geom condim="6"'),
            height=what.height_m,
            away=what.half_width_m + OPEN_M + float(sensors[0].skin.apex_m[2]),
            grip=what.grip_n,
        )
        self.moves = moves
        self.model = mujoco.MjModel.from_xml_string(text)
        self.model.opt.gravity[2] = -gravity_m_s2
        self.data = mujoco.MjData(self.model)
        fingers = [
            Finger(sensor, side, "gripped")
            for sensor, side in zip(sensors, ("left", "right"), strict=True)
        ]
        self.gripper = MujocoGripper(
            self.model, self.data, fingers, coupling_s=COUPLING_S, move_m=move_m
        )
        self.mass_kg = float(self.model.body("object").mass[0])
        self.lost_j: list[float] = []
        self._passive, self._before = np.zeros(self.model.nv), self._state()
        self._work_j = self._before[2]

    def step(self) -> None:
        """Move the world on by a coupling time."""
        mujoco.set_mjcb_control(self._control)
        try:
            self.gripper.step()
        finally:
            mujoco.set_mjcb_control(None)

    def _state(self) -> tuple[float, FloatArray, float]:
        return self.data.time, self.data.qvel.copy(), float(self.data.energy.sum())

    def _control(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Set the motors of one of MuJoCo's steps, and note what was lost until the one before."""
        way = dict.fromkeys(MOTORS, 0.0)
        for motor, start, end, value in self.moves:
            share = float(np.clip((data.time - start) / (end - start), 0.0, 1.0))
            way[motor] += value * share**2 * (3.0 - 2.0 * share)
        data.ctrl[:] = [way[motor] for motor in MOTORS]
        (time_s, speed, energy_j), now = self._before, self._state()
        if now[0] > time_s:
            gels_j = sum(finger.work_j for finger in self.gripper.fingers)
            self.lost_j.append(self._work_j - energy_j + gels_j)
            power = 0.5 * data.qfrc_actuator @ (speed + now[1]) + self._passive @ now[1]
            self._work_j += float(power) * (now[0] - time_s)
        self._passive, self._before = data.qfrc_passive.copy(), now

    def place(self) -> tuple[FloatArray, FloatArray]:
        """Return the object's position (3,) and axes (3, 3), both seen from the hand."""
        hand, thing = self.data.body("hand"), self.data.body("object")
        axes = hand.xmat.reshape(3, 3)
        return axes.T @ (thing.xpos - hand.xpos), axes.T @ thing.xmat.reshape(3, 3)

    def middle_m(self) -> FloatArray:
        """Return the middle (3,) of the gels' pressures on the object, in the world."""
        points = []
        for finger in self.gripper.fingers:
            wrench, base = finger.wrench(), finger.base_pose()
            x, y = -wrench.torque_nm[1], wrench.torque_nm[0]
            face_m = float(finger.sensor.skin.apex_m[2])
            points.append(
                base.apply(np.array([x, y, 0.0]) / wrench.force_n[2] + [0.0, 0.0, face_m])
            )
        return np.mean(points, axis=0)

    def normal_n(self) -> float:
        """Return what both gels press with, together."""
        return float(sum(finger.wrench().force_n[2] for finger in self.gripper.fingers))


def _degrees(before: FloatArray, after: FloatArray) -> float:
    """Return the angle between two sets of axes (3, 3)."""
    cosine = 0.5 * (float(np.trace(before.T @ after)) - 1.0)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def hold(what: Object, sensors: Sequence[TactileSensor]) -> dict[str, float]:
    """Return how an object is lifted, carried, turned and set down."""
    grasp = Grasp(what, sensors, MOVES)
    start_m = grasp.data.body("object").xpos.copy()
    axes = grasp.data.body("object").xmat.reshape(3, 3).copy()
    moved_m, turned_deg, touching = [0.0], [0.0], 0
    gripped = grasp.place()
    returned_j, pressed_n = [], []
    while grasp.data.time < END_S - 1e-9:
        grasp.step()
        returned_j.append(sum(finger.work_j for finger in grasp.gripper.fingers))
        if grasp.data.time < GRIPPED_S + 1e-9:
            gripped = grasp.place()
        elif grasp.data.time < SET_DOWN_S:
            place = grasp.place()
            moved_m.append(float(np.linalg.norm(place[0] - gripped[0])))
            turned_deg.append(_degrees(gripped[1], place[1]))
            pressed_n.append(grasp.normal_n())
        if GRIPPED_S + 0.1 < grasp.data.time < SET_DOWN_S - 0.1:
            touching += grasp.data.ncon
    thing = grasp.data.body("object")
    astray_m = thing.xpos - start_m - [0.0, CARRY_M, 0.0]
    lost_j = np.array(grasp.lost_j)
    friction = sensors[0].specification.contact.friction_coefficient
    return {
        "mass_g": 1e3 * grasp.mass_kg,
        "squeeze_n": what.grip_n,
        "margin": 2.0 * friction * what.grip_n / (grasp.mass_kg * GRAVITY_M_S2),
        "moved_mm": 1e3 * max(moved_m),
        "turned_deg": max(turned_deg),
        "touching": touching,
        "astray_mm": 1e3 * float(np.linalg.norm(astray_m)),
        "set_down_turned_deg": _degrees(axes, thing.xmat.reshape(3, 3)),
        "gels_lost_mj": -1e3 * returned_j[-1],
        "gels_gave_mj": 1e3 * max(returned_j),
        "contacts_lost_mj": 1e3 * float(lost_j[-1]),
        "grown_mj": 1e3 * float((np.maximum.accumulate(lost_j) - lost_j).max()),
        "lifting_mj": 1e3 * grasp.mass_kg * GRAVITY_M_S2 * LIFT_M,
        "solutions": sum(finger.solution_count for finger in grasp.gripper.fingers),
    }


def pull(what: Object, sensors: Sequence[TactileSensor]) -> dict[str, float | None]:
    """Return the force that makes a gripped object slip, without gravity, and its share of
    Coulomb's; None where the largest load does not."""
    move_m = FACE_CREPT_M if what.is_wide else CREPT_M
    grasp = Grasp(what, sensors, MOVES[:1], gravity_m_s2=0.0, move_m=move_m)
    friction = sensors[0].specification.contact.friction_coefficient
    coulomb_n = 2.0 * friction * what.grip_n
    body = grasp.data.body("object")
    while grasp.data.time < GRIPPED_S - 1e-9:
        grasp.step()
    # A pull beside the middle of the grip would turn the object, too.
    middle_m = body.xmat.reshape(3, 3).T @ (grasp.middle_m() - body.xipos)
    load_n, slip_n, height_m = 0.0, None, float(grasp.place()[0][2])
    while grasp.data.time < GRIPPED_S + RESTED_S + PULL_S:
        since_s = grasp.data.time - GRIPPED_S
        first, last = PULL_SHARES
        share = float(np.clip(since_s / LOADED_S, 0.0, 1.0))
        grown = max(since_s - RESTED_S, 0.0) / PULL_S
        load_n = coulomb_n * (first * share**2 * (3.0 - 2.0 * share) + (last - first) * grown)
        force_n = np.array([0.0, 0.0, load_n])
        torque_nm = np.cross(body.xmat.reshape(3, 3) @ middle_m, force_n)
        grasp.data.xfrc_applied[body.id] = [*force_n, *torque_nm]
        grasp.step()
        before_m, height_m = height_m, float(grasp.place()[0][2])
        # The gel gives way faster than that while the first load comes on.
        if since_s > RESTED_S and height_m - before_m > SLIPPING_M_S * COUPLING_S:
            slip_n = load_n
            break
    share_of_coulomb = None if slip_n is None else slip_n / coulomb_n
    return {"slip_n": slip_n, "slip_over_coulomb": share_of_coulomb}


def frictionless_slide() -> dict[str, float]:
    """Return the tangential force of a plate that slides on a pad without friction."""
    plate = box(np.array([0.06, 0.06, 0.01]), 0.3e-3)
    sensor = TactileSensor.load(coarse_sensor(friction=0.0), indenter=plate)
    face_m, shares = float(sensor.skin.apex_m[2]), []
    for slid_mm in np.linspace(0.0, 2.0, 9):
        frame = sensor.press(Pose(np.array([1e-3 * slid_mm, 0.0, face_m - 0.1e-3])))
        force_n = frame.wrench.force_n
        shares.append(float(np.linalg.norm(force_n[:2]) / force_n[2]))
    return {"normal_n": float(force_n[2]), "tangential_share": max(shares)}


def grasps(*, objects: tuple[str, ...] = tuple(OBJECTS), workers: int = 2) -> dict[str, Any]:
    """Which of ten objects two sensors lift, carry, turn and set down by friction alone.

    Args:
        objects: names of those to grasp.
        workers: processes.
    """
    expect_known("object", objects, OBJECTS)
    expect_positive(workers=workers)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        sliding = pool.submit(frictionless_slide)
        rows = dict(zip(objects, pool.map(_grasped, objects), strict=True))
        slide = sliding.result()
    failed = list(_failures(rows, slide))
    return {"objects": rows, "frictionless_slide": slide, FAILED: failed}


def _grasped(name: str) -> dict[str, Any]:
    what = OBJECTS[name]
    specification = coarse_sensor() if what.is_wide else load_sensor("gelsight_mini")
    sensors = [TactileSensor.load(specification) for _ in range(2)]
    begun_s = time.monotonic()
    row = {**hold(what, sensors), **pull(what, sensors)}
    row["minutes"] = (time.monotonic() - begun_s) / 60.0
    print(f"{name}: {row}")
    return row


def _failures(objects: dict[str, dict[str, Any]], slide: dict[str, float]) -> Iterator[str]:
    for name, row in objects.items():
        if row["moved_mm"] > MOST_MOVED_MM or row["turned_deg"] > MOST_TURNED_DEG:
            yield f"{name} moved by {row['moved_mm']:.2g} mm, {row['turned_deg']:.2g} degrees"
        if row["touching"]:
            yield f"{name} touched the bench while it was carried"
        if row["astray_mm"] > MOST_ASTRAY_MM:
            yield f"{name} was set down {row['astray_mm']:.2g} mm away"
        if row["gels_gave_mj"] > 0.0 or row["grown_mj"] > MOST_GROWN * row["lifting_mj"]:
            yield f"{name}: energy grew by {max(row['gels_gave_mj'], row['grown_mj']):.2g} mJ"
        slipped = row["slip_over_coulomb"]
        if slipped is None:
            yield f"{name} did not slip at {PULL_SHARES[1]:g} of Coulomb's load"
        elif not abs(slipped - 1.0) < MOST_OFF_COULOMB:
            yield f"{name} slipped at {slipped:.3f} of Coulomb's load"
    if not slide["tangential_share"] < MOST_TANGENTIAL:
        yield f"without friction {slide['tangential_share']:.2%} are tangential"
