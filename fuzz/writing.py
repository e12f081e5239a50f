# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files on a disk that is full: the one before stays, or the new one is whole."""

from __future__ import annotations

import resource
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.trajectory import PoseChannel, Trajectory
from dotsim_ros.effects.overlay import Estimate, FoundEffect, Overlay, overlay_text, read_overlay
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.io.files import write_image, write_json, write_text
from dotsim_ros.io.replacement import replace_files
from dotsim_ros.specification import load_sensor, write_sensor
from fuzz.target import Finding, Target

Write = Callable[[Path, int], None]


def _sensor(folder: Path, number: int) -> None:
    sensor = replace(load_sensor("densetact2"), name=f"sensor_{number}")
    write_sensor(folder / "sensor.yaml", sensor, "# fuzz\n" * 40 * number)


def _overlay(folder: Path, number: int) -> None:
    gain = Estimate("gain", "", 1.0 + 0.01 * number, 0.5, 1.5)
    overlay = Overlay("s", "h", (FoundEffect("force_scale", (gain,)),) * number)
    write_text(folder / "overlay.yaml", overlay_text(overlay))


def _image(folder: Path, number: int) -> None:
    noise = np.random.default_rng(number).integers(0, 255, (40, 40, 3)).astype(np.uint8)
    write_image(folder / "image.png", noise)


def _figures(folder: Path, number: int) -> None:
    write_json(folder / "figures.json", {"numbers": list(range(500 * number))})


def _report(folder: Path, number: int) -> None:
    text = f"report {number}\n".encode() * 700
    replace_files(folder, {"report.html": text, "report.md": text, f"part_{number}.md": text})


def _data_set(folder: Path, number: int) -> None:
    stamp_ns = (1e9 + 4e7 * np.arange(30)).astype(np.int64)
    position = np.full((30, 3), 1e-3 * number)
    pose = PoseChannel(stamp_ns, position, np.tile([0.0, 0.0, 0.0, 1.0], (30, 1)))
    DataSetWriter(folder / "set").add(Trajectory(pose=pose, name=f"press_{number}"), sphere(2e-3))


WRITERS: tuple[Write, ...] = (_sensor, _overlay, _image, _figures, _report, _data_set)


def _prepare(_folder: Path) -> None:
    # Beyond the limit on a file's size a write then fails as on a full disk.
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)


def _attempt(_prepared: None, random: Random, folder: Path) -> None:
    write = random.choice(WRITERS)
    write(folder, 1)
    before = _content(folder)
    _, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (random.choice((0, 1, 10, 300, 3000, 12000)), hard))
    try:
        write(folder, 2)
        is_written = True
    except (OSError, ValueError):
        is_written = False
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    after = _content(folder)
    if is_written:
        fresh = folder / "fresh"
        fresh.mkdir()
        write(fresh, 1)
        write(fresh, 2)
        expected = _content(fresh)
        after = {name: content for name, content in after.items() if not name.startswith("fresh")}
        if write is not _data_set and after != expected:
            raise Finding(f"{write.__name__} says that it wrote, but files differ")
    else:
        lost = [name for name, content in before.items() if after.get(name) != content]
        if lost:
            raise Finding(f"{write.__name__} failed, and {', '.join(lost)} is no longer as before")
        more = sorted(after.keys() - before.keys())
        if more and write is not _data_set:
            raise Finding(f"{write.__name__} failed and left {', '.join(more)}")
    if write is _data_set:
        for entry in read_data_set(folder / "set").entries:
            entry.read()
    if write is _overlay:
        read_overlay(folder / "overlay.yaml")


def _content(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


TARGETS = (Target("writing", _prepare, _attempt),)
