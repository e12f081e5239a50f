# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A running `tactile_sim`, or a real sensor's driver, in the viewer of rerun."""

from __future__ import annotations

from functools import partial

from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, PointCloud2

from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.view.rerun_log import RerunLog

QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
TOPICS = {
    "image": (Image, "image_raw"),
    "depth": (Image, "depth/image"),
    "points": (PointCloud2, "points"),
    "wrench": (WrenchStamped, "wrench"),
    "pose": (PoseStamped, "indenter/state"),
}


class RerunView(WorkingNode):
    """Puts what a node publishes into a recording of rerun.

    Args:
        log: takes each message.
    """

    def __init__(self, log: RerunLog) -> None:
        super().__init__("rerun_view")
        for name, (kind, topic) in TOPICS.items():
            self.open_subscription(kind, topic, partial(log.log, name), QOS)
