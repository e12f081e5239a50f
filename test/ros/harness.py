# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Starts real executables and talks to them over DDS, as a user's program would."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from forked import Forked
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy._rclpy_pybind11 import InvalidHandle, RCLError
from rclpy.client import Client as RosClient
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

import msg_adapters

START_PATIENCE_S = 120.0
PATIENCE_S = 120.0
APEX_M = 0.01575
# Some 3 MB each.
KEPT_FRAMES = 100
BASE_FRAME = "densetact_base"

FRAME_TOPICS: dict[str, type] = {
    "image_raw": Image,
    "camera_info": CameraInfo,
    "depth/image": Image,
    "points": PointCloud2,
    "wrench": WrenchStamped,
}
STATE_TOPIC = "indenter/state"


class Executable:
    """A node in a process of its own.

    Args:
        module: the module that is run.
        parameters: ROS parameters of the node.
        arguments: further ROS arguments.
        code: Python code to run in the module's place.
        script: Python file to run in the module's place.
    """

    def __init__(
        self,
        module: str,
        parameters: Mapping[str, Any] | None = None,
        arguments: Sequence[str] = (),
        *,
        code: str = "",
        script: Path | None = None,
    ) -> None:
        program = ["-c", code] if code else ["-m", module]
        if script is not None:
            program = [str(script)]
        self.process = Forked([*program, *with_parameters(parameters or {}), *arguments])
        self._lines: list[str] = []
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            with self._changed:
                self._lines.append(line)
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    @property
    def log(self) -> str:
        """What the process has written so far."""
        with self._changed:
            return "".join(self._lines)

    def wait_for_line(self, text: str) -> None:
        """Wait until the process has written a line that holds `text`."""

        def is_over() -> bool:
            return any(text in line for line in self._lines) or not self._reader.is_alive()

        with self._changed:
            self._changed.wait_for(is_over, START_PATIENCE_S)
        assert text in self.log, f"no line with {text!r} in:\n{self.log}"

    def exit_status(self, patience_s: float = START_PATIENCE_S) -> int:
        """Wait for the process to end by itself."""
        status = self.process.wait(patience_s)
        self._reader.join(PATIENCE_S)
        return status

    def interrupt(self, count: int = 1) -> int:
        """Send SIGINT, once or more, and return the exit status."""
        for _ in range(count):
            self.process.send_signal(signal.SIGINT)
            time.sleep(0.02)
        return self.exit_status()

    def end(self) -> None:
        """Make sure that nothing is left running."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(10.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()


STARTS = """
import json, sys
from importlib import import_module
from dotsim_ros.nodes.common.spin import run_node

module, name = sys.argv[1:]
for arguments in json.load(sys.stdin):
    status = run_node(getattr(import_module(module), name), arguments=arguments)
    print(f"status {status}", file=sys.stderr, flush=True)
"""
"""One process starts them all: what takes time is to import ROS."""


def refused_starts(node: type[Node], starts: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the logs of starts of a node, all of which must be refused.

    Args:
        node: class of the node.
        starts: the command line of each, by a name of it.
    """
    done = subprocess.run(
        [sys.executable, "-c", STARTS, node.__module__, node.__name__],
        input=json.dumps(list(starts.values())),
        capture_output=True,
        text=True,
        timeout=START_PATIENCE_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    logs = done.stderr.split("status ")
    assert [log.split()[0] for log in logs[1:]] == ["2"] * len(starts), done.stderr
    return dict(zip(starts, logs, strict=False))


def with_parameters(parameters: Mapping[str, Any]) -> list[str]:
    """Return the ROS arguments that set parameters."""
    given = (["-p", f"{name}:={value}"] for name, value in parameters.items())
    return ["--ros-args", *(argument for pair in given for argument in pair)]


def measured_until(
    measure: Callable[[], float], *, below: float, never: float = np.inf
) -> list[float]:
    """Measure until what is found is below a bound, three times at most; return all that was found.

    What is too slow is so every time, a busy machine now and then.

    Args:
        measure: does it again and returns what is found.
        below: the bound.
        never: what may not be reached even once.

    Raises:
        AssertionError: none of the three was below the bound, or one reached `never`.
    """
    found: list[float] = []
    while not found or found[-1] >= below:
        assert len(found) < 3, f"{found}, expected one below {below}"
        found.append(measure())
        assert found[-1] < never
    return found


def spin_in_background(node: Node, executor: Executor | None = None) -> threading.Thread:
    """Start a thread that runs a node, by itself or by an executor, until its context is shut down,
    whatever that meets half-way."""
    runs = SingleThreadedExecutor(context=node.context) if executor is None else executor
    runs.add_node(node)

    def spin() -> None:
        while node.context.ok():
            try:
                runs.spin()
            except ExternalShutdownException:
                pass
            except InvalidHandle:
                # A test took one of its publishers away as a turn began: the next is without it.
                pass
            except RCLError:
                if node.context.ok():
                    raise

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    return thread


@contextmanager
def running(
    module: str = "dotsim_ros.nodes.tactile_sim.node",
    *,
    ready: str = "ready:",
    parameters: Mapping[str, Any] | None = None,
    arguments: Sequence[str] = (),
    code: str = "",
) -> Iterator[Executable]:
    """Run a node from ready to the end of the block."""
    executable = Executable(module, parameters, arguments, code=code)
    try:
        executable.wait_for_line(ready)
        yield executable
    finally:
        executable.end()


def check_interrupts(
    name: str,
    *,
    count: int,
    ready: str = "ready:",
    parameters: Mapping[str, Any] | None = None,
    output: Path | None = None,
) -> None:
    """Assert that a node ends at its first SIGINT, whenever that comes once it is ready.

    Args:
        name: of the node.
        count: how often it is started, two at a time.
        ready: what its log says once it works.
        parameters: of the node.
        output: folder below which each start has its parameter `output`.
    """
    # After ready: some periods of every timer of the nodes that wakes them.
    moments_s = np.random.default_rng(0).uniform(0.0, 1.0, count)

    def interrupt(number: int) -> None:
        own = {} if output is None else {"output": output / str(number)}
        with running(
            f"dotsim_ros.nodes.{name}.node",
            ready=ready,
            parameters={**(parameters or {}), **own},
            arguments=["-r", f"__ns:=/run_{number}"],
        ) as node:
            time.sleep(moments_s[number])
            assert node.interrupt() == 0, f"after {moments_s[number]:.3f} s:\n{node.log}"
            assert "Traceback" not in node.log

    with ThreadPoolExecutor(2) as threads:
        list(threads.map(interrupt, range(count)))


@dataclass
class TactileFrame:
    """All messages of one stamp, by topic."""

    stamp_ns: int
    messages: dict[str, Any] = field(default_factory=dict)

    def is_whole(self) -> bool:
        """Whether every topic has come; a frame without an indenter has no state of it."""
        return set(FRAME_TOPICS) <= set(self.messages)

    def image(self) -> np.ndarray[Any, Any]:
        """Pixels (H, W, 3)."""
        return msg_adapters.decode_image(self.messages["image_raw"])

    def depth_m(self) -> np.ndarray[Any, Any]:
        """Depth (H, W)."""
        return msg_adapters.decode_image(self.messages["depth/image"])

    def cloud(self) -> msg_adapters.Cloud:
        """The skin."""
        return msg_adapters.decode_cloud(self.messages["points"])

    def force_n(self) -> np.ndarray[Any, Any]:
        """Force (3,) on the indenter."""
        return msg_adapters.decode_wrench_stamped(self.messages["wrench"])[0]

    def indenter_m(self) -> list[float] | None:
        """Position of the indenter in the frame, or None where none has come."""
        if STATE_TOPIC not in self.messages:
            return None
        return msg_adapters.decode_pose_stamped(self.messages[STATE_TOPIC])[0].tolist()

    def differing(self, other: TactileFrame) -> list[str]:
        """Return the topics of which a number differs, stamps aside."""
        return [
            topic
            for topic in FRAME_TOPICS
            if _content(self.messages[topic]) != _content(other.messages[topic])
        ]

    def is_same(self, other: TactileFrame) -> bool:
        """Whether every number of the two frames is the same, stamps aside."""
        return not self.differing(other)


def assert_same(frames: Sequence[TactileFrame], reference: Sequence[TactileFrame]) -> None:
    """Assert that frames are the same to the bit; a failure names the topics that are not."""
    assert [a.differing(b) for a, b in zip(frames, reference, strict=True)] == [[]] * len(reference)


def _content(message: Any) -> list[Any]:
    """Return every field but the header, arrays as bytes, so that NaN equals NaN."""
    fields = [name for name in message.get_fields_and_field_types() if name != "header"]
    values = [getattr(message, name) for name in fields]
    return [value.tobytes() if hasattr(value, "tobytes") else value for value in values]


class Watcher:
    """A program next to the nodes, with a ROS context of its own.

    Args:
        name, namespace: of its node.
        is_deaf: never read what it subscribes to.

    Attributes:
        diagnostics: the newest state of each part of each node, by name.
    """

    def __init__(self, name: str, namespace: str = "", *, is_deaf: bool = False) -> None:
        self.diagnostics: dict[str, msg_adapters.Status] = {}
        self._diagnosed_ns: dict[str, int] = {}
        self._clients: dict[str, RosClient] = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node(name, context=self._context, namespace=namespace)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._thread = None if is_deaf else spin_in_background(self.node)

    def close(self) -> None:
        """Leave the graph."""
        rclpy.try_shutdown(context=self._context)
        if self._thread is not None:
            self._thread.join(10.0)
        self.node.destroy_node()

    def now_ns(self) -> int:
        """Return the time that messages are stamped with."""
        return self.node.get_clock().now().nanoseconds

    def wait(
        self, is_reached: Callable[[], Any], what: str, *, patience_s: float = PATIENCE_S
    ) -> Any:
        """Wait until something holds."""
        end_s = time.monotonic() + patience_s
        while not (reached := is_reached()):
            assert time.monotonic() < end_s, f"waited {patience_s} s for {what}; {self.diagnostics}"
            time.sleep(0.01)
        return reached

    def call(self, kind: type, name: str, *, patience_s: float = PATIENCE_S, **fields: Any) -> Any:
        """Call a service and return its response."""
        # Kept, so that a call that is timed does not wait for the graph.
        if name not in self._clients:
            self._clients[name] = self.node.create_client(kind, name)
        assert self._clients[name].wait_for_service(PATIENCE_S), name
        future = self._clients[name].call_async(kind.Request(**fields))  # type: ignore[attr-defined]
        self.wait(future.done, f"an answer of {name}", patience_s=patience_s)
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
            self._diagnosed_ns[status.name] = msg_adapters.message_stamp_ns(message)


class Client(Watcher):
    """A user's program: publishes poses, reads every topic of the frames, calls services.

    Args:
        is_deaf: subscribe to everything and never read any of it.
        topics: what of the frames to read.
    """

    def __init__(self, *, is_deaf: bool = False, topics: Mapping[str, type] = FRAME_TOPICS) -> None:
        self.frames: dict[int, TactileFrame] = {}
        self._changed = threading.Condition()
        super().__init__("client", is_deaf=is_deaf)
        self._poses = self.node.create_publisher(
            PoseStamped, "indenter/pose", QoSProfile(history=HistoryPolicy.KEEP_ALL)
        )
        # The state first: of what is ready together, what was subscribed first is taken first, so
        # that a whole frame has its state.
        for topic, kind in {STATE_TOPIC: PoseStamped, **topics}.items():
            self.node.create_subscription(kind, topic, self._collector(topic), 50)

    def wait(
        self, is_reached: Callable[[], Any], what: str, *, patience_s: float = PATIENCE_S
    ) -> Any:
        """Wait until something holds; looks again at each frame, and each 50 ms."""
        end_s = time.monotonic() + patience_s
        with self._changed:
            while not (reached := is_reached()):
                assert time.monotonic() < end_s, f"waited {patience_s} s for {what}"
                self._changed.wait(0.05)
        return reached

    def meet(self) -> None:
        """Wait until the sensor reads poses and is read."""
        self.wait(
            lambda: (
                self._poses.get_subscription_count() > 0
                and all(self.node.count_publishers(topic) > 0 for topic in FRAME_TOPICS)
            ),
            "the sensor",
        )
        # What the publishers know of their readers comes on its own way.
        self.wait(lambda: bool(self.diagnostics), "diagnostics")

    def send(
        self,
        position_m: Sequence[float],
        *,
        stamp_ns: int | None = None,
        quaternion_xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        frame_id: str = BASE_FRAME,
    ) -> int:
        """Publish a pose as it is given, valid or not; return its stamp."""
        message = PoseStamped()
        message.header.frame_id = frame_id
        if stamp_ns is None:
            stamp_ns = self.now_ns()
        message.header.stamp = msg_adapters.encode_stamp(stamp_ns)
        point, rotation = message.pose.position, message.pose.orientation
        point.x, point.y, point.z = map(float, position_m)
        rotation.x, rotation.y, rotation.z, rotation.w = map(float, quaternion_xyzw)
        self._poses.publish(message)
        return stamp_ns

    def whole_frame(self, stamp_ns: int) -> TactileFrame:
        """Wait for every message of one stamp."""
        return self.wait(
            lambda: (found := self.frames.get(stamp_ns)) and found.is_whole() and found,
            f"a whole frame stamped {stamp_ns}",
        )

    def next_frame(
        self, is_wanted: Callable[[TactileFrame], bool], *, after: TactileFrame | None = None
    ) -> TactileFrame:
        """Wait for a whole frame that is wanted, newer than another or than those at hand."""
        newest_ns = max(self.frames, default=0) if after is None else after.stamp_ns

        def find() -> TactileFrame | None:
            for stamp_ns in sorted(stamp for stamp in self.frames if stamp > newest_ns):
                frame = self.frames[stamp_ns]
                if frame.is_whole() and is_wanted(frame):
                    return frame
            return None

        return self.wait(find, "a frame that is wanted")

    def state(self, part: str) -> msg_adapters.Status:
        """Return the newest diagnostic of a part: frames, input or gel."""
        return self.wait(lambda: self.diagnostics.get(f"tactile_sim: {part}"), part)

    def state_from_now(self, part: str) -> msg_adapters.Status:
        """Wait for a diagnostic of a part that is written from now on, and return it."""
        name, now_ns = f"tactile_sim: {part}", self.now_ns()
        self.wait(lambda: self._diagnosed_ns.get(name, 0) > now_ns, f"a new state of {part}")
        return self.diagnostics[name]

    def wait_for_state(
        self, part: str, is_wanted: Callable[[msg_adapters.Status], bool]
    ) -> msg_adapters.Status:
        """Wait for a diagnostic that is wanted and return it; the newest may be another by then."""
        name = f"tactile_sim: {part}"
        return self.wait(
            lambda: (found := self.diagnostics.get(name)) and is_wanted(found) and found,
            f"a state of {part}",
        )

    def set_parameters(self, **values: Any) -> Any:
        """Set parameters of the sensor together; return the result with its reason."""
        return self.set_parameters_of("/tactile_sim", **values)

    def _collector(self, topic: str) -> Callable[[Any], None]:
        def collect(message: Any) -> None:
            stamp_ns = msg_adapters.message_stamp_ns(message)
            with self._changed:
                frame = self.frames.setdefault(stamp_ns, TactileFrame(stamp_ns))
                frame.messages[topic] = message
                while len(self.frames) > KEPT_FRAMES:
                    del self.frames[next(iter(self.frames))]
                self._changed.notify_all()

        return collect


class LockstepPress:
    """The press that frames are compared by: from far away, down to 1 mm, a little sideways.

    Stamps go on from press to press, as those of one program would.
    """

    depth_mm = (-2.0, 0.2, 0.6, 1.0, 1.0)
    shift_mm = (0.0, 0.0, 0.0, 0.0, 0.4)
    period_ns = 40_000_000

    def __init__(self, client: Client) -> None:
        self.client = client
        self.stamp_ns = 10_000_000_000

    def next_stamp(self) -> int:
        """Return a stamp one period after the last one."""
        self.stamp_ns += self.period_ns
        return self.stamp_ns

    def frame_at(self, position_m: Sequence[float]) -> TactileFrame:
        """Send a pose and wait for its frame."""
        stamp_ns = self.client.send(position_m, stamp_ns=self.next_stamp())
        return self.client.whole_frame(stamp_ns)

    def run(self, between: Callable[[int], None] = lambda index: None) -> list[TactileFrame]:
        """Press once from afar; `between` acts after each frame, by its index."""
        self.frame_at((0.0, 0.0, APEX_M + 0.05))
        frames = []
        for index, (depth, shift) in enumerate(zip(self.depth_mm, self.shift_mm, strict=True)):
            frames.append(self.frame_at((1e-3 * shift, 0.0, APEX_M - 1e-3 * depth)))
            between(index)
        return frames


@contextmanager
def sensor(**parameters: Any) -> Iterator[tuple[Executable, Client]]:
    """Run a fresh tactile_sim and a client that has met it."""
    with running(parameters=parameters) as executable, closing(Client()) as client:
        client.meet()
        yield executable, client
