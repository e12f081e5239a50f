# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the node starts, refuses to start, and ends."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from geometry_msgs.msg import TwistStamped
from harness import APEX_M, Executable, refused_starts, sensor, with_parameters

import msg_adapters
from dotsim_ros.nodes.tactile_sim.node import TactileSim

REFUSED: dict[str, dict[str, object]] = {
    "rate_hz": {"rate_hz": 1000.0},
    "expected one of realtime, lockstep": {"clock": "sundial"},
    "no_such_sensor": {"sensor": "no_such_sensor"},
    "no mesh file": {"indenter": "/no/such/mesh.stl"},
    "must differ": {"base_frame": "indenter"},
    "no idle image /no/such/image.png": {"idle_image": "/no/such/image.png"},
    "expected one of by_clock, exact, realtime, fast, auto": {"profile": "quick"},
    "lockstep shows each pose": {"profile": "fast", "clock": "lockstep"},
    "of type 'INTEGER', expecting type 'STRING': profile": {"profile": 3},
    "of type 'STRING_ARRAY', expecting type 'STRING': profile": {"profile": "[fast, auto]"},
}
"""Parameters that cannot work, by words of the reason."""


@pytest.fixture(scope="module")
def refusals() -> dict[str, str]:
    """Return the log of each start that must be refused, by words of the reason."""
    starts = {reason: with_parameters(given) for reason, given in REFUSED.items()}
    return refused_starts(TactileSim, starts)


@pytest.mark.parametrize("reason", REFUSED)
def test_a_start_that_cannot_work_is_refused_with_the_reason(
    refusals: dict[str, str], reason: str
) -> None:
    assert reason in refusals[reason]
    assert "Traceback" not in refusals[reason]


def test_simulated_time_without_a_clock_is_told_and_two_sigints_end_it() -> None:
    told = {
        "tactile_sim": "/clock is silent",
        "xarm_sim": "/clock is silent",
        "indenter_player": "no /clock comes",
    }
    with ExitStack() as stack:
        # All at once: each is silent for seconds before it says so.
        nodes = {
            name: Executable(f"dotsim_ros.nodes.{name}.node", {"use_sim_time": True})
            for name in told
        }
        for node in nodes.values():
            stack.callback(node.end)
        for name, node in nodes.items():
            node.wait_for_line(told[name])
            # test_in_the_middle.py interrupts a node that is at work.
            assert node.interrupt(2) == 0, node.log
            assert "Traceback" not in node.log


@pytest.mark.fault("node parameters", "a home that cannot be written, for the logs of ROS")
def test_a_home_that_cannot_be_written_ends_no_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answered: Callable[..., None]
) -> None:
    (tmp_path / "home").write_text("a file")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    for name in ("ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    node = Executable("dotsim_ros.nodes.xarm_sim.node", {})
    try:
        node.wait_for_line("ready:")
        assert node.interrupt(1) == 0, node.log
    finally:
        node.end()
    (line,) = (each for each in node.log.splitlines() if "nothing can be kept in" in each)
    assert "set ROS_LOG_DIR to a folder that can be written" in line
    answered(line)
    (kept,) = (tmp_path / "temporary").glob("dotsim_ros-*")
    assert list(kept.glob("*.log"))


def test_a_velocity_is_integrated_and_a_pose_beside_it_refused() -> None:
    with sensor(
        diagnostics_period_s=0.1, start_position_m=[0.0, 0.0, APEX_M], grid_spacing_m=0.0048
    ) as (_, client):
        twists = client.node.create_publisher(TwistStamped, "indenter/twist", 10)
        client.wait(lambda: twists.get_subscription_count() > 0, "the velocity's reader")

        def push() -> bool:
            twists.publish(
                msg_adapters.encode_twist_stamped(
                    (0.0, 0.0, -0.001),
                    (0.0, 0.0, 0.0),
                    stamp_ns=client.now_ns(),
                    frame_id="indenter",
                )
            )
            return any(
                frame.force_n()[2] > 0.0
                for frame in list(client.frames.values())
                if frame.is_whole()
            )

        client.wait(push, "a force from a velocity")
        client.send((0.0, 0.0, APEX_M + 0.05))
        state = client.wait_for_state("input", lambda state: state.values["both_inputs"] == "1")
        assert "indenter/pose comes while indenter/twist" in state.values["last_fault"]
