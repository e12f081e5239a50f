# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""time_stepper with light nodes: that all go together, what its services do, and how it ends."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from harness import measured_until
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from stepper_rig import (
    BEAT_S,
    CONTROLLER,
    CONTROLLER_ENTRY,
    REPLYING,
    TICK_S,
    WORKER,
    WORKER_ENTRY,
    Session,
    session,
)

from dotsim_ros.io.arrays import IntArray

STEPPED = {"use_sim_time": "true", "stepped": "true"}
SIMULATED = {"use_sim_time": "true"}
STEP_NS = 10_000_000
AREA = "simulated time"


def without_time(line: str) -> str:
    """Return a line without the simulated time, which differs from run to run."""
    return re.sub(r"at \d+\.\d{3} s", "at 12.340 s", line)


@pytest.fixture
def steps(tmp_path: Path) -> Iterator[Session]:
    with session(tmp_path) as found:
        yield found


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    """A worker that takes part in the steps of one stepper after the other."""
    with session(tmp_path_factory.mktemp("steps")) as found:
        found.start(WORKER, **STEPPED)
        yield found


def test_all_go_together(steps: Session) -> None:
    steps.start(WORKER, **STEPPED)
    steps.start(CONTROLLER, **SIMULATED)
    stepper = steps.begin(WORKER_ENTRY + CONTROLLER_ENTRY)
    steps.wait(lambda: len(steps.ticks) > 100, "ticks")
    running = steps.wait_for_state("running")
    assert stepper.interrupt() == 0
    assert "Traceback" not in stepper.log

    # One message for each step, none of them lost.
    np.testing.assert_array_equal(np.diff(steps.clock_ns), STEP_NS)
    stamps_s, counts, replies, beats = np.array(steps.ticks).T
    np.testing.assert_allclose(np.diff(stamps_s), TICK_S, atol=1e-9)
    # Each tick was answered before the next, though that took longer than a step.
    np.testing.assert_array_equal(replies, counts - 1)
    # Beats of the simulated times before that of the tick, the last of which was one step earlier.
    expected = np.ceil(stamps_s / BEAT_S - 1e-6)
    assert np.ptp(beats - expected) == 0
    assert float(running.values["speed_factor"]) > 0.0
    assert float(running.values["time_s"]) > 1.0
    assert int(running.values["steps"]) > 0


def test_a_managed_node_may_rest_but_not_be_configured_again(steps: Session) -> None:
    def change(label: str) -> None:
        asked = Transition(label=label)
        assert steps.call(ChangeState, "worker/change_state", transition=asked).success

    steps.start(WORKER, **STEPPED)
    with steps.stepping() as stepper:
        # The first ticks go before the graph has connected anyone to them.
        steps.wait(lambda: stepper.advance(0.1) or steps.ticks, "a tick")
        change("deactivate")
        stepper.advance(0.5)
        steps.wait(lambda: steps.clock_ns[-1] >= stepper.time_ns, "the last tick")
        count = len(steps.ticks)
        stepper.advance(1.0)
        change("activate")
        stepper.advance(1.0)
        steps.wait(lambda: len(steps.ticks) >= count + 48, "ticks again")
        stamps_s, counts, _, _ = np.array(steps.ticks).T
        np.testing.assert_array_equal(np.diff(counts), 1)
        assert np.sum(np.diff(stamps_s) > 1.4) == 1
        change("deactivate")
        change("cleanup")
        assert "started again: start all participants together" in steps.reason(stepper)


def test_services_and_speed(steps: Session) -> None:
    """Pause, steps and a reset; what is no message of the protocol; time that keeps its speed."""
    steps.start(WORKER, **STEPPED)
    stepper = steps.step(paused="true", steps_per_call=5, start_s=7.0, speed=1.0)
    stepper.wait_for_line("simulated time begins, paused")
    assert steps.wait_for_state("paused").values["steps"] == "0"
    steps.wait(lambda: steps.node.count_publishers("/clock"), "the stepper")
    time.sleep(0.5)
    assert steps.trigger("step").message == "at 7.050 s"
    assert steps.trigger("step").message == "at 7.100 s"
    steps.wait_for_time(7.1)
    time.sleep(0.3)
    assert steps.clock_ns[-1] == 7_100_000_000

    assert steps.pause(False).message == "running"
    for topic in ("answer", "step"):
        publisher = steps.node.create_publisher(String, f"/simulated_time/{topic}", 1)
        steps.wait(publisher.get_subscription_count, "a reader")
        publisher.publish(String(data="[" * 5000))
    stepper.wait_for_line("a message on /simulated_time/answer is left out")

    def lead_s() -> float:
        """Return by how much a second of the clock is shorter than one of the machine."""
        begun_s, begun_ns = time.monotonic(), steps.clock_ns[-1]
        steps.wait_for_time(1e-9 * begun_ns + 1.0)
        spent_s = time.monotonic() - begun_s
        return 1e-9 * (steps.clock_ns[-1] - begun_ns) - spent_s

    # It may make up for a tenth of a second, and what it says may be heard late now and then.
    measured_until(lead_s, below=0.15)
    refused = steps.trigger("step")
    assert not refused.success
    assert "pause it first" in refused.message
    steps.wait(lambda: steps.ticks, "a tick")
    reset = steps.trigger("reset")
    assert reset.success
    assert reset.message.startswith("reset worker; time goes on from ")
    # The pause may come before the first tick after it.
    steps.wait(lambda: _new_starts(steps).size, "a tick after the reset")
    assert steps.pause().message == "paused"
    steps.wait_for_state("paused")
    counts = [count for _, count, _, _ in steps.ticks]
    (again,) = _new_starts(steps)
    assert counts[again + 1] == 1
    # The start may be told more than once, to a worker that answers late.
    again = max(0, steps.clock_ns.count(7_000_000_000) - 1)
    np.testing.assert_array_equal(np.diff(steps.clock_ns[again:]), STEP_NS)
    assert stepper.interrupt() == 0


def _new_starts(steps: Session) -> IntArray:
    """Return where the worker's count of its ticks began again."""
    return np.flatnonzero(np.diff([count for _, count, _, _ in list(steps.ticks)]) < 0)


def test_it_stops_while_it_waits(steps: Session) -> None:
    stepper = steps.step()
    waiting = steps.wait_for_state("waiting", lambda state: "is not there" in state.message)
    assert waiting.level > 0
    assert "worker is not there; start it" in waiting.message
    # The step waits for the participants, and is given up with them.
    assert stepper.interrupt() == 0
    assert "Traceback" not in stepper.log


@pytest.mark.fault(AREA, "a node that time waits for is not there")
def test_a_participant_never_comes(steps: Session, answered: Callable[..., None]) -> None:
    stepper = steps.step(patience_s=1.0)
    assert stepper.exit_status() == 1, stepper.log
    line = steps.fatal(stepper)
    assert "does not begin after 1 s: worker is not there; start it" in line
    answered(line)


@pytest.mark.fault(AREA, "a node without `stepped` is to answer each step")
def test_a_participant_never_answers(steps: Session, answered: Callable[..., None]) -> None:
    steps.start(WORKER, **SIMULATED).wait_for_line("ready:")
    with steps.stepping() as stepper:
        line = steps.reason(stepper, patience_s=2.0)
    assert "worker does not answer" in line
    assert "use_sim_time and stepped" in line
    answered(line)


@pytest.mark.fault(AREA, "a node that time waits for ends")
def test_participants_leave(steps: Session, answered: Callable[..., None]) -> None:
    worker = steps.start(WORKER, **STEPPED)
    with steps.stepping() as stepper:
        stepper.advance(0.2)
        assert worker.interrupt() == 0
        line = steps.reason(stepper)
        assert "worker left at " in line
        answered(without_time(line))
        worker = steps.start(WORKER, **STEPPED)
        worker.wait_for_line("ready:")
        steps.wait(lambda: f"{steps.namespace}/worker" in stepper._there(), "the new worker")
        line = steps.reason(stepper)
        assert "has started again" in line
        answered(without_time(line), what="a node that time waits for is started again")
    with steps.stepping() as stepper:
        stepper.advance(0.2)
        worker.process.send_signal(signal.SIGKILL)
        line = steps.reason(stepper, patience_s=1.0)
        assert "worker did not answer for 1 s" in line
        answered(without_time(line), what="a node that time waits for is killed")


@pytest.mark.fault(AREA, "another node publishes `/clock`")
def test_another_clock_begins_in_the_middle(shared: Session, answered: Callable[..., None]) -> None:
    with shared.stepping() as stepper:
        stepper.advance(0.2)
        clock = shared.node.create_publisher(Clock, "/clock", 10)
        line = shared.reason(stepper)
    assert "another node publishes /clock" in line
    answered(line)
    # It is no better before the start, once the stepper knows of it.
    with shared.stepping() as stepper:
        shared.wait(lambda: stepper._node.count_publishers("/clock") > 1, "the other clock")
        shared.hindrance(stepper, "another node publishes /clock")
    shared.node.destroy_publisher(clock)


@pytest.mark.fault(AREA, "a node of yours has no `use_sim_time`")
def test_a_node_goes_by_another_clock(shared: Session, answered: Callable[..., None]) -> None:
    controller = shared.start(CONTROLLER)
    with shared.stepping(WORKER_ENTRY + CONTROLLER_ENTRY) as stepper:
        line = shared.reason(stepper)
    controller.end()
    assert "set use_sim_time on that node" in line
    assert "/beats of controller is stamped" in line
    answered(re.sub("[0-9]{9,}", "1700000000", line))


@pytest.mark.fault(AREA, "a node of yours stops to publish")
def test_a_controller_that_time_cannot_wait_for(
    shared: Session, answered: Callable[..., None]
) -> None:
    controller = shared.start(CONTROLLER, silent_after=20, **SIMULATED)
    controller.wait_for_line("ready:")
    wrong = {
        "a node of yours is to answer what nobody publishes": (
            "replies: {for_each: images}",
            "of /images, which no participant publishes",
        ),
        "an unstamped topic is to come every so often": (
            "replies: {every_s: 0.05}",
            "std_msgs/msg/Empty, which has no stamp: every_s needs one",
        ),
    }
    for what, (publication, reason) in wrong.items():
        entry = f"  controller:\n    publishes:\n      {publication}\n"
        with shared.stepping(WORKER_ENTRY + entry) as stepper:
            answered(shared.hindrance(stepper, reason), what=what)
    entry = f"  controller:\n{REPLYING}"
    with shared.stepping(WORKER_ENTRY + entry) as stepper:
        stepper.advance(0.1)
        line = shared.reason(stepper, patience_s=1.0)
    controller.end()
    assert "controller published nothing on /replies for 1 s" in line
    answered(without_time(line))


REFUSED = {
    "`period_s` is 0": ({"period_s": 0.0}, "", "period_s out of range"),
    "`use_sim_time` on the stepper itself": (SIMULATED, "", "unset it on this node"),
    "a file of no participants": ({}, "  []\n", "participants names no node"),
    "a period between two steps": (
        {},
        "  controller:\n    publishes:\n      beats: {every_s: 0.025}\n",
        "expected a whole number of steps",
    ),
}


@pytest.mark.fault(AREA, "parameters that make no sense")
def test_it_refuses_to_start(steps: Session, answered: Callable[..., None]) -> None:
    started = [
        (steps.step(participants or WORKER_ENTRY, **parameters), what, reason)
        for what, (parameters, participants, reason) in REFUSED.items()
    ]
    for stepper, what, reason in started:
        assert stepper.exit_status() == 2, stepper.log
        line = steps.fatal(stepper)
        assert reason in line
        answered(re.sub("participants_[0-9]+", "participants", line), what=what)
