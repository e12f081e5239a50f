# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Frames are read on the wire by another implementation of DDS, which knows nothing of ROS."""

from __future__ import annotations

import os
import subprocess
import sys

from harness import APEX_M, sensor

# Where ROS looks on this machine only, it announces itself by no multicast.
CONFIGURATION = """
<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer Address="127.0.0.1"/></Peers>
  </Discovery>
</Domain></CycloneDDS>
"""

READER = """
import time
from dataclasses import dataclass
import cyclonedds.idl as idl
import cyclonedds.idl.annotations as annotate
import cyclonedds.idl.types as types
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

@dataclass
@annotate.final
@annotate.autoid("sequential")
class Time(idl.IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: types.int32
    nanosec: types.uint32

@dataclass
@annotate.final
@annotate.autoid("sequential")
class Header(idl.IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str

@dataclass
@annotate.final
@annotate.autoid("sequential")
class Image(idl.IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: types.uint32
    width: types.uint32
    encoding: str
    is_bigendian: types.uint8
    step: types.uint32
    data: types.sequence[types.uint8]

participant = DomainParticipant(DOMAIN)
quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(5))
reader = DataReader(participant, Topic(participant, "rt/image_raw", Image), qos=quality)
print("reading", flush=True)
end = time.monotonic() + 60
count = 0
while count < 3 and time.monotonic() < end:
    for image in reader.take(5):
        stamp = image.header.stamp.sec * 10**9 + image.header.stamp.nanosec
        print(image.encoding, image.width, image.height, image.step, len(image.data),
              image.header.frame_id, stamp, sum(image.data), flush=True)
        count += 1
    time.sleep(0.02)
"""


def test_cyclonedds_reads_whole_images_with_their_stamps() -> None:
    # So slow that the frames are still kept here when they are compared.
    with sensor(rate_hz=5.0) as (_, client):
        client.send((0.0, 0.0, APEX_M - 0.001))
        # A process of its own: two DDS implementations in one process share signal handlers.
        code = READER.replace("DOMAIN", os.environ["ROS_DOMAIN_ID"])
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "CYCLONEDDS_URI": CONFIGURATION},
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        rows = [line.split() for line in done.stdout.splitlines() if line != "reading"]
        assert len(rows) >= 3, done.stdout + done.stderr
        for encoding, width, height, step, length, frame_id, stamp, total in rows:
            assert (encoding, width, height, step) == ("rgb8", "640", "480", "1920")
            assert int(length) == 480 * 1920
            assert frame_id == "densetact_optical_frame"
            same = client.whole_frame(int(stamp))
            assert int(same.image().sum()) == int(total)
