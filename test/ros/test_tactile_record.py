# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`tactile_record` as a process, fed over DDS, its bag read back."""

import re
import resource
import signal
import time
from contextlib import closing

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from harness import PATIENCE_S, Executable, Watcher, refused_starts, running, with_parameters
from rclpy.qos import HistoryPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

import msg_adapters
from dotsim_ros.cli.main import main
from dotsim_ros.data.bag import BagReader
from dotsim_ros.data.lerobot.bags import IMAGE
from dotsim_ros.data.lerobot.reader import LeRobotReader
from dotsim_ros.data.trajectory import RECORDED_TOPICS, read_trajectory
from dotsim_ros.nodes.tactile_record.node import TactileRecord

MODULE = "dotsim_ros.nodes.tactile_record.node"
KEEP_ALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
TOPICS = {
    "image_raw": Image,
    "camera_info": CameraInfo,
    "depth/image": Image,
    "points": PointCloud2,
    "wrench": WrenchStamped,
    "indenter/pose": PoseStamped,
    "indenter/state": PoseStamped,
}
COUNT = 12


class Source(Watcher):
    """Publishes what a sensor does, each message to be delivered."""

    def __init__(self):
        super().__init__("source")
        self._publishers = {
            topic: self.node.create_publisher(kind, topic, KEEP_ALL)
            for topic, kind in TOPICS.items()
        }

    def meet(self, *topics):
        met = [self._publishers[topic] for topic in topics]
        self.wait(lambda: all(each.get_subscription_count() for each in met), "subscribers")

    def send(self, topic, message):
        self._publishers[topic].publish(message)

    def send_forces(self, numbers):
        """Send wrenches no faster than a reader with a depth of 50 takes them."""
        for number in numbers:
            self.send("wrench", wrench(number))
            time.sleep(0.002)

    def deliver(self):
        for publisher in self._publishers.values():
            assert publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=PATIENCE_S))


def recording(**parameters):
    # What is acknowledged is in the reader's cache; the node says what has come out of it.
    verbose = ["--log-level", "tactile_record:=debug"]
    return running(MODULE, ready="recording", parameters=parameters, arguments=verbose)


def frame(index):
    """Return the messages of one frame, all different from those of the others."""
    random = np.random.default_rng(index)
    header = {"stamp_ns": 10**9 + index * 40_000_000, "frame_id": "base"}
    return {
        "image_raw": msg_adapters.encode_image(
            random.integers(0, 256, (48, 64, 3), dtype=np.uint8), encoding="rgb8", **header
        ),
        "camera_info": msg_adapters.encode_camera_info(
            width=64,
            height=48,
            focal_px=30.0 + index,
            principal_point_px=(31.5, 23.5),
            distortion=(0.0, 0.0, 0.0, 0.0),
            **header,
        ),
        "depth/image": msg_adapters.encode_image(
            random.random((48, 64), dtype=np.float32), encoding="32FC1", **header
        ),
        "points": msg_adapters.encode_cloud(random.random((100, 3)), **header),
        "wrench": msg_adapters.encode_wrench_stamped(random.random(3), random.random(3), **header),
        **{
            topic: msg_adapters.encode_pose_stamped(
                random.random(3), (0.0, 0.0, 0.0, 1.0), **header
            )
            for topic in ("indenter/pose", "indenter/state")
        },
    }


def test_everything_that_is_published_is_in_the_bag(tmp_path):
    path = tmp_path / "bag"
    frames = [frame(index) for index in range(COUNT)]
    with (
        closing(Source()) as source,
        recording(output=path) as recorder,
    ):
        source.meet(*TOPICS)
        for messages in frames:
            for topic, message in messages.items():
                source.send(topic, message)
        source.deliver()
        assert not path.exists()
        recorder.wait_for_line(f" {COUNT * len(TOPICS)} messages so far")
        assert recorder.interrupt(2) == 0, recorder.log
    assert f"wrote {COUNT * len(TOPICS)} messages" in recorder.log
    assert "0 dropped, 0 lost" in recorder.log
    assert "Traceback" not in recorder.log
    trajectory = read_trajectory(path, topics=RECORDED_TOPICS)
    for index, messages in enumerate(frames):
        pixels = msg_adapters.decode_image(messages["image_raw"])
        assert np.array_equal(trajectory.image.pixels[index], pixels)
        force, torque = msg_adapters.decode_wrench_stamped(messages["wrench"])
        assert np.array_equal(trajectory.wrench.force_n[index], force)
        assert np.array_equal(trajectory.wrench.torque_nm[index], torque)
        position = msg_adapters.decode_cloud(messages["points"]).position
        assert np.array_equal(trajectory.skin.position_m[index], position)
    with BagReader(path) as bag:
        depths = [item.message() for item in bag.messages("/depth/image")]
        cameras = [item.message() for item in bag.messages("/camera_info")]
        for item in bag.messages(*bag.topics()):
            assert item.log_time_ns == msg_adapters.message_stamp_ns(item.message())
    assert [camera.k[0] for camera in cameras] == [30.0 + index for index in range(COUNT)]
    for messages, depth in zip(frames, depths, strict=True):
        assert msg_adapters.decode_image(depth).tobytes() == messages["depth/image"].data.tobytes()


def test_a_data_set_is_made_of_the_bag(tmp_path):
    for package in ("pyarrow", "av"):
        pytest.importorskip(package, reason="needs the extra dataset: pip install '.[dataset]'")
    frames = [frame(index) for index in range(COUNT)]
    parameters = {"output": tmp_path / "bag", "lerobot": tmp_path / "set"}
    with closing(Source()) as source, recording(**parameters) as recorder:
        source.meet(*TOPICS)
        for messages in frames:
            for topic, message in messages.items():
                source.send(topic, message)
        source.deliver()
        recorder.wait_for_line(f"{COUNT * len(TOPICS)} messages so far")
        assert recorder.interrupt() == 0, recorder.log
    assert f"wrote {COUNT} frames to {tmp_path / 'set'}" in recorder.log
    reader = LeRobotReader(tmp_path / "set")
    (episode,) = reader.episodes()
    for image, messages in zip(reader.images(episode, IMAGE), frames, strict=True):
        assert np.array_equal(image, msg_adapters.decode_image(messages["image_raw"]))


@pytest.mark.fault("recording", "a camera's driver publishes as sensor data, of best effort")
def test_what_is_published_without_delivery_is_recorded(tmp_path, answered):
    with (
        closing(Source()) as source,
        recording(output=tmp_path / "bag", topics="['image_raw','wrench']") as recorder,
    ):
        source.meet("image_raw", "wrench")
        camera = source.node.create_publisher(Image, "image_raw", qos_profile_sensor_data)
        recorder.wait_for_line("image_raw: a publisher offers best_effort")

        def is_received():
            camera.publish(frame(0)["image_raw"])
            return "receiving /image_raw" in recorder.log

        source.wait(is_received, "an image in the recorder")
        assert recorder.interrupt() == 0, recorder.log
    with BagReader(tmp_path / "bag") as bag:
        images = [item.message() for item in bag.messages("/image_raw")]
    assert images
    assert images[0].data.tobytes() == frame(0)["image_raw"].data.tobytes()
    answered(next(line for line in recorder.log.splitlines() if "best_effort" in line))


def test_what_the_disk_does_not_take_is_dropped_and_told(tmp_path):
    # A queue of 1 MiB holds a wrench and never this image of 2.3 MB.
    large = msg_adapters.encode_image(
        np.zeros((960, 800, 3), np.uint8), encoding="rgb8", stamp_ns=1, frame_id=""
    )
    parameters = {"output": tmp_path / "bag", "queue_mb": 1}
    with (
        closing(Source()) as source,
        recording(**parameters) as recorder,
    ):
        source.meet("image_raw", "wrench")
        source.send("image_raw", large)
        source.send("wrench", frame(0)["wrench"])
        source.deliver()
        recorder.wait_for_line("messages are dropped")
        recorder.wait_for_line(" 2 messages so far")
        assert recorder.interrupt() == 0, recorder.log
    assert "1 dropped" in recorder.log
    assert list(read_trajectory(tmp_path / "bag", topics=RECORDED_TOPICS).channels()) == ["wrench"]


def test_nothing_to_record_leaves_no_bag(tmp_path):
    parameters = {"output": tmp_path / "bag", "duration_s": 0.5}
    recorder = Executable(MODULE, parameters)
    assert recorder.exit_status() == 0, recorder.log
    assert "no bag written" in recorder.log
    assert list(tmp_path.iterdir()) == []


REFUSED = {
    "give its type": "['sound']",
    "only stamped messages": "['text=std_msgs/msg/String']",
    "nowhere_msgs": "['a=nowhere_msgs/msg/Nothing']",
    "expected NAME=PACKAGE/msg/TYPE": "['a=std_srvs/srv/Trigger']",
    "names /wrench twice": "['wrench', '/wrench=geometry_msgs/msg/PoseStamped']",
    "topics is given without a value": "[]",
}
"""Topics that cannot be recorded, by words of the reason."""
OVERWRITES = "exists already"


@pytest.fixture(scope="module")
def refusals(tmp_path_factory):
    """Return the folder of bags and the log of each start that must be refused, by words of the
    reason."""
    folder = tmp_path_factory.mktemp("refused")
    starts = {
        reason: with_parameters({"output": folder / "bag", "topics": topics})
        for reason, topics in REFUSED.items()
    }
    starts[OVERWRITES] = with_parameters({"output": folder})
    return folder, refused_starts(TactileRecord, starts)


@pytest.mark.parametrize("reason", [*REFUSED, OVERWRITES])
def test_what_cannot_be_recorded_is_refused_and_leaves_nothing(refusals, reason):
    folder, logs = refusals
    assert reason in logs[reason]
    assert "Traceback" not in logs[reason]
    assert list(folder.iterdir()) == []


def forces_of(path):
    with BagReader(path) as bag:
        return [item.message().wrench.force.x for item in bag.messages("/wrench")]


def wrench(number, stamp_s=0):
    message = msg_adapters.encode_wrench_stamped(
        (float(number), 0.0, 0.0), (0.0, 0.0, 0.0), stamp_ns=10**9 + number, frame_id="base"
    )
    if stamp_s:
        message.header.stamp.sec = stamp_s
    return message


def last_words(recorder):
    """What the node logged last, without its time."""
    return recorder.log.strip().splitlines()[-1].partition("]: ")[2]


@pytest.fixture
def heeded_hangup():
    """Let processes that a test starts heed SIGHUP, which nohup has those ignore that it starts."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("heeded_hangup")
@pytest.mark.fault("recording", "one message with a negative stamp among a hundred good ones")
def test_chosen_topics_up_to_the_end_of_the_terminal_with_a_stamp_that_is_no_time(
    tmp_path, answered
):
    path = tmp_path / "bag"
    topics = "['wrench','image_raw','indenter/pose=geometry_msgs/msg/PoseStamped']"
    with closing(Source()) as source, recording(output=path, topics=topics) as recorder:
        source.meet("wrench", "indenter/pose")
        source.send_forces(range(100))
        source.send("wrench", wrench(100, stamp_s=-5))
        source.send("wrench", wrench(101))
        for topic in ("indenter/pose", "indenter/state"):
            source.send(topic, frame(0)[topic])
        source.deliver()
        recorder.wait_for_line(" 103 messages so far")
        recorder.process.send_signal(signal.SIGHUP)
        assert recorder.exit_status() == 0, recorder.log
    assert "wrote 103 messages" in recorder.log
    assert "Traceback" not in recorder.log
    assert forces_of(path) == [float(number) for number in range(102)]
    with BagReader(path) as bag:
        assert set(bag.topics()) == {"/wrench", "/indenter/pose"}
    assert "no message came on /image_raw: name the topics" in recorder.log
    (line,) = [line for line in recorder.log.splitlines() if "no time" in line]
    assert "1 messages have a stamp that is no time (/wrench 1)" in line
    answered(line.partition("]: ")[2])


@pytest.mark.fault("recording", "the recorder is killed (SIGKILL) after a second")
def test_a_killed_recorder_leaves_what_it_wrote(tmp_path, capsys, answered):
    path = tmp_path / "bag"
    with closing(Source()) as source, recording(output=path, topics="['wrench']") as recorder:
        source.meet("wrench")
        source.send_forces(range(100))
        source.deliver()
        recorder.wait_for_line(" 100 messages so far")
        time.sleep(1.0)
        recorder.process.send_signal(signal.SIGKILL)
        recorder.exit_status()
    assert not path.exists()
    with pytest.raises(FileNotFoundError, match="partial is a recording that was not finished"):
        BagReader(path)
    again = Executable(MODULE, {"output": path})
    assert again.exit_status() == 2
    assert "not finished" in again.log
    capsys.readouterr()
    assert main(["record", "--repair", f"{path}.partial"]) == 0
    said = capsys.readouterr()
    assert f"{path}: 100 messages (/wrench 100)" in said.out
    assert forces_of(path) == [float(number) for number in range(100)]
    answered(f"{last_words(again)} (then: {said.err.strip()}: {said.out.strip()})")


@pytest.mark.fault("recording", "the disk is full")
def test_a_full_disk_keeps_what_is_written(tmp_path, answered):
    path = tmp_path / "bag"
    image = np.random.default_rng(0).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    with closing(Source()) as source, recording(output=path, topics="['image_raw']") as recorder:
        source.meet("image_raw")
        resource.prlimit(recorder.process.pid, resource.RLIMIT_FSIZE, (3 * 2**20, 3 * 2**20))
        for number in range(40):
            message = msg_adapters.encode_image(
                image, encoding="rgb8", stamp_ns=10**9 + number, frame_id="camera"
            )
            # So soon one after the other that no chunk is written before it is full.
            source.send("image_raw", message)
        assert recorder.exit_status() == 1, recorder.log

        def error():
            state = source.diagnostics.get("tactile_record: recording")
            return state is not None and state.level == msg_adapters.Level.ERROR and state.message

        reported = source.wait(error, "the error in the diagnostics")
    assert "Traceback" not in recorder.log
    with BagReader(path) as bag:
        stamps = [item.log_time_ns for item in bag.messages("/image_raw")]
    assert stamps == [10**9 + number for number in range(len(stamps))]
    # Chunks of five; two fit below the limit.
    assert len(stamps) in (10, 5)
    words = last_words(recorder)
    assert "the recording broke off: [Errno 27] File too large" in words
    assert f"{len(stamps)} are in {path}" in words
    lost = int(re.search(r"; (\d+) messages are missing", words).group(1))
    assert lost >= 5
    assert "File too large" in reported
    answered(re.sub(r"\d+ messages", "N messages", words.replace(f" {len(stamps)} are", " M are")))
