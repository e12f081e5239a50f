# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""ROS parameters of a node from a frozen data class of options, refused with a reason."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import ParameterUninitializedException
from rclpy.parameter import Parameter

from dotsim_ros.io.files import expanded
from dotsim_ros.nodes.common.guarded_node import GuardedNode
from dotsim_ros.nodes.common.options import Option, option_of
from dotsim_ros.nodes.common.reasons import reason_of

Parameters = TypeVar("Parameters")


def declare(node: GuardedNode, kind: type[Parameters]) -> Parameters:
    """Declare every field of a parameter class and return what the user set.

    Raises:
        ValueError: the class's own checks refuse the values, or one is none at all.
        ParameterException: ROS refuses a value, by type or range.
    """
    declare_fields(node, kind)
    return read(node, kind)


def declare_fields(node: GuardedNode, kind: type[Any]) -> None:
    """Declare every field of a parameter class.

    Raises:
        ParameterException: ROS refuses a value, by type or range.
    """
    for field in dataclasses.fields(kind):
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        descriptor = _descriptor(field.name, option_of(field), field.default)
        node.declare_parameter(field.name, default, descriptor)


def read(node: GuardedNode, kind: type[Parameters]) -> Parameters:
    """Return what the parameters declared of a class are now.

    Raises:
        ValueError: the class's own checks refuse the values, or one is none at all.
    """
    values = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        try:
            value = node.get_parameter(field.name).value
        except ParameterUninitializedException:
            value = None
        if value is None:
            raise ValueError(f"{field.name} is given without a value, such as an empty list")
        values[field.name] = _plain(value, option_of(field))
    return kind(**values)


def follow(
    node: GuardedNode,
    current: Callable[[], Parameters | None],
    apply: Callable[[Parameters], None],
) -> None:
    """Let a running node's parameters be changed, all of one call together or none.

    Call it once all other checks of the node's parameters are there: what these refuse must not be
    applied.

    Args:
        node: whose parameters were declared with `declare` or `declare_fields`.
        current: returns the parameters in force; None while there are none, since the node is not
            configured: what is set then is checked when it is.
        apply: takes the changed parameters, all or none; refuses them by ValueError or OSError.
            What else it raises is refused as well, and logged as a fault of ours.
    """

    def change(changes: Sequence[Parameter]) -> None:
        settings = current()
        if settings is None:
            return
        fields = dataclasses.fields(settings)  # type: ignore[arg-type]
        known = {field.name: option_of(field) for field in fields}
        changed = {
            each.name: _plain(each.value, known[each.name])
            for each in changes
            if each.name in known
        }
        for name in changed:
            is_same = changed[name] == _plain(node.get_parameter(name).value, known[name])
            if known[name].fixed_while_configured and not is_same:
                raise ValueError(
                    f"{name} is read-only while the node is configured: clean it up first"
                )
        if changed:
            apply(dataclasses.replace(settings, **changed))  # type: ignore[type-var]

    def on_set(changes: Sequence[Parameter]) -> SetParametersResult:
        try:
            change(changes)
        except (ValueError, OSError) as error:
            reason = reason_of(error)
            node.get_logger().warning(f"parameters refused: {reason}")
            return SetParametersResult(successful=False, reason=reason)
        except Exception as error:
            reason = node.note_failure("parameters are left as they were", error)
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    node.add_parameter_check(on_set)


def _plain(value: Any, known: Option) -> Any:
    if known.is_path and value:
        return str(expanded(value))
    return value if isinstance(value, str | bool | int | float) else tuple(value)


def _descriptor(name: str, known: Option, default: Any) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        name=name, description=known.description, read_only=known.read_only
    )
    constraints = [f"one of {', '.join(known.choices)}"] if known.choices else []
    if known.fixed_while_configured:
        constraints.append("read-only while the node is configured")
    descriptor.additional_constraints = "; ".join(constraints)
    if known.minimum is None or known.maximum is None:
        return descriptor
    # ROS knows ranges of scalars only; those of lists are checked by the class itself.
    if isinstance(default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(known.minimum), to_value=float(known.maximum))
        ]
    elif isinstance(default, int):
        descriptor.integer_range = [
            IntegerRange(from_value=int(known.minimum), to_value=int(known.maximum), step=1)
        ]
    return descriptor
