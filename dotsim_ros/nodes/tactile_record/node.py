# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`tactile_record`: writes what the sensor publishes to a ROS 2 bag (mcap).

Messages are taken as they come over the wire, without being unpacked, and written by a thread.
Until the recording ends the bag lies in OUTPUT.partial; `dotsim_ros record --repair` makes a bag of
one that was cut short.
"""

from __future__ import annotations

import re
import signal
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.logging import get_logger
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import try_shutdown

from dotsim_ros.data.bag import PARTIAL, unfinished_path
from dotsim_ros.data.bag_metadata import METADATA
from dotsim_ros.data.lerobot.bags import TASK, bags_to_lerobot, check_absent
from dotsim_ros.data.lerobot.writer import check_installed
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.declare import declare
from dotsim_ros.nodes.common.health import Report, statuses_of
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.pace import FramePace
from dotsim_ros.nodes.common.parameters import READ_ONLY
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.nodes.tactile_record.recording import (
    FLUSH_PERIOD_S,
    BagRecording,
    RecordingSummary,
)
from dotsim_ros.view.timeline import bag_topics
from msg_adapters import Level, message_class

SENSOR_TOPICS = {
    "image_raw": "sensor_msgs/msg/Image",
    "image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "depth/image": "sensor_msgs/msg/Image",
    "points": "sensor_msgs/msg/PointCloud2",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    "indenter/pose": "geometry_msgs/msg/PoseStamped",
    "indenter/state": "geometry_msgs/msg/PoseStamped",
}
"""Message types of the topics that need no type to be given."""

TOPIC_NAME = re.compile("~?/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

# Deeper than the publishers': a recorder must not lose what waits behind one large image, nor 100
# messages a second while its machine is busy. What is deeper is replaced unseen by DDS.
RECORD_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
CHECK_PERIOD_S = 0.5
REPORT_PERIOD_S = 1.0


@dataclass(frozen=True)
class RecordParameters:
    """Parameters of `tactile_record`.

    Raises:
        ValueError: a value out of its range, a topic without a type, or one named twice or wrongly.
    """

    FIXED: ClassVar[str] = READ_ONLY

    output: str = quantity("", is_path=True)
    """folder of the bag, which must not exist (empty: tactile_DATE_TIME); until the recording ends
    it has .partial behind its name"""
    lerobot: str = quantity("", is_path=True)
    """folder of a LeRobotDataset that the bag is converted to at the end, which must not exist
    (empty: none); the bag stays"""
    topics: tuple[str, ...] = quantity(
        tuple(name for name in SENSOR_TOPICS if name != "image_raw/compressed")
    )
    """topics to record: names of the sensor, or NAME=PACKAGE/msg/TYPE of a stamped message"""
    queue_mb: int = quantity(512, low=1, high=65536)
    """memory (MB) for messages that wait for the disk; messages beyond it are dropped"""
    duration_s: float = quantity(0.0, low=0.0, high=1e6)
    """end the recording after this time; 0: when stopped"""

    def __post_init__(self) -> None:
        check_fields("", self)
        self.message_types()

    def message_types(self) -> dict[str, str]:
        """Return the message type of each topic.

        Raises:
            ValueError: none at all, or a name that needs a type.
        """
        types = {}
        for entry in self.topics:
            name, _, given = entry.partition("=")
            if not TOPIC_NAME.fullmatch(name):
                raise ValueError(
                    f"topics holds {value_text(entry)}, whose name is none of a topic: letters, "
                    "digits, _ and / are expected, and no part may begin with a digit"
                )
            if name in types:
                raise ValueError(f"topics names {name!r} twice, expected each topic once")
            if given and "/msg/" not in given:
                raise ValueError(
                    f"topics holds {value_text(entry)}, expected NAME=PACKAGE/msg/TYPE"
                )
            if not given and name not in SENSOR_TOPICS:
                raise ValueError(
                    f"topics holds {value_text(entry)}, which is none of "
                    f"{', '.join(SENSOR_TOPICS)}: give its type, '{name}=sensor_msgs/msg/Image'"
                )
            types[name] = given or SENSOR_TOPICS[name]
        if not types:
            raise ValueError("topics is empty: nothing to record")
        return types


def _check_stamped(kind: str) -> None:
    if kind.split("/")[1:2] != ["msg"]:
        raise ValueError(f"{value_text(kind)} is no message type of the form PACKAGE/msg/TYPE")
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
        if self._settings.lerobot:
            check_installed()
            check_absent(Path(self._settings.lerobot))
        named = self._settings.message_types()
        for kind in named.values():
            _check_stamped(kind)
        self._types: dict[str, str] = {}
        for name, kind in named.items():
            topic = self.resolve_topic_name(name)
            if topic in self._types:
                raise ValueError(f"topics names {topic} twice, expected each topic once")
            self._types[topic] = kind
        self._received = 0
        self._heard: set[str] = set()
        self._told_lost: Counter[str] = Counter()
        self._gaps: Counter[str] = Counter()
        self._numbers: dict[str, int] = {}
        self._shared: set[str] = set()
        self._recording: BagRecording | None = None
        self._is_ending = self._is_over = False

    def begin(self) -> None:
        """Open the recording and listen."""
        recording = BagRecording(
            self._path,
            self._types,
            queue_bytes=self._settings.queue_mb * 2**20,
            flush_period_s=None if self.is_stepped else FLUSH_PERIOD_S,
        )
        self._recording = recording
        now_s = self.now_s()
        flushes = FramePace(rate_hz=1.0 / FLUSH_PERIOD_S, start_s=now_s + FLUSH_PERIOD_S)
        duration_s = max(self._settings.duration_s, 1e-3)
        end = FramePace(rate_hz=1.0 / duration_s, start_s=now_s + duration_s)
        for topic, kind in self._types.items():
            self.open_subscription(
                message_class(kind),
                topic,
                partial(self._on_message, recording, topic),
                RECORD_QOS,
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(
                    message_lost=partial(self._on_lost, topic)
                ),
            )
        report = self.report_health(
            REPORT_PERIOD_S,
            lambda: statuses_of(self.label, "", {"recording": self._health(recording)}),
            "diagnostics have no time",
        )
        self.create_timer(
            CHECK_PERIOD_S,
            partial(self._check, recording, report),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        if self.is_stepped:
            self.start_paced("flush", lambda: flushes, recording.flush, "flushing the bag failed")
        if self._settings.duration_s > 0.0:
            self.start_paced("end", lambda: end, self._stop, "ending the recording failed")
        self.get_logger().info(
            f"recording {', '.join(self._types)} to {self._path} (until it is finished: "
            f"{unfinished_path(self._path).name})"
        )

    def _stop(self) -> None:
        self._is_over = True
        try_shutdown()

    def destroy_node(self) -> None:
        """Finish the bag, log what is in it, and take the node down."""
        if self._recording is not None:
            self._finish(self._recording.close())
        super().destroy_node()

    def _finish(self, summary: RecordingSummary) -> None:
        # Not the node's own logger, which would try to publish what it says after the shutdown.
        logger = get_logger("dotsim_ros.tactile_record")
        count = sum(summary.written.values())
        if summary.stamp_is_no_time:
            logger.warning(
                f"{_odd(summary)} ({_by_topic(summary.stamp_is_no_time)}); they are in the bag, "
                "where the message before them lies: mend what publishes them, calibrate refuses "
                "such messages"
            )
        if summary.went_back:
            logger.warning(f"{_mixed(summary)}: record each time by itself")
        if summary.refused:
            logger.warning(
                f"{sum(summary.refused.values())} messages are too short to hold a header "
                f"({_by_topic(summary.refused)}) and are not in the bag"
            )
        silent = [topic for topic in self._types if topic not in self._heard]
        if silent and count:
            logger.warning(
                f"no message came on {', '.join(silent)}: name the topics that are published with "
                "the parameter topics"
            )
        if summary.error is not None:
            self.exit_status = 1
            logger.error(_ending(summary))
        elif not count:
            logger.warning("no message came: no bag written")
        else:
            log = logger.warning if summary.missing or self._lost else logger.info
            log(
                f"wrote {count} messages to {self._path} ({_by_topic(summary.written)}); "
                f"{sum(summary.dropped.values())} dropped, {self._lost} lost on the way"
            )
            if self._settings.lerobot:
                self._convert(Path(self._settings.lerobot))

    def _convert(self, folder: Path) -> None:
        """Make a data set of the bag, which stays whatever happens here."""
        logger = get_logger("dotsim_ros.tactile_record")
        try:
            count = bags_to_lerobot(
                [self._path], folder, logger.warning, topics=bag_topics, task=TASK
            )
        except (ValueError, OSError) as error:
            self.exit_status = 1
            logger.error(f"no data set was made of {self._path}, which is whole: {error}")
        else:
            logger.info(f"wrote {count} frames to {folder}")

    def _health(self, recording: BagRecording) -> Report:
        summary = recording.summary()
        level, message = Level.OK, "recording"
        missing = summary.missing + self._lost
        if summary.error is not None:
            level, message = Level.ERROR, _ending(summary)
        elif missing:
            level, message = Level.WARN, f"{missing} messages are missing from the bag"
        elif summary.went_back:
            level, message = Level.WARN, _mixed(summary)
        elif summary.stamp_is_no_time:
            level, message = Level.WARN, _odd(summary)
        counted = ("written", "dropped", "lost", "refused", "stamp_is_no_time", "went_back")
        values = {name: str(sum(getattr(summary, name).values())) for name in counted}
        values |= {
            "folder": str(summary.folder),
            "waiting": str(summary.waiting),
            "lost_on_the_way": str(self._lost),
        }
        return level, message, values

    def _on_message(
        self, recording: BagRecording, topic: str, serialized: bytes, info: dict[str, int | None]
    ) -> None:
        if self._is_over:
            return
        self._received += 1
        self._look_for_gap(topic, info["publication_sequence_number"])
        if topic not in self._heard:
            self._heard.add(topic)
            self.get_logger().info(f"receiving {topic}")
        if not recording.put(topic, serialized) and recording.error is None:
            self.get_logger().warning(
                "the disk does not keep up: messages are dropped", throttle_duration_sec=5.0
            )

    def _on_lost(self, topic: str, event: Any) -> None:
        self._told_lost[topic] += event.total_count_change

    def _look_for_gap(self, topic: str, number: int | None) -> None:
        """Count what its publisher sent before this message and what did not come.

        DDS tells of messages that the network lost, not of those that newer ones replaced in its
        own memory.
        """
        if number is None:
            return
        last, self._numbers[topic] = self._numbers.get(topic, number - 1), number
        if number == last + 1:
            return
        # Each publisher counts for itself, and which one sent a message is not known.
        if self.count_publishers(topic) != 1:
            self._shared.add(topic)
        elif topic not in self._shared:
            self._gaps[topic] += max(0, number - last - 1)

    @property
    def _lost(self) -> int:
        return (self._told_lost | self._gaps).total()

    def _check(self, recording: BagRecording, report: Callable[[], None]) -> None:
        self.get_logger().debug(f"{self._received} messages so far")
        if self._is_ending:
            try_shutdown()
        elif recording.error is not None:
            # Once more before the end, so that who listens hears why.
            report()
            self._is_ending = True


def _by_topic(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{topic} {count}" for topic, count in counts.items())


def _odd(summary: RecordingSummary) -> str:
    return f"{sum(summary.stamp_is_no_time.values())} messages have a stamp that is no time"


def _mixed(summary: RecordingSummary) -> str:
    """Say that messages of several times lie in one bag."""
    return (
        f"stamps went back ({_by_topic(summary.went_back)}): time has begun again, and messages of "
        "before and after lie in this bag by their stamps, mixed"
    )


def _ending(summary: RecordingSummary) -> str:
    """Say how a recording broke off."""
    count = sum(summary.written.values())
    words = f"the recording broke off: {summary.error}; {summary.missing} messages are missing"
    if not count:
        return f"{words}, no bag was written"
    advice = ""
    if (summary.folder / METADATA).is_file():
        advice = "" if summary.folder.suffix != PARTIAL else ", a whole bag: give it another name"
    else:
        advice = f", without an index: dotsim_ros record --repair {summary.folder}"
    return f"{words}, {count} are in {summary.folder}{advice}"


def main() -> None:
    """Run the executable."""
    # A terminal that is closed ends a recording as Ctrl-C does, unless nohup keeps it.
    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, lambda *_: try_shutdown())
    sys.exit(run_node(TactileRecord))


if __name__ == "__main__":
    main()
