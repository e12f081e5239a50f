# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Environments of a gel in processes of their own: the same as single ones, and what goes wrong."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.gel.batch import GelBatch, GelWorkerError
from dotsim_ros.gel.implicit.gel import GelState, PressTooDeepError
from dotsim_ros.gel.make import make_gel_batch
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import SensorSpecification, SolverSpecification, load_sensor

BALL = sphere(4.0e-3)
COUNT, STEP_S = 3, 0.04


def coarse_sensor() -> SensorSpecification:
    solver = SolverSpecification(grid_spacing_m=4.8e-3, refined=False)
    return replace(load_sensor("densetact2"), solver=solver)


def pose_at(depth_m: float, x_m: float = 0.0) -> Pose:
    return Pose(np.array([x_m, 0.0, 15.75e-3 - depth_m]))


def paths() -> list[list[Pose | None]]:
    """Return the poses of each step."""
    return [
        [pose_at(0.4e-3), pose_at(0.8e-3), None],
        [pose_at(0.8e-3), pose_at(0.8e-3, 0.3e-3), pose_at(0.2e-3)],
        [pose_at(1.2e-3, 0.2e-3), None, pose_at(0.6e-3)],
    ]


def assert_same(one: GelState, other: GelState) -> None:
    assert np.array_equal(one.displacement_m, other.displacement_m)
    assert np.array_equal(one.skin_position_m, other.skin_position_m)
    assert np.array_equal(one.wrench.force_n, other.wrench.force_n)
    assert one.iterations == other.iterations


def test_environments_equal_single_gels_until_a_process_is_killed() -> None:
    batch = GelBatch(coarse_sensor(), indenter=BALL, environment_count=COUNT, worker_count=2)
    together = [batch.step(poses, STEP_S) for poses in paths()]
    single = make_gel_batch(coarse_sensor(), indenter=BALL, environment_count=1)
    pressed = 0
    for environment in range(COUNT):
        single.reset()
        for step, poses in enumerate(paths()):
            alone = single.step([poses[environment]], STEP_S)[0]
            assert_same(together[step][environment], alone)
            pressed += alone.contact_count > 0
    assert pressed >= 6

    # A refused step moves no environment.
    first, second = paths()[:2]
    batch.reset()
    batch.step(first, STEP_S)
    with pytest.raises(PressTooDeepError, match="press less deep"):
        batch.step([*second[:2], pose_at(9.0e-3)], STEP_S)
    with pytest.raises(ValueError, match="2 poses for 3 environments"):
        batch.step([None, None], STEP_S)
    for state, wanted in zip(batch.step(second, STEP_S), together[1], strict=True):
        assert_same(state, wanted)

    processes = [share.process for share in batch._shares]
    os.kill(processes[1].pid, signal.SIGKILL)
    for _ in range(2):
        with pytest.raises(GelWorkerError, match="environments 1 to 2 has ended with status -9"):
            batch.step([None] * COUNT, STEP_S)
    batch.close()
    batch.close()
    assert not any(process.is_alive() for process in processes)
    with pytest.raises(GelWorkerError):
        batch.reset()


def test_no_worker_is_refused() -> None:
    with pytest.raises(ValueError, match="expected at least one"):
        GelBatch(coarse_sensor(), indenter=BALL, environment_count=1, worker_count=0)


def test_a_closed_batch_says_so() -> None:
    batch = GelBatch(coarse_sensor(), indenter=BALL, environment_count=1)
    batch.close()
    with pytest.raises(ValueError, match="closed"):
        batch.reset()
