# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Profiles of the running node: what it tells of them, and how it changes them."""

from __future__ import annotations

from harness import APEX_M, sensor


def test_realtime_is_the_profile_of_the_realtime_clock() -> None:
    with sensor(diagnostics_period_s=0.1) as (executable, client):
        client.wait_for_state("frames", lambda state: state.values["profile"] == "realtime")
        assert "profile realtime" in executable.log
        refused = client.set_parameters(profile="fast")
        assert not refused.successful
        assert "read-only" in refused.reason


def test_exact_takes_any_motion_in_one_frame() -> None:
    with sensor(profile="exact", diagnostics_period_s=0.1, rate_hz=2.0, input_timeout_s=0.6) as (
        _,
        client,
    ):
        start_m, end_m = [0.0, 0.0, APEX_M + 0.0002], [0.0, 0.0, APEX_M - 0.002]
        client.send((0.0, 0.0, start_m[2]))
        begun = client.next_frame(lambda frame: frame.indenter_m() == start_m)
        client.send((0.0, 0.0, end_m[2]))
        client.next_frame(lambda frame: frame.indenter_m() == end_m)
        shown = {
            tuple(frame.indenter_m())
            for stamp_ns, frame in list(client.frames.items())
            if stamp_ns > begun.stamp_ns and frame.indenter_m() is not None
        }
        assert shown <= {tuple(start_m), tuple(end_m)}


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
