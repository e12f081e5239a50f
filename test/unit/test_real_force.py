# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Real forces: the depth of a force, laws of cylinders, and predictions from a few depths."""

from __future__ import annotations

import numpy as np
import pytest

from dotsim_ros.data.importers.ecoflex_compression import HEIGHT_M, RADIUS_M, CompressionTest
from dotsim_ros.data.importers.force_depth import ForceDepth
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.twin.force_control import pose_at_force
from studies.real.causes import all_explained
from studies.real.cylinders import SHARE, chosen_law, fitted, slipping
from studies.real.inference import Prior, each_left_out, weighted_draws
from studies.real.pad import COMPRESSIBILITY, DEPTH_M, FRICTION, PadTable
from studies.reference.compression import Compression, compressed
from studies.reference.run import CalculixMissingError, calculix_path

SURFACE_M = 0.004


def pushed(pose: Pose) -> np.ndarray:
    """Return the force of a gel that answers with the square of the depth, 5 N at 1 mm."""
    depth = max(SURFACE_M - float(pose.position_m[2]), 0.0)
    return np.array([0.0, 0.0, 5.0e6 * depth**2])


@pytest.mark.parametrize("start_m", [0.006, 0.0035, 0.001])
def test_the_depth_of_a_force_is_found_from_outside_and_from_inside(start_m: float) -> None:
    found = pose_at_force(pushed, Pose(np.array([0.001, 0.0, start_m])), 5.0)
    assert found.force_n == pytest.approx(5.0, rel=1e-3)
    np.testing.assert_allclose(found.pose.position_m, [0.001, 0.0, 0.003], atol=2e-6)
    assert found.trials < 40


def cylinder_test(specimen: str, repeat: int, c10_pa: float, c20_pa: float) -> CompressionTest:
    share = np.linspace(0.0, 0.6, 61)
    ends = slipping(share)
    force = c10_pa * ends.force_n["C10"] + c20_pa * ends.force_n["C20"]
    curve = ForceDepth(HEIGHT_M * share, force)
    return CompressionTest(f"EF30_{specimen}{repeat}", "EF30", specimen, repeat, share, curve)


@pytest.mark.parametrize(("c20_pa", "law"), [(0.0, "neo_hookean"), (-1500.0, "yeoh")])
def test_the_law_that_a_cylinder_has_is_chosen(c20_pa: float, law: str) -> None:
    tests = [cylinder_test("A", repeat, 1e4, c20_pa) for repeat in range(1, 6)]
    chosen, error = chosen_law(slipping(), tests)
    assert chosen == law
    assert error[law] < 1e-4
    found = fitted(slipping(), law, tests)
    np.testing.assert_allclose(found.constants_pa[0], 1e4, rtol=1e-3)
    stiffer = cylinder_test("B", 1, 1.1e4, 1.1 * c20_pa)
    np.testing.assert_allclose(found.errors([stiffer]), 1.0 / 1.1 - 1.0, atol=1e-3)


def test_calculix_compresses_a_cylinder_that_slips_as_the_closed_form_does() -> None:
    try:
        calculix_path()
    except CalculixMissingError:
        pytest.skip("CalculiX is not installed")
    bulk = 2.0e7
    modulus = 9.0 * bulk * 2.0e4 / (3.0 * bulk + 2.0e4)
    law = NeoHookean(modulus, 0.5 - modulus / (6.0 * bulk))
    solved = compressed(Compression(RADIUS_M, HEIGHT_M, law, [0.25, 0.5], 5e-3, is_stuck=False))
    wanted = 1e4 * slipping(np.array([0.25, 0.5])).force_n["C10"]
    np.testing.assert_allclose(solved.force_n, wanted, rtol=2e-3)
    stuck = compressed(Compression(RADIUS_M, HEIGHT_M, law, [0.1], 5e-3))
    assert 1.3 < stuck.force_n[0] / (1e4 * np.interp(0.1, SHARE, slipping().force_n["C10"])) < 1.6


def powers() -> PadTable:
    """Return a pad whose force is a power of depth: 1.9 where the ball slips, 2.3 where not."""
    power = 1.9 + 0.4 * FRICTION[:, None]
    log_force = np.log(6.0) + power * np.log(1e3 * DEPTH_M)
    table = np.broadcast_to(log_force, (len(COMPRESSIBILITY), *log_force.shape))
    return PadTable(np.array(table), 0.1 * (1e3 * DEPTH_M) ** 2)


def pressed(power: float) -> ForceDepth:
    depth = 1e-3 * np.array([0.5, 1.0, 2.0])
    return ForceDepth(depth, 6.0 * (1e3 * depth) ** power)


def test_each_depth_is_predicted_with_an_interval_that_holds() -> None:
    press = pressed(2.0)
    found = each_left_out(powers(), press, Prior(), seed=0)
    for one, force in zip(found, press.force_n, strict=True):
        assert one.interval_n[0] < force < one.interval_n[1]
        assert one.effective_draws > 500
    inside = abs(found[1].force_n / press.force_n[1] - 1.0)
    assert inside < 0.05
    with pytest.raises(ValueError, match="one depth fits every state"):
        weighted_draws(
            powers(), ForceDepth(press.depth_m[:1], press.force_n[:1]), prior=Prior(), count=10
        )


def test_what_is_hidden_in_a_press_is_among_its_explanations() -> None:
    found = all_explained(powers(), pressed(1.9))
    holding = {one.name for one in found if one.holds}
    assert "slip of the ball" in holding
    assert "the makers' model" not in holding
    assert len(holding) > 1  # three depths do not name one cause
