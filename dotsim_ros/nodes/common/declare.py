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
from rclpy.parameter import Parameter

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
    values = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        descriptor = _descriptor(field.name, option_of(field), field.default)
        value = node.declare_parameter(field.name, default, descriptor).value
        if value is None:
            raise ValueError(f"{field.name} is given without a value, such as an empty list")
        values[field.name] = _plain(value)
    return kind(**values)


def follow(
    node: GuardedNode, current: Callable[[], Parameters], apply: Callable[[Parameters], None]
) -> None:
    """Let a running node's parameters be changed, all of one call together or none.

    Args:
        node: whose parameters were declared with `declare`.
        current: returns the parameters in force.
        apply: takes the changed parameters, all or none; refuses them by ValueError or OSError.
            What else it raises is refused as well, and logged as a fault of ours.
    """

    def change(changes: Sequence[Parameter]) -> None:
        names = {field.name for field in dataclasses.fields(current())}  # type: ignore[arg-type]
        changed = {each.name: _plain(each.value) for each in changes if each.name in names}
        if changed:
            apply(dataclasses.replace(current(), **changed))  # type: ignore[type-var]

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

    node.add_on_set_parameters_callback(on_set)


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | bool | int | float) else tuple(value)


def _descriptor(name: str, known: Option, default: Any) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        name=name, description=known.description, read_only=known.read_only
    )
    if known.choices:
        descriptor.additional_constraints = f"one of {', '.join(known.choices)}"
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
