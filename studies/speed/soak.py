# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nodes under faults for hours: what is lost is reported, memory does not grow, each recovers.

Two sensors run next to each other: one in real time, under poses at 100 Hz, and one in lockstep,
whose simulated time this process publishes. In each round every fault of `FAULTS` is committed, one
after the other, and has to show in what the nodes report. A recovery is timed from the end of its
fault; how long one takes depends on the machine, whether it comes does not. Memory is the resident
set of the sensors, sampled once a second; its growth is the last tenth of the run against the
second tenth (the first one fills caches).
"""

from __future__ import annotations

import resource
import signal
import tempfile
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_srvs.srv import SetBool

import msg_adapters
from dotsim_ros.data.bag import BagReader, unfinished_path
from dotsim_ros.data.mcap.reader import Tolerance
from dotsim_ros.data.scripted import Site, press_hold_release
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.processes import NodeProcess
from studies.run import FAILED, expect_known
from studies.speed.running_node import PosePublisher, observing_node, running_sensors

POSE_RATE_HZ, RATE_HZ = 100.0, 25.0
STEP_NS = 40_000_000
"""Simulated time of a pose in lockstep..."""
STEP_PERIOD_S = 0.1
"""...and the least time that one takes, which leaves the machine to the other sensor."""
MOST_IN_FLIGHT = 4
"""The publisher keeps five images for a slow reader."""
STOPPED_S = 1.5
SLEPT_FRAMES = 20
"""Of others, while a reader or the recorder sleeps."""
PATIENCE_S = 60.0
READER_STARTS = 3
ROOM_BYTES = 3 * 2**20
"""On the disk that is full: room for three images."""
JUMPS_S = (60.0, -60.0)
BALANCE = 2.0
"""Deadlines by which a count may be off: one is in work, and one falls on the edge."""
LARGEST_GROWTH = 0.02
JUDGED_MINUTES = 5.0
"""A shorter run says nothing of the growth of memory."""
CHANGES: tuple[dict[str, Any], ...] = (
    {"image_size_px": [320, 240]},
    {"encoding": "bgr8", "image_size_px": [0, 0]},
    {"indenter": "cone"},
    {"rate_hz": 10.0},
    {"encoding": "rgb8", "indenter": "sphere_4mm", "rate_hz": RATE_HZ},
)
"""Together they end where they begin."""
READER = """
import signal

import rclpy
from sensor_msgs.msg import Image
from std_msgs.msg import Header

rclpy.init()
signal.signal(signal.SIGINT, signal.SIG_DFL)
node = rclpy.create_node("reader")
seen = node.create_publisher(Header, "seen", 10)
node.create_subscription(Image, "image_raw", lambda image: seen.publish(image.header), 5)
rclpy.spin(node)
"""


class UnreportedError(OSError):
    """Something was lost, and nothing reported it; or what should have come back did not."""


def resident_bytes(pid: int) -> int:
    """Return the resident set of a process."""
    for line in Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return 1024 * int(line.split()[1])
    raise OSError(f"process {pid} has no resident set: it has ended")


def growth(samples: list[int]) -> float:
    """Return the relative growth from the second tenth of the samples to the last tenth."""
    tenth = max(1, len(samples) // 10)
    before, after = np.mean(samples[tenth : 2 * tenth]), np.mean(samples[-tenth:])
    return float(after / before - 1.0)


class Numbered:
    """Messages of one publisher, by the numbers that it gives them.

    Attributes:
        received: how many came.
        missed: how many did not, by gaps between the numbers.
        last: the newest number.
        stamps_ns: of the newest 2000.
    """

    def __init__(self) -> None:
        self.received = self.missed = self.last = 0
        self.stamps_ns: deque[int] = deque(maxlen=2000)

    def note(self, stamp_ns: int, number: int) -> None:
        """Count a message."""
        if self.received:
            self.missed += number - self.last - 1
        self.last = number
        self.received += 1
        self.stamps_ns.append(stamp_ns)


class Lockstep(threading.Thread):
    """Sends poses to the sensor in lockstep, with its time, and expects an image of each.

    Attributes:
        waiting: stamps whose image has not come.
        sent: how many poses.
    """

    def __init__(self, node: Node) -> None:
        super().__init__(daemon=True)
        every = QoSProfile(history=HistoryPolicy.KEEP_ALL)
        self._poses = node.create_publisher(PoseStamped, "lockstep/indenter/pose", every)
        self._clock = node.create_publisher(Clock, "/clock", every)
        node.create_subscription(Image, "lockstep/image_raw", self._on_image, every)
        self._press = press_hold_release(Site(), depth_m=0.002, hold_s=0.2)
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._now_ns = 100 * 10**9
        self.waiting: set[int] = set()
        self.sent = 0

    def has_reader(self) -> bool:
        """Return whether the sensor reads its poses and its time."""
        return all(each.get_subscription_count() > 0 for each in (self._poses, self._clock))

    def has_sent(self, count: int) -> bool:
        """Return whether so many poses have been sent."""
        return self.sent >= count

    def jump(self, seconds: float, wait: Callable[[Callable[[], Any], str], Any]) -> None:
        """Go on at another time, once every pose of this one has its image."""
        with self._lock:
            wait(lambda: not self.waiting, "the images of the time before")
            self._now_ns += round(1e9 * seconds)
            self._tick()

    def end(self) -> None:
        """Send no more."""
        self._ending.set()
        self.join()

    def run(self) -> None:
        while not self._ending.wait(STEP_PERIOD_S):
            with self._lock:
                if len(self.waiting) >= MOST_IN_FLIGHT:
                    continue
                self._now_ns += STEP_NS
                self.waiting.add(self._now_ns)
                self._tick()
                pose = self._press.at(1e-9 * self._now_ns % self._press.duration_s)
                self._poses.publish(
                    msg_adapters.encode_pose_stamped(
                        pose.position_m,
                        pose.quaternion_xyzw,
                        stamp_ns=self._now_ns,
                        frame_id="densetact_base",
                    )
                )
                self.sent += 1

    def _tick(self) -> None:
        self._clock.publish(Clock(clock=msg_adapters.encode_stamp(self._now_ns)))

    def _on_image(self, message: Image) -> None:
        self.waiting.discard(msg_adapters.message_stamp_ns(message))


class Scene:
    """Two sensors, what is sent to them, and what comes back.

    Args:
        node: of this process, which is spun by another thread.
        live: the sensor in real time.
        stepped: the one in lockstep.

    Attributes:
        images: of the live sensor.
        lockstep: sends poses to the one in lockstep.
        newest: image of the live sensor.
        values: newest figures of each part of the nodes, with the time of the report, "stamp_s".
        seen_ns: newest stamp that the other reader has seen.
        deaf_readers: how many others got no image, and were started again.
        memory: samples of each sensor.
        turned_back: what was counted and then was less, in words.
    """

    def __init__(self, node: Node, live: NodeProcess, stepped: NodeProcess) -> None:
        self.node, self.live, self.stepped = node, live, stepped
        self.images, self.lockstep = Numbered(), Lockstep(node)
        self.newest = Image()
        self.values: dict[str, dict[str, str]] = {}
        self.seen_ns = self.deaf_readers = 0
        self.memory: dict[str, list[int]] = {"live": [], "lockstep": []}
        self.turned_back: list[str] = []
        self._sent_s: dict[tuple[float, ...], float] = {}
        self._shown_s = 0.0
        self._ending = threading.Event()
        self._publisher = PosePublisher(node)
        # The number of its arguments says that it takes the numbers of the messages.
        on_image: Callable[..., None] = self._on_image
        node.create_subscription(Image, "image_raw", on_image, 50)
        node.create_subscription(PoseStamped, "indenter/state", self._on_state, 50)
        node.create_subscription(Header, "seen", self._on_seen, 50)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._player = threading.Thread(target=self._play, daemon=True)

    def begin(self) -> None:
        """Send poses, once the sensors read them, and wait for frames of both."""
        self.wait(
            lambda: self._publisher.has_reader() and self.lockstep.has_reader(),
            "readers of the poses: check ROS_DOMAIN_ID and the network settings",
        )
        self._player.start()
        self.lockstep.start()
        self.wait(self.shows_poses_from_now(), "the first frames")
        self.wait(lambda: len(self.values) > 1, "diagnostics")

    def end(self) -> None:
        """Send no more."""
        self._ending.set()
        self._player.join()
        self.lockstep.end()

    def wait(self, is_reached: Callable[[], Any], what: str) -> Any:
        """Wait until something holds, and return it.

        Raises:
            UnreportedError: it does not in a minute.
        """
        end_s = time.monotonic() + PATIENCE_S
        while not (reached := is_reached()):
            if time.monotonic() > end_s:
                raise UnreportedError(f"waited {PATIENCE_S:.0f} s for {what}")
            time.sleep(0.01)
        return reached

    def shows_poses_from_now(self) -> Callable[[], bool]:
        """Return what tells whether the live sensor shows a pose that is sent from now on."""
        now_s, now_ns = time.monotonic(), self.node.get_clock().now().nanoseconds
        return lambda: (
            self._shown_s > now_s
            and bool(self.images.stamps_ns)
            and self.images.stamps_ns[-1] > now_ns
        )

    def wait_for_images(self, count: int) -> None:
        """Wait for so many more images of the live sensor."""
        before = self.images.received
        self.wait(lambda: self.images.received >= before + count, f"{count} more images")

    def report(self, part: str) -> dict[str, str]:
        """Wait for the next report of a part, and return its figures."""
        before = self.values.get(part)
        self.wait(lambda: self.values.get(part) is not before, f"a report of {part}")
        return self.values[part]

    def has_seen_after(self, stamp_ns: int) -> bool:
        """Return whether the other reader has seen an image that is newer than a time."""
        return self.seen_ns > stamp_ns

    def has_counted(self, part: str, name: str, before: int) -> bool:
        """Return whether the newest report of a part counts more than before."""
        return int(self.values[part][name]) > before

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """Call a service of the live sensor, and return its response."""
        client = self.node.create_client(kind, f"tactile_sim/{name}")
        try:
            self.wait(client.service_is_ready, f"the service {name}")
            future = client.call_async(kind.Request(**fields))
            self.wait(future.done, f"an answer of {name}")
            return future.result()
        finally:
            self.node.destroy_client(client)

    def set_parameters(self, values: Mapping[str, Any]) -> Any:
        """Set parameters of the live sensor; return the result."""
        given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        return self.call(
            SetParametersAtomically, "set_parameters_atomically", parameters=given
        ).result

    def _play(self) -> None:
        press = press_hold_release(Site(), depth_m=0.002, hold_s=0.2)
        begun_s = time.monotonic()
        index = 0
        while not self._ending.wait(max(0.0, begun_s + index / POSE_RATE_HZ - time.monotonic())):
            pose = press.at(index / POSE_RATE_HZ % press.duration_s)
            # A picometre a message makes the positions of minutes ones of a kind.
            index += 1
            position_m = pose.position_m + np.array([1e-12 * (index % 100_000), 0.0, 0.0])
            self._sent_s[tuple(position_m.tolist())] = time.monotonic()
            while len(self._sent_s) > 2000:
                del self._sent_s[next(iter(self._sent_s))]
            self._publisher.send(Pose(position_m, pose.quaternion_xyzw))
            if index % int(POSE_RATE_HZ) == 0:
                for name, process in (("live", self.live), ("lockstep", self.stepped)):
                    self.memory[name].append(resident_bytes(process.pid))

    def _on_image(self, message: Image, info: dict[str, int]) -> None:
        self.newest = message
        stamp_ns = msg_adapters.message_stamp_ns(message)
        self.images.note(stamp_ns, info["publication_sequence_number"])

    def _on_state(self, message: PoseStamped) -> None:
        position_m, _ = msg_adapters.decode_pose_stamped(message)
        self._shown_s = max(self._shown_s, self._sent_s.get(tuple(position_m.tolist()), 0.0))

    def _on_seen(self, message: Header) -> None:
        self.seen_ns = msg_adapters.decode_stamp(message.stamp)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        stamp_s = 1e-9 * msg_adapters.message_stamp_ns(message)
        for status in msg_adapters.decode_diagnostics(message):
            before = self.values.get(status.name, {})
            if status.name == "tactile_sim: frames":
                self.turned_back += [
                    f"{name} went from {before[name]} to {status.values[name]}"
                    for name in ("frames", "dropped", "late")
                    if int(status.values[name]) < int(before.get(name, 0))
                ]
            self.values[status.name] = {
                **status.values,
                "message": status.message,
                "stamp_s": str(stamp_s),
            }


Steps = Iterator[Callable[[], Any]]
"""Of a fault: commits it, yields what tells that all work again, and then checks the reports."""


def a_sensor_stops(scene: Scene) -> Steps:
    """Stop the live sensor and let it go on: the deadlines that passed are counted."""
    before = scene.report("tactile_sim: frames")
    with _stopped(scene.live):
        time.sleep(STOPPED_S)
    yield scene.shows_poses_from_now()

    def is_balanced() -> bool:
        now = scene.values["tactile_sim: frames"]
        frames, dropped = (int(now[name]) - int(before[name]) for name in ("frames", "dropped"))
        due = RATE_HZ * (float(now["stamp_s"]) - float(before["stamp_s"]))
        return dropped >= RATE_HZ * STOPPED_S - BALANCE and abs(frames + dropped - due) <= BALANCE

    scene.wait(is_balanced, "frames and dropped deadlines that add up to the time that passed")


def a_sensor_in_lockstep_stops(scene: Scene) -> Steps:
    """Stop the sensor in lockstep and let it go on: each pose that was sent has its image."""
    with _stopped(scene.stepped):
        scene.wait(lambda: len(scene.lockstep.waiting) >= MOST_IN_FLIGHT, "poses under way")
        time.sleep(STOPPED_S)
        expected = set(scene.lockstep.waiting)
    yield lambda: not expected & scene.lockstep.waiting


def a_clock_jumps(scene: Scene) -> Steps:
    """Let the simulated time leap and go back: it is reported, and each pose has its image."""
    part = "lockstep/tactile_sim: clock"
    for seconds, name in zip(JUMPS_S, ("leaps", "restarts"), strict=True):
        before = int(scene.report(part)[name])
        scene.lockstep.jump(seconds, scene.wait)
        enough = scene.lockstep.sent + 2 * MOST_IN_FLIGHT
        yield partial(scene.lockstep.has_sent, enough)
        scene.wait(partial(scene.has_counted, part, name, before), f"a report of {name}")


def a_reader_sleeps(scene: Scene) -> Steps:
    """Stop another reader of the images: this one gets them, and it goes on with the newest."""
    with _reader(scene) as reader:
        with _stopped(reader):
            scene.wait_for_images(SLEPT_FRAMES)
            newest_ns = scene.images.stamps_ns[-1]
        yield lambda: scene.seen_ns >= newest_ns


def a_reader_dies(scene: Scene) -> Steps:
    """Kill another reader of the images: the sensor goes on, and a new reader gets images."""
    with _reader(scene) as reader:
        reader.signal(signal.SIGKILL)
        reader.wait()
        yield scene.shows_poses_from_now()
        scene.wait_for_images(SLEPT_FRAMES)
    with _reader(scene):
        pass


def the_recorder_stops(scene: Scene) -> Steps:
    """Stop the recorder and let it go on: what its bag misses is counted."""
    with tempfile.TemporaryDirectory(prefix="dotsim_ros_soak_") as folder:
        bag = Path(folder) / "bag"
        recorder = _recorder(scene, bag)
        try:
            with _stopped(recorder):
                scene.wait_for_images(SLEPT_FRAMES)
            newest_ns, part = scene.images.stamps_ns[-1], "tactile_record: recording"
            written = int(scene.report(part)["written"])
            yield partial(scene.has_counted, part, "written", written)
            scene.wait_for_images(SLEPT_FRAMES)
            reported = scene.report(part)
        finally:
            status = recorder.stop()
        recorded = _image_stamps_ns(bag)
    missing = [
        stamp_ns
        for stamp_ns in scene.images.stamps_ns
        if min(recorded) < stamp_ns < max(recorded) and stamp_ns not in recorded
    ]
    counted = int(reported["lost_on_the_way"]) + int(reported["dropped"])
    if status != 0 or max(recorded) <= newest_ns or len(missing) > counted:
        raise UnreportedError(
            f"the recorder ended with status {status}; its bag misses {len(missing)} images, "
            f"{counted} were counted"
        )


def the_disk_is_full(scene: Scene) -> Steps:
    """Let a recording find no room: it says so, and keeps what it wrote."""
    with tempfile.TemporaryDirectory(prefix="dotsim_ros_soak_") as folder:
        bag = Path(folder) / "bag"
        recorder = _recorder(scene, bag)
        resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (ROOM_BYTES, ROOM_BYTES))
        try:
            scene.wait(lambda: recorder.has_logged("broke off"), "the end of the recorder")
        finally:
            status = recorder.stop()
        yield scene.shows_poses_from_now()
        # Without room for its index, either, it says how to repair the bag.
        place = bag if bag.exists() else unfinished_path(bag)
        with BagReader(place, Tolerance.UNFINISHED) as reader:
            count = len(list(reader.messages("/image_raw", "/wrench")))
    if status != 1 or not recorder.has_logged(f"{count} are in {place}"):
        raise UnreportedError(f"the recorder ended with status {status}, its bag holds {count}")


def parameters_change(scene: Scene) -> Steps:
    """Change parameters of the live sensor: images follow, and a bad value changes nothing."""
    for change in CHANGES:
        result = scene.set_parameters(change)
        if not result.successful:
            raise UnreportedError(f"{change} was refused: {result.reason}")
        yield scene.shows_poses_from_now()
        width, encoding = change.get("image_size_px", [0])[0] or 640, change.get("encoding")
        if "image_size_px" in change and scene.newest.width != width:
            raise UnreportedError(f"images are {scene.newest.width} pixels wide after {change}")
        if encoding is not None and scene.newest.encoding != encoding:
            raise UnreportedError(f"images are in {scene.newest.encoding} after {change}")
    result = scene.set_parameters({"rate_hz": -1.0})
    if result.successful or "rate_hz" not in result.reason:
        raise UnreportedError(f"a rate of -1 Hz was taken, or refused by {result.reason!r}")
    yield scene.shows_poses_from_now()


FAULTS: dict[str, Callable[[Scene], Steps]] = {
    function.__name__: function
    for function in (
        a_sensor_stops,
        a_sensor_in_lockstep_stops,
        a_clock_jumps,
        a_reader_sleeps,
        a_reader_dies,
        the_recorder_stops,
        the_disk_is_full,
        parameters_change,
    )
}


@contextmanager
def _stopped(process: NodeProcess) -> Iterator[None]:
    """Let a process do nothing in the block."""
    process.signal(signal.SIGSTOP)
    try:
        yield
    finally:
        process.signal(signal.SIGCONT)


@contextmanager
def _reader(scene: Scene) -> Iterator[NodeProcess]:
    """Run another reader of the images, from its first one. One that gets none is started again, as
    a user would, and counted: after others were killed, Fast DDS now and then fails to reach one,
    though both are matched."""
    process, starts = None, 0
    while process is None:
        now_ns = scene.node.get_clock().now().nanoseconds
        process, starts = NodeProcess("reader", {}, code=READER), starts + 1
        try:
            scene.wait(partial(scene.has_seen_after, now_ns), "images at another reader")
        except UnreportedError:
            process.stop()
            process = None
            scene.deaf_readers += 1
            if starts == READER_STARTS:
                raise
    try:
        yield process
    finally:
        process.stop()


def _recorder(scene: Scene, bag: Path) -> NodeProcess:
    """Return a recorder that has received images."""
    process = NodeProcess("tactile_record", {"output": bag, "topics": "['image_raw','wrench']"})
    try:
        process.wait_for_line("receiving /image_raw", timeout_s=PATIENCE_S)
    except OSError:
        process.stop()
        raise
    scene.wait_for_images(2)
    return process


def _image_stamps_ns(bag: Path) -> set[int]:
    with BagReader(bag) as reader:
        return {item.log_time_ns for item in reader.messages("/image_raw")}


def _unseen(scene: Scene, expected: int | None = None) -> int:
    """Return how many frames the live sensor says that it made beyond the number of its last image,
    while it makes none; where it is known, wait for the images until it is that.

    Raises:
        UnreportedError: it is another: frames were counted and not published.
    """
    scene.call(SetBool, "set_enabled", data=False)
    try:
        # What is under way arrives meanwhile.
        for _ in range(4):
            frames = int(scene.report("tactile_sim: frames")["frames"])
        if expected is not None:
            scene.wait(lambda: frames - scene.images.last == expected, "frames that were counted")
        return frames - scene.images.last
    finally:
        scene.call(SetBool, "set_enabled", data=True)


def soak(
    *, hours: float = 0.5, grid_spacing_m: float = 0.0, faults: tuple[str, ...] = tuple(FAULTS)
) -> dict[str, Any]:
    """Nodes under faults for hours: losses that nothing reports, memory, recoveries.

    Args:
        hours: how long; at least one round.
        grid_spacing_m: of both sensors; 0: their own.
        faults: of a round, in their order.
    """
    expect_known("fault", faults, FAULTS)
    if not hours >= 0.0:
        raise ValueError(f"hours is {hours:g}, expected 0 (one round) or more")
    own = {"grid_spacing_m": grid_spacing_m, "diagnostics_period_s": 0.2}
    failed: list[str] = []
    recovery_s: defaultdict[str, list[float]] = defaultdict(list)
    begun_s, rounds = time.monotonic(), 0
    with (
        running_sensors({**own, "rate_hz": RATE_HZ}) as (live,),
        running_sensors(
            {**own, "clock": "lockstep", "use_sim_time": True}, namespaces=("lockstep",)
        ) as (stepped,),
        observing_node("soak") as (node, executor),
    ):
        scene = Scene(node, live, stepped)
        spinning = threading.Thread(target=executor.spin, daemon=True)
        spinning.start()
        scene.begin()
        unseen = _unseen(scene)
        while rounds == 0 or time.monotonic() - begun_s < 3600.0 * hours:
            rounds += 1
            for name in faults:
                print(f"round {rounds}, {(time.monotonic() - begun_s) / 60.0:.1f} min: {name}")
                try:
                    for has_recovered in FAULTS[name](scene):
                        ended_s = time.monotonic()
                        scene.wait(has_recovered, "a recovery")
                        recovery_s[name].append(time.monotonic() - ended_s)
                except (OSError, ValueError) as error:
                    failed.append(f"round {rounds}, {name}: {error}")
                    print(failed[-1])
            try:
                _unseen(scene, unseen)
            except UnreportedError as error:
                failed.append(f"round {rounds}: {error}")
        scene.end()
        try:
            scene.wait(lambda: not scene.lockstep.waiting, "images of the last poses")
        except UnreportedError as error:
            failed.append(str(error))
        statuses = {"live": live.stop(), "lockstep": stepped.stop()}
        executor.shutdown()
        spinning.join()
    minutes = (time.monotonic() - begun_s) / 60.0
    grown = {name: growth(samples) for name, samples in scene.memory.items()}
    failed += [f"a count went back: {words}" for words in scene.turned_back]
    failed += [f"{name}: ended with status {each}" for name, each in statuses.items() if each]
    failed += [
        f"{name}: memory grew by {each:.1%}"
        for name, each in grown.items()
        if minutes >= JUDGED_MINUTES and each > LARGEST_GROWTH
    ]
    return {
        "minutes": round(minutes, 1),
        "rounds": rounds,
        "faults": sum(map(len, recovery_s.values())),
        "images": scene.images.received,
        "images_missed": scene.images.missed,
        "deaf_readers": scene.deaf_readers,
        "lockstep_poses": scene.lockstep.sent,
        "lockstep_lost": len(scene.lockstep.waiting),
        "unreported": len(failed),
        "recovery_s": {
            name: {"median": round(float(np.median(each)), 3), "worst": round(max(each), 3)}
            for name, each in recovery_s.items()
        },
        "memory_mib": {
            name: [round(sample / 2**20, 1) for sample in samples[:: max(1, len(samples) // 30)]]
            for name, samples in scene.memory.items()
        },
        "memory_growth": {name: round(each, 5) for name, each in grown.items()},
        FAILED: failed,
    }
