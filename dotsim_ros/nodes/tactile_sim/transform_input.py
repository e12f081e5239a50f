# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the indenter is in the sensor's base, from /tf and /tf_static.

tf2_ros is not needed: it tells nobody when a transform comes, while the sensor has to make a frame
of each. Its messages are, from the package tf2_msgs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Lock

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile

import msg_adapters
from dotsim_ros.geometry.frame_tree import FrameTree, OutOfOrderError
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.nodes.common.ingest import Fault, RefusedInputError
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters

TRANSFORMS = "tf2_msgs/msg/TFMessage"
# As tf2_ros listens: a message holds some of the frames, so that the newest alone is not enough.
REALTIME_QOS = QoSProfile(depth=100)
LOCKSTEP_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL)
STATIC_QOS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class TransformInput:
    """Follows two frames of TF.

    Args:
        node: owns the subscriptions.
        parameters: names of the frames, and clock.
        guard: does something with an input, and counts and logs it where it is refused.
        check_time: refuses a stamp (ns) of the time before the clock went back.
        on_pose: takes the pose of the indenter in the base frame at each new time (ns).
    """

    def __init__(
        self,
        node: WorkingNode,
        parameters: TactileSimParameters,
        *,
        guard: Callable[[Callable[[], object]], None],
        check_time: Callable[[int], None],
        on_pose: Callable[[Pose, int], None],
    ) -> None:
        self._guard, self._check_time, self._on_pose = guard, check_time, on_pose
        self._pair = (parameters.frames.base_frame, parameters.frames.indenter_frame)
        self._world = (parameters.frames.world_frame, parameters.frames.base_frame)
        pairs = [self._pair, self._world] if parameters.frames.world_frame else [self._pair]
        self._lock = Lock()
        self._tree = FrameTree(pairs, maximum_step_s=parameters.motion.maximum_step_s)
        self._last_ns: int | None = None
        quality = REALTIME_QOS if parameters.time.is_realtime else LOCKSTEP_QOS
        self._subscribe(node, "/tf", quality, False)
        self._subscribe(node, "/tf_static", STATIC_QOS, True)

    def configure(self, parameters: TactileSimParameters) -> None:
        """Take changed limits."""
        with self._lock:
            self._tree.maximum_step_s = parameters.motion.maximum_step_s

    def forget(self) -> None:
        """Pass on the pose that is known as soon as the next transform comes."""
        self._last_ns = None

    def restart(self) -> None:
        """Forget all that moves, since time begins again; what is static stays."""
        with self._lock:
            self._tree.forget_motion()
        self.forget()

    def missing(self) -> str:
        """Return why there is no pose of the indenter, in words; empty where there is one."""
        with self._lock:
            why = self._tree.missing(*self._pair)
        if not why:
            return ""
        base, indenter = self._pair
        return (
            f"/tf and /tf_static do not place {indenter!r} (indenter_frame) in {base!r} "
            f"(base_frame): {why}"
        )

    def world_rotation(self) -> FloatArray | None:
        """Return the (3, 3) rotation from the base to the world; None where TF does not have it."""
        with self._lock:
            found = self._tree.locate(*self._world)
        return None if found is None else found[0].rotation()

    def _subscribe(self, node: WorkingNode, topic: str, quality: QoSProfile, static: bool) -> None:
        node.open_subscription(
            msg_adapters.message_class(TRANSFORMS),
            topic,
            lambda message: self._hear(message, is_static=static),
            quality,
        )

    def _hear(self, message: msg_adapters.Message, *, is_static: bool) -> None:
        for transform in message.transforms:
            # One that is refused takes no other with it.
            self._guard(partial(self._put, transform, is_static))
        self._guard(self.pass_on)

    def _put(self, transform: msg_adapters.Message, is_static: bool) -> None:
        stamp_ns = msg_adapters.message_stamp_ns(transform)
        if not is_static:
            self._check_time(stamp_ns)
        try:
            with self._lock:
                self._tree.put(
                    transform.header.frame_id,
                    transform.child_frame_id,
                    stamp_ns,
                    lambda: Pose(*msg_adapters.decode_transform(transform)),
                    is_static=is_static,
                )
        except OutOfOrderError as error:
            raise RefusedInputError(Fault.ORDER, str(error)) from None

    def pass_on(self) -> None:
        """Pass on the pose of the indenter, where it is known and new."""
        with self._lock:
            found = self._tree.locate(*self._pair)
        if found is not None and found[1] != self._last_ns:
            self._last_ns = found[1]
            self._on_pose(*found)
