# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The gel's wrench as the external force on a simulator's links: on the one that presses, and its
opposite on the one that carries the sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

import msg_adapters
from dotsim_ros.geometry.pose import Pose, Wrench, compose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters

WRENCH_QOS = QoSProfile(depth=5)
ENTITY_WRENCH = "ros_gz_interfaces/msg/EntityWrench"
LOG_EVERY_S = 5.0


class ExternalWrenches:
    """Publishes a frame's wrench on each link, where it has subscribers.

    Args:
        node: owns the publishers.
        parameters: names of frames and of Gazebo's links.
        world_rotation: returns the (3, 3) rotation from the base to Gazebo's world, or None where
            it is not known yet.
    """

    def __init__(
        self,
        node: WorkingNode,
        parameters: TactileSimParameters,
        *,
        world_rotation: Callable[[], FloatArray | None],
    ) -> None:
        self._node, self._world_rotation = node, world_rotation
        self._frames, self._links = parameters.frames, parameters.links
        self._indenter = node.open_publisher(WrenchStamped, "external_wrench/indenter", WRENCH_QOS)
        self._sensor = node.open_publisher(WrenchStamped, "external_wrench/sensor", WRENCH_QOS)
        self._entity: Publisher | None = None
        if self._links.entity_indenter or self._links.entity_sensor:
            self._entity = node.open_publisher(
                msg_adapters.message_class(ENTITY_WRENCH), "entity_wrench", WRENCH_QOS
            )

    def publish(self, wrench: Wrench, pose: Pose | None, stamp_ns: int) -> None:
        """Publish a frame's wrench.

        Args:
            wrench: of the gel on the indenter, base frame.
            pose: of the indenter in the base frame; None where there is none, and no force on it.
            stamp_ns: of the frame.
        """
        if self._sensor.get_subscription_count() > 0:
            self._send(self._sensor, wrench.opposite(), stamp_ns, self._frames.base_frame)
        if pose is not None and self._indenter.get_subscription_count() > 0:
            self._send(
                self._indenter, wrench.seen_from(pose), stamp_ns, self._frames.indenter_frame
            )
        if self._entity is not None and self._entity.get_subscription_count() > 0:
            self._publish_entities(self._entity, wrench, pose, stamp_ns)

    @staticmethod
    def _send(publisher: Publisher, wrench: Wrench, stamp_ns: int, frame_id: str) -> None:
        publisher.publish(
            msg_adapters.encode_wrench_stamped(
                wrench.force_n, wrench.torque_nm, stamp_ns=stamp_ns, frame_id=frame_id
            )
        )

    def _publish_entities(
        self, publisher: Publisher, wrench: Wrench, pose: Pose | None, stamp_ns: int
    ) -> None:
        rotation = self._world_rotation()
        if rotation is None:
            self._node.get_logger().warning(
                f"/tf does not place {self._frames.base_frame!r} (base_frame) in "
                f"{self._frames.world_frame!r} (world_frame): nothing on entity_wrench",
                throttle_duration_sec=LOG_EVERY_S,
            )
            return
        for link, on_link, centre in self._loads(wrench, pose):
            at_centre = on_link.seen_from(Pose(centre))
            publisher.publish(
                msg_adapters.encode_entity_wrench(
                    rotation @ at_centre.force_n,
                    rotation @ at_centre.torque_nm,
                    link=link,
                    stamp_ns=stamp_ns,
                    frame_id=self._frames.world_frame or self._frames.base_frame,
                )
            )

    def _loads(self, wrench: Wrench, pose: Pose | None) -> Iterator[tuple[str, Wrench, FloatArray]]:
        """Yield each link of Gazebo's, the wrench on it, and its centre of mass, base frame."""
        known = self._links
        if known.entity_indenter and pose is not None:
            at = Pose(np.array(known.entity_indenter_centre_m))
            yield known.entity_indenter, wrench, compose(pose, at).position_m
        if known.entity_sensor:
            yield known.entity_sensor, wrench.opposite(), np.array(known.entity_sensor_centre_m)
