"""`tactile_record`: writes what the sensor publishes to a ROS 2 bag (mcap).

Messages are taken as they come over the wire, without being unpacked, and written by a thread.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.logging import get_logger
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.utilities import try_shutdown

from dotsim_ros.nodes.common.declare import declare
from dotsim_ros.nodes.common.options import check_options, option
from dotsim_ros.nodes.common.spin import WorkingNode, run_node
from dotsim_ros.nodes.tactile_record.recording import BagRecording, RecordingSummary
from msg_adapters import message_class

SENSOR_TOPICS = {
    "image_raw": "sensor_msgs/msg/Image",
    "image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "depth/image": "sensor_msgs/msg/Image",
    "points": "sensor_msgs/msg/PointCloud2",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    "indenter/pose": "geometry_msgs/msg/PoseStamped",
}
"""Message types of the topics that need no type to be given."""

# Deeper than the publishers': a recorder must not lose what waits behind one large image.
RECORD_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
CHECK_PERIOD_S = 0.5


@dataclass(frozen=True)
class RecordParameters:
    """Parameters of `tactile_record`.

    Raises:
        ValueError: a value out of its range, or a topic without a type.
    """

    output: str = option(
        "", "folder of the bag, which must not exist (empty: tactile_DATE_TIME)", read_only=True
    )
    topics: tuple[str, ...] = option(
        ("image_raw", "camera_info", "depth/image", "points", "wrench", "indenter/pose"),
        "topics to record: names of the sensor, or NAME=PACKAGE/msg/TYPE of a stamped message",
        read_only=True,
    )
    queue_mb: int = option(
        512,
        "memory (MB) for messages that wait for the disk; messages beyond it are dropped",
        minimum=1,
        maximum=65536,
        read_only=True,
    )
    duration_s: float = option(
        0.0,
        "end the recording after this time; 0: when stopped",
        minimum=0.0,
        maximum=1e6,
        read_only=True,
    )

    def __post_init__(self) -> None:
        check_options(self)
        self.message_types()

    def message_types(self) -> dict[str, str]:
        """Return the message type of each topic.

        Raises:
            ValueError: none at all, or a name that needs a type.
        """
        types = {}
        for entry in self.topics:
            name, _, given = entry.partition("=")
            if not given and name not in SENSOR_TOPICS:
                raise ValueError(
                    f"topics holds {entry!r}, which is none of {', '.join(SENSOR_TOPICS)}: give "
                    f"its type, '{name or 'NAME'}=sensor_msgs/msg/Image'"
                )
            types[name] = given or SENSOR_TOPICS[name]
        if not types:
            raise ValueError("topics is empty: nothing to record")
        return types


def _check_stamped(kind: str) -> None:
    try:
        fields = list(message_class(kind).get_fields_and_field_types().values())
    except ImportError as error:
        raise ValueError(str(error)) from error
    if fields[:1] != ["std_msgs/Header"]:
        raise ValueError(f"{kind} has no header: only stamped messages are recorded")


class TactileRecord(WorkingNode):
    """Subscribes to the sensor's topics and hands their messages to a recording."""

    def __init__(self) -> None:
        super().__init__("tactile_record")
        self._settings = declare(self, RecordParameters)
        self._path = Path(self._settings.output or f"tactile_{datetime.now():%Y%m%d_%H%M%S}")
        named = self._settings.message_types()
        for kind in named.values():
            _check_stamped(kind)
        self._types = {self.resolve_topic_name(name): kind for name, kind in named.items()}
        self._received = 0
        self._heard: set[str] = set()
        self._lost = 0
        self._recording: BagRecording | None = None

    def begin(self) -> None:
        """Open the recording and listen."""
        recording = BagRecording(
            self._path, self._types, queue_bytes=self._settings.queue_mb * 2**20
        )
        self._recording = recording
        for topic, kind in self._types.items():
            self.create_subscription(
                message_class(kind),
                topic,
                partial(self._on_message, recording, topic),
                RECORD_QOS,
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(message_lost=self._on_lost),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
        self.create_timer(CHECK_PERIOD_S, partial(self._check, recording))
        if self._settings.duration_s > 0.0:
            self.create_timer(self._settings.duration_s, try_shutdown)
        self.get_logger().info(f"recording {', '.join(self._types)} to {self._path}")

    def destroy_node(self) -> None:
        """Finish the bag, log what is in it, and take the node down."""
        if self._recording is not None:
            self._finish(self._recording.close())
        super().destroy_node()

    def _finish(self, summary: RecordingSummary) -> None:
        # Not the node's own logger, which would try to publish what it says after the shutdown.
        logger = get_logger("dotsim_ros.tactile_record")
        dropped = sum(summary.dropped.values())
        if summary.error is not None:
            logger.error(f"no bag at {self._path}: {summary.error}")
            self.exit_status = 1
        elif not summary.written:
            logger.warning("no message came: no bag written")
        else:
            counts = ", ".join(f"{topic} {count}" for topic, count in summary.written.items())
            logger.info(
                f"wrote {sum(summary.written.values())} messages to {self._path} ({counts}); "
                f"{dropped} dropped, {self._lost} lost on the way"
            )

    def _on_message(self, recording: BagRecording, topic: str, serialized: bytes) -> None:
        self._received += 1
        if topic not in self._heard:
            self._heard.add(topic)
            self.get_logger().info(f"receiving {topic}")
        if not recording.put(topic, serialized):
            self.get_logger().warning(
                "the disk does not keep up: messages are dropped", throttle_duration_sec=5.0
            )

    def _on_lost(self, event: Any) -> None:
        self._lost += event.total_count_change

    def _check(self, recording: BagRecording) -> None:
        self.get_logger().debug(f"{self._received} messages so far")
        if recording.error is not None:
            try_shutdown()


def main() -> None:
    """Run the executable."""
    sys.exit(run_node(TactileRecord))


if __name__ == "__main__":
    main()
