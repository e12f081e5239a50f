# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Declares the parameters of a class as ROS parameters, and takes changes of them."""

from __future__ import annotations

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
from dotsim_ros.io.quantity import Quantity
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.parameters import (
    CONFIGURED,
    READ_ONLY,
    from_values,
    known_parameters,
    values_of,
)
from dotsim_ros.nodes.common.reasons import reason_of

Parameters = TypeVar("Parameters")


def declare(node: WorkingNode, kind: type[Parameters]) -> Parameters:
    """Declare every field of a parameter class and return what the user set.

    Raises:
        ValueError: the class's own checks refuse the values, or one is none at all.
        ParameterException: ROS refuses a value, by type or range.
    """
    declare_fields(node, kind)
    return read(node, kind)


def declare_fields(node: WorkingNode, kind: type[Any]) -> None:
    """Declare every field of a parameter class.

    Raises:
        ParameterException: ROS refuses a value, by type or range.
    """
    for name, (default, known) in known_parameters(kind).items():
        value = list(default) if isinstance(default, tuple) else default
        node.declare_parameter(name, value, _descriptor(name, known, default))


def read(node: WorkingNode, kind: type[Parameters]) -> Parameters:
    """Return what the parameters declared of a class are now.

    Raises:
        ValueError: the class's own checks refuse the values, or one is none at all.
    """
    values = {}
    for name, (_, known) in known_parameters(kind).items():
        try:
            value = node.get_parameter(name).value
        except ParameterUninitializedException:
            value = None
        if value is None:
            raise ValueError(f"{name} is given without a value, such as an empty list")
        values[name] = _plain(value, known)
    return from_values(kind, values)


def follow(
    node: WorkingNode,
    current: Callable[[], Parameters | None],
    apply: Callable[[Parameters], None],
) -> None:
    """Let a running node's parameters be changed, all of one call together or none.

    Call it once all other checks of the node's parameters are there: what these refuse must not be
    applied.

    Args:
        node: whose parameters are declared.
        current: returns the parameters in force; None while there are none, since the node is not
            configured: what is set then is checked when it is.
        apply: takes the changed parameters, all or none; refuses them by ValueError or OSError.
    """

    def change(changes: Sequence[Parameter]) -> None:
        settings = current()
        if settings is None:
            return
        known = {name: one for name, (_, one) in known_parameters(type(settings)).items()}
        changed = {
            each.name: _plain(each.value, known[each.name])
            for each in changes
            if each.name in known
        }
        for name in changed:
            is_same = changed[name] == _plain(node.get_parameter(name).value, known[name])
            if known[name].fixed == CONFIGURED and not is_same:
                raise ValueError(f"{name} is {CONFIGURED}: clean it up first")
        if changed:
            apply(from_values(type(settings), {**values_of(settings), **changed}))

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


def _plain(value: Any, known: Quantity) -> Any:
    if known.is_path and value:
        return str(expanded(value))
    return value if isinstance(value, str | bool | int | float) else tuple(value)


def _descriptor(name: str, known: Quantity, default: Any) -> ParameterDescriptor:
    constraints = [f"one of {', '.join(known.choices)}"] if known.choices else []
    constraints += [CONFIGURED] if known.fixed == CONFIGURED else []
    descriptor = ParameterDescriptor(
        name=name,
        description=known.help,
        read_only=known.fixed == READ_ONLY,
        additional_constraints="; ".join(constraints),
    )
    # ROS knows ranges of scalars only; those of lists are checked by the class itself.
    if isinstance(default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(known.low), to_value=float(known.high))
        ]
    elif isinstance(default, int) and not isinstance(default, bool):
        descriptor.integer_range = [
            IntegerRange(from_value=int(known.low), to_value=int(known.high), step=1)
        ]
    return descriptor
