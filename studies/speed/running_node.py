# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The running `tactile_sim`, a node that observes it, and poses that are sent to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.processes import NodeProcess
from dotsim_ros.nodes.common.transport import stay_local

START_TIMEOUT_S = 300.0
"""A first start compiles kernels and computes tables."""


@contextmanager
def running_sensors(
    parameters: Mapping[str, Any] | None = None,
    *,
    namespaces: Sequence[str] = ("",),
    arguments: Sequence[str] = (),
    environment: Mapping[str, str] | None = None,
) -> Iterator[list[NodeProcess]]:
    """Run a `tactile_sim` in each namespace, from ready to the end of the block.

    Raises:
        OSError: one does not start.
    """
    stay_local()
    with ExitStack() as stack:
        processes = []
        for namespace in namespaces:
            own = ["-r", f"__ns:=/{namespace}"] if namespace else []
            process = NodeProcess(
                "tactile_sim",
                parameters or {},
                arguments=[*arguments, *own],
                environment=environment,
            )
            stack.callback(process.stop)
            processes.append(process)
        for process in processes:
            process.wait_for_line("ready:", timeout_s=START_TIMEOUT_S)
        yield processes


@contextmanager
def observing_node(name: str) -> Iterator[tuple[Node, SingleThreadedExecutor]]:
    """Make a node and the executor that spins it, until the end of the block."""
    rclpy.init()
    try:
        node = rclpy.create_node(name)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        yield node, executor
        node.destroy_node()
    finally:
        rclpy.try_shutdown()


class PosePublisher:
    """Sends poses of the indenter to a sensor.

    Args:
        node: that sends them.
        namespace: of the sensor.
        quality: of the topic: a QoS profile or the depth of its queue.
    """

    def __init__(self, node: Node, *, namespace: str = "", quality: QoSProfile | int = 1) -> None:
        self._node = node
        self._frame_id = f"{namespace}_densetact_base".lstrip("_")
        topic = f"{namespace}/indenter/pose".lstrip("/")
        self._publisher = node.create_publisher(PoseStamped, topic, quality)

    def has_reader(self) -> bool:
        """Return whether the poses are subscribed to."""
        return bool(self._publisher.get_subscription_count() > 0)

    def send(self, pose: Pose) -> int:
        """Send a pose, and return its stamp in nanoseconds."""
        stamp_ns: int = self._node.get_clock().now().nanoseconds
        message = msg_adapters.encode_pose_stamped(
            pose.position_m, pose.quaternion_xyzw, stamp_ns=stamp_ns, frame_id=self._frame_id
        )
        self._publisher.publish(message)
        return stamp_ns
