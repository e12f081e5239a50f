# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The subscription of the forces that the indenter's depth follows: see `force_drive`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.tactile_sim.force_pairing import ForcePairing, checked_force
from dotsim_ros.nodes.tactile_sim.motion import MotionOrder
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters

TOPIC = "indenter/wrench"
"""As a measured data set names the force of the gel on the indenter."""


class ForceInput:
    """Receives forces, and says which one holds.

    In real time that is the newest. In lockstep a pose waits for the force of its time, see
    `ForcePairing`.

    Args:
        node: owns the subscription.
        parameters: frames, clock and limits.
        quality: of the subscription: that of the poses.
        guard: does something with an input, and counts and logs it where it is refused.
        check_time: refuses a stamp (ns) of the time before the clock went back.
        on_motion: takes each motion of lockstep, once its force is known.
    """

    def __init__(
        self,
        node: WorkingNode,
        parameters: TactileSimParameters,
        quality: QoSProfile,
        *,
        guard: Callable[[Callable[[], object]], None],
        check_time: Callable[[int], None],
        on_motion: Callable[[MotionOrder], None],
    ) -> None:
        self._node, self._parameters = node, parameters
        self._guard, self._check_time, self._on_motion = guard, check_time, on_motion
        self._is_realtime = parameters.time.is_realtime
        self._pairing = ForcePairing(maximum_step_s=parameters.motion.maximum_step_s)
        self._heard_s: float | None = None
        node.open_subscription(
            WrenchStamped, TOPIC, lambda message: guard(lambda: self._hear(message)), quality
        )

    def configure(self, parameters: TactileSimParameters) -> None:
        """Take changed limits."""
        self._parameters = parameters
        self._pairing.maximum_step_s = parameters.motion.maximum_step_s

    def forget(self) -> None:
        """Begin again: no force is known, and no pose waits for one."""
        self._heard_s = None
        self._pairing.forget()

    def normal_n(self, pose: Pose) -> float:
        """Return the normal force that holds for an indenter at a pose; one that pulls is refused,
        and the one before holds."""
        self._guard(lambda: self._pairing.weigh(pose))
        return self._pairing.normal_n

    def missing(self) -> str:
        """Return which force has not come, in words; empty where none is due."""
        waiting = self._pairing.waiting()
        if waiting is not None:
            return (
                f"{waiting[0]} poses wait for a force on {TOPIC} stamped {waiting[1]} ns or later: "
                "in lockstep each frame needs a pose and the force of its time"
            )
        if not self._is_realtime:
            return ""
        if self._heard_s is None:
            return f"no force on {TOPIC} so far: the indenter stays clear of the skin"
        silence_s = self._node.now_s() - self._heard_s
        if silence_s <= self._parameters.motion.input_timeout_s:
            return ""
        return f"no force on {TOPIC} for {silence_s:.1f} s: the last one holds"

    def hold(self, motion: MotionOrder) -> None:
        """Take a motion of lockstep, and pass on those whose force is known.

        Raises:
            RefusedInputError: too many wait for a force already.
        """
        self._pairing.put_motion(motion)
        self._pass_on()

    def _hear(self, message: WrenchStamped) -> None:
        force_n, _ = msg_adapters.decode_wrench_stamped(message)
        stamp_ns = msg_adapters.message_stamp_ns(message)
        if stamp_ns == 0 and self._is_realtime:
            stamp_ns = self._pairing.stamp_of_now(self._node.time_ns())
        self._check_time(stamp_ns)
        self._pairing.put_force(
            checked_force(
                force_n,
                stamp_ns,
                message.header.frame_id,
                base_frame=self._parameters.frames.base_frame,
                indenter_frame=self._parameters.frames.indenter_frame,
            )
        )
        self._heard_s = self._node.now_s()
        if self._is_realtime:
            self._pairing.take_newest()
        else:
            self._pass_on()

    def _pass_on(self) -> None:
        while (motion := self._pairing.next_pair()) is not None:
            self._guard(partial(self._on_motion, motion))
