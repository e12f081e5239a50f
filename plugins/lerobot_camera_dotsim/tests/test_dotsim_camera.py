# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera through LeRobot's own registry, factory and errors."""

import threading

import numpy as np
import pytest

pytest.importorskip("lerobot.cameras", reason="needs pip install lerobot")

from lerobot.cameras.configs import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_camera_dotsim import DotsimCamera, DotsimCameraConfig

from dotsim_ros import Pose


def test_lerobot_finds_and_makes_the_camera():
    register_third_party_plugins()
    assert CameraConfig.get_choice_class("dotsim") is DotsimCameraConfig
    config = CameraConfig.get_choice_class("dotsim")(sensor="gelsight_mini")
    camera = make_cameras_from_configs({"finger": config})["finger"]
    assert type(camera) is DotsimCamera
    assert {each["id"] for each in DotsimCamera.find_cameras()} >= {"digit", "gelsight_mini"}


def test_frames_follow_the_pose_and_are_read_as_of_any_camera():
    depth_m = [-1e-3]
    colours = {
        mode: DotsimCamera(
            DotsimCameraConfig(sensor="gelsight_mini", color_mode=mode),
            pose_source=lambda _: Pose.above_apex(depth_m=depth_m[0]),
        )
        for mode in ("rgb", "bgr")
    }
    camera = colours["rgb"]
    for call in (camera.read, camera.async_read, camera.read_latest, camera.disconnect):
        with pytest.raises(DeviceNotConnectedError):
            call()
    with camera:
        assert camera.is_connected
        with pytest.raises(DeviceAlreadyConnectedError):
            camera.connect()
        assert camera.fps == 25
        idle = camera.async_read(timeout_ms=10_000)
        assert idle.shape == (camera.height, camera.width, 3)
        assert idle.dtype == np.uint8
        with pytest.raises(TimeoutError):
            camera.async_read(timeout_ms=0)
        assert camera.read_latest(max_age_ms=10_000).shape == idle.shape
        depth_m[0] = 1e-3
        camera.read()
        pressed = camera.read()
        assert np.abs(pressed.astype(int) - idle).max() > 20
        with colours["bgr"] as other:
            other.read()
            difference = other.read()[..., ::-1].astype(int) - pressed
        # Of the noise of two frames alone.
        assert np.abs(difference).mean() < 3.0
        threads = threading.active_count()
    assert not camera.is_connected
    assert threading.active_count() < threads
    camera.connect()
    camera.disconnect()


def test_what_cannot_be_opened_is_said(tmp_path):
    with pytest.raises(ConnectionError, match="no sensor is named 'digitt'"):
        DotsimCamera(DotsimCameraConfig(sensor="digitt")).connect()
    with pytest.raises(ConnectionError, match="no bag at"):
        DotsimCamera(DotsimCameraConfig(sensor="digit", bag=str(tmp_path / "none"))).connect()
    with pytest.raises(RuntimeError, match="expected the sensor's"):
        DotsimCamera(DotsimCameraConfig(sensor="digit", width=99_999, height=480)).connect()
    with pytest.raises(ValueError, match="press_period_s"):
        DotsimCameraConfig(press_period_s=0.0)
    failing = DotsimCamera(DotsimCameraConfig(sensor="digit"), pose_source=lambda _: 1 / 0)
    with pytest.raises(ConnectionError, match="division by zero"):
        failing.connect()
    assert not failing.is_connected
