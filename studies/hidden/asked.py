# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A hidden unit that CalculiX solves along whatever is asked for: reality on demand.

The unit is one of a series of `python -m studies hide`: the same gel, mesh, mounting, instruments
and effect that made its set make what is recorded next.

    python -m studies hide --hidden slippery late --count 1 --seed 5 --out out/asked \\
        --trajectories hold_0 press_sphere_4mm_2 slide_0
    dotsim_ros find-gap --measured out/asked/set_00 --out out/asked_report \\
        --ask "python -m studies unit --of out/asked/set_00"

The twin of `data/hidden_17` is for its own units: CalculiX slid them in increments as long as
frames, so that it has more friction than units that are made now.
"""

from __future__ import annotations

import time
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.data.measurement import read_poses
from dotsim_ros.data.motion import Motion
from dotsim_ros.data.recording import Recording
from dotsim_ros.data.trajectory import write_trajectory
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import load_sensor
from studies.hidden.solved_draw import SolvedUnit
from studies.hidden.solved_sets import SKIN_SPACING_M, SeriesPlan, read_series
from studies.hidden.solved_unit import Protocol, measured


def unit(planned: Path, out: Path, *, of: Path) -> dict[str, Any]:
    """Record planned trajectories with a hidden unit, as `find-gap --ask` has it do.

    Args:
        planned: folder of the poses, a data set.
        out: folder that gets a bag of the name of each.
        of: the unit's folder in a series that `python -m studies hide` made; any unit of a series
            can be asked, whether its set is made or not.

    Raises:
        FileNotFoundError, ValueError: as `hidden_unit`; poses or an indenter that cannot be read.
        CalculixMissingError, UnsolvedError, OSError: as `solved_unit.measured`.
    """
    plan, own = hidden_unit(of)
    skin = dome_skin(plan.sensor.gel.outer_radius_m, SKIN_SPACING_M)
    recordings, left_out = read_poses(planned, skin=skin)
    if left_out:
        raise ValueError(f"{planned}: {left_out[0]}; write its poses again")
    made = {}
    for recording in recordings:
        begun_s = time.monotonic()
        name = recording.name
        trajectory, tries = measured(
            own,
            plan.sensor,
            skin,
            _protocol(recording),
            load_indenter(recording.press.indenter),
            np.random.default_rng([*own.seed, 5, zlib.crc32(name.encode())]),
            coarseness=plan.coarseness,
        )
        write_trajectory(out / name, trajectory)
        seconds = time.monotonic() - begun_s
        made[name] = {"frames": recording.press.frame_count, "tries": tries, "seconds": seconds}
    return {"trajectories": made}


def hidden_unit(folder: Path) -> tuple[SeriesPlan, SolvedUnit]:
    """Return how a series is made, and the unit of one of its folders.

    Raises:
        FileNotFoundError: the folder lies in no series.
        ValueError: it is of no unit, or this version draws another one.
    """
    index, records = read_series(folder.parent)
    plan = SeriesPlan(
        load_sensor(index["sensor"]),
        index["count"],
        index["seed"],
        coarseness=index["coarseness"],
        hidden=tuple(index.get("hidden", ())),
    )
    sealed = {record.name: record.truth_sha256 for record in records}
    if folder.name not in sealed:
        raise ValueError(f"{folder} is no set of its series; choose of {', '.join(sealed)}")
    own = next(one for one in plan.units() if one.name == folder.name)
    if own.digest() != sealed[folder.name]:
        raise ValueError(f"{folder} has another truth than this version draws; make it again")
    return plan, own


def _protocol(recording: Recording) -> Protocol:
    """Return planned poses as a motion, straight from one to the next."""
    press = recording.press
    time_s = press.stamp_s - press.stamp_s[0]
    return Protocol(recording.name, press.indenter, Motion(time_s, tuple(press.poses)), time_s)
