"""Every topic of one frame: published where there are subscribers, all with one stamp."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypedDict

import cv2
import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, PointCloud2

import msg_adapters
from dotsim_ros.nodes.tactile_sim.framing import Framing, encoded_pixels
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters
from dotsim_ros.optics.noise import with_noise

if TYPE_CHECKING:
    from dotsim_ros.nodes.tactile_sim.session import SensorMoment
    from dotsim_ros.sensor import Frame, TactileSensor
    from dotsim_ros.specification import NoiseSpecification

# Reliable serves best-effort readers too; 5 is what viewers ask for.
FRAME_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


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
        node: Node,
        sensor: TactileSensor,
        parameters: TactileSimParameters,
        *,
        noise: NoiseSpecification,
    ) -> None:
        self._sensor, self._noise = sensor, noise
        self.configure(parameters)
        self._image = self._publisher(node, Image, "image_raw")
        self._compressed = self._publisher(node, CompressedImage, "image_raw/compressed")
        self._camera_info = self._publisher(node, CameraInfo, "camera_info")
        self._depth = self._publisher(node, Image, "depth/image")
        self._points = self._publisher(node, PointCloud2, "points")
        self._wrench = self._publisher(node, WrenchStamped, "wrench")
        self._state = self._publisher(node, PoseStamped, "indenter/state")
        self._idle = node.create_publisher(Image, "~/idle_image", LATCHED_QOS)

    def framing_of(self, parameters: TactileSimParameters) -> Framing:
        """Return what of the sensor's image parameters ask for.

        Raises:
            ValueError: the crop or the size does not fit the camera, or takes too much memory.
        """
        return Framing.of_camera(
            self._sensor.camera,
            crop_px=parameters.crop_px,
            image_size_px=parameters.image_size_px,
        )

    def configure(self, parameters: TactileSimParameters) -> None:
        """Take changed parameters; errors as `framing_of`, and the ones before stay."""
        self._framing = self.framing_of(parameters)
        self._camera = self._framing.camera(self._sensor.camera)
        self._parameters = parameters

    def shows_image(self) -> bool:
        """Return whether a topic that needs the camera's image has a subscriber."""
        return any(self._is_shown(each) for each in (self._image, self._compressed, self._depth))

    def publish(self, moment: SensorMoment, stamp_ns: int) -> None:
        """Publish a moment on every topic with a subscriber; render it only for an image."""
        optical: _Header = {"stamp_ns": stamp_ns, "frame_id": self._parameters.optical_frame}
        base: _Header = {"stamp_ns": stamp_ns, "frame_id": self._parameters.base_frame}
        if self._is_shown(self._image):
            self._image.publish(self._image_message(moment.render().image, stamp_ns))
        if _is_read(self._camera_info):
            self._camera_info.publish(
                msg_adapters.encode_camera_info(
                    width=self._camera.width,
                    height=self._camera.height,
                    focal_px=self._camera.focal_px,
                    principal_point_px=self._camera.principal_point_px,
                    distortion=self._camera.distortion,
                    **optical,
                )
            )
        if _is_read(self._wrench):
            wrench = moment.gel.wrench
            self._wrench.publish(
                msg_adapters.encode_wrench_stamped(wrench.force_n, wrench.torque_nm, **base)
            )
        if moment.pose is not None and _is_read(self._state):
            pose = moment.pose
            self._state.publish(
                msg_adapters.encode_pose_stamped(pose.position_m, pose.quaternion_xyzw, **base)
            )
        if self._is_shown(self._compressed):
            self._compressed.publish(
                msg_adapters.encode_compressed_image(
                    self._framing.apply(self._noisy(moment.render().image, stamp_ns)),
                    compression=self._parameters.compression,
                    quality=self._parameters.jpeg_quality,
                    **optical,
                )
            )
        if self._is_shown(self._depth):
            # Never averaged: between skin and nothing lies no skin.
            depth = self._framing.apply(moment.render().depth_m, interpolation=cv2.INTER_NEAREST)
            self._depth.publish(msg_adapters.encode_image(depth, encoding="32FC1", **optical))
        if _is_read(self._points):
            rest_m, skin_m = self._sensor.skin.rest_position_m, moment.gel.skin_position_m
            self._points.publish(
                msg_adapters.encode_cloud(
                    skin_m,
                    normal=moment.skin_normal(),
                    displacement_m=skin_m - rest_m,
                    **base,
                )
            )

    def _is_shown(self, publisher: Publisher) -> bool:
        return _is_read(publisher) and not self._parameters.fail_drop_images

    def publish_idle(self, frame: Frame, stamp_ns: int) -> None:
        """Publish the image without contact, kept for late readers."""
        self._idle.publish(self._image_message(frame.image, stamp_ns))

    def _image_message(self, rgb: np.ndarray[Any, np.dtype[np.uint8]], stamp_ns: int) -> Any:
        return msg_adapters.encode_image(
            encoded_pixels(
                self._framing.apply(self._noisy(rgb, stamp_ns)), self._parameters.encoding
            ),
            encoding=self._parameters.encoding,
            stamp_ns=stamp_ns,
            frame_id=self._parameters.optical_frame,
        )

    def _noisy(
        self, rgb: np.ndarray[Any, np.dtype[np.uint8]], stamp_ns: int
    ) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return an image with the camera's noise, which the stamp draws: the raw and the
        compressed image of a frame have the same, and so has a frame that is simulated again."""
        levels = self._parameters.image_noise_levels
        if levels < 0.0:
            return with_noise(rgb, self._noise.deviation_levels, (self._noise.seed, stamp_ns))
        return with_noise(rgb, levels, stamp_ns)

    @staticmethod
    def _publisher(node: Node, kind: type[Any], topic: str) -> Publisher:
        overriding = QoSOverridingOptions.with_default_policies()
        return node.create_publisher(kind, topic, FRAME_QOS, qos_overriding_options=overriding)


def _is_read(publisher: Publisher) -> bool:
    return bool(publisher.get_subscription_count() > 0)
