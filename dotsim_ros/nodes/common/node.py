# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The node that every executable of this package is: it goes on, whatever is sent to it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from inspect import iscoroutinefunction, signature
from threading import Event, Thread
from typing import Any, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

import msg_adapters
from dotsim_ros.io import tracing
from dotsim_ros.io.documents import value_text
from dotsim_ros.nodes.common import topic_quality
from dotsim_ros.nodes.common.clock_watch import ClockJump
from dotsim_ros.nodes.common.failures import Failures
from dotsim_ros.nodes.common.local_topics import (
    Information,
    LocalPublisher,
    LocalSubscription,
    composed_topics,
)
from dotsim_ros.nodes.common.node_clock import (
    PAUSED_CLOCK_WARNING_S,
    SILENT_CLOCK_WARNING_S,
    SimulatedClock,
    ros_time_ns,
)
from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.common.reasons import nearest
from dotsim_ros.nodes.common.seldom import SeldomCallbacks
from dotsim_ros.nodes.simulated_time.latency import Latency
from dotsim_ros.nodes.simulated_time.participant import StepParticipant, stamp_of
from dotsim_ros.nodes.simulated_time.schedule import PacedWork
from msg_adapters import Status

ParameterCheck = Callable[[Sequence[Parameter]], SetParametersResult]
Result = TypeVar("Result")

WAKE_PERIOD_S = 0.25
BROKEN = 1
"""Exit status of a node that could not start, or go on, for a fault of its own."""
STEPPED = ParameterDescriptor(
    description="with use_sim_time: go on only in the steps of a time_stepper, with others",
    read_only=True,
)
TRACE = ParameterDescriptor(
    description="file to write what the process does when, for Perfetto; empty: none",
    read_only=True,
)


class WorkingNode(Node):
    """A node whose callbacks cannot end it, and whose work goes by one clock.

    What a message or a request brings a callback to raise is counted, logged, and reported; the
    node goes on with the next one, and a request is answered with the reason.

    A node that owns threads or files opens them in `begin`, not while it is made: making one may
    take minutes, so a SIGINT cuts it short wherever it is, and what is opened then would stay open.

    What it does at which time goes through `start_work`, `start_paced` and `compute`, and what it
    calls now is `now_s`. With `use_sim_time` that is the time of /clock, and everything runs on the
    executor's thread as the clock moves on; else it is the steady clock, and threads wait for it.
    With `stepped` too the node is a participant of steps (see `StepParticipant`).

    Args:
        name: of the node.
        options: of `rclpy.node.Node`.

    Attributes:
        exit_status: other than 0 where something went wrong in a thread or while closing.
        stopping: set when the threads are to return.
        is_stepped: whether the node is a participant of steps.
        participant: the node's part in the steps; set before the publishers and subscriptions that
            belong to it are made.
        failures: of callbacks.
    """

    def __init__(self, name: str, **options: Any) -> None:
        # Before the node: it makes services of its own.
        self.participant: StepParticipant | None = None
        self._simulated: SimulatedClock | None = None
        self._local = composed_topics()
        self._publisher_events = SeldomCallbacks()
        self.failures = Failures(self)
        self._parameter_checks: list[ParameterCheck] = [_refuse_nameless]
        super().__init__(name, **options)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.exit_status = 0
        self.stopping = Event()
        self._threads: list[Thread] = []
        self._ends: list[Event] = []
        trace = str(self.declare_parameter("trace", "", TRACE).value)
        self._traces = bool(trace) and tracing.begin(trace, self.label)
        is_simulated = bool(self.get_parameter("use_sim_time").value)
        self.is_stepped = bool(self.declare_parameter("stepped", False, STEPPED).value)
        if self.is_stepped and not is_simulated:
            raise ValueError("stepped is true, which needs simulated time: set use_sim_time too")
        if is_simulated:
            self._simulated = SimulatedClock(self, is_stepped=self.is_stepped)
        if self.is_stepped and self._simulated is not None:
            self.participant = StepParticipant(self, self._simulated.step_to)
        self.add_parameter_check(partial(_refuse_other_clock, is_simulated))
        # A signal between the executor's look at the context and its wait wakes nothing: of a node
        # without a timer, one SIGINT in 20 was lost.
        self.create_timer(
            WAKE_PERIOD_S,
            self._publisher_events.open,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def begin(self) -> None:
        """Open what `destroy_node` closes; a signal waits until it is done.

        Raises:
            ValueError, OSError: what the user gave does not work; nothing has been opened.
        """

    @property
    def label(self) -> str:
        """Return what diagnostics call the node: its name, behind the namespace where it has one,
        so that two sensors of one name are not confused."""
        return str(self.get_fully_qualified_name()).strip("/")

    # Time.

    @property
    def is_simulated(self) -> bool:
        """Return whether the node goes by simulated time."""
        return self._simulated is not None

    def now_s(self) -> float:
        """Return the time by which the node acts, on a clock that is never set: in simulated time
        what has passed since the first time of /clock, else the steady clock."""
        return time.monotonic() if self._simulated is None else self._simulated.schedule.now_s

    def time_ns(self) -> int:
        """Return the time of messages; 0 where there is none: see `ros_time_ns`."""
        return ros_time_ns(self) if self._simulated is None else self._simulated.time_ns()

    def on_clock_jump(self, act: Callable[[ClockJump], None]) -> None:
        """Do something when the simulated time goes back or leaps forward, until `leave`."""
        if self._simulated is not None:
            self._simulated.on_jump.append(act)

    def clock_silence(self) -> str:
        """Return in words that the simulated time does not move on; empty where it does, and in
        real time."""
        return "" if self._simulated is None else self._simulated.silence()

    # Topics, services and parameters.

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any
    ) -> Any:
        """See `rclpy.node.Node.create_publisher`.

        Raises:
            ValueError: the topic's name, or a policy that the user set for it, is not valid.
        """
        quality = topic_quality.profile_of(qos_profile)
        is_stepped = topic_quality.is_stepped(topic, quality)
        participant, local = (self.participant, self._local) if is_stepped else (None, None)
        if participant is not None:
            topic_quality.keep_all(quality)
        if participant is not None or local is not None:
            options["publisher_class"] = LocalPublisher
        options.setdefault("callback_group", self._publisher_events)
        try:
            publisher = super().create_publisher(
                msg_type, topic, quality, **topic_quality.with_check(options)
            )
        except Exception as error:
            raise topic_quality.topic_refusal(self, topic, error) from error
        if isinstance(publisher, LocalPublisher):
            publisher.sends_all = participant is not None
            if local is not None:
                local.publish_here(publisher)
            if participant is not None:
                participant.watch(publisher)
        return publisher

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., object],
        qos_profile: QoSProfile | int,
        **options: Any,
    ) -> Any:
        """See `rclpy.node.Node.create_subscription`; errors as `create_publisher`.

        Where a publisher offers less than is asked for, the subscription asks for that, as ROS's
        own recorder does, unless the topic belongs to the steps of simulated time, which lose
        nothing.
        """
        quality = topic_quality.profile_of(qos_profile)
        is_stepped = topic_quality.is_stepped(topic, quality)
        participant = self.participant if is_stepped else None
        if participant is not None:
            topic_quality.keep_all(quality)
        # As ROS does: the number of its arguments says whether a callback takes the information.
        takes_information = len(signature(callback).parameters) != 1
        events = copy(options.get("event_callbacks") or SubscriptionEventCallbacks())
        opened: Any = None
        resolved = ""
        local: LocalSubscription | None = None

        def take(*what: Any) -> None:
            if self._simulated is not None:
                self._simulated.begin_again()
            callback(*what)

        def receive(message: Any, information: Information) -> None:
            what = (message, information) if takes_information else (message,)
            act = partial(self._attempt, topic, partial(take, *what))
            if participant is None:
                act()
                return
            number = information["publication_sequence_number"]
            hold = partial(participant.hold, resolved, number, stamp_of(message), act)
            self._attempt(topic, hold)

        # rclpy's types know no callback that takes the information, too.
        untyped: Any = receive

        def adapt(event: Any) -> None:
            nonlocal opened
            if local is not None and local.dds is None:
                return  # only this process is read by now
            policy = QoSPolicyKind(int(event.last_policy_kind))
            if participant is None and topic_quality.ask_less(quality, policy):
                self.get_logger().warning(
                    f"{topic}: a publisher offers {topic_quality.policies_text(quality)}, which is "
                    "taken: messages may be lost on the way, or before this node started"
                )
                self.destroy_subscription(opened)
                again = {**options, "qos_overriding_options": None}
                opened = Node.create_subscription(self, msg_type, topic, untyped, quality, **again)
                if local is not None:
                    local.dds = opened
                return
            name = policy.name.lower()
            reason = (
                f"a publisher offers another {name} than {topic_quality.policies_text(quality)}: "
                "change that, or set "
                f"qos_overrides.{self.resolve_topic_name(topic)}.subscription.{name}"
            )
            self.note_failure(f"nothing comes on {topic}", ValueError(reason))

        events.incompatible_qos = adapt
        options["event_callbacks"] = events
        try:
            opened = super().create_subscription(
                msg_type, topic, untyped, quality, **topic_quality.with_check(options)
            )
        except Exception as error:
            raise topic_quality.topic_refusal(self, topic, error) from error
        # Of its own, since what is opened over DDS may be destroyed again.
        resolved = opened.topic_name
        subscription: Any = opened
        if self._local is not None and is_stepped:
            subscription = local = LocalSubscription(self, resolved, receive, quality, opened)
            self._local.subscribe_here(local)
        if participant is not None:
            participant.read(subscription)
        return subscription

    def open_publisher(self, msg_type: Any, topic: str, quality: QoSProfile) -> Any:
        """Create a publisher whose policies the user may set by parameters `qos_overrides`."""
        overriding = QoSOverridingOptions.with_default_policies()
        return self.create_publisher(msg_type, topic, quality, qos_overriding_options=overriding)

    def open_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[..., object],
        quality: QoSProfile,
        **options: Any,
    ) -> Any:
        """Create a subscription whose policies the user may set by parameters `qos_overrides`."""
        options["qos_overriding_options"] = QoSOverridingOptions.with_default_policies()
        return self.create_subscription(msg_type, topic, callback, quality, **options)

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Any:
        """See `rclpy.node.Node.create_service`; the callback may be a coroutine, which is answered
        when it ends."""

        def refused(error: Exception) -> Any:
            reason = self.note_failure(f"a call of {srv_name} fails", error)
            return _refused(srv_type, reason)

        def answer(request: Any, response: Any) -> Any:
            try:
                self.settle()
                return callback(request, response)
            except Exception as error:
                return refused(error)

        async def answer_later(request: Any, response: Any) -> Any:
            try:
                self.settle()
                return await callback(request, response)
            except Exception as error:
                return refused(error)

        def answer_each(request: Any, response: Any) -> Any:
            # ROS sets one after the other: those before a broken one are set.
            for parameter in request.parameters:
                one = answer(SetParameters.Request(parameters=[parameter]), srv_type.Response())
                response.results.extend(one.results)
            return response

        serve: Callable[[Any, Any], Any] = answer
        if srv_type is SetParameters:
            serve = answer_each
        elif iscoroutinefunction(callback):
            serve = answer_later
            # Else nothing of the node's would be called while it waits.
            options.setdefault("callback_group", ReentrantCallbackGroup())
        return super().create_service(srv_type, srv_name, serve, **options)

    def add_parameter_check(self, check: ParameterCheck) -> None:
        """Let parameters that are set be checked, too, once all checks before have taken them.

        So the last one may put them in force. ROS calls its own callbacks the other way round: what
        one has put in force, another may refuse.
        """
        self._parameter_checks.append(check)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """See `rclpy.node.Node.set_parameters_atomically`; a parameter that the node does not have
        is refused with the nearest name, where ROS raises an error without any."""
        for name in (each.name for each in parameter_list):
            if name and not self.has_parameter(name):
                meant = nearest(name, self.get_parameters_by_prefix(""))
                hint = f": is it {meant}?" if meant else ""
                reason = f"the node has no parameter {value_text(name)}{hint}"
                return SetParametersResult(successful=False, reason=reason)
        return super().set_parameters_atomically(parameter_list)

    def settle(self) -> None:
        """Let what is being computed for the simulated time end: it began before a request."""
        if self._simulated is not None:
            self._simulated.schedule.settle()

    def leave(self) -> None:
        """Do nothing any more that simulated time would bring, and have no part in what passes on
        topics within the process or in steps, before publishers and subscriptions that may have one
        are destroyed."""
        if self._simulated is not None:
            self._simulated.drop_scheduled()
        if self._local is not None:
            self._local.leave(self)
        if self.participant is not None:
            self.participant.restart()

    def _check_parameters(self, changes: Sequence[Parameter]) -> SetParametersResult:
        for check in self._parameter_checks:
            result = check(changes)
            if not result.successful:
                return result
        return SetParametersResult(successful=True)

    def _attempt(self, topic: str, act: Callable[[], None]) -> None:
        """Do something with a message of a topic, which is left out where that fails."""
        try:
            with tracing.span(f"receive {topic}"):
                act()
        except Exception as error:
            self.note_failure(f"a message on {topic} is left out", error)

    # Work.

    def start_thread(self, name: str, run: Callable[[], None], broken: str) -> Thread:
        """Start a thread without which the node must not live on; it returns once it is `stopping`.

        An exception of `run` is logged with `broken` and ends the node with exit status 1, unless a
        signal has shut the context down: to publish there is how a run ends.
        """
        thread = Thread(target=self._watch, args=(run, broken), name=name, daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

    def start_paced(
        self, name: str, pace: Callable[[], FramePace], tick: Callable[[], None], broken: str
    ) -> Callable[[], None]:
        """Call `tick` at each deadline until the node stops; as `start_work`.

        `pace` is asked for each deadline, since a parameter may change the rate.
        """

        def run(now_s: float) -> None:
            pace().begin(now_s)
            tick()

        return self._repeat(name, lambda: pace().deadline_s(), run, broken)

    def start_work(self, name: str, work: PacedWork, broken: str) -> Callable[[], None]:
        """Do work at each of its deadlines until the node stops; `broken` as of `start_thread`.

        Returns:
            What ends it before, and waits until nothing of it is being done; not for the work
            itself to call.
        """
        return self._repeat(name, work.deadline_s, work.run, broken)

    def _repeat(
        self,
        name: str,
        deadline_s: Callable[[], float],
        run: Callable[[float], None],
        broken: str,
    ) -> Callable[[], None]:
        def traced(now_s: float) -> None:
            with tracing.span(name):
                run(now_s)

        if self._simulated is not None:
            return self._simulated.schedule.pace(
                deadline_s, lambda now_s: self._watch(partial(traced, now_s), broken)
            )
        is_over = Event()

        def loop() -> None:
            while True:
                with tracing.span("wait"):
                    if is_over.wait(max(0.0, deadline_s() - time.monotonic())):
                        return
                traced(time.monotonic())

        self._ends.append(is_over)
        thread = self.start_thread(name, loop, broken)

        def end() -> None:
            is_over.set()
            thread.join()
            self._ends.remove(is_over)
            self._threads.remove(thread)

        return end

    def compute(
        self,
        latency: Latency,
        work: Callable[[], Result],
        take: Callable[[Result], None],
        broken: str,
    ) -> None:
        """Compute something, and take what comes out when it is there: in simulated time after the
        latency, else at once.

        Args:
            latency: of what stands where this does in reality.
            work: changes nothing that other work of this node looks at.
            take: uses what came out, on the thread of the node's work.
            broken: as of `start_thread`.
        """
        if self._simulated is None:
            take(work())
        else:
            self._simulated.schedule.compute(
                latency.draw_s(), work, lambda result: self._watch(partial(take, result), broken)
            )

    def _watch(self, run: Callable[[], None], broken: str) -> None:
        try:
            run()
        except Exception:
            if self.context.ok():
                self.get_logger().fatal(broken)
                self.exit_status = BROKEN
                rclpy.try_shutdown()
                raise

    def destroy_node(self) -> None:
        """Wait until the threads have returned, and take the node down."""
        self.stopping.set()
        for end in self._ends:
            end.set()
        if self._simulated is not None:
            self._simulated.schedule.close()
        for thread in self._threads:
            thread.join()
        super().destroy_node()
        if self._traces and (failure := tracing.end()) is not None:
            self.get_logger().warning(f"the trace is not whole: {failure}")

    # Health.

    def note_failure(self, what: str, error: Exception) -> str:
        """Count and log what was raised while `what` was done; return the reason in words."""
        return self.failures.note(what, error)

    def report_health(
        self, period_s: float, statuses: Callable[[], Sequence[Status]], without_clock: str
    ) -> Callable[[], None]:
        """Publish the node's health on /diagnostics.

        Args:
            period_s: between reports, by a steady clock: a node says what is wrong without /clock,
                too. In steps, of simulated time.
            statuses: returns the states of the node's parts.
            without_clock: what does not work while `use_sim_time` is set and /clock is silent, for
                the log.

        Returns:
            What publishes a report at once.
        """
        publisher = self.create_publisher(DiagnosticArray, "/diagnostics", 10)

        def report() -> None:
            stamp_ns, silence = self.time_ns(), self.clock_silence()
            if silence and stamp_ns == 0:
                self.get_logger().warning(
                    f"{silence}: {without_clock}", throttle_duration_sec=SILENT_CLOCK_WARNING_S
                )
            elif silence:
                self.get_logger().warning(silence, throttle_duration_sec=PAUSED_CLOCK_WARNING_S)
            found = [*statuses(), *self.failures.statuses(self.label)]
            if self._simulated is not None:
                level, message, values = self._simulated.watch.report(time.monotonic())
                found.append(Status(f"{self.label}: clock", level, message, self.label, values))
            publisher.publish(msg_adapters.encode_diagnostics(found, stamp_ns=stamp_ns))

        if self._simulated is not None and self.is_stepped:
            # At times that are known: who steps the nodes decides by what they report.
            self._simulated.schedule.every(period_s, report)
        else:
            self.create_timer(period_s, report, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return report


def _refuse_nameless(changes: Sequence[Parameter]) -> SetParametersResult:
    # ROS lets a parameter of no name pass as one that was declared, and keeps it.
    is_named = all(change.name for change in changes)
    reason = "" if is_named else "a parameter without a name, expected one of the node's"
    return SetParametersResult(successful=is_named, reason=reason)


def _refuse_other_clock(is_simulated: bool, changes: Sequence[Parameter]) -> SetParametersResult:
    is_other = any(
        change.name == "use_sim_time" and change.value != is_simulated for change in changes
    )
    reason = "use_sim_time is fixed once the node runs: start it again" if is_other else ""
    return SetParametersResult(successful=not is_other, reason=reason)


def _refused(srv_type: Any, reason: str) -> Any:
    """Return the response to a request that failed, with the reason where it has a place for it."""
    response = srv_type.Response()
    refused = SetParametersResult(successful=False, reason=reason)
    if srv_type is SetParameters:
        response.results = [refused]
    elif srv_type is SetParametersAtomically:
        response.result = refused
    elif hasattr(response, "status_message"):
        response.success, response.status_message = False, reason
    elif hasattr(response, "message"):
        response.success, response.message = False, reason
    return response
