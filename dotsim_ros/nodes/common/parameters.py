# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of a node: a frozen data class whose fields are by `io.quantity`, or are groups of
such fields. In ROS each field is one parameter of its name, whatever group it is in. Needs no ROS.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar

from dotsim_ros.io.quantity import Quantity, meanings_of, quantities_of

Kind = TypeVar("Kind")

FREE = ""
READ_ONLY = "read-only"
CONFIGURED = "read-only while the node is configured"
"""When a parameter is fixed: `Quantity.fixed`, and `FIXED` of a class for all of its fields."""


def known_parameters(kind: type) -> dict[str, tuple[Any, Quantity]]:
    """Return default and description of each parameter of a class and its groups, by name."""
    found = {}
    for field in dataclasses.fields(kind):
        if dataclasses.is_dataclass(field.default):
            found.update(known_parameters(type(field.default)))
    for name, (default, known) in quantities_of(kind).items():
        fixed = getattr(kind, "FIXED", FREE) if known.fixed is None else known.fixed
        found[name] = (
            default,
            dataclasses.replace(known, help=meanings_of(kind)[name], fixed=fixed),
        )
    return found


def from_values(kind: type[Kind], values: Mapping[str, Any]) -> Kind:
    """Return an instance of the values of parameters by their names; defaults for all others.

    Raises:
        ValueError: the class refuses a value, or none of its parameters has a name that is given.
    """
    unknown = sorted(values.keys() - known_parameters(kind).keys())
    if unknown:
        raise ValueError(f"{', '.join(unknown)}: expected only {', '.join(known_parameters(kind))}")
    return _made(kind, values)


def _made(kind: type[Kind], values: Mapping[str, Any]) -> Kind:
    own: dict[str, Any] = {}
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        if dataclasses.is_dataclass(field.default):
            own[field.name] = _made(type(field.default), values)
        elif field.name in values:
            own[field.name] = values[field.name]
    return kind(**own)


def values_of(instance: Any) -> dict[str, Any]:
    """Return the value of each parameter of an instance, by its name."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        if dataclasses.is_dataclass(value):
            found.update(values_of(value))
        else:
            found[field.name] = value
    return found
