"""How every node of this package starts, spins and stops."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node

REFUSED = 2
"""Exit status of a node that could not start from what its user gave it."""


def _interrupt_once(_number: int, _frame: FrameType | None) -> None:
    # `ros2 launch` and a terminal both signal the process: the second SIGINT must not cut the
    # shutdown that the first one began.
    signal.signal(signal.SIGINT, _do_nothing)
    raise KeyboardInterrupt


def _do_nothing(_number: int, _frame: FrameType | None) -> None:
    # Not SIG_IGN: ROS puts C handlers back behind Python's back, and Python complains of a signal
    # that reaches it there while it holds none of its own.
    pass


def run_node(factory: Callable[[], Node], *, arguments: Sequence[str] | None = None) -> int:
    """Start ROS, make the node, spin it until it is told to stop, and take everything down.

    Stops on SIGINT (once or more), on SIGTERM, and when any thread calls `rclpy.try_shutdown()`,
    which is how a node ends itself. A node that owns threads or files closes them in its
    `destroy_node`, which runs here with SIGINT ignored and, after a signal, with the ROS context
    already shut down: it must not publish there. What went wrong in its threads or while closing
    it says by an attribute `exit_status` other than 0.

    Args:
        factory: makes the node; called after `rclpy.init`.
        arguments: the command line, `sys.argv` by default.

    Returns:
        The exit status: 0 (or the node's `exit_status`) after a stop, `REFUSED` where the factory
        refused its parameters or files (ValueError, OSError or a ROS parameter's exception), with
        one line that says why.
    """
    signal.signal(signal.SIGINT, _interrupt_once)
    node: Node | None = None
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
        try:
            node = factory()
        except (ValueError, OSError, ParameterException) as error:
            get_logger("dotsim_ros").fatal(f"cannot start: {error}")
            return REFUSED
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        # A shutdown between the executor's check and its wait makes the wait itself fail.
        if rclpy.ok():
            raise
    finally:
        signal.signal(signal.SIGINT, _do_nothing)
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        # Taking ROS down puts back the handler from before it, which would let a late one through.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return int(getattr(node, "exit_status", 0))
