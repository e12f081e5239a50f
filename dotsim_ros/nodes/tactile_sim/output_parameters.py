# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of `tactile_sim` that say under what names and in what form it publishes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import CONFIGURED, FREE, READ_ONLY
from dotsim_ros.nodes.tactile_sim.framing import KEEP, STRETCH

AXIAL, RANGE = "z", "range"
TOPIC = "_topic"


@dataclass(frozen=True)
class OutputParameters:
    """Names and forms of what is published; each field says what it is.

    Raises:
        ValueError: a value out of its range, a topic without a name, or limits in disorder.
    """

    FIXED: ClassVar[str] = CONFIGURED

    image_topic: str = quantity(
        "image_raw",
        help="Topic of the images; compressed ones are published on its name with /compressed.",
    )
    camera_info_topic: str = quantity(
        "", help="Topic of the intrinsics; empty: camera_info next to the images."
    )
    camera_info_url: str = quantity(
        "",
        help="Calibration that camera_info shows in place of the simulated camera's own, and that "
        "set_camera_info writes: file:///PATH.yaml or package://PACKAGE/PATH.yaml.",
        fixed=READ_ONLY,
    )
    wrench_topic: str = quantity("wrench", help="Topic of the wrench.")
    difference_topic: str = quantity(
        "image_diff",
        help="Topic of the images' difference to the reference, and with /compressed of the same "
        "as JPEG or PNG.",
    )
    reference_topic: str = quantity(
        "reset_dt", help="Topic of std_msgs/Bool that makes what is seen now the reference."
    )
    radius_topic: str = quantity(
        "depth/radius", help="Topic of the skin's distance from the centre of the dome in 8 bits."
    )
    radius_shown_topic: str = quantity(
        "depth/radius_shown", help="Topic of the same as a grey rgb8 image."
    )
    image_aspect: str = quantity(
        KEEP,
        help="Whether an image_size_px of another aspect ratio than the part's is refused (keep), "
        "or the image squeezed to it (stretch).",
        choices=(KEEP, STRETCH),
        fixed=FREE,
    )
    difference_gain: float = quantity(
        8.0, help="What differences are multiplied by.", low=1.0, high=255.0, fixed=FREE
    )
    depth_convention: str = quantity(
        AXIAL,
        help="What depth/image holds: z, the depth along the optical axis as in REP 118; or range, "
        "the distance along the ray, which a fisheye has beyond 90 degrees, too.",
        choices=(AXIAL, RANGE),
        fixed=FREE,
    )
    radius_limits_m: tuple[float, float] = quantity(
        (0.01223, 0.01688),
        help="Radii that the values 0 and 256 of the 8-bit image stand for.",
        low=0.0,
        high=1.0,
        fixed=FREE,
    )
    frame_prefix: str = quantity(
        "",
        help="Put before base_frame, optical_frame and indenter_frame, such as left_ for one of "
        "two sensors.",
    )

    def __post_init__(self) -> None:
        check_fields("", self)
        for field in dataclasses.fields(self):
            # Empty is what its default means.
            needs_name = field.name.endswith(TOPIC) and field.default
            if needs_name and not getattr(self, field.name):
                raise ValueError(f"{field.name} is empty, expected the name of a topic")
        if self.radius_limits_m[0] >= self.radius_limits_m[1]:
            raise ValueError(
                f"radius_limits_m is {list(self.radius_limits_m)}, expected two radii, the smaller "
                "one first"
            )
