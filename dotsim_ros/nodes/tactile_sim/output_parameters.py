# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `tactile_sim` that say under what names and in what form it publishes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from dotsim_ros.nodes.common.options import check_options, option
from dotsim_ros.nodes.tactile_sim.framing import KEEP, STRETCH

AXIAL, RANGE = "z", "range"
TOPIC = "_topic"


@dataclass(frozen=True)
class OutputParameters:
    """Names and forms of what is published; each field says what it is.

    Raises:
        ValueError: a value out of its range, a topic without a name, or limits in disorder.
    """

    image_topic: str = option(
        "image_raw",
        "Topic of the images; compressed ones are published on its name with /compressed.",
        fixed_while_configured=True,
    )
    camera_info_topic: str = option(
        "",
        "Topic of the intrinsics; empty: camera_info next to the images.",
        fixed_while_configured=True,
    )
    camera_info_url: str = option(
        "",
        "Calibration that camera_info shows in place of the simulated camera's own, and that "
        "set_camera_info writes: file:///PATH.yaml or package://PACKAGE/PATH.yaml.",
        read_only=True,
    )
    wrench_topic: str = option("wrench", "Topic of the wrench.", fixed_while_configured=True)
    difference_topic: str = option(
        "image_diff",
        "Topic of the images' difference to the reference, and with /compressed of the same as "
        "JPEG or PNG.",
        fixed_while_configured=True,
    )
    reference_topic: str = option(
        "reset_dt",
        "Topic of std_msgs/Bool that makes what is seen now the reference.",
        fixed_while_configured=True,
    )
    radius_topic: str = option(
        "depth/radius",
        "Topic of the skin's distance from the centre of the dome in 8 bits.",
        fixed_while_configured=True,
    )
    radius_shown_topic: str = option(
        "depth/radius_shown", "Topic of the same as a grey rgb8 image.", fixed_while_configured=True
    )
    image_aspect: str = option(
        KEEP,
        "Whether an image_size_px of another aspect ratio than the part's is refused (keep), or "
        "the image squeezed to it (stretch).",
        choices=(KEEP, STRETCH),
    )
    difference_gain: float = option(
        8.0, "What differences are multiplied by.", minimum=1.0, maximum=255.0
    )
    depth_convention: str = option(
        AXIAL,
        "What depth/image holds: z, the depth along the optical axis as in REP 118; or range, the "
        "distance along the ray, which a fisheye has beyond 90 degrees, too.",
        choices=(AXIAL, RANGE),
    )
    radius_limits_m: tuple[float, float] = option(
        (0.01223, 0.01688),
        "Radii that the values 0 and 256 of the 8-bit image stand for.",
        minimum=0.0,
        maximum=1.0,
    )
    frame_prefix: str = option(
        "",
        "Put before base_frame, optical_frame and indenter_frame, such as left_ for one of two "
        "sensors.",
        fixed_while_configured=True,
    )

    def __post_init__(self) -> None:
        check_options(self)
        for field in dataclasses.fields(self):
            # Empty is what its default means.
            needs_name = field.name.endswith(TOPIC) and field.default
            if needs_name and not getattr(self, field.name):
                raise ValueError(f"{field.name} is empty, expected the name of a topic")
        if len(self.radius_limits_m) != 2 or self.radius_limits_m[0] >= self.radius_limits_m[1]:
            raise ValueError(
                f"radius_limits_m is {list(self.radius_limits_m)}, expected two radii, the smaller "
                "one first"
            )
