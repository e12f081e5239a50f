"""Moves simulated time on in steps, each when every participant has gone as far as the one before.

The order of what happens is then that of the simulated times, on any machine and under any load. A
message that is sent in one step is heard at the beginning of the next.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from threading import Condition
from typing import Any

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

import msg_adapters
from dotsim_ros.nodes.common.guarded_node import GuardedNode
from dotsim_ros.nodes.simulated_time.participant import stamp_of
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
    encode_step,
)

CLOCK_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
HEARD_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.BEST_EFFORT)
CALL_EVERY_S = 0.1
LOOK_EVERY_S = 0.5
FARTHEST_STAMP_S = 10.0
"""A stamp further from the simulated time is one of another clock."""


class SteppingError(OSError):
    """Time cannot go on; says whom it waits for."""


@dataclass(frozen=True)
class StepperSettings:
    """How time goes.

    Attributes:
        period_s: of a step.
        start_s: the first time; above zero, which means no time.
        speed: simulated seconds for each real one; 0: as many as the machine gives.
        patience_s: how long a participant may take for one step, or to come.
    """

    period_s: float = 0.01
    start_s: float = 1.0
    speed: float = 0.0
    patience_s: float = 40.0


@dataclass
class _Heard:
    """What has come from a node that knows nothing of steps.

    Attributes:
        node: its name.
        publication: when it publishes.
        since: number of its newest message, when it joined.
        replied_to: messages that it answers had been sent then.
        count: number of its newest message.
        stamp_ns: of that.
        fault: why what comes is not counted.
    """

    node: str
    publication: Publication
    since: int = 0
    replied_to: int = 0
    count: int = 0
    stamp_ns: int = 0
    fault: str = ""


class Stepper:
    """Steps the participants of one session; `join`, `advance` from one thread of the user's.

    Args:
        node: for its topics; somebody spins it in another thread.
        participants: whom time waits for, by name.
        settings: how time goes.

    Attributes:
        time_ns: where the participants are.
        speed_factor: simulated seconds for each real one, over the last `advance`.
    """

    def __init__(
        self, node: GuardedNode, participants: Mapping[str, Participant], settings: StepperSettings
    ) -> None:
        self._node = node
        self.settings = settings
        self._period_ns = round(settings.period_s * NANOSECONDS_PER_SECOND)
        if self._period_ns <= 0:
            raise ValueError(f"the step is {settings.period_s:g} s, expected more than 0")
        self.time_ns = round(settings.start_s * NANOSECONDS_PER_SECOND)
        self.speed_factor = 0.0
        self._changed = Condition()
        self._present: dict[str, Answer] = {}
        self._done: dict[str, int] = {}
        self._sent: dict[str, Sent] = {}
        self._news: dict[str, Sent] = {}
        self._heard: dict[str, _Heard] = {}
        self._listening: dict[str, Any] = {}
        self._is_joined = False
        self._steps = Node.create_publisher(node, String, STEP_TOPIC, PROTOCOL_QOS)
        self._clock = Node.create_publisher(node, Clock, CLOCK_TOPIC, CLOCK_QOS)
        Node.create_subscription(node, String, ANSWER_TOPIC, self._on_answer, PROTOCOL_QOS)
        self.expect(participants)

    def expect(self, participants: Mapping[str, Participant]) -> None:
        """Wait for these participants from now on; they join before the next step."""
        with self._changed:
            self._participants = {self._resolved(n): p for n, p in participants.items()}
            self._heard = {
                self._resolved(topic): _Heard(self._resolved(name), publication)
                for name, participant in participants.items()
                for topic, publication in participant.publishes.items()
            }
            self._is_joined = False

    def join(self) -> None:
        """Wait until all participants are there and connected to each other.

        Raises:
            SteppingError: they are not after the patience; says what is missing.
        """
        end_s = time.monotonic() + self.settings.patience_s
        with self._changed:
            self._present.clear()
        while True:
            # The nodes that follow /clock need a time to begin with.
            self._publish_clock()
            self._steps.publish(encode_step(Step(self.time_ns, Kind.CALL)))
            with self._changed:
                self._changed.wait_for(self._all_are_present, CALL_EVERY_S)
                hindrance = self._hindrance()
                if not hindrance:
                    self._begin()
                    return
                self._present.clear()
            if time.monotonic() > end_s:
                raise SteppingError(
                    f"simulated time does not begin after {self.settings.patience_s:g} s: "
                    f"{hindrance}"
                )
            time.sleep(CALL_EVERY_S)

    def advance(self, duration_s: float, progress: Callable[[float], None] | None = None) -> None:
        """Take all participants on by a time, a whole number of steps.

        Args:
            duration_s: of the simulated time.
            progress: called after each step with the share that is done.

        Raises:
            SteppingError: a participant does not answer, or left.
        """
        if not self._is_joined:
            self.join()
        begun_s = time.monotonic()
        count = round(duration_s * NANOSECONDS_PER_SECOND / self._period_ns)
        for index in range(count):
            self._step()
            simulated_s = (index + 1) * self.settings.period_s
            if self.settings.speed > 0.0:
                due_s = begun_s + simulated_s / self.settings.speed
                time.sleep(max(0.0, due_s - time.monotonic()))
            self.speed_factor = simulated_s / max(time.monotonic() - begun_s, 1e-9)
            if progress is not None:
                progress((index + 1) / count)

    def _step(self) -> None:
        with self._changed:
            self.time_ns += self._period_ns
            step = Step(self.time_ns, Kind.STEP, self._news)
            self._news = {}
        self._publish_clock()
        self._steps.publish(encode_step(step))
        self._wait(self._late)

    def _publish_clock(self) -> None:
        self._clock.publish(Clock(clock=msg_adapters.encode_stamp(self.time_ns)))

    def _wait(self, late: Callable[[], str]) -> None:
        """Wait until nobody is late.

        Raises:
            SteppingError: somebody is for too long, or has left, or something else sets the time.
        """
        begun_s = time.monotonic()
        with self._changed:
            while late():
                if self._changed.wait(LOOK_EVERY_S):
                    continue
                spent_s = time.monotonic() - begun_s
                self._look(late())
                self._steps.publish(encode_step(Step(self.time_ns, Kind.CALL)))
                if spent_s > self.settings.patience_s:
                    waits = [each.waits for each in self._present.values() if each.waits]
                    more = f"; it waits for {', '.join(waits)}" if waits else ""
                    raise SteppingError(
                        f"at {self._time_s:.3f} s of simulated time: {late()} for "
                        f"{spent_s:.0f} s{more}"
                    )

    @property
    def _time_s(self) -> float:
        return self.time_ns / NANOSECONDS_PER_SECOND

    def _look(self, late: str) -> None:
        """Look whether those who are waited for can still come."""
        if not late:
            return
        for heard in self._heard.values():
            if heard.fault:
                raise SteppingError(heard.fault)
        there = self._there()
        for name in self._participants:
            if name not in there:
                raise SteppingError(
                    f"{name.lstrip('/')} left at {self._time_s:.3f} s of simulated time: see its "
                    "log for the reason"
                )
        if self._node.count_publishers(CLOCK_TOPIC) > 1:
            raise SteppingError(_TWO_CLOCKS)

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
        for topic, heard in self._heard.items():
            if self._is_late(heard):
                return f"{heard.node.lstrip('/')} published nothing on {topic}"
        return ""

    def _is_late(self, heard: _Heard) -> bool:
        publication = heard.publication
        if publication.for_each:
            asked = self._sent.get(self._resolved(publication.for_each), Sent("", 0)).count
            return heard.count - heard.since < asked - heard.replied_to
        every_ns = round(publication.every_s * NANOSECONDS_PER_SECOND)
        start_ns = round(self.settings.start_s * NANOSECONDS_PER_SECOND)
        return self.time_ns - start_ns >= every_ns and heard.stamp_ns <= self.time_ns - every_ns

    def _all_are_present(self) -> bool:
        return all(name in self._present for name, p in self._participants.items() if p.answers)

    def _hindrance(self) -> str:
        """Return why time cannot begin yet, in words; empty for nothing."""
        there = self._there()
        for name, each in self._participants.items():
            if name not in there:
                return f"{name.lstrip('/')} is not there; start it, or take it off the participants"
            if each.answers and name not in self._present:
                return (
                    f"{name.lstrip('/')} does not answer: is it warming up? It needs use_sim_time "
                    "and stepped, or an entry that says what it publishes"
                )
        if self._node.count_publishers(CLOCK_TOPIC) > 1:
            return _TWO_CLOCKS
        return self._listen() or self._disconnected()

    def _listen(self) -> str:
        """Subscribe to what the nodes publish that know nothing of steps."""
        types = dict(self._node.get_topic_names_and_types())
        for topic in self._heard:
            if topic in self._listening:
                continue
            if topic not in types or not self._node.count_publishers(topic):
                return f"{self._heard[topic].node.lstrip('/')} has no publisher on {topic}"
            kind = msg_adapters.message_class(types[topic][0])

            hear: Any = partial(self._on_message, topic)
            self._listening[topic] = Node.create_subscription(
                self._node, kind, topic, hear, HEARD_QOS, raw=True
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
        for each in self._participants.values():
            for topic in map(self._resolved, each.reads):
                readers[topic] = readers.get(topic, 0) + 1
        for topic, heard in self._heard.items():
            senders.setdefault(topic, []).append(heard.node)
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

    def _begin(self) -> None:
        """Take what the participants have sent so far as the state to begin with."""
        self._sent = {
            topic: Sent(answer.life, count)
            for answer in self._present.values()
            for topic, count in answer.sent.items()
        }
        for topic, heard in self._heard.items():
            asked = self._sent.get(self._resolved(heard.publication.for_each or topic))
            heard.since, heard.replied_to = heard.count, asked.count if asked else 0
            self._sent[topic] = Sent(heard.node, heard.count)
        self._news = dict(self._sent)
        self._done.clear()
        self._is_joined = True

    def _on_answer(self, message: Any) -> None:
        try:
            answer = decode_answer(message)
        except ValueError as error:
            self._node.get_logger().error(str(error))
            return
        with self._changed:
            if answer.name not in self._participants:
                return
            if answer.kind is Kind.PRESENT:
                self._present[answer.name] = answer
            elif answer.time_ns == self.time_ns:
                self._done[answer.name] = answer.time_ns
                for topic, count in answer.sent.items():
                    self._sent[topic] = self._news[topic] = Sent(answer.life, count)
            self._changed.notify_all()

    def _on_message(self, topic: str, message: bytes, information: Any) -> None:
        heard, stamp_ns = self._heard.get(topic), stamp_of(message)
        if heard is None:
            return
        away_s = (stamp_ns - self.time_ns) / NANOSECONDS_PER_SECOND
        if abs(away_s) > FARTHEST_STAMP_S:
            heard.fault = (
                f"{topic} of {heard.node.lstrip('/')} is stamped {away_s:.0f} s away from the "
                "simulated time: set use_sim_time on that node"
            )
            return
        with self._changed:
            heard.count, heard.stamp_ns = information["publication_sequence_number"], stamp_ns
            self._sent[topic] = self._news[topic] = Sent(heard.node, heard.count)
            self._changed.notify_all()

    def _resolved(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._node.get_namespace().rstrip('/')}/{name}"


_TWO_CLOCKS = "another node publishes /clock, expected this one alone: stop it"
