# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A running `tactile_sim`, or a real sensor's driver, on the live page: topics in, poses out."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image, PointCloud2
from std_srvs.srv import Trigger

import msg_adapters
from dotsim_ros.data.trajectory import BASE_FRAME
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.live.desk import LiveDesk
from dotsim_ros.live.moments import Picture, Scene, SkinMoment
from dotsim_ros.nodes.common.counters import RateMeter
from dotsim_ros.nodes.common.ingest import Fault
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.tactile_sim.profiles import PROFILES
from dotsim_ros.view.skin_map import rest_position_m, skin_triangles
from msg_adapters import Level, Status

# The newest alone: a page that falls behind must not show what was.
IMAGE_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
STATE_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
LOOK_PERIOD_S = 0.5
RATE_WINDOW_S = 2.0
WAITING = "waiting for {topic}: is the node running, in this ROS_DOMAIN_ID and namespace?"


class LiveAttachment(WorkingNode):
    """Shows what a node publishes, and presses it; see `desk.Subject`.

    Args:
        desk: shows it.
        node_name: of the node, for its parameter `indenter` and its service `reset`.
        indenters: names to choose from.
        indenter: drawn until the node says what presses it; None: nothing.
    """

    def __init__(
        self,
        desk: LiveDesk,
        *,
        node_name: str,
        indenters: Collection[str],
        indenter: Indenter | None,
    ) -> None:
        super().__init__("live_page")
        # A node's sensor and profile are its own.
        self.sensors: Collection[str] = ()
        self.indenters: Collection[str] = indenters
        self.profiles: Mapping[str, str] = {}
        self._desk, self._node_name, self._indenter = desk, node_name, indenter
        self._scene: Scene | None = None
        self._pose: Pose | None = None
        self._force_n: FloatArray | None = None
        self._torque_nm: FloatArray = np.zeros(3)
        self._image: Any = None
        self._seen_depth_s = -np.inf
        self._depth_m: Any = None
        self._depth_stamp_ns: int | None = None
        self._rest_stamp_ns: int | None = None
        self._rest_depth_m: Any = None
        self._rate = RateMeter(RATE_WINDOW_S)
        self._heard_s: float | None = None
        self._is_asked = False
        self._base_frame = BASE_FRAME
        self._fault_count: int | None = None
        self._publisher = self.open_publisher(PoseStamped, "indenter/pose", STATE_QOS)
        self.title = self._publisher.topic_name.removesuffix("indenter/pose") + node_name
        for kind, topic, hear, qos in (
            (Image, "image_raw", self._on_image, IMAGE_QOS),
            (Image, "depth/image", self._on_depth, IMAGE_QOS),
            (PointCloud2, "points", self._on_points, IMAGE_QOS),
            (WrenchStamped, "wrench", self._on_wrench, STATE_QOS),
            (PoseStamped, "indenter/state", self._on_state, STATE_QOS),
            (DiagnosticArray, "/diagnostics", self._on_diagnostics, STATE_QOS),
        ):
            self.open_subscription(kind, topic, hear, qos)
        self._get = self.create_client(GetParameters, f"{node_name}/get_parameters")
        self._set = self.create_client(
            SetParametersAtomically, f"{node_name}/set_parameters_atomically"
        )
        self._reset = self.create_client(Trigger, f"{node_name}/reset")
        self.create_timer(LOOK_PERIOD_S, self._look)

    def begin(self) -> None:
        """Let the pages press the node."""
        self._desk.attend(self)
        self._desk.tell_state(busy=WAITING.format(topic=self.resolve_topic_name("points")))

    # Orders, from the server's thread.

    def move(self, pose: Pose | None, number: int) -> None:
        if pose is None:
            raise ValueError(
                "a node's indenter cannot be taken away: drag it off, or reset the node"
            )
        self._publisher.publish(
            msg_adapters.encode_pose_stamped(
                pose.position_m,
                pose.quaternion_xyzw,
                stamp_ns=self.time_ns(),
                frame_id=self._base_frame,
            )
        )

    def choose(self, what: str, name: str) -> None:
        if what != "indenter":
            raise ValueError(f"{what} {name} is the node's own: set it when the node is started")
        self._need(self._set, "parameters")
        change = Parameter("indenter", value=name).to_parameter_msg()
        answer = self._set.call_async(SetParametersAtomically.Request(parameters=[change]))
        answer.add_done_callback(partial(self._on_set, name))
        self._desk.tell_state(busy=f"the node prepares {name}")

    def reset(self) -> None:
        self._need(self._reset, "service reset")
        self._reset.call_async(Trigger.Request()).add_done_callback(self._on_reset)

    def _need(self, client: Any, what: str) -> None:
        if not client.service_is_ready():
            raise ValueError(
                f"no node answers for the {what} of {self._node_name}; name it with --node"
            )

    def _on_set(self, name: str, answer: Any) -> None:
        result = answer.result().result
        if result.successful:
            self._take_indenter(name)
        else:
            self._desk.tell(result.reason)
        self._desk.tell_state(busy="")

    def _on_reset(self, answer: Any) -> None:
        if not answer.result().success:
            self._desk.tell(answer.result().message)

    # What the node says.

    def _look(self) -> None:
        """Ask the node what presses it, as soon as it answers, and say where it is silent."""
        now_s = time.monotonic()
        if not self._is_asked and self._get.service_is_ready():
            self._is_asked = True
            answer = self._get.call_async(GetParameters.Request(names=["indenter"]))
            answer.add_done_callback(self._on_indenter)
        if self._heard_s is not None and now_s - self._heard_s > RATE_WINDOW_S:
            self._heard_s = None
            self._desk.tell_state(
                can_press=False, busy=WAITING.format(topic=self.resolve_topic_name("points"))
            )
            self._is_asked = False

    def _on_indenter(self, answer: Any) -> None:
        values = answer.result().values
        if values and values[0].type == ParameterType.PARAMETER_STRING:
            self._take_indenter(values[0].string_value)

    def _take_indenter(self, name: str) -> None:
        self._desk.tell_state(indenter=name)
        try:
            self._indenter = load_indenter(name)
        except (ValueError, OSError):
            # A file of another machine, or a definition: it presses all the same.
            self._indenter = None
        if self._scene is not None:
            self._show(replace(self._scene, indenter=self._indenter))

    def _show(self, scene: Scene) -> None:
        self._scene = scene
        self._desk.show_scene(scene)

    def _on_wrench(self, message: WrenchStamped) -> None:
        self._force_n, self._torque_nm = msg_adapters.decode_wrench_stamped(message)

    def _on_state(self, message: PoseStamped) -> None:
        self._pose = Pose(*msg_adapters.decode_pose_stamped(message))

    def _on_points(self, message: PointCloud2) -> None:
        # That of the poses as well, whatever prefix or name the node was given for it.
        self._base_frame = message.header.frame_id
        cloud = msg_adapters.decode_cloud(message)
        skin_m = np.asarray(cloud.position, dtype=np.float64)
        scene = self._scene
        if scene is None or len(scene.rest_m) != len(skin_m):
            rest_m = rest_position_m(cloud)
            scene = Scene(rest_m, skin_triangles(rest_m), self._indenter)
            self._show(scene)
        stamp_ns = msg_adapters.message_stamp_ns(message)
        if scene.is_at_rest(skin_m):
            self._rest_stamp_ns = stamp_ns
            self._learn_rest_depth()
        now_s = time.monotonic()
        self._rate.note(now_s)
        if self._heard_s is None:
            self._desk.tell_state(can_press=True, busy="")
        self._heard_s = now_s
        self._desk.show_skin(
            SkinMoment(
                stamp_ns,
                skin_m,
                self._force_n,
                self._torque_nm,
                self._pose,
                rate_hz=self._rate.rate_hz(now_s) or None,
            )
        )

    def _on_image(self, message: Image) -> None:
        self._image = message
        # The depth comes after the image of its frame, and where there is none, the image alone.
        if time.monotonic() - self._seen_depth_s > RATE_WINDOW_S:
            self._show_picture(msg_adapters.message_stamp_ns(message), None)

    def _on_depth(self, message: Image) -> None:
        self._depth_m = msg_adapters.decode_image(message)
        self._depth_stamp_ns = msg_adapters.message_stamp_ns(message)
        self._seen_depth_s = time.monotonic()
        if self._rest_depth_m is not None and self._rest_depth_m.shape != self._depth_m.shape:
            self._rest_depth_m = None
        self._learn_rest_depth()
        self._show_picture(self._depth_stamp_ns, self._depth_m)

    def _learn_rest_depth(self) -> None:
        """Keep the newest depth where it is of the frame that shows the skin at rest."""
        if self._depth_stamp_ns is not None and self._depth_stamp_ns == self._rest_stamp_ns:
            self._rest_depth_m = self._depth_m

    def _show_picture(self, stamp_ns: int, depth_m: Any) -> None:
        image = None if self._image is None else msg_adapters.decode_rgb(self._image)
        self._desk.show_picture(Picture(stamp_ns, image, depth_m, self._rest_depth_m))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        # As `WorkingNode.label` of a node that shares this one's namespace.
        label = f"{self.get_namespace()}/{self._node_name}".strip("/")
        for status in msg_adapters.decode_diagnostics(message):
            if status.name == f"{label}: frames":
                self._tell_profile(status.values.get("profile", ""))
            elif status.name == f"{label}: input":
                self._tell_fault(status)

    def _tell_profile(self, name: str) -> None:
        if name:
            self.profiles = {name: PROFILES[name].summary if name in PROFILES else ""}
        self._desk.tell_state(profile=name, profiles=self.profiles)

    def _tell_fault(self, status: Status) -> None:
        """Show what the node has refused since its last report."""
        count = sum(int(status.values.get(fault, "0")) for fault in Fault)
        # What was before this page is none of its news, and an older count is a new node's.
        is_new = self._fault_count is not None and count > self._fault_count
        self._fault_count = count
        if is_new and status.level is Level.WARN:
            self._desk.tell(status.message)
