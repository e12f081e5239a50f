# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every topic of one frame: published where there are subscribers, all with one stamp."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, TypedDict

import cv2
import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped, WrenchStamped
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

import msg_adapters
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io import tracing
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.tactile_sim.framing import Framing, encoded_pixels
from dotsim_ros.nodes.tactile_sim.parameters import AXIAL, TactileSimParameters
from dotsim_ros.optics.depth import DepthConversion, radius_bytes
from dotsim_ros.optics.noise import with_noise

if TYPE_CHECKING:
    from dotsim_ros.nodes.tactile_sim.session import SensorMoment
    from dotsim_ros.sensor import Frame, TactileSensor
    from dotsim_ros.specification import NoiseSpecification

# Reliable serves best-effort readers too; 5 is what viewers ask for.
FRAME_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

ADVICE = (
    "give each a namespace (-r __ns:=/left, namespace:=left of a launch file), or topics of its own"
)


class _Header(TypedDict):
    stamp_ns: int
    frame_id: str


class FramePublishers:
    """Publishes frames of one sensor.

    Args:
        node: owns the publishers.
        sensor: whose camera and skin the frames are of.
        parameters: frames, crop, size and encodings.
        noise: that images get where the parameters set none; the sensor itself must add none.

    Raises:
        ValueError: the crop or the size does not fit the camera.
    """

    def __init__(
        self,
        node: WorkingNode,
        sensor: TactileSensor,
        parameters: TactileSimParameters,
        *,
        noise: NoiseSpecification,
    ) -> None:
        self._node, self._sensor, self._noise = node, sensor, noise
        publisher = partial(node.open_publisher, quality=FRAME_QOS)
        self._reference: ImageArray | None = None
        self._calibration: msg_adapters.CameraCalibration | None = None
        self._depth_of: DepthConversion | None = None
        self._framing = self.framing_of(parameters)
        # A network, and effects that were found, know images of the sensor's own size.
        self._renders_part = not (sensor.has_network or parameters.sensor.effects)
        self.configure(parameters)
        self._image = publisher(Image, parameters.topics.image_topic)
        # Of the topic as it is after a remap, so that what belongs to an image goes along with it.
        image_topic = self._image.topic_name
        self._compressed = publisher(CompressedImage, f"{image_topic}/compressed")
        self._camera_info = publisher(
            CameraInfo,
            parameters.topics.camera_info_topic or _beside(node, image_topic, "camera_info"),
        )
        self._difference = publisher(Image, parameters.topics.difference_topic)
        self._difference_compressed = publisher(
            CompressedImage, f"{self._difference.topic_name}/compressed"
        )
        self._depth = publisher(Image, "depth/image")
        self._radius = publisher(Image, parameters.topics.radius_topic)
        self._radius_shown = publisher(Image, parameters.topics.radius_shown_topic)
        self._points = publisher(PointCloud2, "points")
        self._markers = None
        if sensor.markers is not None:
            self._markers = publisher(PointCloud2, "markers")
        self._wrench = publisher(WrenchStamped, parameters.topics.wrench_topic)
        self._state = publisher(PoseStamped, "indenter/state")
        self._idle = node.create_publisher(Image, "~/idle_image", LATCHED_QOS)

    def rivals(self) -> str:
        """Return who else publishes the images or the wrench, in words; empty where nobody does:
        two sensors may have been started under one name."""
        for topic in (self._image.topic_name, self._wrench.topic_name):
            if self._node.count_publishers(topic) < 2:
                continue
            others = self._node.get_publishers_info_by_topic(topic)
            names = sorted(f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in others)
            return f"{topic} has {len(names)} publishers ({', '.join(names)}): {ADVICE}"
        return ""

    def framing_of(self, parameters: TactileSimParameters) -> Framing:
        """Return what of the sensor's image parameters ask for.

        Raises:
            ValueError: the crop or the size does not fit the camera, or takes too much memory.
        """
        return Framing.of_camera(
            self._sensor.whole_camera,
            crop_px=parameters.image.crop_px,
            image_size_px=parameters.image.image_size_px,
            image_aspect=parameters.image.image_aspect,
        )

    def configure(self, parameters: TactileSimParameters) -> None:
        """Take changed parameters; errors as `framing_of`, and the ones before stay.

        Another part or size of the image takes some tenths of a second, and makes the untouched
        image the reference.
        """
        framing = self.framing_of(parameters)
        if self._renders_part:
            self._sensor.set_view(framing.crop_px, framing.rendered_px)
        if framing != self._framing:
            self._reference = self._depth_of = None
        self._framing, self._frames, self._form = framing, parameters.frames, parameters.image
        self._intrinsics = framing.intrinsics(self._sensor.whole_camera)

    def shows_image(self) -> bool:
        """Return whether a topic that needs the camera's image has a subscriber."""
        shown = (
            self._image,
            self._compressed,
            self._difference,
            self._difference_compressed,
            self._depth,
            self._radius,
            self._radius_shown,
        )
        return any(self._is_shown(each) for each in shown)

    def publish(self, moment: SensorMoment, stamp_ns: int) -> None:
        """Publish a moment on every topic with a subscriber; render it only for an image."""
        optical: _Header = {"stamp_ns": stamp_ns, "frame_id": self._frames.optical_frame}
        base: _Header = {"stamp_ns": stamp_ns, "frame_id": self._frames.base_frame}
        if self._is_shown(self._image):
            _send(self._image, self._image_message, moment.render().image, stamp_ns)
        if _is_read(self._camera_info):
            _send(self._camera_info, self._camera_info_message, optical)
        if _is_read(self._wrench):
            wrench = moment.gel.wrench
            given = (wrench.force_n, wrench.torque_nm)
            _send(self._wrench, msg_adapters.encode_wrench_stamped, *given, **base)
        if moment.pose is not None and _is_read(self._state):
            pose = moment.pose
            placed = (pose.position_m, pose.quaternion_xyzw)
            _send(self._state, msg_adapters.encode_pose_stamped, *placed, **base)
        if self._is_shown(self._compressed):
            with tracing.span("message"):
                seen = self._framed(self._noisy(moment.render().image, stamp_ns))
            _send(self._compressed, self._compressed_message, seen, optical)
        self._publish_difference(moment, optical)
        self._publish_depth(moment, optical)
        if _is_read(self._points):
            rest_m, skin_m = self._sensor.skin.rest_position_m, moment.gel.skin_position_m
            _send(
                self._points,
                msg_adapters.encode_cloud,
                skin_m,
                normal=moment.skin_normal(),
                displacement_m=skin_m - rest_m,
                **base,
            )
        if self._markers is not None and _is_read(self._markers):
            _send(self._markers, self._markers_message, moment.gel.skin_position_m, base)

    def _markers_message(self, skin_position_m: FloatArray, header: _Header) -> Any:
        assert self._sensor.markers is not None
        seen_by = self._framing.camera(self._sensor.whole_camera)
        motion = self._sensor.markers.motion(skin_position_m, seen_by)
        # To the published size: a pixel's middle has a half to its edge.
        scale = np.array(self._framing.size_px) / np.array(self._framing.rendered_px)
        return msg_adapters.encode_cloud(
            motion.position_m,
            displacement_m=motion.position_m - motion.rest_m,
            pixel=(motion.position_px + 0.5) * scale - 0.5,
            pixel_displacement=(motion.position_px - motion.rest_px) * scale,
            **header,
        )

    def _is_shown(self, publisher: Publisher) -> bool:
        return _is_read(publisher) and not self._form.fail_drop_images

    def check_calibration(self, calibration: msg_adapters.CameraCalibration) -> None:
        """Refuse a calibration that camera_info could not show.

        Raises:
            ValueError: the images have another size now.
        """
        given, size = (calibration.width, calibration.height), self._framing.size_px
        if given != size:
            raise ValueError(
                f"the calibration is of {given[0]} x {given[1]} pixels, the images have {size[0]} "
                f"x {size[1]}: calibrate with these, or set image_size_px"
            )

    def take_calibration(self, calibration: msg_adapters.CameraCalibration) -> None:
        """Publish a calibration as camera_info, while images have its size."""
        self._calibration = calibration

    def _camera_info_message(self, header: _Header) -> Any:
        own, given = self._intrinsics, self._calibration
        if given is None or (given.width, given.height) != (own.width, own.height):
            given = own
        return msg_adapters.encode_calibration(given, **header)

    def take_reference(self, image: ImageArray | None) -> None:
        """Take differences to an image of the sensor from now on; None: to the untouched one."""
        self._reference = image

    def _publish_difference(self, moment: SensorMoment, header: _Header) -> None:
        plain, compressed = self._difference, self._difference_compressed
        if not (self._is_shown(plain) or self._is_shown(compressed)):
            return
        reference = self._sensor.idle_image if self._reference is None else self._reference
        with tracing.span("message"):
            difference = difference_image(
                self._framed(self._noisy(moment.render().image, header["stamp_ns"])),
                self._framed(reference),
                self._form.difference_gain,
            )
        if self._is_shown(plain):
            encoding = self._form.encoding
            pixels = encoded_pixels(difference, encoding)
            _send(plain, msg_adapters.encode_image, pixels, encoding=encoding, **header)
        if self._is_shown(compressed):
            _send(compressed, self._compressed_message, difference, header)

    def _publish_depth(self, moment: SensorMoment, header: _Header) -> None:
        if self._is_shown(self._depth):
            depth_m = moment.render().depth_m
            with tracing.span("message"):
                if self._form.depth_convention == AXIAL:
                    depth_m = self._conversion().axial_m(depth_m)
                # Never averaged: between skin and nothing lies no skin.
                depth_m = self._framed(depth_m, interpolation=cv2.INTER_NEAREST)
            _send(self._depth, msg_adapters.encode_image, depth_m, encoding="32FC1", **header)
        if not (self._is_shown(self._radius) or self._is_shown(self._radius_shown)):
            return
        with tracing.span("message"):
            radius = radius_bytes(
                self._conversion().radius_m(moment.render().depth_m), self._form.radius_limits_m
            )
            radius = self._framed(radius, interpolation=cv2.INTER_NEAREST)
        if self._is_shown(self._radius):
            _send(self._radius, msg_adapters.encode_image, radius, encoding="8UC1", **header)
        if self._is_shown(self._radius_shown):
            grey = np.repeat(radius[..., None], 3, axis=2)
            _send(self._radius_shown, msg_adapters.encode_image, grey, encoding="rgb8", **header)

    def _conversion(self) -> DepthConversion:
        if self._depth_of is None:
            self._depth_of = DepthConversion(self._sensor.camera)
        return self._depth_of

    def _framed(self, pixels: NDArray[Any], *, interpolation: int = cv2.INTER_AREA) -> NDArray[Any]:
        """Return pixels of a frame as they are published."""
        frame = self._framing.fit if self._renders_part else self._framing.apply
        return frame(pixels, interpolation=interpolation)

    def _compressed_message(self, pixels: ImageArray, header: _Header) -> Any:
        return msg_adapters.encode_compressed_image(
            pixels,
            compression=self._form.compression,
            quality=self._form.jpeg_quality,
            **header,
        )

    def publish_idle(self, frame: Frame, stamp_ns: int) -> None:
        """Publish the image without contact, kept for late readers."""
        self._idle.publish(self._image_message(frame.image, stamp_ns))

    def _image_message(self, rgb: np.ndarray[Any, np.dtype[np.uint8]], stamp_ns: int) -> Any:
        return msg_adapters.encode_image(
            encoded_pixels(self._framed(self._noisy(rgb, stamp_ns)), self._form.encoding),
            encoding=self._form.encoding,
            stamp_ns=stamp_ns,
            frame_id=self._frames.optical_frame,
        )

    def _noisy(
        self, rgb: np.ndarray[Any, np.dtype[np.uint8]], stamp_ns: int
    ) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return an image with the camera's noise, which the stamp draws: the raw and the
        compressed image of a frame have the same, and so has a frame that is simulated again."""
        levels = self._form.image_noise_levels
        channels = self._sensor.specification.camera.channel_count
        if levels < 0.0:
            seed = (self._noise.seed, stamp_ns)
            return with_noise(rgb, self._noise.deviation_levels, seed, channel_count=channels)
        return with_noise(rgb, levels, stamp_ns, channel_count=channels)


def _beside(node: WorkingNode, topic: str, name: str) -> str:
    """Return the topic of a name next to another, unless the user has renamed it on its own."""
    given = node.resolve_topic_name(name)
    is_renamed = given != node.resolve_topic_name(name, only_expand=True)
    return given if is_renamed else f"{topic.rpartition('/')[0]}/{name}"


def _send(publisher: Publisher, encode: Callable[..., Any], *what: Any, **header: Any) -> None:
    """Publish the message that something encodes."""
    with tracing.span("message"):
        message = encode(*what, **header)
    with tracing.span("publish"):
        publisher.publish(message)


def _is_read(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count() > 0)


def difference_image(image: ImageArray, reference: ImageArray, gain: float) -> ImageArray:
    """Return (H, W, 3) the amplified absolute difference of two images in grey.

    So does the public ROS 2 driver of two DenseTact sensors: grey levels, absolute difference,
    times 8, clipped, in three equal channels.

    Args:
        image, reference: (H, W, 3) uint8, red, green, blue.
        gain: of the difference.
    """
    grey, before = (
        cv2.cvtColor(np.ascontiguousarray(each), cv2.COLOR_RGB2GRAY) for each in (image, reference)
    )
    amplified = cv2.convertScaleAbs(cv2.absdiff(grey, before), alpha=gain)
    return np.asarray(cv2.cvtColor(amplified, cv2.COLOR_GRAY2RGB), dtype=np.uint8)


def publish_static_frame(node: WorkingNode, pose: Pose, *, parent: str, child: str) -> Any | None:
    """Publish the pose of a child frame in its parent, once, kept for late readers.

    Returns:
        The broadcaster, to be kept alive; None where tf2_ros is not installed.
    """
    try:
        from tf2_ros import StaticTransformBroadcaster
    except ImportError:
        node.get_logger().info("tf2_ros is not installed: no transform on /tf_static")
        return None
    message = TransformStamped()
    message.header.stamp = node.get_clock().now().to_msg()
    message.header.frame_id, message.child_frame_id = parent, child
    x, y, z = pose.position_m.tolist()
    translation, rotation = message.transform.translation, message.transform.rotation
    translation.x, translation.y, translation.z = x, y, z
    rotation.x, rotation.y, rotation.z, rotation.w = pose.quaternion_xyzw.tolist()
    broadcaster = StaticTransformBroadcaster(node)
    broadcaster.sendTransform(message)
    return broadcaster
