# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A user's program next to a node: it spins in the background, waits, and calls services."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from harness import PATIENCE_S, spin_in_background
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.client import Client
from rclpy.parameter import Parameter

import msg_adapters


class Watcher:
    """A node with a context of its own.

    Attributes:
        diagnostics: the newest state of each part of each node, by name.
    """

    def __init__(self, name: str, namespace: str = "") -> None:
        self.diagnostics: dict[str, msg_adapters.Status] = {}
        self._clients: dict[str, Client] = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node(name, context=self._context, namespace=namespace)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._thread = spin_in_background(self.node)

    def close(self) -> None:
        """Leave the graph."""
        rclpy.try_shutdown(context=self._context)
        self._thread.join(10.0)
        self.node.destroy_node()

    def wait(self, is_reached: Callable[[], Any], what: str) -> Any:
        """Wait until something holds."""
        end_s = time.monotonic() + PATIENCE_S
        while not (reached := is_reached()):
            assert time.monotonic() < end_s, f"waited {PATIENCE_S} s for {what}; {self.diagnostics}"
            time.sleep(0.01)
        return reached

    def call(self, kind: type, name: str, **fields: Any) -> Any:
        """Call a service and return its response."""
        # Kept, so that a call that is timed does not wait for the graph.
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        assert client.wait_for_service(PATIENCE_S), name
        future = client.call_async(kind.Request(**fields))  # type: ignore[attr-defined]
        self.wait(future.done, f"an answer of {name}")
        return future.result()

    def set_parameters_of(self, node: str, **values: Any) -> Any:
        """Set parameters of a node together; return the result with its reason."""
        parameters = [Parameter(name, value=value) for name, value in values.items()]
        return self.call(
            SetParametersAtomically,
            f"{node}/set_parameters_atomically",
            parameters=[parameter.to_parameter_msg() for parameter in parameters],
        ).result

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in msg_adapters.decode_diagnostics(message):
            self.diagnostics[status.name] = status
