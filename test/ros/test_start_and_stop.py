"""How the node starts, refuses to start, and ends."""

from __future__ import annotations

import pytest
from geometry_msgs.msg import TwistStamped
from harness import APEX_M, Executable, running, sensor

import msg_adapters

MODULE = "dotsim_ros.nodes.tactile_sim.node"


@pytest.mark.parametrize("count", [1, 2])
def test_sigint_ends_it_with_status_0(count: int) -> None:
    with running() as node:
        assert node.interrupt(count) == 0, node.log
        assert "Traceback" not in node.log


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"rate_hz": 1000.0}, "rate_hz"),
        ({"clock": "sundial"}, "expected one of realtime, lockstep"),
        ({"sensor": "no_such_sensor"}, "no_such_sensor"),
        ({"indenter": "/no/such/mesh.stl"}, "no mesh file"),
        ({"base_frame": "indenter"}, "must differ"),
        ({"idle_image": "/no/such/image.png"}, "no idle image /no/such/image.png"),
    ],
)
def test_a_start_that_cannot_work_is_refused_with_the_reason(
    parameters: dict[str, object], reason: str
) -> None:
    node = Executable(MODULE, parameters)
    try:
        assert node.exit_status() != 0
        assert reason in node.log
        assert "Traceback" not in node.log
    finally:
        node.end()


def test_simulated_time_without_a_clock_is_told() -> None:
    with running(parameters={"use_sim_time": True}) as node:
        node.wait_for_line("/clock is silent")
        assert node.interrupt() == 0


def test_a_velocity_is_integrated_and_a_pose_beside_it_refused() -> None:
    with sensor(diagnostics_period_s=0.1, start_position_m=[0.0, 0.0, APEX_M]) as (_, client):
        twists = client.node.create_publisher(TwistStamped, "indenter/twist", 10)
        client.wait(lambda: twists.get_subscription_count() > 0, "the velocity's reader")

        def push() -> bool:
            twists.publish(
                msg_adapters.encode_twist_stamped(
                    (0.0, 0.0, -0.001),
                    (0.0, 0.0, 0.0),
                    stamp_ns=client.node.get_clock().now().nanoseconds,
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
