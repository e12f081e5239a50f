# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Motion at a constant velocity, against many small steps and known screws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance

component = st.floats(-2.0, 2.0)
vector = st.tuples(component, component, component)


@settings(deadline=None, max_examples=30)
@given(linear=vector, angular=vector, along=st.sampled_from(TwistFrame))
def test_a_long_step_is_many_short_ones(linear, angular, along):
    start = Pose(np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.5, 0.5, 0.5]))
    whole = advance(start, linear, angular, duration_s=0.5, along=along)
    stepped = start
    for _ in range(10):
        stepped = advance(stepped, linear, angular, duration_s=0.05, along=along)
    assert stepped.position_m == pytest.approx(whole.position_m, abs=1e-9)
    assert stepped.rotation() == pytest.approx(whole.rotation(), abs=1e-9)


def test_half_a_turn_on_a_circle_about_the_parents_axis():
    end = advance(
        Pose(), (np.pi, 0.0, 0.0), (0.0, 0.0, np.pi), duration_s=1.0, along=TwistFrame.OWN
    )
    # Speed pi over turn rate pi: a circle of radius 1, half of it.
    assert end.position_m == pytest.approx([0.0, 2.0, 0.0], abs=1e-12)
    assert end.apply([1.0, 0.0, 0.0]) == pytest.approx([-1.0, 2.0, 0.0], abs=1e-12)


def test_a_turn_in_the_parents_axes_leaves_the_origin_on_its_line():
    end = advance(Pose(), (1.0, 0.0, 0.0), (0.0, 0.0, np.pi), duration_s=0.5)
    assert end.position_m == pytest.approx([0.5, 0.0, 0.0])
    assert end.apply([1.0, 0.0, 0.0]) == pytest.approx([0.5, 1.0, 0.0])


@pytest.mark.parametrize("duration_s", [-0.1, np.nan, np.inf])
def test_a_time_that_is_none_is_refused(duration_s):
    with pytest.raises(ValueError, match="duration_s"):
        advance(Pose(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), duration_s=duration_s)
