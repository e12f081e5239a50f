# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor whose file names a network publishes the image that the network completes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from harness import LockstepPress, sensor

from dotsim_ros import Pose, TactileSensor, load_indenter, load_sensor
from dotsim_ros.specification import NoiseSpecification, SensorSpecification
from studies.speed.frame_shares import shares

LEARNED = replace(load_sensor("sensor_a"), noise=NoiseSpecification())
PLAIN = replace(LEARNED, camera=replace(LEARNED.camera, residual=""))


PARTS = ("gel", "solve", "touch", "view", "warp", "normals", "network", "message", "publish")


def test_the_network_completes_what_the_node_publishes(tmp_path: Path) -> None:
    trace = tmp_path / "trace.json"
    place_m = (0.0, 0.0, LEARNED.gel.outer_radius_m - 1e-3)
    options = {"image_noise_levels": 0.0, "clock": "lockstep", "trace": str(trace)}
    with sensor(sensor=LEARNED.name, **options) as (_, client):
        frame = LockstepPress(client).frame_at(place_m)

    def seen_by(specification: SensorSpecification) -> np.ndarray:
        made = TactileSensor(specification, indenter=load_indenter("sphere_4mm"))
        return made.step(Pose(np.array(place_m)), 0.04).image

    assert np.array_equal(frame.image(), seen_by(LEARNED))
    assert not np.array_equal(frame.image(), seen_by(PLAIN))

    check_trace(trace)
    with pytest.raises(ValueError, match="0 frames in real time, expected 2 or more"):
        shares(trace)


def check_trace(trace: Path) -> None:
    """The trace's parts lie within the message that asked for them, and fill most of its time."""
    events = json.loads(trace.read_text().rstrip(",\n") + "]")
    spans = [event for event in events if event["ph"] == "X"]
    frame = max((s for s in spans if s["name"] == "receive indenter/pose"), key=lambda s: s["dur"])
    begun, ended = frame["ts"], frame["ts"] + frame["dur"]
    inside = [
        span
        for span in spans
        if span["tid"] == frame["tid"] and begun <= span["ts"] and span["ts"] + span["dur"] <= ended
    ]
    assert set(PARTS) <= {span["name"] for span in inside}
    outermost = ("gel", "view", "warp", "normals", "network", "message", "publish")
    covered = sum(span["dur"] for span in inside if span["name"] in outermost)
    assert 0.8 * frame["dur"] < covered <= frame["dur"]


def test_a_part_of_a_frame_is_its_time_less_what_lies_within(tmp_path: Path) -> None:
    trace = tmp_path / "trace.json"
    # Thread, begin and end, and of a core, in milliseconds; the first is before the first frame.
    given = [
        ("wait", 1, 0, 9, 0),
        ("frames", 1, 10, 20, 8),
        ("gel", 1, 11, 16, 4),
        ("solve", 1, 12, 14, None),
        ("band", 2, 12, 13, 1),
        ("frames", 1, 50, 54, 4),
        ("gel", 1, 50, 53, 2),
    ]
    spans = [
        {"ph": "X", "name": name, "tid": thread, "ts": 1e3 * begun, "dur": 1e3 * (ended - begun)}
        | ({} if core is None else {"tdur": 1e3 * core})
        for name, thread, begun, ended, core in given
    ]
    trace.write_text("[\n" + "".join(json.dumps(span) + ",\n" for span in spans))
    found = shares(trace)
    assert found["frames_per_second"] == 25.0
    assert [tuple(part.values()) for part in found["parts"]] == [
        ("frames", 3.0, 3.0, 10.0),
        ("gel", 3.0, 3.0, 5.0),
        ("solve", 1.0, 0.0, 2.0),
        ("band", 0.5, 0.5, 1.0),
    ]
    trace.write_text("not a trace")
    with pytest.raises(ValueError, match="no trace of a node"):
        shares(trace)
