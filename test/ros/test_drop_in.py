# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Programs that were written for public drivers of DenseTact sensors read the simulated one.

studies/speed/drop_in.py holds the programs, and says what they find wrong.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest
from harness import Watcher, running
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo

import msg_adapters
from dotsim_ros.nodes.tactile_sim.camera_calibration import read_calibration
from studies.run import FAILED
from studies.speed.drop_in import drop_in

SIDES = {"dual_difference": (20, 22), "dual_raw": (8, 10)}


def read(interface: str, seconds: float) -> dict[str, dict[str, object]]:
    """Run the reader of an interface; return what it got, by topic."""
    figures = drop_in(seconds=seconds, interfaces=(interface,))
    assert figures[FAILED] == []
    topics: dict[str, dict[str, object]] = figures["interfaces"][interface]["topics"]
    assert all(row["messages"] > 5 for row in topics.values()), topics
    return topics


def test_the_reader_of_the_ros_1_driver_gets_its_topics() -> None:
    topics = read("run_camera", 2.5)
    assert {topic: row["form"] for topic, row in topics.items()} == {
        "/RunCamera/image_raw_1": "bgr8",
        "/RunCamera/camera_info": "equidistant",
        "/RunCamera/force": "wrench",
        "/RunCamera/imgDepth": "8UC1",
        "/RunCamera/imgDepth_show": "rgb8",
    }
    sizes = {(row["width"], row["height"]) for row in topics.values() if "width" in row}
    assert sizes == {(640, 640)}


# A new reference is asked for in the second half, while the indenter is held; the next hold comes
# 2 s later: 8 s show all states, whatever the phase.
@pytest.mark.parametrize(
    ("interface", "seconds", "form"),
    [("dual_difference", 9.0, "jpeg"), ("dual_raw", 3.0, "bgr8")],
)
def test_the_readers_of_the_driver_of_two_get_both(
    interface: str, seconds: float, form: str
) -> None:
    topics = read(interface, seconds)
    for topic, row in topics.items():
        (number,) = [each for each in SIDES[interface] if f"_{each}" in topic]
        assert row["frame_id"] == f"camera_{number}_frame"
        assert (row["form"], row["width"], row["height"]) == (form, 320, 180)
    assert len(topics) == (4 if interface == "dual_difference" else 2)


def test_what_belongs_to_an_image_goes_along_with_its_remap_and_a_rival_is_told_of(
    tmp_path: Path,
) -> None:
    remaps = ["-r", "image_raw:=/RunCamera/image_raw_1", "-r", "camera_info:=/mine/info"]
    kept = tmp_path / "kept" / "camera.yaml"
    prefixed = {
        "frame_prefix": "left_",
        "diagnostics_period_s": 0.1,
        "camera_info_url": f"file://{kept}",
    }
    with (
        running(parameters=prefixed, arguments=["-r", "__ns:=/left", *remaps]) as node,
        closing(Watcher("client")) as client,
    ):
        states = client.diagnostics
        name = "left/tactile_sim: frames"
        client.wait(lambda: name in states, "the sensor's diagnostics")
        assert states[name].hardware_id == "left/densetact2"
        topics = dict(client.node.get_topic_names_and_types())
        expected = {"/RunCamera/image_raw_1", "/RunCamera/image_raw_1/compressed", "/mine/info"}
        assert expected <= set(topics)
        assert not {"/left/camera_info", "/RunCamera/camera_info"} & set(topics)

        images: list[Image] = []
        client.node.create_subscription(Image, "/RunCamera/image_raw_1", images.append, 5)
        client.wait(lambda: images, "an image")
        assert images[-1].header.frame_id == "left_densetact_optical_frame"

        rival = client.node.create_publisher(Image, "/RunCamera/image_raw_1", 5)
        crowd = "/RunCamera/image_raw_1 has 2 publishers (/client, /left/tactile_sim)"
        client.wait(lambda: states[name].message.startswith(crowd), "a warning")
        assert states[name].level is msg_adapters.Level.WARN
        assert "give each a namespace" in states[name].message
        client.node.destroy_publisher(rival)
        client.wait(lambda: "publishers" not in states[name].message, "its end")
        infos: list[CameraInfo] = []
        client.node.create_subscription(CameraInfo, "/mine/info", infos.append, 5)
        client.wait(lambda: infos, "intrinsics")
        given = infos[-1]
        given.k[0], given.distortion_model = 123.0, "plumb_bob"
        service = "/left/set_camera_info"
        answer = client.call(SetCameraInfo, service, camera_info=given)
        assert answer.success, answer.status_message
        assert read_calibration(kept).camera_matrix[0, 0] == 123.0
        client.wait(lambda: infos[-1].k[0] == 123.0, "the calibration")
        given.width = 320
        answer = client.call(SetCameraInfo, service, camera_info=given)
        assert not answer.success
        assert "of 320 x 480 pixels, the images have 640 x 480" in answer.status_message
        assert read_calibration(kept).width == 640
        count = len(images)
        client.wait(lambda: len(images) > count, "frames that go on")
        assert node.interrupt() == 0
