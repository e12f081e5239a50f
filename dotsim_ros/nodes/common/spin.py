# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How every node of this package starts, spins and stops."""

from __future__ import annotations

import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from threading import Event, Thread
from types import FrameType
from typing import TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.clock import Clock, ClockType, JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.time import Time

import msg_adapters
from dotsim_ros.io.cores import keep_single_threaded
from dotsim_ros.nodes.common.arguments import (
    check_start,
    names_for,
    typed_names,
    with_found_files,
)
from dotsim_ros.nodes.common.clock_watch import ClockJump, ClockWatch
from dotsim_ros.nodes.common.guarded_node import GuardedNode
from dotsim_ros.nodes.common.log_folder import prepare_log_folder
from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.common.reasons import nearest, reason_of
from dotsim_ros.nodes.simulated_time.latency import Latency
from dotsim_ros.nodes.simulated_time.participant import StepParticipant
from dotsim_ros.nodes.simulated_time.schedule import (
    LONGEST_STEP_S,
    PacedWork,
    PeriodicWork,
    SimulatedSchedule,
)
from msg_adapters import Status

Result = TypeVar("Result")

SILENT_CLOCK_WARNING_S = 5.0
PAUSED_CLOCK_WARNING_S = 60.0
"""A simulator may be paused for long."""
ROUNDING_NS = 1000
"""A time that is so little before the last one is the same, computed another way."""
WAKE_PERIOD_S = 0.25
QUALITY = "qos_overrides."
"""Parameters of a topic, which are there once it is opened."""
REFUSED = 2
"""Exit status of a node that could not start from what its user gave it."""
STEPPED = ParameterDescriptor(
    description="with use_sim_time: go on only in the steps of a time_stepper, with others",
    read_only=True,
)
BROKEN = 1
"""Exit status of a node that could not start, or go on, for a fault of its own."""
FORESEEN = (
    ValueError,
    OSError,
    ParameterException,
    NameValidationException,
    RCLError,
    UnknownROSArgsError,
)
"""What is raised where a node cannot do its work with what its user gave it."""


class WorkingNode(GuardedNode):
    """A node that owns threads or files: it opens them in `begin`, not while it is made.

    Making a node may take minutes, so a SIGINT cuts it short wherever it is; what is opened then
    would stay open.

    What it does at which time goes through `start_work`, `start_paced` and `compute`, and what it
    calls now is `now_s`. With `use_sim_time` that is the time of /clock, and everything runs on the
    executor's thread as the clock moves on; else it is the steady clock, and threads wait for it.
    With `stepped` too the node is a participant of steps (see `StepParticipant`).

    A simulated time that goes back is a new start: results that are being computed are dropped, and
    what is given to `on_clock_jump` is called. One that leaps forward leaves something out: nothing
    of it passes in the node, so that no work is late for it.

    Args:
        name: of the node.

    Attributes:
        exit_status: other than 0 where something went wrong in a thread or while closing.
        stopping: set when the threads are to return.
        is_stepped: whether the node is a participant of steps.
    """

    exit_status = 0

    def __init__(self, name: str) -> None:
        super().__init__(name)
        keep_single_threaded()
        self.stopping = Event()
        is_simulated = bool(self.get_parameter("use_sim_time").value)
        self.is_stepped = bool(self.declare_parameter("stepped", False, STEPPED).value)
        if self.is_stepped and not is_simulated:
            raise ValueError("stepped is true, which needs simulated time: set use_sim_time too")
        self._schedule = SimulatedSchedule() if is_simulated else None
        self._origin_ns: int | None = None
        self._clock_watch = ClockWatch(time.monotonic()) if is_simulated else None
        self._on_jump: list[Callable[[ClockJump], None]] = []
        if self.is_stepped:
            # The steps themselves tell the time, and to hear it twice costs a tenth of a core.
            self._time_source.detach_node()
            self.participant = StepParticipant(self, self._step_to)
        elif is_simulated:
            self._follow_clock()
        self.add_parameter_check(partial(_refuse_other_clock, is_simulated))
        self._threads: list[Thread] = []
        self._ends: list[Event] = []
        # A signal between the executor's look at the context and its wait wakes nothing: of a node
        # without a timer, one SIGINT in 20 was lost.
        self.create_timer(WAKE_PERIOD_S, _wake, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def begin(self) -> None:
        """Open what `destroy_node` closes; a signal waits until it is done.

        Raises:
            ValueError, OSError: what the user gave does not work; nothing has been opened.
        """
        raise NotImplementedError

    @property
    def is_simulated(self) -> bool:
        """Return whether the node goes by simulated time."""
        return self._schedule is not None

    def now_s(self) -> float:
        """Return the time by which the node acts, on a clock that is never set: in simulated time
        what has passed since the first time of /clock, else the steady clock."""
        return time.monotonic() if self._schedule is None else self._schedule.now_s

    def time_ns(self) -> int:
        """Return the time of messages; 0 where there is none: see `GuardedNode.time_ns`."""
        if self._schedule is None:
            return super().time_ns()
        return 0 if self._origin_ns is None else self._origin_ns + round(1e9 * self._schedule.now_s)

    def before_request(self) -> None:
        """Let what is being computed for the simulated time end: it began before the request."""
        if self._schedule is not None:
            self._schedule.settle()

    def before_message(self) -> None:
        """Begin again where /clock has gone back: the message may be of the new time."""
        if self._origin_ns is None or self.is_stepped:
            return
        time_ns = GuardedNode.time_ns(self)
        if time_ns and time_ns < self.time_ns() and self._has_jumped(time_ns):
            self._go_to(time_ns)

    def on_clock_jump(self, act: Callable[[ClockJump], None]) -> None:
        """Do something when the simulated time goes back or leaps forward, until
        `drop_scheduled`."""
        self._on_jump.append(act)

    def clock_silence(self) -> str:
        """Return in words that the simulated time does not move on; empty where it does, and in
        real time."""
        if self._clock_watch is None or self.is_stepped:
            return ""
        return self._clock_watch.silence(time.monotonic())

    def destroy_node(self) -> None:
        """Wait until the threads have returned, and take the node down."""
        self.stopping.set()
        for end in self._ends:
            end.set()
        if self._schedule is not None:
            self._schedule.close()
        for thread in self._threads:
            thread.join()
        super().destroy_node()

    def start_thread(self, name: str, run: Callable[[], None], broken: str) -> Thread:
        """Start a thread without which the node must not live on; it returns once it is `stopping`.

        Args:
            name: of the thread.
            run: its work. An exception of it is logged with `broken` and ends the node with exit
                status 1, unless a signal has shut the context down: to publish there is how a run
                ends.
            broken: what has happened then.
        """
        thread = Thread(target=self._watch, args=(run, broken), name=name, daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

    def start_paced(
        self, name: str, pace: Callable[[], FramePace], tick: Callable[[], None], broken: str
    ) -> Callable[[], None]:
        """Call `tick` at each deadline until the node stops.

        Args:
            name, broken: as of `start_thread`.
            pace: gives the deadlines; asked each time, since a parameter may change the rate.
            tick: the work of one period.

        Returns:
            What ends it before; see `start_work`.
        """
        return self.start_work(name, PeriodicWork(pace, tick), broken)

    def start_work(self, name: str, work: PacedWork, broken: str) -> Callable[[], None]:
        """Do work at each of its deadlines until the node stops.

        Args:
            name, broken: as of `start_thread`.
            work: and its deadlines.

        Returns:
            What ends it before, and waits until nothing of it is being done; not for the work
            itself to call.
        """
        if self._schedule is not None:
            return self._schedule.pace(_Watched(self, work, broken))
        is_over = Event()

        def run() -> None:
            while not is_over.wait(max(0.0, work.deadline_s() - time.monotonic())):
                work.run(time.monotonic())

        self._ends.append(is_over)
        thread = self.start_thread(name, run, broken)

        def end() -> None:
            is_over.set()
            thread.join()
            self._ends.remove(is_over)
            self._threads.remove(thread)

        return end

    def drop_scheduled(self) -> None:
        """Let nothing be done any more that simulated time would bring: frames that are being
        computed, reports of health."""
        self._on_jump.clear()
        if self._schedule is not None:
            self._schedule.clear()

    def compute(
        self,
        latency: Latency,
        work: Callable[[], Result],
        take: Callable[[Result], None],
        broken: str,
    ) -> None:
        """Compute something, and take what comes out when it is there: in simulated time after the
        latency, else at once.

        Args:
            latency: of what stands where this does in reality.
            work: changes nothing that other work of this node looks at.
            take: uses what came out, on the thread of the node's work.
            broken: as of `start_thread`.
        """
        if self._schedule is None:
            take(work())
        else:
            self._schedule.compute(
                latency.draw_s(), work, lambda result: self._watch(partial(take, result), broken)
            )

    def report_health(
        self, period_s: float, statuses: Callable[[], Sequence[Status]], without_clock: str
    ) -> Callable[[], None]:
        """Publish the node's health on /diagnostics.

        Args:
            period_s: between reports, by a steady clock: a node says what is wrong without /clock,
                too. In steps, of simulated time.
            statuses: returns the states of the node's parts.
            without_clock: what does not work while `use_sim_time` is set and /clock is silent, for
                the log.

        Returns:
            What publishes a report at once.
        """
        publisher = self.create_publisher(DiagnosticArray, "/diagnostics", 10)

        def report() -> None:
            stamp_ns, silence = self.time_ns(), self.clock_silence()
            if silence and stamp_ns == 0:
                self.get_logger().warning(
                    f"{silence}: {without_clock}", throttle_duration_sec=SILENT_CLOCK_WARNING_S
                )
            elif silence:
                self.get_logger().warning(silence, throttle_duration_sec=PAUSED_CLOCK_WARNING_S)
            found = [*statuses(), *self.failure_status(), *self._clock_status()]
            publisher.publish(msg_adapters.encode_diagnostics(found, stamp_ns=stamp_ns))

        if self._schedule is not None and self.is_stepped:
            # At times that are known: who steps the nodes decides by what they report.
            self._schedule.every(period_s, report)
        else:
            self.create_timer(period_s, report, clock=Clock(clock_type=ClockType.STEADY_TIME))
        return report

    def _clock_status(self) -> list[Status]:
        """Return the state of the clock, for the diagnostics; nothing in real time."""
        if self._clock_watch is None:
            return []
        level, message, values = self._clock_watch.report(time.monotonic())
        return [Status(f"{self.label}: clock", level, message, self.label, values)]

    def _step_to(self, time_ns: int) -> None:
        """Go on in a step; the node's ROS clock, which its log is stamped by, goes with it."""
        clock = self.get_clock()
        assert isinstance(clock, ROSClock)
        clock.set_ros_time_override(Time(nanoseconds=time_ns, clock_type=ClockType.ROS_TIME))
        self._go_to(time_ns)

    def _go_to(self, time_ns: int) -> None:
        """Do what is due up to a time of the clock that the node goes by."""
        schedule, watch = self._schedule, self._clock_watch
        assert schedule is not None
        assert watch is not None
        watch.move(time.monotonic())
        if self._origin_ns is None:
            self._origin_ns = time_ns
        elif self._has_jumped(time_ns):
            self._jump_to(time_ns)
        schedule.advance(1e-9 * (time_ns - self._origin_ns))

    def _has_jumped(self, time_ns: int) -> bool:
        step_ns = time_ns - self.time_ns()
        return not -ROUNDING_NS <= step_ns <= round(1e9 * LONGEST_STEP_S)

    def _jump_to(self, time_ns: int) -> None:
        """Let the times of messages go on from another time than what passes in the node does."""
        schedule, watch, before_ns = self._schedule, self._clock_watch, self.time_ns()
        assert schedule is not None
        assert watch is not None
        assert self._origin_ns is not None
        # Of a leap, only so much passes that what comes next is done: a clock may run so fast that
        # each of its ticks is one.
        passed_ns = 0 if time_ns < before_ns else round(1e9 * schedule.until_next_s())
        jump = ClockJump(before_ns, time_ns, time_ns - before_ns - passed_ns)
        self._origin_ns += jump.shift_ns
        watch.jump(jump, time.monotonic())
        self.get_logger().warning(jump.text(), throttle_duration_sec=SILENT_CLOCK_WARNING_S)
        if jump.is_restart:
            schedule.drop_computed()
        for act in list(self._on_jump):
            act(jump)

    def _follow_clock(self) -> None:
        """Go on whenever /clock does."""

        def go() -> None:
            time_ns = GuardedNode.time_ns(self)
            if time_ns:
                self._go_to(time_ns)

        # Not within the jump's own callback, which must return before the clock can be read.
        moved = self.create_guard_condition(go)
        self._jumps = self.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=Duration(nanoseconds=1),
                min_backward=Duration(nanoseconds=-1),
                on_clock_change=True,
            ),
            post_callback=lambda _: moved.trigger(),
        )

    def _watch(self, run: Callable[[], None], broken: str) -> None:
        try:
            run()
        except Exception:
            if self.context.ok():
                self.get_logger().fatal(broken)
                self.exit_status = BROKEN
                rclpy.try_shutdown()
                raise


class _Watched:
    """Work that ends its node where it fails; see `WorkingNode.start_thread`."""

    def __init__(self, node: WorkingNode, work: PacedWork, broken: str) -> None:
        self._node, self._work, self._broken = node, work, broken

    def deadline_s(self) -> float:
        """Return when it is due."""
        return self._work.deadline_s()

    def run(self, now_s: float) -> None:
        """Do it."""
        self._node._watch(partial(self._work.run, now_s), self._broken)


def _refuse_other_clock(
    is_simulated: bool, changes: Sequence[rclpy.parameter.Parameter]
) -> SetParametersResult:
    is_other = any(
        change.name == "use_sim_time" and change.value != is_simulated for change in changes
    )
    reason = "use_sim_time is fixed once the node runs: start it again" if is_other else ""
    return SetParametersResult(successful=not is_other, reason=reason)


def _wake() -> None:
    """Do nothing, so that the executor looks whether the node goes on."""


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
    """Run one node; see `run_nodes`."""
    return run_nodes([factory], arguments=arguments)


def run_nodes(
    factories: Sequence[Callable[[], Node]], *, arguments: Sequence[str] | None = None
) -> int:
    """Start ROS, make the nodes, spin them until one is stopped, and take everything down.

    Stops on SIGINT (once or more), on SIGTERM, and when any thread calls `rclpy.try_shutdown()`,
    which is how a node ends itself. A callback that runs then runs to its end. `destroy_node` runs,
    after a signal, with the ROS context already shut down: it must not publish there.

    Args:
        factories: make a node each; called after `rclpy.init`, and none begins before all are made.
        arguments: the command line, `sys.argv` by default.

    Returns:
        The exit status: 0 (or the largest `exit_status` of a `WorkingNode`) after a stop; `REFUSED`
        where its arguments were refused, or a factory or `begin` the parameters or files, with one
        line that says why; `BROKEN` where these failed for another reason, with one line that says
        how to get its traceback.
    """
    interruption = _Interruption()
    signal.signal(signal.SIGINT, interruption)
    nodes: list[Node] = []
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
                if isinstance(node, WorkingNode):
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
    return max((int(getattr(node, "exit_status", 0)) for node in nodes), default=0)


def _name_unused(nodes: Sequence[Node], arguments: Sequence[str]) -> None:
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
