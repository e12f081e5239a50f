# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Images are rendered for whoever reads one, and for nobody else."""

from __future__ import annotations

from contextlib import closing

from geometry_msgs.msg import WrenchStamped
from harness import APEX_M, Client, running
from sensor_msgs.msg import CompressedImage, PointCloud2

import msg_adapters

DEPTH_M = 0.001


def is_rendered(client: Client) -> bool:
    """Whether a frame of the last minute has spent time on the camera."""
    values = client.state("frames").values
    return "depth_p95_ms" in values or "image_p95_ms" in values


def test_frames_are_rendered_once_somebody_reads_an_image_and_not_before() -> None:
    topics = {"wrench": WrenchStamped, "points": PointCloud2}
    parameters = {"diagnostics_period_s": 0.1, "grid_spacing_m": 0.0048}
    with running(parameters=parameters), closing(Client(topics=topics)) as client:
        client.meet()
        client.send((0.0, 0.0, APEX_M - DEPTH_M))

        def is_pressed() -> bool:
            wrenches = [frame.messages.get("wrench") for frame in list(client.frames.values())]
            return any(
                wrench is not None and msg_adapters.decode_wrench_stamped(wrench)[0][2] > 0.0
                for wrench in wrenches
            )

        client.wait(is_pressed, "a force")
        count = int(client.state("frames").values["frames"])
        client.wait_for_state("frames", lambda state: int(state.values["frames"]) > count + 10)
        assert not is_rendered(client)

        images = []
        topic = "image_raw/compressed"
        client.node.create_subscription(CompressedImage, topic, images.append, 5)
        client.wait(lambda: images, f"{topic} for its first reader")
        client.wait(lambda: is_rendered(client), "time spent on the camera")
