# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How every node of this package starts, spins and stops."""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger

from dotsim_ros.io.cores import keep_single_threaded
from dotsim_ros.nodes.common.arguments import (
    check_start,
    names_for,
    prepare_log_folder,
    typed_names,
    with_found_files,
)
from dotsim_ros.nodes.common.failures import FORESEEN
from dotsim_ros.nodes.common.node import BROKEN, WorkingNode
from dotsim_ros.nodes.common.reasons import nearest, reason_of

QUALITY = "qos_overrides."
"""Parameters of a topic, which are there once it is opened."""
REFUSED = 2
"""Exit status of a node that could not start from what its user gave it."""


class _Interruption:
    """What Python does at SIGINT: an exception while one is allowed, else nothing.

    ROS has a handler of its own in front of this one, which shuts its context down: that ends
    whatever spins. An exception there would fall anywhere into ROS's own code, which leaves objects
    half made.
    """

    def __init__(self) -> None:
        self._has_come = False
        self._is_allowed = False

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        self._has_come = True
        if self._is_allowed:
            # `ros2 launch` and a terminal both signal the process: one exception is enough.
            self._is_allowed = False
            raise KeyboardInterrupt

    @contextmanager
    def allowed(self) -> Iterator[None]:
        """Raise KeyboardInterrupt at a SIGINT in the block, or at once if one has come before."""
        self._is_allowed = True
        try:
            if self._has_come:
                raise KeyboardInterrupt
            yield
        finally:
            self._is_allowed = False


def run_node(factory: Callable[[], WorkingNode], *, arguments: Sequence[str] | None = None) -> int:
    """Run one node; see `run_nodes`."""
    return run_nodes([factory], arguments=arguments)


def run_nodes(
    factories: Sequence[Callable[[], WorkingNode]], *, arguments: Sequence[str] | None = None
) -> int:
    """Start ROS, make the nodes, spin them until one is stopped, and take everything down.

    Stops on SIGINT (once or more), on SIGTERM, and when any thread calls `rclpy.try_shutdown()`,
    which is how a node ends itself. A callback that runs then runs to its end. `destroy_node` runs,
    after a signal, with the ROS context already shut down: it must not publish there.

    Args:
        factories: make a node each; called after `rclpy.init`, and none begins before all are made.
        arguments: the command line, `sys.argv` by default.

    Returns:
        The exit status: the largest `exit_status` of the nodes after a stop; `REFUSED`
        where its arguments were refused, or a factory or `begin` the parameters or files, with one
        line that says why; `BROKEN` where these failed for another reason, with one line that says
        how to get its traceback.
    """
    keep_single_threaded()
    interruption = _Interruption()
    signal.signal(signal.SIGINT, interruption)
    nodes: list[WorkingNode] = []
    given = with_found_files(sys.argv[1:] if arguments is None else arguments)
    try:
        check_start(given)
        prepare_log_folder()
        rclpy.init(args=given)
    except (ValueError, OSError, RCLError, UnknownROSArgsError) as error:
        return _refused(error)
    try:
        # Before the node: it cannot be made any more once a signal has shut the context down.
        executor = SingleThreadedExecutor()
        try:
            for factory in factories:
                with interruption.allowed():
                    nodes.append(factory())
            _name_unused(nodes, given)
            for node in nodes:
                executor.add_node(node)
                node.begin()
        except (ExternalShutdownException, KeyboardInterrupt):
            raise
        except Exception as error:
            if isinstance(error, RCLError) and not rclpy.ok():
                raise
            return _refused(error)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        # What meets the shutdown half-way fails: a wait, a publisher, a node that is being made.
        if rclpy.ok():
            raise
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
        # From here on Python takes its handlers down, and the default one would kill the process.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return max((node.exit_status for node in nodes), default=0)


def _name_unused(nodes: Sequence[WorkingNode], arguments: Sequence[str]) -> None:
    """Log the parameters that nodes were given and do not have.

    What is given for nodes of any name may be meant for another one: that is a warning only where
    it is nearly a name of the node's.
    """
    typed = typed_names(arguments)
    for node in nodes:
        by_name = names_for(arguments, node.get_fully_qualified_name())
        known = list(node.get_parameters_by_prefix(""))
        is_configured = not node.has_parameter("autostart") or node.get_parameter("autostart").value
        wrong, others = [], []
        for name in sorted(node._parameter_overrides):
            is_quality = name.startswith(QUALITY)
            if node.has_parameter(name) or (is_quality and not is_configured):
                continue
            if name not in by_name and any(other.has_parameter(name) for other in nodes):
                continue
            meant = nearest(name, known)
            if name in by_name | typed or (meant and not is_quality):
                wrong.append(f"{name} (is it {meant}?)" if meant else name)
            else:
                others.append(name)
        if wrong:
            node.get_logger().warning(
                f"without effect, since the node has no parameter of the name: {', '.join(wrong)}"
            )
        if others:
            node.get_logger().info(
                f"given for any node, and not a parameter of this one: {', '.join(others)}"
            )


def _refused(error: Exception) -> int:
    """Log why a node cannot start; return its exit status."""
    logger = get_logger("dotsim_ros")
    if isinstance(error, FORESEEN):
        logger.fatal(f"cannot start: {reason_of(error)}")
        return REFUSED
    logger.fatal(
        f"cannot start: unexpected {type(error).__name__}: {reason_of(error)}; this is a fault of "
        "the node's: report it with what --ros-args --log-level debug adds"
    )
    logger.debug("".join(traceback.format_exception(error)))
    return BROKEN
