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
from rclpy.node import Node
from rclpy.parameter import Parameter

from dotsim_ros.nodes.common.options import Option, option_of

Parameters = TypeVar("Parameters")


def declare(node: Node, kind: type[Parameters]) -> Parameters:
    """Declare every field of a parameter class and return what the user set.

    Raises:
        ValueError: the class's own checks refuse the values.
        ParameterException: ROS refuses a value, by type or range.
    """
    values = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        descriptor = _descriptor(field.name, option_of(field), field.default)
        values[field.name] = _plain(node.declare_parameter(field.name, default, descriptor).value)
    return kind(**values)


def follow(
    node: Node, current: Callable[[], Parameters], apply: Callable[[Parameters], None]
) -> None:
    """Let a running node's parameters be changed, all of one call together or none.

    Args:
        node: whose parameters were declared with `declare`.
        current: returns the parameters in force.
        apply: takes the changed parameters; refuses them by ValueError or OSError.
    """

    def on_set(changes: Sequence[Parameter]) -> SetParametersResult:
        names = {field.name for field in dataclasses.fields(current())}  # type: ignore[arg-type]
        changed = {change.name: _plain(change.value) for change in changes if change.name in names}
        if not changed:
            return SetParametersResult(successful=True)
        try:
            apply(dataclasses.replace(current(), **changed))  # type: ignore[type-var]
        except (ValueError, OSError) as error:
            node.get_logger().warning(f"parameters refused: {error}")
            return SetParametersResult(successful=False, reason=str(error))
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
