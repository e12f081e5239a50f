# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What `tactile_policy` talks to in the tests: a stream of images, an arm that obeys, a small real
network. The streams can be cut and spoilt."""

from __future__ import annotations

import hashlib
import itertools
import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from harness import Executable, Watcher, running
from sensor_msgs.msg import CompressedImage, Image
from std_srvs.srv import SetBool, Trigger

import msg_adapters
from dotsim_ros.control.policy.images import CHANNEL_COUNT, fingerprint
from dotsim_ros.control.policy.network import FORMAT, INPUT, USUAL_MEAN, USUAL_ROOT, PolicyCard
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.twist import TwistFrame, advance
from dotsim_ros.optics.network.carded_weights import (
    CARD,
    GRAPH,
    WEIGHTS,
    weights_hash,
    write_weights,
)

MODULE = "dotsim_ros.nodes.tactile_policy.node"
HEIGHT, WIDTH = 120, 160
SIDE_PX = 48
FOLLOWED = (0.004, 0.0, 0.001, 0.0, 0.0, 0.02)
"""What the network commands, but for 1e-5 of it."""
DOWN = (1.0, 0.0, 0.0, 0.0)
IMAGE_PERIOD_S, POSE_PERIOD_S = 0.04, 0.01
QUIET_S = 0.25
_numbers = itertools.count()


def idle_crop() -> np.ndarray[Any, Any]:
    """Return (H, W, 3) what the sensor sees at rest."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    waves = [100.0 + 40.0 * np.sin(x / a) * np.cos(y / b) for a, b in ((9, 7), (6, 11), (13, 5))]
    return np.stack(waves, axis=-1).astype(np.uint8)


def with_white_spot(crop: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return a crop with a spot in the middle that makes the network's root a NaN."""
    spoilt = crop.copy()
    spoilt[55:65, 75:85] = 255
    return spoilt


GRAPH_TEXT = f"""
<ir_version: 9, opset_import: ["" : 18]>
steady (float[1, {CHANNEL_COUNT}, {SIDE_PX}, {SIDE_PX}] {INPUT}) => (float[1, 1, 6] commands)
<float[1, 1, 6] followed = {{{", ".join(map(str, FOLLOWED))}}}, float limit = {{3.5}},
 float little = {{1e-5}}, int64[1] first = {{0}}, int64[1] end = {{3}}, int64[1] channels = {{1}}>
{{
  change = Slice({INPUT}, first, end, channels)
  brightest = ReduceMax <keepdims = 0> (change)
  room = Sub(limit, brightest)
  root = Sqrt(room)
  mean = ReduceMean <keepdims = 0> ({INPUT})
  bent = Tanh(mean)
  product = Mul(bent, root)
  small = Mul(little, product)
  commands = Add(followed, small)
}}
"""
"""The root of what is left below a limit is a NaN where a spot is white."""


def write_network(folder: Path) -> Path:
    """Write a small policy whose output is `FOLLOWED`, or NaN where a spot is white; its graph is
    written down: what exports one takes ten seconds."""
    parser = pytest.importorskip("onnx.parser", reason="writes a network: '.[learning]'")
    graph = parser.parse_model(GRAPH_TEXT).SerializeToString(deterministic=True)
    idle = idle_crop()
    mean = fingerprint(idle, idle)
    usual = {USUAL_MEAN: mean, USUAL_ROOT: np.eye(mean.size, dtype=np.float32)}
    card = PolicyCard(
        version=FORMAT,
        name="steady",
        sensor="test",
        indenter="none",
        paths=("line",),
        rate_hz=25.0,
        image_height=HEIGHT,
        image_width=WIDTH,
        share=0.7,
        side_px=SIDE_PX,
        largest_distance=3.0,
        weights_sha256=weights_hash(usual),
        graph_sha256=hashlib.sha256(graph).hexdigest(),
    )
    folder.mkdir(parents=True)
    (folder / GRAPH).write_bytes(graph)
    (folder / CARD).write_text(card.text() + "\n")
    write_weights(folder / WEIGHTS, usual, card)
    return folder


@dataclass(frozen=True)
class Command:
    """A command as it came.

    Attributes:
        stamp_s: the node's time.
        frame_id: whose axes.
        twist: (6,).
    """

    stamp_s: float
    frame_id: str
    twist: np.ndarray[Any, Any]

    def moves(self) -> bool:
        return bool(self.twist.any())


USUAL = {
    "crop": idle_crop(),
    "has_images": True,
    "has_poses": True,
    "has_forces": True,
    "image_lag_s": 0.0,
    "pose_lag_s": 0.0,
    "force_lag_s": 0.0,
    "image_frame": "densetact_optical_frame",
    "pose_frame": "link_base",
    "encoding": "rgb8",
    "force_n": 0.0,
}
"""The streams of a rig as they should be."""


class Rig(Watcher):
    """Images at 25 Hz, an arm that obeys at once at 100 Hz, and a force; reads what the node says,
    and calls its services.

    Args:
        namespace: of all names.
        compressed: whether images are.
        along_tool: whether commands are along the tool's axes.
        has_forces: whether there is a force.
        now_ns: the time that messages are stamped with.

    Attributes:
        commands: all that came.
        tool: the pose of the arm.
        last_pose_s: when the newest was sent.
        crop: what the images show.
        has_images, has_poses, has_forces: cut a stream.
        image_lag_s, pose_lag_s, force_lag_s: how long before now messages are stamped.
        image_frame, pose_frame: frames of the messages.
        encoding: of the images that are not compressed, rgb8 or bgr8.
        force_n: the force.
        images, poses, wrenches: their publishers.
        last_image_s, last_wrench_s: when the newest was sent.
    """

    def __init__(
        self,
        namespace: str,
        *,
        compressed: bool = False,
        along_tool: bool = True,
        has_forces: bool = True,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._now_ns = now_ns
        self._stop = Event()
        self._lock = Lock()
        super().__init__("rig", namespace)
        self.commands: list[Command] = []
        self.tool = Pose((0.3, 0.0, 0.2), DOWN)
        self._prefix = f"{namespace}/"
        self.idle = USUAL["crop"]
        vars(self).update(USUAL, has_forces=has_forces)
        self.last_image_s = self.last_pose_s = self.last_wrench_s = 0.0
        self._axes = TwistFrame.OWN if along_tool else TwistFrame.PARENT
        self._compressed = compressed
        kind, topic = (
            (CompressedImage, "image_raw/compressed") if compressed else (Image, "image_raw")
        )
        self.images = self.node.create_publisher(kind, topic, 5)
        self.poses = self.node.create_publisher(PoseStamped, "ee_pose", 5)
        self.wrenches = self.node.create_publisher(WrenchStamped, "wrench", 5)
        commands = "tactile_policy/cmd_vel"
        self.node.create_subscription(TwistStamped, commands, self._on_command, 100)
        beats = [(IMAGE_PERIOD_S, self._send_image), (POSE_PERIOD_S, self._send_pose)]
        self._beats = [Thread(target=self._beat, args=beat, daemon=True) for beat in beats]
        for beat in self._beats:
            beat.start()

    def close(self) -> None:
        """End the streams and leave the graph."""
        self._stop.set()
        for beat in self._beats:
            beat.join(10.0)
        super().close()

    def enable(self, wanted: bool = True) -> Any:
        """Call set_enabled."""
        return self.call(SetBool, "tactile_policy/set_enabled", data=wanted)

    def calibrate(self) -> None:
        """Let the node take its idle image."""
        self.wait(
            lambda: self.call(Trigger, "tactile_policy/calibrate_idle").success,
            "an idle image to be taken",
        )

    def newest(self) -> Command:
        """Return the newest command."""
        with self._lock:
            return self.commands[-1] if self.commands else Command(0.0, "", np.zeros(6))

    def after(self, time_s: float) -> list[Command]:
        """Return the commands stamped after a time."""
        with self._lock:
            return [command for command in self.commands if command.stamp_s > time_s]

    def rest_s(self, after_s: float) -> float:
        """Wait until commands are zero and stay so; return the stamp of the first of these zeros.

        A busy machine may stop the arm for a moment, which is another stop.
        """

        def first() -> float:
            later = self.after(after_s)
            moving = [index for index, command in enumerate(later) if command.moves()]
            rest = later[moving[-1] + 1 :] if moving else later
            if not rest or rest[-1].stamp_s - rest[0].stamp_s < QUIET_S:
                return 0.0
            return rest[0].stamp_s

        return self.wait(first, "the arm to stand still")

    def state(self, part: str = "control") -> msg_adapters.Status:
        """Return the newest diagnostic of a part of the node."""
        name = f"{self._prefix}tactile_policy: {part}"
        return self.wait(lambda: self.diagnostics.get(name), f"the diagnostic {name}")

    def wait_for_reason(self, state: str, reason: str) -> msg_adapters.Status:
        """Wait for a state of the loop, and return it: the newest may be another by then."""

        def found() -> msg_adapters.Status | None:
            newest = self.state()
            values = newest.values
            is_wanted = values.get("state") == state and values["reason"] == reason
            return newest if is_wanted else None

        return self.wait(found, f"the state {state} for {reason}")

    def start(self) -> None:
        """Mend everything, enable, and wait until the arm moves."""
        self.enable(False)
        if self._mend():
            # What was spoilt must have passed.
            time.sleep(0.3)
        self.calibrate()
        self.wait(lambda: self.enable().success, "the start")
        # Those that say so by now are of the motion before, if there was one.
        self.diagnostics.clear()
        self.wait(lambda: self.newest().moves(), "a motion")
        # The first of the node, before its control began, names no state and may come late.
        self.wait(lambda: self.state().values.get("state") == "running", "a steady motion")

    def _mend(self) -> bool:
        """Let the streams be as they should; return whether they were not."""
        is_spoilt = any(
            not np.array_equal(getattr(self, name), value) for name, value in USUAL.items()
        )
        vars(self).update(USUAL)
        return is_spoilt

    def next_image_s(self) -> float:
        """Wait for an image that is sent from now on and return when it was."""
        last_s = self.last_image_s
        self.wait(lambda: self.last_image_s != last_s, "an image")
        return self.last_image_s

    def _on_command(self, message: TwistStamped) -> None:
        twist = np.concatenate(msg_adapters.decode_twist_stamped(message))
        stamp_s = 1e-9 * msg_adapters.message_stamp_ns(message)
        with self._lock:
            self.commands.append(Command(stamp_s, message.header.frame_id, twist))

    def _beat(self, period_s: float, send: Callable[[], None]) -> None:
        due_s = time.monotonic()
        while not self._stop.wait(max(0.0, due_s - time.monotonic())):
            due_s += period_s
            with suppress(Exception):
                # Publishing fails once the context is down.
                send()

    def _send_image(self) -> None:
        if not self.has_images:
            return
        stamp_ns = self._now_ns() - round(1e9 * self.image_lag_s)
        known = {"stamp_ns": stamp_ns, "frame_id": self.image_frame}
        message = (
            msg_adapters.encode_compressed_image(self.crop, compression="png", **known)
            if self._compressed
            else msg_adapters.encode_image(
                self.crop[..., :: -1 if self.encoding == "bgr8" else 1],
                encoding=self.encoding,
                **known,
            )
        )
        self.images.publish(message)
        self.last_image_s = 1e-9 * self._now_ns()

    def _send_pose(self) -> None:
        command = self.newest()
        self.tool = advance(
            self.tool,
            command.twist[:3],
            command.twist[3:],
            duration_s=POSE_PERIOD_S,
            along=self._axes,
        )
        stamp_ns = self._now_ns()
        if self.has_forces:
            self.wrenches.publish(
                msg_adapters.encode_wrench_stamped(
                    (0.0, 0.0, self.force_n),
                    (0.0, 0.0, 0.0),
                    stamp_ns=stamp_ns - round(1e9 * self.force_lag_s),
                    frame_id="tool",
                )
            )
            self.last_wrench_s = 1e-9 * stamp_ns
        if self.has_poses:
            self.poses.publish(
                msg_adapters.encode_pose_stamped(
                    self.tool.position_m,
                    self.tool.quaternion_xyzw,
                    stamp_ns=stamp_ns - round(1e9 * self.pose_lag_s),
                    frame_id=self.pose_frame,
                )
            )
            self.last_pose_s = 1e-9 * stamp_ns


@contextmanager
def policy_and_rig(
    folder: Path,
    *,
    compressed: bool = False,
    has_forces: bool = True,
    now_ns: Callable[[], int] = time.time_ns,
    code: str = "",
    **parameters: Any,
) -> Iterator[tuple[Executable, Rig]]:
    """Run a node with the small network, and the rig that it talks to, in a namespace of theirs."""
    namespace = f"bench_{next(_numbers)}"
    with suppress(PermissionError):
        # What is measured is the node, not what else the machine does; children take it over.
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    given = {
        "policy": folder,
        "diagnostics_period_s": 0.1,
        "workspace_m": "[0.5, 0.5, 0.5]",
        **parameters,
    }
    if compressed:
        given["image_transport"] = "compressed"
    with running(
        MODULE, parameters=given, code=code, arguments=("-r", f"__ns:=/{namespace}")
    ) as executable:
        along_tool = given.get("command_frame", "link_tcp") == "link_tcp"
        how = {"compressed": compressed, "along_tool": along_tool, "has_forces": has_forces}
        try:
            with closing(Rig(namespace, **how, now_ns=now_ns)) as rig:
                yield executable, rig
        finally:
            with suppress(PermissionError):
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
