# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which force holds at which pose."""

import itertools

import numpy as np
import pytest

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.nodes.tactile_sim.force_pairing import ForceOrder, ForcePairing
from dotsim_ros.nodes.tactile_sim.motion import MotionOrder

UPRIGHT = Pose(np.zeros(3))
SECOND = 1_000_000_000


def force(stamp_s, normal_n):
    return ForceOrder(np.array([0.0, 0.0, normal_n]), int(stamp_s * SECOND), True)


def motion(stamp_s, new_start=None):
    return MotionOrder(UPRIGHT, int(stamp_s * SECOND), new_start)


def pairs_of(pairing, orders):
    """Return (stamp of a pose, force that holds there) in the order in which they are known."""
    found = []
    for order in orders:
        put = pairing.put_force if isinstance(order, ForceOrder) else pairing.put_motion
        put(order)
        while (known := pairing.next_pair()) is not None:
            pairing.weigh(known.pose)
            found.append((known.stamp_ns / SECOND, pairing.normal_n))
    return found


def test_the_order_of_arrival_of_the_two_topics_changes_nothing():
    poses, forces = [motion(1), motion(2), motion(3)], [force(1, 0.1), force(2.5, 0.2), force(3, 0)]
    expected = [(1.0, 0.1), (2.0, 0.1), (3.0, 0.0)]
    for places in itertools.combinations(range(6), 3):
        left, right = iter(poses), iter(forces)
        mixed = [next(left) if place in places else next(right) for place in range(6)]
        assert pairs_of(ForcePairing(maximum_step_s=1.0), mixed) == expected


def test_a_recording_that_is_played_again_is_paired_with_its_own_forces():
    again = [motion(1, Fault.RESTART), motion(2)]
    first = [motion(1), motion(5), force(1, 0.1), force(5, 0.5)]
    for second in ([*again, force(1, 0.3), force(2, 0.4)], [force(1, 0.3), force(2, 0.4), *again]):
        found = pairs_of(ForcePairing(maximum_step_s=1.0), [*first, *second])
        assert found == [(1.0, 0.1), (5.0, 0.5), (1.0, 0.3), (2.0, 0.4)]


def test_a_force_that_is_out_of_order_is_refused():
    pairing = ForcePairing(maximum_step_s=1.0)
    pairing.put_force(force(2, 0.1))
    for stamp_s, reason in ((2, "has the stamp of the last one"), (1.5, "0.500000 s before")):
        with pytest.raises(RefusedInputError, match=reason):
            pairing.put_force(force(stamp_s, 0.2))


def test_poses_that_wait_for_ever_are_refused_in_the_end(monkeypatch):
    monkeypatch.setattr("dotsim_ros.nodes.tactile_sim.force_pairing.HELD_COUNT", 3)
    pairing = ForcePairing(maximum_step_s=1.0)
    for stamp_s in range(1, 4):
        pairing.put_motion(motion(stamp_s))
    with pytest.raises(RefusedInputError, match="3 poses wait for a force"):
        pairing.put_motion(motion(4))
    assert pairing.waiting() == (3, SECOND)
