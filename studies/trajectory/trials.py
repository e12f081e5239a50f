# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories followed by touch alone: the settings, the trials, and the score of a recording.

What runs the loop is handed in, so nothing here needs ROS.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from dotsim_ros.control.loop.judge import judge, summary_of, trial_start
from dotsim_ros.control.loop.recording import LoopRecording
from dotsim_ros.control.policy.paths import PATHS, DomeContact, reference_path
from dotsim_ros.control.policy.rollout import APPROACH_S
from dotsim_ros.control.safety_layer.limits import SafetyLimits
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.cache import PHYSICS, content_key, tell_broken
from dotsim_ros.io.documents import read_yaml
from dotsim_ros.io.files import given_path, parameter_path, write_image, write_text
from dotsim_ros.io.provenance import provenance
from dotsim_ros.optics.idle import description_of, resample
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.specification import load_sensor, sensor_path

SettingName = Literal["simulated", "transferred", "shifted", "reality"]
SETTINGS: tuple[SettingName, ...] = get_args(SettingName)
SIMULATED, TRANSFERRED, SHIFTED, REALITY = SETTINGS
RELAXING_SHARE, RELAXING_S, THINNER, SLIPPERIER = 0.17, 1.0, 0.104, 0.43
"""What the gap finder said of five sets that finite elements made, each with one effect: a share of
the stress that relaxes, a gel thinner by a share, and a friction that is a share of the twin's."""
REALITY_SPACING_M = 2.4e-3
"""Of the gel's grid: finer than the one of the loop."""
MODULI = {"youngs_modulus_pa", "c10_pa", "c01_pa", "c20_pa", "c30_pa", "bulk_modulus_pa"}
STIFFER, DIMMED, TILT_DEG = 1.1, 0.6, 1.0
CAMERA_NOISE_LEVELS = 1.2
"""Image noise of the camera of `sensor_a`, as its data set states it; differences of its five idle
images confirm it."""
TRIES = 3
PARAMETERS = "closed_loop.yaml"
"""The parameters of the loop, which decide it, too."""


@dataclass(frozen=True)
class Setting:
    """A sensor that the policy is tried on.

    Attributes:
        name: one of SETTINGS.
        sensor: name or file of the sensor.
        noise_levels: standard deviation of the camera's noise, of 255.
        content: hash of what the sensor is made of.
        grid_spacing_m: of its gel; None for the loop's.
    """

    name: str
    sensor: str
    noise_levels: float = 0.0
    content: str = ""
    grid_spacing_m: float | None = None


@dataclass(frozen=True)
class TrialPlan:
    """What is tried.

    Attributes:
        settings: which sensors.
        paths: names of the paths.
        trial_count: of each path in each setting.
        seconds: that the policy leads, the approach of APPROACH_S included.
        seed: of the starts.
        policy: hash of the policy's weights.
        clock: of the loop: simulated or realtime.
    """

    settings: tuple[Setting, ...]
    paths: tuple[str, ...]
    trial_count: int = 10
    seconds: float = 12.0
    seed: int = 0
    policy: str = ""
    clock: str = "simulated"

    def __post_init__(self) -> None:
        unknown = sorted(set(self.paths) - set(PATHS))
        if unknown or not self.paths:
            raise ValueError(
                f"no path {', '.join(unknown) or 'is named'}; choose from {', '.join(PATHS)}"
            )
        if self.trial_count < 1 or self.seconds < APPROACH_S + 1.0:
            raise ValueError(
                f"{self.trial_count} trials of {self.seconds:g} s: expected at least one, of at "
                f"least {APPROACH_S + 1.0:g} s"
            )

    def file_of(self, setting: Setting, path: str, number: int) -> str:
        """Return the name of the file that keeps a trial."""
        what = (self.policy, setting.content, path, number, self.seed, self.seconds, self.clock)
        key = content_key(
            (*PHYSICS, "optics", "control", "nodes"),
            what,
            setting.noise_levels,
            parameter_path(PARAMETERS).read_bytes(),
        )
        return f"{setting.name}-{path}-{number}-{key}.npz"


Loop = Callable[[Setting, str, FloatArray, float], LoopRecording]
"""Runs a closed loop: returns what it did in a setting, along a path, from a start (3,) in metres,
for so many seconds; OSError where it could not be run."""


@dataclass
class TrajectoryTrials:
    """The recordings of a plan, and their figures.

    Attributes:
        recordings: of each trial, by setting and path.
        rows: the figures of each, in the same order.
    """

    recordings: dict[tuple[str, str], list[LoopRecording]] = field(default_factory=dict)
    rows: dict[tuple[str, str], list[dict[str, Any]]] = field(default_factory=dict)


def setting_of(name: str, folder: Path, *, trained_on: str) -> Setting:
    """Return a setting; files of sensors that are made are written into a folder.

    Args:
        name: one of SETTINGS.
        folder: for files that are made.
        trained_on: name or file of the sensor that the policy was trained on.

    Raises:
        ValueError: no such setting.
    """
    noise_levels = CAMERA_NOISE_LEVELS if name in (TRANSFERRED, REALITY) else 0.0
    spacing_m = REALITY_SPACING_M if name == REALITY else None
    if name == SIMULATED:
        source, path = trained_on, sensor_path(trained_on)
    elif name == TRANSFERRED:
        source, path = "sensor_a", sensor_path("sensor_a")
    elif name in (SHIFTED, REALITY):
        path = write_shifted(folder, trained_on) if name == SHIFTED else write_reality(folder)
        source = str(path)
    else:
        raise ValueError(f"there is no setting {name!r}; choose one of {', '.join(SETTINGS)}")
    return Setting(name, source, noise_levels, _content(path), spacing_m)


def write_shifted(folder: Path, source: str) -> Path:
    """Write a sensor with a stiffer gel, dimmed light and a tilted camera, and return its file.

    The camera turns in its place: its idle image is the sensor's own, seen from there.
    """
    document = read_yaml(sensor_path(source))
    sensor = load_sensor(source)
    document["name"] = f"{sensor.name}_shifted"
    material = document["material"]
    for constant in MODULI & material.keys():
        material[constant] = STIFFER * float(material[constant])
    turn = Rotation.from_rotvec([np.radians(TILT_DEG), 0.0, 0.0])
    turned = Rotation.from_quat(sensor.camera.quaternion_xyzw) * turn
    camera = document["camera"]
    camera["quaternion_xyzw"] = [float(number) for number in turned.as_quat()]
    own = Camera.from_specification(sensor.camera)
    x, y, z, w = camera["quaternion_xyzw"]
    tilted = Camera.from_specification(replace(sensor.camera, quaternion_xyzw=(x, y, z, w)))
    seen = resample(idle_frame_of(sensor, own).image, own, tilted)
    idle_file = folder.absolute() / "shifted_idle.png"
    write_image(idle_file, np.rint(DIMMED * seen).astype(np.uint8))
    description = description_of(sensor)
    if description is not None:
        shutil.copyfile(description, idle_file.with_suffix(".yaml"))
    camera["idle_image"] = str(idle_file)
    return _written(folder / "shifted.yaml", document)


def write_reality(folder: Path) -> Path:
    """Write `sensor_a` with a gel that relaxes, is thinner and slips more easily, and return its
    file; camera and lights are its own, and so is the network that completes its image."""
    document = read_yaml(sensor_path("sensor_a"))
    document["material"] |= {"prony_shares": [RELAXING_SHARE], "prony_times_s": [RELAXING_S]}
    gel, contact = document["gel"], document["contact"]
    gel["core_radius_m"] += THINNER * (gel["outer_radius_m"] - gel["core_radius_m"])
    contact["friction_coefficient"] *= SLIPPERIER
    return _written(folder / "reality.yaml", document)


def _written(path: Path, document: Mapping[str, Any]) -> Path:
    write_text(path, yaml.safe_dump(document, sort_keys=False))
    return path


def _content(path: Path) -> str:
    """Return a hash of a sensor's file; where its images lie does not count."""
    document = read_yaml(path)
    idle = document.get("camera", {}).pop("idle_image", "")
    digest = hashlib.sha256(json.dumps(document, sort_keys=True).encode())
    if idle:
        digest.update(given_path(idle).read_bytes())
    return digest.hexdigest()[:16]


def run_trials(
    plan: TrialPlan,
    loop: Loop,
    limits: SafetyLimits,
    cache: Path,
) -> TrajectoryTrials:
    """Run what has not been run before, and judge all.

    Args:
        plan: what to try.
        loop: runs it.
        limits: that the motion is held against.
        cache: folder of the recordings; an interrupted run is resumed.

    Raises:
        OSError: a trial could not be run in TRIES tries.
    """
    contact = DomeContact()
    trials = TrajectoryTrials()
    for setting in plan.settings:
        for name in plan.paths:
            path = reference_path(name, contact)
            for number in range(plan.trial_count):
                kept = cache / plan.file_of(setting, name, number)
                recording = _kept(kept)
                if recording is None:
                    start = trial_start(path, contact, seed=plan.seed, number=number)
                    recording = _tried(loop, setting, name, start, plan.seconds)
                    recording.save(kept)
                row = judge(recording, path, limits)
                trials.recordings.setdefault((setting.name, name), []).append(recording)
                trials.rows.setdefault((setting.name, name), []).append(row)
                print(f"{setting.name}, {name}, trial {number + 1}: {summary_of(row)}")
    return trials


def _kept(path: Path) -> LoopRecording | None:
    """Return the recording of a trial that was run before; None where there is none to be used."""
    try:
        return LoopRecording.load(path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        tell_broken(path, error)
        return None


def _tried(
    loop: Loop,
    setting: Setting,
    path: str,
    start_m: FloatArray,
    seconds: float,
) -> LoopRecording:
    for left in reversed(range(TRIES)):
        try:
            recording = loop(setting, path, start_m, seconds)
        except OSError as error:
            if not left:
                raise
            print(f"{setting.name}, {path}: {error}; once more")
        else:
            known = provenance()
            made = {key: known[key] for key in ("commit", "date", "machine")}
            return replace(recording, notes={**recording.notes, **made})
    raise AssertionError("TRIES is at least one")


def summarize(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the figures of several trials: mean and deviation of the trials' mean errors."""
    judged = [row for row in rows if "mean_error_mm" in row]
    moved = [row for row in rows if "speed_mm_s" in row]
    errors = [row["mean_error_mm"] for row in judged]
    stops: dict[str, int] = {}
    for row in rows:
        for reason, count in row["stops"].items():
            stops[reason] = stops.get(reason, 0) + count
    figures: dict[str, Any] = {
        "trials": len(rows),
        "judged": len(judged),
        "ended_early": sum(bool(row["ended"]) for row in rows),
        "stops": stops,
        "exceeded": sum(bool(row["exceeded"]) for row in moved),
    }
    if judged:
        figures |= {
            "mean_error_mm": round(float(np.mean(errors)), 4),
            "std_mm": round(float(np.std(errors, ddof=1)), 4) if len(errors) > 1 else None,
            "p95_error_mm": round(float(np.mean([row["p95_error_mm"] for row in judged])), 4),
            "largest_error_mm": max(row["largest_error_mm"] for row in judged),
            "progress": round(
                float(
                    sum(row["laps"] for row in judged)
                    / sum(row["laps_of_expert"] for row in judged)
                ),
                3,
            ),
        }
    for name in ("speed_mm_s", "turn_rate_rad_s", "acceleration_m_s2", "turn_rad", "force_n"):
        figures[name] = max((row[name] for row in moved), default=None)
    if moved:
        figures["excursion_mm"] = np.max([row["excursion_mm"] for row in moved], axis=0).tolist()
        for name in ("frame_rate_hz", "command_rate_hz", "feedback_rate_hz"):
            figures[name] = round(float(np.mean([row[name] for row in moved])), 2)
    return figures


def trajectory_figures(plan: TrialPlan, trials: TrajectoryTrials) -> dict[str, Any]:
    """Return the figures as the JSON file holds them."""
    figures: dict[str, Any] = {}
    for setting in plan.settings:
        by_path = {name: trials.rows[setting.name, name] for name in plan.paths}
        together = [row for rows in by_path.values() for row in rows]
        figures[setting.name] = summarize(together) | {
            "sensor": Path(setting.sensor).name,
            "camera_noise_levels": setting.noise_levels,
            "paths": {name: summarize(rows) for name, rows in by_path.items()},
            "rows": by_path,
        }
    return figures
