# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Moves simulated time on in steps, each when every participant has gone as far as the one before.

The order of what happens is then that of the simulated times, on any machine and under any load. A
message that is sent in one step is heard at the beginning of the next.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Condition
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

import msg_adapters
from dotsim_ros.nodes.simulated_time.participants import Participant, Publication
from dotsim_ros.nodes.simulated_time.protocol import (
    ANSWER_TOPIC,
    CLOCK_TOPIC,
    NANOSECONDS_PER_SECOND,
    PROTOCOL_QOS,
    STEP_TOPIC,
    Answer,
    Kind,
    Sent,
    Step,
    decode_answer,
    encode,
)
from dotsim_ros.nodes.simulated_time.publication_watch import PublicationWatch

CLOCK_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
CALL_EVERY_S = 0.1
LOOK_EVERY_S = 0.5
TELL_AFTER_S = 2.0
CALM_ROUNDS = 2
"""In which all are there and connected, before time is told, and one more before it begins."""
LARGEST_LAG_S = 0.1
"""What is behind by more is not made up for: time would run too fast afterwards."""


class SteppingError(OSError):
    """Time cannot go on; says whom it waits for."""


@dataclass(frozen=True)
class StepperSettings:
    """How time goes.

    Attributes:
        start_s: the first time; above zero, which means no time.
        speed: simulated seconds for each real one; 0: as many as the machine gives.
        patience_s: how long a participant may take for one step, or to come.
    """

    period_s: float = 0.01
    start_s: float = 1.0
    speed: float = 0.0
    patience_s: float = 120.0


class SpeedLimit:
    """Keeps simulated time from running ahead of real time.

    Args:
        speed: simulated seconds for each real one; 0: no limit.
        now_s: real time at which the simulated one begins to run.
    """

    def __init__(self, speed: float, *, now_s: float) -> None:
        self._speed = speed
        self._due_s = now_s

    def delay_s(self, simulated_s: float, now_s: float) -> float:
        """Return how long to wait before time may go on."""
        if self._speed == 0.0:
            return 0.0
        self._due_s = max(self._due_s + simulated_s / self._speed, now_s - LARGEST_LAG_S)
        return max(0.0, self._due_s - now_s)


class Stepper:
    """Steps the participants of one session; `join`, `step`, `advance` from one thread of the
    user's.

    Args:
        node: for its topics; somebody spins it in another thread.

    Attributes:
        time_ns: where the participants are.
        waiting_for: what `join` or a step has been waiting for, for a moment or longer, in words.
    """

    def __init__(
        self, node: Node, participants: Mapping[str, Participant], settings: StepperSettings
    ) -> None:
        self._node = node
        self.settings = settings
        self.period_ns = round(settings.period_s * NANOSECONDS_PER_SECOND)
        if self.period_ns <= 0:
            raise ValueError(f"the step is {settings.period_s:g} s, expected more than 0")
        self.time_ns = round(settings.start_s * NANOSECONDS_PER_SECOND)
        self.waiting_for = ""
        self._changed = Condition()
        self._present: dict[str, Answer] = {}
        self._lives: dict[str, set[str]] = {}
        self._joined: dict[str, str] = {}
        self._done: dict[str, int] = {}
        self._sent: dict[str, Sent] = {}
        self._news: dict[str, Sent] = {}
        self._watches: dict[str, PublicationWatch] = {}
        self._anew = ""
        self._is_joined = self._is_cancelled = False
        self._looked_s = -math.inf
        # Not the node's own methods: these topics belong to no step.
        self._steps = Node.create_publisher(node, String, STEP_TOPIC, PROTOCOL_QOS)
        self._clock = Node.create_publisher(node, Clock, CLOCK_TOPIC, CLOCK_QOS)
        Node.create_subscription(node, String, ANSWER_TOPIC, self._on_answer, PROTOCOL_QOS)
        self.expect(participants)

    def expect(self, participants: Mapping[str, Participant]) -> None:
        """Wait for these participants from now on; they join before the next step.

        Raises:
            ValueError: a period of theirs is no whole number of steps.
        """
        for name, participant in participants.items():
            for topic, publication in participant.publishes.items():
                self._check_period(f"{name}: {topic}", publication)
        wanted = {
            self._resolved(topic): (self._resolved(name), publication)
            for name, participant in participants.items()
            for topic, publication in participant.publishes.items()
        }
        with self._changed:
            self._participants = {self._resolved(n): p for n, p in participants.items()}
            for topic, watch in list(self._watches.items()):
                if (watch.owner, watch.publication) != wanted.get(topic):
                    self._watches.pop(topic).close()
            for topic, (owner, publication) in wanted.items():
                if topic not in self._watches:
                    self._watches[topic] = PublicationWatch(
                        self._node,
                        topic,
                        owner,
                        publication,
                        changed=self._changed,
                        now_ns=lambda: self.time_ns,
                    )
            self._is_joined = False

    def join(self) -> None:
        """Wait until all participants are there and connected to each other.

        Raises:
            SteppingError: they are not after the patience; says what is missing.
        """
        begun_s = time.monotonic()
        with self._changed:
            self._present.clear()
        rounds, there_s = 0, math.inf
        while True:
            with self._changed:
                self._lives.clear()
            self._steps.publish(encode(Step(self.time_ns, Kind.CALL)))
            with self._changed:
                self._changed.wait_for(self._all_are_present, CALL_EVERY_S)
                self._check_cancelled()
                absent = self._absent()
                self.waiting_for = absent or self._hindrance()
                rounds = 0 if self.waiting_for else rounds + 1
                if rounds > CALM_ROUNDS:
                    self._begin()
                    return
                self._present.clear()
            now_s = time.monotonic()
            there_s = math.inf if absent else min(there_s, now_s)
            if now_s - begun_s > self.settings.patience_s:
                raise SteppingError(
                    f"simulated time does not begin after {self.settings.patience_s:g} s: "
                    f"{self.waiting_for}"
                )
            # Nodes that follow /clock need a time to begin with. What they publish as they hear it
            # is to be counted: they know who listens a moment after the others do. A node that
            # becomes ready only once there is a time hears it earlier.
            if rounds >= CALM_ROUNDS or now_s - there_s > TELL_AFTER_S:
                self._publish_clock()
            time.sleep(CALL_EVERY_S)

    def step(self) -> None:
        """Take all participants on by one step.

        Raises:
            SteppingError: a participant does not answer, or left, or another clock runs.
        """
        if not self._is_joined:
            self.join()
        with self._changed:
            self.time_ns += self.period_ns
            heard = {topic: watch.sent for topic, watch in self._watches.items()}
            step = Step(self.time_ns, Kind.STEP, {**self._news, **heard})
            self._news = {}
        self._publish_clock()
        self._steps.publish(encode(step))
        self._wait()

    def advance(self, duration_s: float, progress: Callable[[float], None] | None = None) -> None:
        """Take all participants on by a time, a whole number of steps.

        Args:
            progress: called after each step with the share that is done.

        Raises:
            SteppingError: as of `step`.
        """
        if not self._is_joined:
            self.join()
        limit = SpeedLimit(self.settings.speed, now_s=time.monotonic())
        count = round(duration_s * NANOSECONDS_PER_SECOND / self.period_ns)
        for index in range(count):
            self.step()
            time.sleep(limit.delay_s(self.settings.period_s, time.monotonic()))
            if progress is not None:
                progress((index + 1) / count)

    def cancel(self) -> None:
        """End what waits, now and from now on; it raises a SteppingError. From any thread."""
        with self._changed:
            self._is_cancelled = True
            self._changed.notify_all()

    def _publish_clock(self) -> None:
        self._clock.publish(Clock(clock=msg_adapters.encode_stamp(self.time_ns)))

    def _wait(self) -> None:
        """Wait until nobody is late.

        Raises:
            SteppingError: somebody is for too long, or has left, or something else sets the time.
        """
        begun_s = time.monotonic()
        with self._changed:
            while True:
                self._check_cancelled()
                self._check_faults()
                late, now_s = self._late(), time.monotonic()
                # Who does not answer may have left, and another clock stops nobody.
                if now_s - self._looked_s > LOOK_EVERY_S:
                    self._looked_s = now_s
                    self._look(late)
                    if late:
                        # What they answer says what they wait for.
                        self._steps.publish(encode(Step(self.time_ns, Kind.CALL)))
                    self.waiting_for = late if now_s - begun_s > LOOK_EVERY_S else ""
                if not late:
                    return
                if now_s - begun_s > self.settings.patience_s:
                    raise SteppingError(
                        f"at {self._time_s:.3f} s of simulated time: {late} for "
                        f"{now_s - begun_s:.0f} s{self._waits()}"
                    )
                self._changed.wait(min(LOOK_EVERY_S, self.settings.patience_s))

    def _waits(self) -> str:
        waits = [
            f"{name.lstrip('/')} waits for {each.waits}"
            for name, each in self._present.items()
            if each.waits
        ]
        return "".join(f"; {words}" for words in waits)

    @property
    def _time_s(self) -> float:
        return self.time_ns / NANOSECONDS_PER_SECOND

    def _check_cancelled(self) -> None:
        if self._is_cancelled:
            raise SteppingError("simulated time was stopped")

    def _check_faults(self) -> None:
        if self._anew:
            raise SteppingError(
                f"{self._anew.lstrip('/')} left at {self._time_s:.3f} s of simulated time and has "
                "started again: start all participants together"
            )
        for watch in self._watches.values():
            if watch.fault:
                raise SteppingError(watch.fault)

    def _check_period(self, where: str, publication: Publication) -> None:
        """Raise a ValueError where what is published falls between two steps: which step it then
        belonged to would be a matter of chance."""
        every_ns = round(publication.every_s * NANOSECONDS_PER_SECOND)
        if every_ns % self.period_ns:
            raise ValueError(
                f"{where} is published every {publication.every_s:g} s, expected a whole number of "
                f"steps of {self.settings.period_s:g} s: make the steps shorter"
            )

    def _look(self, late: str) -> None:
        """Look whether those who are waited for can still come, and whether the time is ours."""
        if self._node.count_publishers(CLOCK_TOPIC) > 1:
            raise SteppingError(_TWO_CLOCKS)
        if not late:
            return
        there = self._there()
        for name in self._participants:
            if name not in there:
                raise SteppingError(
                    f"{name.lstrip('/')} left at {self._time_s:.3f} s of simulated time: see its "
                    "log for the reason"
                )

    def _there(self) -> set[str]:
        return {
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
        }

    def _late(self) -> str:
        """Return who has not gone to the present time, in words; empty for nobody."""
        late = [
            name.lstrip("/")
            for name, each in self._participants.items()
            if each.answers and self._done.get(name) != self.time_ns
        ]
        if late:
            return f"{', '.join(late)} did not answer"
        for topic, watch in self._watches.items():
            if watch.is_late(self._asked(watch)):
                return f"{watch.owner.lstrip('/')} published nothing on {topic}"
        return ""

    def _asked(self, watch: PublicationWatch) -> int:
        """Return how many messages have been sent that are to be answered on a topic."""
        question = watch.publication.for_each
        if not question:
            return 0
        topic = self._resolved(question)
        other = self._watches.get(topic)
        if other is not None:
            return other.sent.total
        return self._sent[topic].total if topic in self._sent else 0

    def _all_are_present(self) -> bool:
        return self._is_cancelled or all(
            name in self._present for name, p in self._participants.items() if p.answers
        )

    def _absent(self) -> str:
        """Return in words who is not there; empty for nobody."""
        there = self._there()
        for name in self._participants:
            if name not in there:
                return f"{name.lstrip('/')} is not there; start it, or take it off the participants"
        return ""

    def _hindrance(self) -> str:
        """Return why time cannot begin yet though all are there, in words; empty for nothing."""
        for name, each in self._participants.items():
            plain = name.lstrip("/")
            if each.answers and name not in self._present:
                return (
                    f"{plain} does not answer: is it warming up? It needs use_sim_time "
                    "and stepped, or an entry that says what it publishes"
                )
            if len(self._lives.get(name, ())) > 1:
                return f"two nodes are called {plain}: give one of them another name"
        if self._node.count_publishers(CLOCK_TOPIC) > 1:
            return _TWO_CLOCKS
        for watch in self._watches.values():
            if hindrance := watch.listen():
                return hindrance
        return self._unanswerable() or self._disconnected()

    def _unanswerable(self) -> str:
        """Return in words which topic a node should answer that nobody publishes."""
        published = {topic for each in self._present.values() for topic in each.sent}
        for topic, watch in self._watches.items():
            question = watch.publication.for_each
            if question and self._resolved(question) not in {*published, *self._watches}:
                return (
                    f"{watch.owner.lstrip('/')} publishes {topic} for each message of "
                    f"{self._resolved(question)}, which no participant publishes"
                )
        return ""

    def _disconnected(self) -> str:
        """Return which two participants do not know each other yet, in words."""
        readers: dict[str, int] = {}
        senders: dict[str, list[str]] = {}
        for name, answer in self._present.items():
            for topic in answer.read:
                readers[topic] = readers.get(topic, 0) + 1
            for topic in answer.readers:
                senders.setdefault(topic, []).append(name)
        for name, topics in self._read().items():
            for topic in topics:
                readers[topic] = readers.get(topic, 0) + 1
                if name not in self._reading(topic):
                    return f"{name.lstrip('/')} does not read {topic}"
        for topic, watch in self._watches.items():
            senders.setdefault(topic, []).append(watch.owner)
        for topic, names in senders.items():
            if len(names) > 1 or self._node.count_publishers(topic) > 1:
                return f"{topic} has more than one publisher, expected one: stop the others"
            sender = self._present.get(names[0])
            if sender is not None and sender.readers[topic] < readers.get(topic, 0):
                return f"{names[0].lstrip('/')} is not connected to all who read {topic}"
            for name, other in self._present.items():
                if topic in other.read and other.read[topic] < 1:
                    return f"{name.lstrip('/')} is not connected to who publishes {topic}"
        return ""

    def _read(self) -> dict[str, set[str]]:
        """Return what the nodes read that know nothing of steps, by node."""
        found = {
            name: set(map(self._resolved, each.reads))
            for name, each in self._participants.items()
            if not each.answers
        }
        for watch in self._watches.values():
            if watch.publication.for_each:
                found[watch.owner].add(self._resolved(watch.publication.for_each))
        return found

    def _reading(self, topic: str) -> set[str]:
        """Return who reads a topic."""
        return {
            f"{each.node_namespace.rstrip('/')}/{each.node_name}"
            for each in self._node.get_subscriptions_info_by_topic(topic)
        }

    def _begin(self) -> None:
        """Take what the participants have sent so far as the state to begin with."""
        self._sent = {
            topic: Sent(answer.life, count)
            for answer in self._present.values()
            for topic, count in answer.sent.items()
        }
        self._news = dict(self._sent)
        for watch in self._watches.values():
            watch.begin(self._asked(watch))
        self._joined = {name: answer.life for name, answer in self._present.items()}
        self._done.clear()
        self._anew = ""
        self._is_joined = True

    def _on_answer(self, message: Any) -> None:
        try:
            answer = decode_answer(message)
        except ValueError as error:
            self._node.get_logger().warning(f"a message on {ANSWER_TOPIC} is left out: {error}")
            return
        name = answer.name
        with self._changed:
            if name not in self._participants:
                return
            if self._is_joined and answer.life != self._joined.get(name, answer.life):
                self._anew = name
            elif answer.kind is Kind.PRESENT:
                self._present[name] = answer
                self._lives.setdefault(name, set()).add(answer.life)
            elif answer.time_ns == self.time_ns:
                self._done[name] = answer.time_ns
                for topic, count in answer.sent.items():
                    self._sent[topic] = self._news[topic] = Sent(answer.life, count)
            self._changed.notify_all()

    def _resolved(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._node.get_namespace().rstrip('/')}/{name}"


_TWO_CLOCKS = "another node publishes /clock, expected this one alone: stop it"
