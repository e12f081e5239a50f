# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The policies (QoS) of a node's topics: checked, and lowered where a publisher offers less."""

from __future__ import annotations

from copy import copy
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from dotsim_ros.nodes.common.reasons import reason_of

LARGEST_DEPTH = 10_000
UNSTEPPED = ("/clock", "/diagnostics", "/parameter_events", "/rosout")


def profile_of(quality: QoSProfile | int) -> QoSProfile:
    """Return a copy, since what the user overrides for a topic is written into it."""
    return QoSProfile(depth=quality) if isinstance(quality, int) else copy(quality)


def is_stepped(topic: str, quality: QoSProfile) -> bool:
    """Return whether the messages of a topic belong to the steps of simulated time.

    What is kept for late readers, and what says how a node is, does not.
    """
    is_latched = quality.durability is DurabilityPolicy.TRANSIENT_LOCAL
    return not is_latched and topic not in UNSTEPPED


def keep_all(quality: QoSProfile) -> None:
    """Let a topic lose nothing between two steps."""
    quality.history, quality.reliability = HistoryPolicy.KEEP_ALL, ReliabilityPolicy.RELIABLE


def ask_less(quality: QoSProfile, policy: QoSPolicyKind) -> bool:
    """Lower what a subscription asks for to what every publisher offers; return whether it could
    be lowered."""
    if policy is QoSPolicyKind.RELIABILITY and quality.reliability is ReliabilityPolicy.RELIABLE:
        quality.reliability = ReliabilityPolicy.BEST_EFFORT
        return True
    if policy is QoSPolicyKind.DURABILITY and quality.durability is not DurabilityPolicy.VOLATILE:
        quality.durability = DurabilityPolicy.VOLATILE
        return True
    return False


def policies_text(quality: QoSProfile) -> str:
    """Return reliability and durability in words."""
    return f"{quality.reliability.name.lower()}, {quality.durability.name.lower()}"


def with_check(options: dict[str, Any]) -> dict[str, Any]:
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


def topic_refusal(node: Node, topic: str, error: Exception) -> Exception:
    """Return why a topic cannot be opened, as an error that a user can read."""
    if isinstance(error, ParameterException) or not node.context.ok():
        return error
    reason = reason_of(error)
    if isinstance(error, NameValidationException) or "resolve name" in reason:
        return ValueError(f"the topic {topic!r} has no valid name ({reason})")
    return ValueError(
        f"the topic {topic} cannot be opened ({reason}): correct its parameters "
        f"qos_overrides.{node.resolve_topic_name(topic)}; reliability is reliable or "
        f"best_effort, history keep_last or keep_all, depth from 1 to {LARGEST_DEPTH}"
    )
