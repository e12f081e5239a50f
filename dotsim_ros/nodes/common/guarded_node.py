# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A node that goes on, whatever is sent to it, and that starts with one line or not at all."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from inspect import iscoroutinefunction, signature
from threading import Lock
from typing import Any

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from dotsim_ros.io.documents import value_text
from dotsim_ros.nodes.common.health import FAULT_MEMORY_S
from dotsim_ros.nodes.common.local_topics import (
    LocalPublisher,
    LocalSubscription,
    composed_topics,
)
from dotsim_ros.nodes.common.reasons import nearest, reason_of
from dotsim_ros.nodes.simulated_time.participant import StepParticipant, stamp_of
from msg_adapters import Level, Status
from msg_adapters.stamps import MAXIMUM_SECONDS, NANOSECONDS_PER_SECOND

ParameterCheck = Callable[[Sequence[Parameter]], SetParametersResult]

LOG_EVERY_S = 5.0
"""Between two lines about the same topic or service."""
LARGEST_DEPTH = 10_000
UNSTEPPED = ("/clock", "/diagnostics", "/parameter_events", "/rosout")
LATEST_NS = (MAXIMUM_SECONDS - 1_000_000) * NANOSECONDS_PER_SECOND
"""Eleven days before the end of what a stamp holds: what is planned from a time must have one,
too."""


class GuardedNode(Node):
    """A node whose callbacks cannot end it.

    What a message or a request brings a callback to raise is counted, logged, and reported by
    `failure_status`; the node goes on with the next one, and a request is answered with the reason.

    Args:
        name: of the node.
        options: of `rclpy.node.Node`.

    Attributes:
        participant: the node's part in the steps of simulated time; set before the publishers and
            subscriptions that belong to it are made.
    """

    def __init__(self, name: str, **options: Any) -> None:
        # Before the node: it makes services of its own.
        self.participant: StepParticipant | None = None
        self._local = composed_topics()
        self._failure_lock = Lock()
        self._failure_count = 0
        self._failure_reason = ""
        self._failure_s = -np.inf
        self._failure_logged_s: dict[str, float] = {}
        self._parameter_checks: list[ParameterCheck] = [_refuse_nameless]
        super().__init__(name, **options)
        self.add_on_set_parameters_callback(self._check_parameters)

    @property
    def label(self) -> str:
        """Return what diagnostics call the node: its name, behind the namespace where it has one,
        so that two sensors of one name are told apart."""
        return str(self.get_fully_qualified_name()).strip("/")

    @property
    def is_simulated(self) -> bool:
        """Return whether the node goes by simulated time."""
        return False

    def now_s(self) -> float:
        """Return the time by which the node acts, on a clock that is never set."""
        return time.monotonic()

    def time_ns(self) -> int:
        """Return the node's time; 0 where there is none, since /clock is silent or its time is none
        that messages could be stamped with."""
        now_ns = int(self.get_clock().now().nanoseconds)
        return now_ns if 0 < now_ns <= LATEST_NS else 0

    def failure_status(self) -> list[Status]:
        """Return the state of the callbacks, for the diagnostics; nothing where none has failed."""
        with self._failure_lock:
            count, reason, since_s = self._failure_count, self._failure_reason, self._failure_s
        if not count:
            return []
        is_recent = time.monotonic() - since_s < FAULT_MEMORY_S
        return [
            Status(
                f"{self.label}: callbacks",
                Level.WARN if is_recent else Level.OK,
                reason if is_recent else "running",
                self.label,
                {"failures": str(count), "last_failure": reason},
            )
        ]

    def note_failure(self, what: str, error: Exception) -> str:
        """Count and log what a callback raised; return the reason in words.

        Args:
            what: was being done.
            error: that it ended with.
        """
        # What is meant to be read is a ValueError or an OSError; anything else is a fault of ours.
        is_foreseen = isinstance(error, ValueError | OSError)
        name = "" if is_foreseen else f"unexpected {type(error).__name__}: "
        reason = f"{name}{reason_of(error)}"
        # Publishing fails once a signal has shut the context down: that is how a run ends.
        if not self.context.ok():
            return reason
        now_s = time.monotonic()
        with self._failure_lock:
            self._failure_count += 1
            self._failure_reason, self._failure_s = f"{what}: {reason}", now_s
            is_logged = now_s - self._failure_logged_s.get(what, -np.inf) >= LOG_EVERY_S
            if is_logged:
                self._failure_logged_s[what] = now_s
        if is_logged and is_foreseen:
            self.get_logger().warning(f"{what}: {reason}")
        elif is_logged:
            self.get_logger().error(f"{what}: {reason}")
            self.get_logger().debug("".join(traceback.format_exception(error)))
        return reason

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any
    ) -> Any:
        """See `rclpy.node.Node.create_publisher`.

        Raises:
            ValueError: the topic's name, or a policy that the user set for it, is not valid.
        """
        # A copy, since what the user overrides for this topic is written into it.
        quality = copy(qos_profile)
        participant = self.participant if _is_stepped(topic, quality) else None
        local = self._local if _is_stepped(topic, quality) else None
        if participant is not None:
            quality = _keeps_all(quality)
        if participant is not None or local is not None:
            options["publisher_class"] = LocalPublisher
        try:
            publisher = super().create_publisher(msg_type, topic, quality, **_with_check(options))
        except Exception as error:
            raise self._refusal(topic, error) from error
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

        def take(*what: Any) -> None:
            try:
                self.before_message()
                callback(*what)
            except Exception as error:
                self.note_failure(f"a message on {topic} is left out", error)

        quality = copy(qos_profile)
        if isinstance(quality, int):
            quality = QoSProfile(depth=quality)
        participant = self.participant if _is_stepped(topic, quality) else None
        # ROS sees by the number of its arguments whether a callback wants to know more.
        wants_more = len(signature(callback).parameters) != 1
        if participant is not None:
            quality = _keeps_all(quality)
            hear: Callable[..., None] = self._held_back(participant, topic, take, wants_more)
        elif wants_more:
            hear = lambda message, information: take(message, information)  # noqa: E731
        else:
            hear = lambda message: take(message)  # noqa: E731
        events = copy(options.get("event_callbacks") or SubscriptionEventCallbacks())
        opened: Any = None
        local: LocalSubscription | None = None

        def adapt(event: Any) -> None:
            nonlocal opened
            if local is not None and local.dds is None:
                return  # this process alone is heard by now
            policy = QoSPolicyKind(int(event.last_policy_kind))
            if participant is None and _ask_less(quality, policy):
                self.get_logger().warning(
                    f"{topic}: a publisher offers {_policies(quality)}, which is taken: messages "
                    "may be lost on the way, or before this node started"
                )
                self.destroy_subscription(opened)
                again = {**options, "qos_overriding_options": None}
                opened = Node.create_subscription(self, msg_type, topic, hear, quality, **again)
                if local is not None:
                    local.dds = opened
                return
            name = policy.name.lower()
            reason = (
                f"a publisher offers another {name} than {_policies(quality)}: change that, or set "
                f"qos_overrides.{self.resolve_topic_name(topic)}.subscription.{name}"
            )
            self.note_failure(f"nothing comes on {topic}", ValueError(reason))

        events.incompatible_qos = adapt
        options["event_callbacks"] = events
        try:
            opened = super().create_subscription(
                msg_type, topic, hear, quality, **_with_check(options)
            )
        except Exception as error:
            raise self._refusal(topic, error) from error
        subscription: Any = opened
        if self._local is not None and _is_stepped(topic, quality):
            takes_all = participant is not None or wants_more
            subscription = local = LocalSubscription(
                self,
                opened.topic_name,
                hear if takes_all else lambda message, _: hear(message),
                quality,
                opened,
            )
            self._local.subscribe_here(local)
        if participant is not None:
            participant.read(subscription)
        return subscription

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Callable[[Any, Any], Any], **options: Any
    ) -> Any:
        """See `rclpy.node.Node.create_service`; the callback may be a coroutine, which is answered
        when it ends."""

        def answer(request: Any, response: Any) -> Any:
            try:
                self.before_request()
                return callback(request, response)
            except Exception as error:
                reason = self.note_failure(f"a call of {srv_name} fails", error)
                return _refused(srv_type, reason)

        async def answer_later(request: Any, response: Any) -> Any:
            try:
                self.before_request()
                return await callback(request, response)
            except Exception as error:
                reason = self.note_failure(f"a call of {srv_name} fails", error)
                return _refused(srv_type, reason)

        def answer_each(request: Any, response: Any) -> Any:
            # ROS sets one after the other: those before a broken one are set.
            for parameter in request.parameters:
                one = answer(SetParameters.Request(parameters=[parameter]), srv_type.Response())
                response.results.extend(one.results)
            return response

        hear: Callable[[Any, Any], Any] = answer
        if srv_type is SetParameters:
            hear = answer_each
        elif iscoroutinefunction(callback):
            hear = answer_later
            # Else nothing of the node's would be called while it waits.
            options.setdefault("callback_group", ReentrantCallbackGroup())
        return super().create_service(srv_type, srv_name, hear, **options)

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

    def leave_topics(self) -> None:
        """Have no part any more in what passes on topics within the process or in steps, before all
        publishers and subscriptions that may have one are destroyed."""
        if self._local is not None:
            self._local.leave(self)
        if self.participant is not None:
            self.participant.restart()

    def before_request(self) -> None:
        """Called before a service is answered."""

    def before_message(self) -> None:
        """Called before a message is taken."""

    def _check_parameters(self, changes: Sequence[Parameter]) -> SetParametersResult:
        for check in self._parameter_checks:
            result = check(changes)
            if not result.successful:
                return result
        return SetParametersResult(successful=True)

    def _held_back(
        self,
        participant: StepParticipant,
        topic: str,
        take: Callable[..., None],
        wants_more: bool,
    ) -> Callable[..., None]:
        """Return a callback that keeps messages until the next step."""
        resolved = self.resolve_topic_name(topic)

        def hear(message: Any, information: Any) -> None:
            what = (message, information) if wants_more else (message,)
            number = information["publication_sequence_number"]
            try:
                participant.hold(resolved, number, stamp_of(message), partial(take, *what))
            except ValueError as error:
                self.note_failure(f"a message on {topic} is left out", error)

        return hear

    def _refusal(self, topic: str, error: Exception) -> Exception:
        if isinstance(error, ParameterException) or not self.context.ok():
            return error
        reason = reason_of(error)
        if isinstance(error, NameValidationException) or "resolve name" in reason:
            return ValueError(f"the topic {topic!r} has no valid name ({reason})")
        return ValueError(
            f"the topic {topic} cannot be opened ({reason}): correct its parameters "
            f"qos_overrides.{self.resolve_topic_name(topic)}; reliability is reliable or "
            f"best_effort, history keep_last or keep_all, depth from 1 to {LARGEST_DEPTH}"
        )


def _is_stepped(topic: str, quality: QoSProfile | int) -> bool:
    """Return whether the messages of a topic belong to the steps of simulated time.

    What is kept for late readers, and what says how a node is, does not.
    """
    is_latched = (
        isinstance(quality, QoSProfile) and quality.durability is DurabilityPolicy.TRANSIENT_LOCAL
    )
    return not is_latched and topic not in UNSTEPPED


def _ask_less(quality: QoSProfile, policy: QoSPolicyKind) -> bool:
    """Lower what a subscription asks for to what every publisher offers; return whether it could
    be lowered."""
    if policy is QoSPolicyKind.RELIABILITY and quality.reliability is ReliabilityPolicy.RELIABLE:
        quality.reliability = ReliabilityPolicy.BEST_EFFORT
        return True
    if policy is QoSPolicyKind.DURABILITY and quality.durability is not DurabilityPolicy.VOLATILE:
        quality.durability = DurabilityPolicy.VOLATILE
        return True
    return False


def _policies(quality: QoSProfile) -> str:
    return f"{quality.reliability.name.lower()}, {quality.durability.name.lower()}"


def _keeps_all(quality: QoSProfile | int) -> QoSProfile:
    """Return reliable policies that lose nothing between two steps."""
    if isinstance(quality, int):
        quality = QoSProfile(depth=quality)
    quality.history, quality.reliability = HistoryPolicy.KEEP_ALL, ReliabilityPolicy.RELIABLE
    return quality


def _refuse_nameless(changes: Sequence[Parameter]) -> SetParametersResult:
    # ROS lets a parameter of no name pass as one that was declared, and keeps it.
    is_named = all(change.name for change in changes)
    reason = "" if is_named else "a parameter without a name, expected one of the node's"
    return SetParametersResult(successful=is_named, reason=reason)


def _with_check(options: dict[str, Any]) -> dict[str, Any]:
    """Return options of a topic so that policies of the user's are checked before they are used."""
    given: QoSOverridingOptions | None = options.get("qos_overriding_options")
    if given is None:
        return options
    checked = QoSOverridingOptions(
        given.policy_kinds, callback=_check_policies, entity_id=given.entity_id
    )
    return {**options, "qos_overriding_options": checked}


def _check_policies(quality: QoSProfile) -> SetParametersResult:
    """Refuse policies that the middleware cannot keep.

    Raises:
        ValueError: names the policy.
    """
    if quality.history not in (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL):
        raise ValueError(f"history is {quality.history.name.lower()}")
    if quality.reliability not in (ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT):
        raise ValueError(f"reliability is {quality.reliability.name.lower()}")
    if quality.history is HistoryPolicy.KEEP_LAST and not 1 <= quality.depth <= LARGEST_DEPTH:
        raise ValueError(f"depth is {quality.depth}")
    return SetParametersResult(successful=True)


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
