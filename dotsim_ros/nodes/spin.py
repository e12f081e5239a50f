"""How every node of this package starts, spins and stops."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node

REFUSED = 2
"""Exit status of a node that could not start from what its user gave it."""


class WorkingNode(Node):
    """A node that owns threads or files: it opens them in `begin`, not while it is made.

    Making a node may take minutes, so a SIGINT cuts it short wherever it is; what is opened then
    would stay open.

    Attributes:
        exit_status: other than 0 where something went wrong in a thread or while closing.
    """

    exit_status = 0

    def begin(self) -> None:
        """Open what `destroy_node` closes; a signal waits until it is done.

        Raises:
            ValueError, OSError: what the user gave does not work; nothing has been opened.
        """
        raise NotImplementedError

    @contextmanager
    def vital(self, what: str) -> Iterator[None]:
        """Run the work of a thread without which the node must not live on.

        An exception in the block is logged with `what`, ends the node with exit status 1 and goes
        on, unless a signal has shut the context down: to publish there is how a run ends.
        """
        try:
            yield
        except Exception:
            if self.context.ok():
                self.get_logger().fatal(what)
                self.exit_status = 1
                rclpy.try_shutdown()
                raise


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


def run_node(factory: Callable[[], Node], *, arguments: Sequence[str] | None = None) -> int:
    """Start ROS, make the node, spin it until it is told to stop, and take everything down.

    Stops on SIGINT (once or more), on SIGTERM, and when any thread calls `rclpy.try_shutdown()`,
    which is how a node ends itself. A callback that runs then runs to its end. `destroy_node` runs,
    after a signal, with the ROS context already shut down: it must not publish there.

    Args:
        factory: makes the node; called after `rclpy.init`.
        arguments: the command line, `sys.argv` by default.

    Returns:
        The exit status: 0 (or the `exit_status` of a `WorkingNode`) after a stop, `REFUSED` where
        ROS refused its arguments, or factory or `begin` the parameters or files (ValueError,
        OSError or a ROS parameter's exception), with one line that says why.
    """
    interruption = _Interruption()
    signal.signal(signal.SIGINT, interruption)
    node: Node | None = None
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
    except (RCLError, UnknownROSArgsError) as error:
        get_logger("dotsim_ros").fatal(f"cannot start: {error}")
        return REFUSED
    try:
        # Before the node: it cannot be made any more once a signal has shut the context down.
        executor = SingleThreadedExecutor()
        try:
            with interruption.allowed():
                node = factory()
            if isinstance(node, WorkingNode):
                node.begin()
        except (ValueError, OSError, ParameterException) as error:
            get_logger("dotsim_ros").fatal(f"cannot start: {error}")
            return REFUSED
        rclpy.spin(node, executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        # What meets the shutdown half-way fails: a wait, a publisher, a node that is being made.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        # From here on Python takes its handlers down, and the default one would kill the process.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return int(getattr(node, "exit_status", 0))
