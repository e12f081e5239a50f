"""The recorder's queue and thread, without ROS."""

import threading

import numpy as np
import pytest

import msg_adapters
from dotsim_ros.measured.bag import BAG_TYPES, TYPESTORE, BagReader, serialized_stamp_ns
from dotsim_ros.measured.trajectory import Topics, read_trajectory
from dotsim_ros.nodes.tactile_record.recording import BagRecording

WRENCH = "geometry_msgs/msg/WrenchStamped"
TOPIC = Topics().wrench


def serialized(index):
    message = msg_adapters.encode_wrench_stamped(
        (float(index), 0.0, 0.0),
        (0.0, 0.0, 0.0),
        stamp_ns=10**9 + index,
        frame_id="base",
        types=BAG_TYPES,
    )
    return bytes(TYPESTORE.serialize_cdr(message, WRENCH))


def test_everything_put_is_written(tmp_path):
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=2**20)
    threads = [
        threading.Thread(
            target=lambda part=part: [recording.put(TOPIC, serialized(i)) for i in part]
        )
        for part in (range(0, 200, 2), range(1, 200, 2))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not (tmp_path / "bag").exists()
    summary = recording.close()
    assert (summary.written, summary.dropped, summary.error) == ({TOPIC: 200}, {}, None)
    wrench = read_trajectory(tmp_path / "bag").wrench
    assert np.array_equal(wrench.force_n[:, 0], np.arange(200))


def test_log_times_are_those_of_the_headers(tmp_path):
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=2**20)
    recording.put(TOPIC, serialized(7))
    recording.close()
    with BagReader(tmp_path / "bag") as bag:
        assert [message.log_time_ns for message in bag.messages(TOPIC)] == [10**9 + 7]


def test_what_finds_the_queue_full_is_counted(tmp_path):
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=10)
    assert not recording.put(TOPIC, serialized(0))
    summary = recording.close()
    assert summary.dropped == {TOPIC: 1}
    assert list(tmp_path.iterdir()) == []


def test_failure_ends_the_recording_and_leaves_nothing(tmp_path):
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=2**20)
    recording.put(TOPIC, serialized(0))
    recording.put(TOPIC, b"short")
    summary = recording.close()
    assert "holds no header" in summary.error
    assert summary.written == {}
    assert summary.dropped == {TOPIC: 2}
    assert not recording.put(TOPIC, serialized(1))
    assert list(tmp_path.iterdir()) == []


def test_existing_path_is_refused(tmp_path):
    (tmp_path / "bag").mkdir()
    with pytest.raises(FileExistsError):
        BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=1)


def test_stamp_of_big_endian_message():
    assert serialized_stamp_ns(b"\0\0\0\0" + b"\0\0\0\2" + b"\0\0\0\3") == 2 * 10**9 + 3
