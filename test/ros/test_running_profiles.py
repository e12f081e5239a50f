# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Profiles of the running node: what it tells of them, and how it changes them."""

from __future__ import annotations

from harness import APEX_M, sensor


def test_auto_tells_its_profile_and_goes_down_when_frames_miss_their_deadline() -> None:
    # First slow enough for a busy machine to begin with an exact profile; then far beyond what any
    # machine computes: every frame of a motion misses its deadline.
    with sensor(profile="auto", diagnostics_period_s=0.1, rate_hz=1.0, input_timeout_s=1.5) as (
        executable,
        client,
    ):
        client.wait_for_state("frames", lambda state: "profile_changes" in state.values)
        assert "of auto: a frame takes exact" in executable.log
        assert client.set_parameters(rate_hz=240.0).successful
        for number in range(600):
            depth_m = 0.0005 + 0.0005 * (number % 2)
            client.send((0.0, 0.0, APEX_M - depth_m))
            client.next_frame(lambda frame: frame.force_n()[2] > 0.0)
            if client.state("frames").values["profile"] == "fast":
                break
        state = client.wait_for_state("frames", lambda state: state.values["profile"] == "fast")
        assert int(state.values["profile_changes"]) >= 1
        assert "took more than 4 ms" in state.values["profile_reason"]
        executable.wait_for_line("-> fast")
