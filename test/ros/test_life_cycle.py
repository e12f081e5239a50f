# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""tactile_sim under a manager: its states, what it does in each, and what it refuses."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import pytest
from harness import APEX_M, START_PATIENCE_S, Client, Executable, running
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from std_srvs.srv import Trigger

NODE = "/tactile_sim"
PERIOD_S = 0.1
# A coarse gel is made in a tenth of the time.
FRAME = {"rate_hz": 10.0, "grid_spacing_m": 0.0048}


@contextmanager
def managed(**parameters: Any) -> Iterator[tuple[Executable, Client]]:
    """Run a tactile_sim that waits to be configured, and a client."""
    given = {"autostart": False, "diagnostics_period_s": PERIOD_S, **FRAME, **parameters}
    ready = "unconfigured: waits"
    with running(parameters=given, ready=ready) as executable, closing(Client()) as client:
        yield executable, client


def change(client: Client, label: str) -> bool:
    """Ask for a transition; return whether it was made."""
    # The first configuration imports and compiles.
    answer = client.call(
        ChangeState,
        f"{NODE}/change_state",
        patience_s=START_PATIENCE_S,
        transition=Transition(label=label),
    )
    return bool(answer.success)


def state(client: Client) -> str:
    """Return the node's state."""
    return str(client.call(GetState, f"{NODE}/get_state").current_state.label)


def frames_stay_away(client: Client) -> bool:
    """Return whether no frame comes while the node says three times how it is."""
    for _ in range(3):
        client.diagnostics.clear()
        client.state("frames")
        # What was on its way when the node was asked may have come until the first.
        client.frames.clear()
    client.diagnostics.clear()
    client.state("frames")
    return not client.frames


def has_topic(client: Client, topic: str) -> bool:
    return client.node.count_publishers(topic) > 0


def test_frames_come_while_the_node_is_active_alone() -> None:
    with managed() as (executable, client):
        events: list[str] = []
        client.node.create_subscription(
            TransitionEvent,
            f"{NODE}/transition_event",
            lambda event: events.append(event.goal_state.label),
            10,
        )
        client.wait(lambda: has_topic(client, f"{NODE}/transition_event"), "the events")
        assert state(client) == "unconfigured"
        assert not has_topic(client, "image_raw")
        assert change(client, "configure"), executable.log
        assert state(client) == "inactive"
        client.meet()
        assert frames_stay_away(client)
        assert "inactive: activate the node" in client.state("frames").message
        refused = client.call(Trigger, f"{NODE}/calibrate_idle")
        assert (refused.success, "inactive" in refused.message) == (False, True)
        assert client.call(Trigger, f"{NODE}/reset").success
        assert "ready:" not in executable.log

        assert change(client, "activate")
        assert state(client) == "active"
        client.next_frame(lambda frame: True)
        executable.wait_for_line("ready: densetact2")
        client.send((0.0, 0.0, APEX_M - 0.001))
        pressed = client.next_frame(lambda frame: frame.force_n()[2] > 0.0)

        assert change(client, "deactivate")
        assert frames_stay_away(client)
        assert change(client, "activate")
        # The same sensor, at rest until it hears of the indenter again.
        client.next_frame(lambda frame: frame.indenter_m() is None)
        client.send((0.0, 0.0, APEX_M - 0.001))
        again = client.next_frame(lambda frame: frame.force_n()[2] > 0.0)
        assert again.image().shape == pressed.image().shape
        client.wait(lambda: events.count("active") == 2, "both events")
        assert executable.interrupt() == 0, executable.log
        assert "Traceback" not in executable.log


@pytest.mark.fault("node parameters", "a managed node cannot make a transition")
def test_a_transition_that_cannot_be_made_is_refused_and_what_fails_can_be_corrected(
    answered: Any,
) -> None:
    with managed(sensor="no_such_sensor") as (executable, client):
        assert not change(client, "activate")
        executable.wait_for_line("expected configure (1), shutdown (5)")
        answered(
            executable.log.rpartition("]: ")[2],
            what="a managed node is activated before it is configured",
        )
        assert not change(client, "no_such_transition")
        for number in (0, 4, 255):
            transition = Transition(id=number)
            answer = client.call(ChangeState, f"{NODE}/change_state", transition=transition)
            assert not answer.success
        offered = client.call(GetAvailableTransitions, f"{NODE}/get_available_transitions")
        labels = [each.transition.label for each in offered.available_transitions]
        assert labels == ["configure", "shutdown"]
        for name in ("effects", "effects_folder", "camera_info_url", "autostart"):
            # What runs programs, or writes files, is nothing for another node to choose.
            value = True if name == "autostart" else "/tmp/of_somebody"
            fixed = client.set_parameters(**{name: value})
            assert (fixed.successful, "read-only" in fixed.reason) == (False, True)
        assert not change(client, "configure")
        executable.wait_for_line("the transition 'configure' is refused")
        (line,) = [each for each in executable.log.splitlines() if "'configure' is ref" in each]
        assert "no sensor is named 'no_such_sensor', expected one of densetact2, " in line
        answered(
            line.partition("]: ")[2].partition(";")[0],
            what="a managed node is configured with a sensor that is not there",
        )
        assert state(client) == "unconfigured"
        # Two that contradict each other, and then another fault, late: the topics are made.
        assert client.set_parameters(sensor="densetact2", base_frame="indenter").successful
        assert not change(client, "configure")
        executable.wait_for_line("must differ")
        assert client.set_parameters(base_frame="densetact_base", image_topic="bad name").successful
        assert not change(client, "configure")
        executable.wait_for_line("bad name")
        assert not has_topic(client, "wrench")
        assert client.set_parameters(image_topic="image_raw").successful
        assert change(client, "configure"), executable.log
        assert change(client, "activate")
        client.next_frame(lambda frame: True)


def test_cleaned_up_it_becomes_another_sensor_with_another_clock_and_ends_when_shut_down() -> None:
    # Of each sensor its own grid.
    with managed(grid_spacing_m=0.0) as (executable, client):
        assert change(client, "configure")
        fixed = client.set_parameters(sensor="flat_pad", clock="lockstep", image_topic="pad/image")
        assert not fixed.successful
        assert "read-only while the node is configured: clean it up first" in fixed.reason
        # As of a dump that is loaded again.
        assert client.set_parameters(sensor="densetact2", jpeg_quality=50).successful
        assert change(client, "activate")
        domed = client.next_frame(lambda frame: True)
        assert change(client, "deactivate")
        assert change(client, "cleanup")
        assert state(client) == "unconfigured"
        for topic in ("image_raw", "wrench", "/diagnostics"):
            client.wait(lambda topic=topic: not has_topic(client, topic), f"no more {topic}")
        client.wait(
            lambda: not client.node.count_subscribers("indenter/pose"), "no more reader of poses"
        )
        assert client.set_parameters(sensor="flat_pad", clock="lockstep").successful
        assert change(client, "configure"), executable.log
        assert change(client, "activate")
        client.meet()
        stamp_ns = client.send((0.0, 0.0, 0.05))
        flat = client.whole_frame(stamp_ns)
        assert len(flat.cloud().position) != len(domed.cloud().position)
        # Back to the clock that has a thread of its own, with a rate of its own.
        assert change(client, "deactivate")
        client.send((0.0, 0.0, 0.04))
        assert change(client, "cleanup")
        assert client.set_parameters(clock="realtime", rate_hz=20.0).successful
        assert change(client, "configure")
        assert change(client, "activate")
        client.next_frame(lambda frame: frame.stamp_ns > stamp_ns)
        assert change(client, "shutdown")
        assert state(client) == "finalized"
        client.wait(lambda: not has_topic(client, "image_raw"), "no more images")
        assert not change(client, "configure")
        assert executable.interrupt() == 0, executable.log
        assert "Traceback" not in executable.log
