# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The recorder's queue and thread, without ROS."""

import os
import resource
import shutil
import struct
import subprocess
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import msg_adapters
from dotsim_ros.data.bag import (
    BAG_TYPES,
    TYPESTORE,
    BagFile,
    BagReader,
    unfinished_path,
)
from dotsim_ros.data.trajectory import Topics, read_trajectory
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.live.moments import SkinMoment
from dotsim_ros.live.recorder import PressRecorder
from dotsim_ros.nodes.tactile_record.recording import BagRecording

WRENCH = "geometry_msgs/msg/WrenchStamped"
IMAGE = "sensor_msgs/msg/Image"
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


def image(index):
    pixels = np.random.default_rng(index).integers(0, 256, (160, 200, 3), dtype=np.uint8)
    message = msg_adapters.encode_image(
        pixels, encoding="rgb8", stamp_ns=10**9 + index, frame_id="camera", types=BAG_TYPES
    )
    return bytes(TYPESTORE.serialize_cdr(message, IMAGE))


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
    assert (summary.written, summary.missing, summary.error) == ({TOPIC: 200}, 0, None)
    wrench = read_trajectory(tmp_path / "bag").wrench
    assert np.array_equal(wrench.force_n[:, 0], np.arange(200))


def forces(path):
    with BagReader(path) as bag:
        return [item.message().wrench.force.x for item in bag.messages(TOPIC)]


def with_stamp(index, seconds, nanoseconds=0):
    message = serialized(index)
    return message[:4] + struct.pack("<iI", seconds, nanoseconds) + message[12:]


def recorded(path, messages, **options):
    recording = BagRecording(path, {TOPIC: WRENCH}, queue_bytes=2**26, **options)
    for message in messages:
        recording.put(TOPIC, message)
    return recording.close()


def test_stamps_that_go_back_are_counted_since_times_then_lie_mixed_in_the_bag(tmp_path):
    # A little out of order is no new time.
    messages = [with_stamp(0, 5), with_stamp(1, 4, 950_000_000), with_stamp(2, 5, 500_000_000)]
    assert recorded(tmp_path / "one", messages).went_back == {}
    messages += [with_stamp(3, 0, 80_000_000), with_stamp(4, 0, 160_000_000)]
    summary = recorded(tmp_path / "two", messages)
    assert (summary.went_back, summary.written) == ({TOPIC: 1}, {TOPIC: 5})


@pytest.mark.parametrize("stamp", [(-5, 0), (3, 10**9)])
def test_stamp_that_is_no_time_takes_the_place_where_it_came(tmp_path, stamp):
    messages = [*map(serialized, range(100)), with_stamp(100, *stamp), serialized(101)]
    summary = recorded(tmp_path / "bag", messages)
    assert (summary.written, summary.missing, summary.error) == ({TOPIC: 102}, 0, None)
    assert summary.stamp_is_no_time == {TOPIC: 1}
    assert forces(tmp_path / "bag") == list(range(102))
    with BagReader(tmp_path / "bag") as bag:
        times = [message.log_time_ns for message in bag.messages(TOPIC)]
    assert times[100] == times[99]


def test_message_too_short_for_a_header_is_refused_and_counted(tmp_path):
    summary = recorded(tmp_path / "bag", [serialized(0), b"short", b"", serialized(1)])
    assert (summary.written, summary.refused, summary.error) == ({TOPIC: 2}, {TOPIC: 2}, None)
    assert summary.missing == 2
    assert forces(tmp_path / "bag") == [0, 1]


def test_what_is_written_before_a_fault_is_a_bag(tmp_path, monkeypatch):
    write = BagFile.write_serialized

    def fail(bag, topic, log_time_ns, message):
        if log_time_ns == 10**9 + 60:
            raise RuntimeError("unforeseen")
        write(bag, topic, log_time_ns, message)

    monkeypatch.setattr(BagFile, "write_serialized", fail)
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=2**20)
    taken = sum(recording.put(TOPIC, serialized(index)) for index in range(100))
    summary = recording.close()
    assert summary.error == "RuntimeError: unforeseen"
    assert (summary.written, summary.folder) == ({TOPIC: 60}, tmp_path / "bag")
    assert summary.lost == {TOPIC: taken - 60}
    assert summary.missing == 40
    assert forces(tmp_path / "bag") == list(range(60))
    assert not recording.put(TOPIC, serialized(1))


@contextmanager
def files_up_to(length):
    """Let no file of this process grow beyond a length, as a full disk would."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (length, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("length", [200_000, 1_500_000])
def test_full_disk_keeps_every_message_that_was_written(tmp_path, length):
    topics = {TOPIC: WRENCH, "/image_raw": IMAGE}
    with files_up_to(length):
        recording = BagRecording(tmp_path / "bag", topics, queue_bytes=2**26)
        for index in range(60):
            recording.put(TOPIC, serialized(index))
            recording.put("/image_raw", image(index))
        summary = recording.close()
    count = sum(summary.written.values())
    assert "File too large" in summary.error
    assert count + summary.missing == 120
    if length == 200_000:
        assert (count, list(tmp_path.iterdir())) == (0, [])
        return
    assert count > 0
    assert summary.folder == tmp_path / "bag"
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
    # An independent reader, checksums and all.
    with AnyReader([tmp_path / "bag"]) as bag:
        found = [(item.topic, time_ns) for item, time_ns, _ in bag.messages()]
    assert len(found) == count
    assert [time_ns for topic, time_ns in found if topic == TOPIC] == [
        10**9 + index for index in range(summary.written[TOPIC])
    ]


def test_disk_that_is_really_full(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(disk)], capture_output=True
    )
    if mounted.returncode != 0:
        pytest.skip("no disk can be mounted here")
    try:
        recording = BagRecording(disk / "bag", {"/image_raw": IMAGE}, queue_bytes=2**26)
        for index in range(60):
            recording.put("/image_raw", image(index))
        summary = recording.close()
        assert "No space left on device" in summary.error
        count = summary.written["/image_raw"]
        assert count > 20
        assert count + summary.missing == 60
        with BagReader(disk / "bag") as bag:
            assert len(list(bag.messages("/image_raw"))) == count
        assert os.listdir(disk) == ["bag"]
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def wait_until_written(recording, count):
    end_s = time.monotonic() + 20.0
    while sum(recording.summary().written.values()) < count:
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.mark.parametrize("done", ["removed", "cut"])
def test_file_that_somebody_spoils_is_noticed(tmp_path, done):
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=2**20)
    for index in range(10):
        recording.put(TOPIC, serialized(index))
    wait_until_written(recording, 10)
    unfinished = unfinished_path(tmp_path / "bag")
    if done == "removed":
        shutil.rmtree(unfinished)
    else:
        os.truncate(unfinished / "bag.mcap", 100)
    recording.put(TOPIC, serialized(10))
    summary = recording.close()
    assert summary.error == f"the file was {done} while it was written"
    assert not (tmp_path / "bag").exists()
    assert summary.missing == (11 if done == "removed" else 1)


def test_name_that_was_taken_meanwhile_costs_nothing(tmp_path):
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=2**20)
    recording.put(TOPIC, serialized(0))
    (tmp_path / "bag").mkdir()
    summary = recording.close()
    assert "exists by now" in summary.error
    assert (summary.folder, summary.missing) == (unfinished_path(tmp_path / "bag"), 0)
    assert forces(summary.folder) == [0]
    assert os.listdir(tmp_path / "bag") == []


def test_what_cannot_be_recorded_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="not known"):
        BagRecording(tmp_path / "bag", {TOPIC: "no_msgs/msg/Such"}, queue_bytes=1)
    assert list(tmp_path.iterdir()) == []
    recording = BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=10)
    assert not recording.put(TOPIC, serialized(0))
    assert recording.close().dropped == {TOPIC: 1}
    assert list(tmp_path.iterdir()) == []
    unfinished_path(tmp_path / "bag").mkdir()
    with pytest.raises(FileExistsError, match="not finished"):
        BagRecording(tmp_path / "bag", {TOPIC: WRENCH}, queue_bytes=1)


def test_a_bag_of_the_page_holds_the_pose_that_the_skin_shows(tmp_path):
    rest_m, tip_m = np.zeros((3, 3)), np.array([0.001, 0.0, 0.015])
    recorder = PressRecorder(tmp_path / "bag", rest_m, "sphere_4mm")
    recorder.add_skin(SkinMoment(10**9, rest_m, np.zeros(3), np.zeros(3), Pose(tip_m)))
    recorder.finish()
    state = read_trajectory(
        tmp_path / "bag", topics=Topics(pose="/indenter/state"), channels=["pose"]
    ).pose
    assert state.stamp_ns.tolist() == [10**9]
    assert state.position_m.tolist() == [tip_m.tolist()]
