# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Which classes messages are made of: those of an installed ROS, or those of a bag's type store.

The encoders of this package build messages of either kind. They ask a `MessageTypes` for the class
of a name ("sensor_msgs/msg/Image") and for the containers that its fields hold. The decoders need
none of this: the fields of both kinds are read through the buffer protocol.
"""

from __future__ import annotations

import array
import importlib
import re
from collections.abc import Mapping
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

LONGEST_EXCERPT = 80

Message = Any
"""A message of either kind: the two share attribute names, not classes."""


class MessageTypes(Protocol):
    """What an encoder needs to make messages of one kind."""

    def make(self, name: str, /, **fields: Any) -> Message:
        """Return a message of the type `name` with every field given."""

    def octets(self, values: NDArray[Any]) -> Any:
        """Return the bytes of a C-contiguous array as the value of a `uint8[]` field."""

    def doubles(self, values: NDArray[np.float64]) -> Any:
        """Return numbers as the value of a `float64[]` or `float64[N]` field."""

    def octet(self, value: int) -> Any:
        """Return a small integer as the value of a `byte` field."""


@cache
def message_class(name: str) -> Any:
    """Return the installed ROS 2 class of a message name such as "sensor_msgs/msg/Image".

    Raises:
        ImportError: its package is not installed.
        ValueError: the name is of another form, or the package has no such message.
    """
    form = re.fullmatch("([a-z][a-z0-9_]*)/(msg|srv)/([A-Z][A-Za-z0-9]*)", name)
    if form is None:
        raise ValueError(
            f"message type {name[:LONGEST_EXCERPT]!r} is not of the form PACKAGE/msg/TYPE"
        )
    package, kind, class_name = form.groups()
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except ImportError as error:
        raise ImportError(
            f"message package {package!r} is not installed: source a ROS 2 environment that has it"
        ) from error
    found = getattr(module, class_name, None)
    if found is None:
        raise ValueError(f"package {package!r} has no message {class_name!r}")
    return found


class RosTypes:
    """The message classes of the installed ROS 2, imported at their first use."""

    def make(self, name: str, /, **fields: Any) -> Message:
        return message_class(name)(**fields)

    def octets(self, values: NDArray[Any]) -> array.array[int]:
        """See `MessageTypes.octets`.

        rclpy checks every element of a list, an ndarray or a bytes object (30 to 85 ms for an
        image of 640x480), and takes an `array.array` as it is.
        """
        octets = array.array("B")
        octets.frombytes(values.data.cast("B") if values.size else b"")
        return octets

    def doubles(self, values: NDArray[np.float64]) -> list[float]:
        return [float(value) for value in values]

    def octet(self, value: int) -> bytes:
        return bytes([value])


class BagTypes:
    """The message classes of a `rosbags` type store, for bags on machines without ROS.

    Args:
        classes: class by message name: the attribute `types` of a type store.
    """

    def __init__(self, classes: Mapping[str, Any]) -> None:
        self._classes = classes

    def make(self, name: str, /, **fields: Any) -> Message:
        return self._classes[name](**fields)

    def octets(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        """See `MessageTypes.octets`; without a copy."""
        return values.reshape(-1).view(np.uint8)

    def doubles(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.ascontiguousarray(values, dtype=np.float64)

    def octet(self, value: int) -> int:
        return value


ROS: MessageTypes = RosTypes()
"""The default of every encoder."""
