# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What callbacks of a node have raised: counted, logged, and reported on /diagnostics."""

from __future__ import annotations

import time
import traceback
from threading import Lock

import numpy as np
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.node import Node

from dotsim_ros.nodes.common.health import FAULT_MEMORY_S
from dotsim_ros.nodes.common.reasons import reason_of
from msg_adapters import Level, Status

FORESEEN = (
    ValueError,
    OSError,
    ParameterException,
    NameValidationException,
    RCLError,
    UnknownROSArgsError,
)
"""What is raised where a node cannot do its work with what its user gave it."""
LOG_EVERY_S = 5.0
"""Between two lines about the same topic or service."""


class Failures:
    """The failures of one node, from any thread."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._lock = Lock()
        self._count, self._reason, self._last_s = 0, "", -np.inf
        self._logged_s: dict[str, float] = {}

    def note(self, what: str, error: Exception) -> str:
        """Count and log what was raised while `what` was done; return the reason in words."""
        # What is meant to be read is a ValueError or an OSError; anything else is a fault of ours.
        is_foreseen = isinstance(error, ValueError | OSError)
        name = "" if is_foreseen else f"unexpected {type(error).__name__}: "
        reason = f"{name}{reason_of(error)}"
        # Publishing fails once a signal has shut the context down: that is how a run ends.
        if not self._node.context.ok():
            return reason
        now_s = time.monotonic()
        with self._lock:
            self._count += 1
            self._reason, self._last_s = f"{what}: {reason}", now_s
            is_logged = now_s - self._logged_s.get(what, -np.inf) >= LOG_EVERY_S
            if is_logged:
                self._logged_s[what] = now_s
        logger = self._node.get_logger()
        if is_logged and is_foreseen:
            logger.warning(f"{what}: {reason}")
        elif is_logged:
            logger.error(f"{what}: {reason}")
            logger.debug("".join(traceback.format_exception(error)))
        return reason

    def statuses(self, label: str) -> list[Status]:
        """Return the state of the callbacks, for the diagnostics; nothing where none has failed."""
        with self._lock:
            count, reason, since_s = self._count, self._reason, self._last_s
        if not count:
            return []
        is_recent = time.monotonic() - since_s < FAULT_MEMORY_S
        level, message = (Level.WARN, reason) if is_recent else (Level.OK, "running")
        values = {"failures": str(count), "last_failure": reason}
        return [Status(f"{label}: callbacks", level, message, label, values)]
