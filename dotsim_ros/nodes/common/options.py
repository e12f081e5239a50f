# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of a node as one frozen data class: default, description, range and choices in a
field, so that ROS, a test and a reader of the source all see the same thing. Needs no ROS."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from dotsim_ros.io.documents import value_text

METADATA_KEY = "option"


@dataclass(frozen=True)
class Option:
    """What is known of a parameter next to its default.

    Attributes:
        description: one sentence for the user.
        minimum: smallest number allowed, or None.
        maximum: largest number allowed, or None.
        choices: the closed set of texts allowed; empty: any.
        is_path: whether it names a file or folder, in which a leading `~` is the user's home.
        read_only: fixed once the node runs.
        fixed_while_configured: of a `ManagedNode`: taken when it is configured, and free to be set
            while it is not.
    """

    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    is_path: bool = False
    read_only: bool = False
    fixed_while_configured: bool = False

    @property
    def is_fixed(self) -> bool:
        """Whether it is fixed while the node does its work."""
        return self.read_only or self.fixed_while_configured


def option(default: Any, description: str, **known: Any) -> Any:
    """Return a field of a parameter class; `known` as in `Option`."""
    metadata = {METADATA_KEY: Option(description, **known)}
    return dataclasses.field(default=default, metadata=metadata)


def option_of(field: dataclasses.Field[Any]) -> Option:
    """Return what `option` said of a field."""
    known: Option = field.metadata[METADATA_KEY]
    return known


def check_options(parameters: Any) -> None:
    """Check every field of an instance against its range and choices.

    Raises:
        ValueError: names the parameter, its value and what was expected.
    """
    for field in dataclasses.fields(parameters):
        known = option_of(field)
        value = getattr(parameters, field.name)
        if known.choices and value not in known.choices:
            raise ValueError(
                f"{field.name} is {value_text(str(value))}, expected one of "
                f"{', '.join(known.choices)}"
            )
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, int | float) and not isinstance(number, bool):
                _check_number(field.name, float(number), known)


def _check_number(name: str, number: float, known: Option) -> None:
    minimum = -math.inf if known.minimum is None else known.minimum
    maximum = math.inf if known.maximum is None else known.maximum
    if not (math.isfinite(number) and minimum <= number <= maximum):
        raise ValueError(f"{name} holds {number:g}, expected a number from {minimum} to {maximum}")
