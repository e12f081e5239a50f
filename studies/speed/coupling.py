# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which way of coupling gel and bodies is stable, keeps energy, and what it costs.

Three schemes between two solutions of the gel:
- held: the wrench of the last solution, constant (plain staggered);
- tangent: the wrench of the last solution and its tangent, as `MujocoCoupling` has it;
- iterated: held, but each coupling time is repeated from its start with the wrench of its end,
  relaxed by Aitken's rule, until the wrench at the end is the one that was put in.

Stability: a box lies down on the dome, free in height; it is stable where the force's deviation in
the last 0.1 s is below 2 % of its weight. Energy: a ball swings on the gel without damping; of the
energy of the swing, what is left after ten periods.
"""

from __future__ import annotations

import copy
import time
from dataclasses import replace
from typing import Any
from unittest import mock

import mujoco
import numpy as np

from dotsim_ros.control.environments import coupling as coupling_module
from dotsim_ros.control.environments.coupling import CoupledFinger, MujocoCoupling
from dotsim_ros.gel.make import GelFrame, SingleImplicitGel
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.sensor import GelFailureError, TactileSensor
from dotsim_ros.specification import SolverSpecification, load_sensor
from studies.run import expect_known, expect_positive

GRAVITY_M_S2 = 9.81
STEP_S = 0.5e-3
MASSES_KG = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
SETTLING_S = 0.6
RELATIVE_CHANGE = 1e-3
MOST_ITERATIONS = 12


class HeldFinger(CoupledFinger):
    """The wrench of the last solution, constant."""

    def _predicted(self, base: Any) -> FloatArray:
        indenter = self._indenter(base)
        # It must at least notice when they meet.
        if not self._anchor.wrench.any() and self._is_due(indenter):
            self._solve(indenter)
        return self._anchor.wrench


class GivenFinger(CoupledFinger):
    """A wrench that `IteratedCoupling` sets."""

    held: FloatArray

    def _predicted(self, base: Any) -> FloatArray:
        return self.held


class IteratedCoupling(MujocoCoupling):
    """The wrench of the end of each coupling time, found by relaxed repetition."""

    def step(self) -> GelFrame:
        gel, finger = self.sensor._gel, self.finger
        assert isinstance(finger, GivenFinger)
        assert isinstance(gel, SingleImplicitGel)
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        begun = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.data, begun, kind)
        world, before = copy.copy(gel.gel.worlds[0]), finger._before
        finger.held = finger._anchor.wrench.copy()
        share, last_error = 0.5, None
        for _ in range(MOST_ITERATIONS):
            mujoco.mj_setState(self.model, self.data, begun, kind)
            mujoco.mj_forward(self.model, self.data)
            gel.gel.worlds[0], finger._before = copy.copy(world), before
            frame = super().step()
            error = finger._anchor.wrench - finger.held
            scale = max(float(np.linalg.norm(finger._anchor.wrench[:3])), 1e-3)
            if float(np.linalg.norm(error[:3])) < RELATIVE_CHANGE * scale:
                break
            if last_error is not None:
                change = error - last_error
                share *= -float(last_error @ change) / max(float(change @ change), 1e-30)
                share = float(np.clip(share, 0.02, 1.0))
            finger.held = finger.held + share * error
            last_error = error
        return frame


SCHEMES = {
    "held": (HeldFinger, MujocoCoupling),
    "tangent": (CoupledFinger, MujocoCoupling),
    "iterated": (GivenFinger, IteratedCoupling),
}


def coupled(
    scheme: str, sensor: TactileSensor, geom: str, mass_kg: float, height_m: float, period_s: float
) -> MujocoCoupling:
    """Return a body above the dome, free in height alone."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
          <option timestep="{STEP_S}" gravity="0 0 {-GRAVITY_M_S2}" integrator="implicitfast"/>
          <worldbody>
            <body name="sensor"/>
            <body name="thing" pos="0 0 {height_m}">
              <joint type="slide" axis="0 0 1"/>
              <geom name="thing" {geom} mass="{mass_kg}"/>
            </body>
          </worldbody>
        </mujoco>"""
    )
    finger, coupling = SCHEMES[scheme]
    with mock.patch.object(coupling_module, "CoupledFinger", finger):
        return coupling(
            model,
            mujoco.MjData(model),
            sensor,
            sensor_body="sensor",
            pressed_geom="thing",
            coupling_s=period_s,
        )


def settle(scheme: str, sensor: TactileSensor, mass_kg: float, period_s: float) -> dict[str, Any]:
    """Return how a box comes to rest on the dome: force's error and deviation as shares of its
    weight, solutions of the gel, and CPU time, for each second that was simulated."""
    apex_m = float(sensor.skin.apex_m[2])
    geom = 'type="box" size="0.006 0.006 0.004"'
    with mock.patch.object(sensor, "press", wraps=sensor.press) as press:
        begun_s = time.process_time()
        world = coupled(scheme, sensor, geom, mass_kg, apex_m + 4.02e-3, period_s)
        weight_n, forces = mass_kg * GRAVITY_M_S2, []
        try:
            for _ in range(round(SETTLING_S / period_s)):
                world.step()
                forces.append(world.wrench().force_n[2])
        except (ValueError, GelFailureError) as failure:
            return {"stable": False, "reason": type(failure).__name__}
        spent_s = time.process_time() - begun_s
    last = np.array(forces[-round(0.1 / period_s) :])
    deviation = float(np.std(last) / weight_n)
    return {
        "stable": bool(deviation < 0.02 and abs(last.mean() / weight_n - 1.0) < 0.02),
        "force_error": float(last.mean() / weight_n - 1.0),
        "force_deviation": deviation,
        "solutions_per_second": press.call_count / SETTLING_S,
        "cpu_s_per_second": spent_s / SETTLING_S,
    }


def energy_left(scheme: str, sensor: TactileSensor, period_s: float) -> float:
    """Return what is left of a ball's energy of swinging after ten periods, as a share: 1 where
    none is lost or won, infinite where it leaves the gel or is pushed through it."""
    mass_kg, amplitude_m = 0.05, 0.15e-3
    weight_n = mass_kg * GRAVITY_M_S2
    apex_m = float(sensor.skin.apex_m[2])
    geom = 'type="sphere" size="0.004"'
    # The force of the gel over the height of the ball's centre, pressed once without a swing.
    world = coupled("held", sensor, geom, mass_kg, apex_m + 4.0e-3, period_s)
    heights, forces = np.linspace(apex_m + 4.0e-3, apex_m + 2.8e-3, 49), []
    for height in heights:
        world.data.qpos[0] = height - heights[0]
        mujoco.mj_forward(world.model, world.data)
        forces.append(sensor.press(world.indenter_pose()).wrench.force_n[2])
    net = np.array(forces) - weight_n
    middle = 0.5 * (net[1:] + net[:-1]) * np.diff(heights)
    potential = -np.concatenate([[0.0], np.cumsum(middle)])
    lowest = int(np.argmin(potential))
    stiffness_n_m = float(-np.gradient(np.array(forces), heights)[lowest])
    swing_s = 2.0 * np.pi * np.sqrt(mass_kg / stiffness_n_m)

    def energy(height: float, speed: float) -> float:
        above = np.interp(height, heights[::-1], potential[::-1]) - potential[lowest]
        return float(above + 0.5 * mass_kg * speed**2)

    with mock.patch.object(coupling_module, "DAMPING_S", 0.0):
        start_m = float(heights[lowest]) + amplitude_m
        world = coupled(scheme, sensor, geom, mass_kg, start_m, period_s)
        try:
            for _ in range(round(10.0 * swing_s / period_s)):
                world.step()
        except (ValueError, GelFailureError):
            return float("inf")
    end_m, speed = start_m + float(world.data.qpos[0]), float(world.data.qvel[0])
    if not heights[-1] < end_m < heights[0]:
        return float("inf")
    return energy(end_m, speed) / energy(start_m, 0.0)


def finite(share: float) -> float | None:
    """Return a share with three digits; None where it is infinite, which JSON does not know."""
    return round(share, 3) if np.isfinite(share) else None


def coupling(
    *,
    schemes: tuple[str, ...] = tuple(SCHEMES),
    periods_ms: tuple[float, ...] = (5.0, 10.0, 20.0),
) -> dict[str, Any]:
    """Which way of coupling gel and bodies is stable, keeps energy, and what it costs.

    Args:
        schemes: of held, tangent, iterated.
        periods_ms: coupling times.
    """
    expect_known("scheme", schemes, SCHEMES)
    expect_positive(shortest_period_ms=min(periods_ms))
    solver = SolverSpecification(grid_spacing_m=3.6e-3, refined=False)
    sensor = TactileSensor.load(replace(load_sensor("densetact2"), solver=solver))
    return {
        "schemes": {
            f"{scheme}_{period_ms:g}_ms": _measured(scheme, sensor, 1e-3 * period_ms)
            for scheme in schemes
            for period_ms in periods_ms
        }
    }


def _measured(scheme: str, sensor: TactileSensor, period_s: float) -> dict[str, Any]:
    masses = {mass_kg: settle(scheme, sensor, mass_kg, period_s) for mass_kg in MASSES_KG}
    lightest = None
    for mass_kg in sorted(MASSES_KG, reverse=True):
        if not masses[mass_kg]["stable"]:
            break
        lightest = mass_kg
    return {
        "lightest_stable_kg": lightest,
        "energy_left": finite(energy_left(scheme, sensor, period_s)),
        "masses": {f"{mass_kg:g}": row for mass_kg, row in masses.items()},
    }
