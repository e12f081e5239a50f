# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a simulated tactile camera is, in LeRobot's registry as the type `dotsim`."""

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig, ColorMode


@CameraConfig.register_subclass("dotsim")
@dataclass(kw_only=True)
class DotsimCameraConfig(CameraConfig):
    """A sensor that a press moves, or an image topic.

    Attributes:
        sensor, indenter: names or files, as for `dotsim_ros.TactileSensor.load`.
        press_depth_m: deepest, below the apex.
        press_period_s: from press to press.
        bag: path of a bag whose poses move the indenter instead, again and again.
        topic: of an Image or, with the ending `/compressed`, a CompressedImage that is shown
            instead; the sensor is not simulated then.
        color_mode: order of the channels.

    Raises:
        ValueError: a period that is not positive, a depth that is negative, or bag and topic.
    """

    sensor: str = "densetact2"
    indenter: str = "sphere_4mm"
    press_depth_m: float = 1e-3
    press_period_s: float = 2.0
    bag: str = ""
    topic: str = ""
    color_mode: ColorMode = ColorMode.RGB

    def __post_init__(self) -> None:
        self.color_mode = ColorMode(self.color_mode)
        if not self.press_period_s > 0.0:
            raise ValueError(f"press_period_s is {self.press_period_s}, expected more than 0")
        if not self.press_depth_m >= 0.0:
            raise ValueError(f"press_depth_m is {self.press_depth_m}, expected at least 0")
        if self.bag and self.topic:
            raise ValueError("bag and topic are both given, expected one: poses or images")
