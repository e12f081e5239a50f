# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The life cycle of a node in ROS 2, which needs no manager.

The states, transitions, services and the topic of events are those of lifecycle_msgs:
https://design.ros2.org/articles/node_lifecycle.html
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from dotsim_ros.io.documents import value_text
from dotsim_ros.nodes.common.failures import FORESEEN
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.reasons import reason_of

AUTOSTART = ParameterDescriptor(
    description="configure and activate the node at its start; false: wait for a manager to do it",
    read_only=True,
)
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class Managed(Protocol):
    """What a life cycle brings from one state to the next; what raises refuses the transition."""

    def configure(self) -> None:
        """Make what the parameters ask for."""

    def activate(self) -> None:
        """Begin the work."""

    def deactivate(self) -> None:
        """End the work, and keep what was made."""

    def clean_up(self) -> None:
        """Let go of what was made."""


class LifeCycle(LifecycleNodeMixin):
    """The state machine of a node, which configures and activates itself or, without the parameter
    `autostart`, waits for a manager.

    Where a transition is refused the state stays, the log says why, and the node goes on; where it
    starts by itself, it does not start. Publishers, subscriptions, services and timers that are
    made from `configure` on are destroyed when the node is cleaned up, or shut down, and when it
    cannot be configured.

    Args:
        node: that has the states.
        work: of the node.
    """

    def __init__(self, node: WorkingNode, work: Managed) -> None:
        self._node, self._work = node, work
        # What rclpy's mixin asks of the node that it is written to be part of.
        self.handle, self.default_callback_group = node.handle, node.default_callback_group
        self._services = node._services
        super().__init__()
        self._starts_itself = bool(node.declare_parameter("autostart", True, AUTOSTART).value)
        self._last_error: Exception | None = None
        # What it had made in ROS before it was configured; None while it is not.
        self._kept: set[int] | None = None
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def start(self) -> None:
        """Configure the node, where it starts by itself.

        Raises:
            Exception: what `configure` raises.
        """
        if self._starts_itself:
            self._insist(self.trigger_configure)

    def begin(self) -> None:
        """Activate the node, where it starts by itself; errors as of `activate`."""
        if self._starts_itself:
            self._insist(self.trigger_activate)
        else:
            self._node.get_logger().info(
                "unconfigured: waits for a manager, or for "
                f"ros2 lifecycle set {self._node.get_fully_qualified_name()} configure"
            )

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """See `configure`."""
        self._kept = {id(each) for each, _ in self._entities()}
        outcome = self._attempt(self._work.configure)
        if outcome != SUCCESS:
            self._release()
        return outcome

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """See `activate`."""
        return self._attempt(self._work.activate)

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """See `deactivate`."""
        return self._attempt(self._work.deactivate)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """See `clean_up`."""
        return self._attempt(self._release)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate and clean up, from whatever state."""

        def end() -> None:
            if state.label == "active":
                self._work.deactivate()
            self._release()

        return self._attempt(end)

    def _attempt(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        self._last_error = None
        try:
            act()
        except Exception as error:
            self._last_error = error
            return FAILURE
        return SUCCESS

    def _insist(self, trigger: Callable[[], TransitionCallbackReturn]) -> None:
        trigger()
        if self._last_error is not None:
            raise self._last_error

    def _release(self) -> None:
        if self._kept is None:
            return
        self._work.clean_up()
        self._node.leave()
        for entity, destroy in self._entities():
            if id(entity) not in self._kept:
                destroy(entity)
        self._kept = None

    def _entities(self) -> list[tuple[Any, Callable[[Any], bool]]]:
        """Return what the node has made in ROS, each with what destroys it."""
        node = self._node
        return [
            *((each, node.destroy_publisher) for each in node.publishers),
            *((each, node.destroy_subscription) for each in node.subscriptions),
            *((each, node.destroy_service) for each in node.services),
            *((each, node.destroy_timer) for each in node.timers),
            *((each, node.destroy_guard_condition) for each in node.guards),
        ]

    def _on_change_state(self, request: Any, response: Any) -> Any:
        """Answer a call of `~/change_state`: rclpy raises where the state has no such transition,
        which would end the node, and keeps to itself why one failed."""
        asked, self._last_error = request.transition, None
        found = {number: label for number, label, *_ in self._state_machine.available_transitions}
        if asked.label in found.values() if asked.label else asked.id in found:
            self._node.settle()
            response = self._change_state(request, response)
        else:
            response.success = False
            expected = ", ".join(f"{label} ({number})" for number, label in found.items())
            self._last_error = ValueError(
                f"the node is {self._state_machine.current_state[1]}, expected "
                f"{expected or 'no transition any more'}"
            )
        if self._last_error is not None:
            name = value_text(asked.label or found.get(asked.id, asked.id))
            what = f"the transition {name} is refused"
            if isinstance(self._last_error, FORESEEN):
                # Each one, at whatever interval: the answer itself has no room for a reason.
                self._node.get_logger().warning(f"{what}: {reason_of(self._last_error)}")
            else:
                self._node.note_failure(what, self._last_error)
        return response
