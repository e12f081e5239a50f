# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a set of protocols can identify, before anyone measures: detectable sizes, and effects
that look alike (step 7 of the method)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.measurement import protocol_of, read_poses
from dotsim_ros.effects.effect import FORCE
from dotsim_ros.effects.simulate import EffectRequest, open_solver
from dotsim_ros.gap.decision import ALIKE, APART
from dotsim_ros.gap.presses.assumptions import ABSOLUTE, centred
from dotsim_ros.gap.presses.certainty import pairs_of
from dotsim_ros.gap.presses.covariance import ChannelNoise, load_discrepancy
from dotsim_ros.gap.presses.evidence import make_case
from dotsim_ros.gap.presses.inference import cosines, lengths
from dotsim_ros.gap.presses.screening import excited_variants
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.gap.presses.weighed import EFFECT as FORCE_SCALE
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.io.cores import single_threaded

WEIGHT = (
    "rest a known mass on the force gauge for some seconds, hung on it or, where the gauge carries "
    "the sensor, on the dome; list the bag with its mass_kg under 'weights' of dataset.yaml. "
    "Without it a force scale that is wrong by less than a third is taken for another stiffness"
)
"""The protocol that no press replaces."""

FOUND = 8.0
"""Whitened size from which an effect is found with 95 % probability: its score, the square, is to
pass a limit of about 40 (`decision.HEAVIER` times the threshold of simulated nulls)."""


@single_threaded()
def plan(request: GapRequest) -> dict[str, Any]:
    """Return what the protocols of a data set can identify.

    Args:
        request: whose `measured` holds the poses; what else it holds is not used.

    Returns:
        `effects`: for each, the whitened size of its first probe, the size that can be found, its
        unit, and seconds of each protocol; `cosines`: of each pair; `alike`: pairs that are too
        close, with what to add; `silent`: effects that nothing excites, with what would; `add`:
        protocols next to presses that are missing, with how to record them.
    """
    data_set = read_data_set(request.measured)
    # That of the planned measurement, where it is known.
    has_mesh = data_set.has_skin_mesh
    skin = data_set.skin_mesh() if has_mesh else skin_of(request.sensor.gel)
    recordings, warnings = read_poses(data_set, skin=skin, indenters=request.indenters)
    library = request.library()
    values = values_of(request.sensor)
    with open_solver(
        request.sensor, skin, request.directory / "solves", workers=request.workers
    ) as solver:
        # What will be measured: forces set the discrepancy, and how far an arm gives way.
        expected = solver.run([EffectRequest(r, values) for r in recordings])
        recordings = tuple(
            replace(
                r,
                press=replace(r.press, skin_position_m=e.skin_position_m, force_n=e.force_n),
            )
            for r, e in zip(recordings, expected, strict=True)
        )
        discrepancy = load_discrepancy(request.discrepancy)
        nuisances = centred(ABSOLUTE, discrepancy.bias)
        case, left_out = make_case(
            recordings,
            (),
            values=values,
            nuisances=nuisances,
            library=library,
            solver=solver,
            skin=skin,
            noise=ChannelNoise(),
            discrepancy=discrepancy,
            channels=request.channels,
        )
        variants, silent = excited_variants(case)
        first = {v.effect.name: v for v in reversed(variants)}
        variants = [v for v in variants if first[v.effect.name] is v]
        probes = [v.effect.parameters[0].probes[0] for v in variants]
        failures = case.extend(list(zip(variants, probes, strict=True)))
    chosen = range(len(case.trajectories))
    evidence = case.evidence(chosen)
    names = [v.effect.name for v in variants]
    columns = [
        case.whitened(case.change_at(v, probe), chosen)
        for v, probe in zip(variants, probes, strict=True)
    ]
    matrix = np.stack(columns, axis=1)
    size, rho = lengths(evidence, matrix), cosines(evidence, matrix)
    moved = [probe - v.absent for v, probe in zip(variants, probes, strict=True)]
    smallest = {
        name: float(abs(moved[k]) * FOUND / max(size[k], 1e-9)) for k, name in enumerate(names)
    }
    if FORCE_SCALE in smallest and data_set.weights:
        # A weight alone gives it, to its own tolerance.
        smallest[FORCE_SCALE] = APART * min(one.tolerance for one in data_set.weights)
    pairs = pairs_of(
        evidence, [v.effect for v in variants], matrix, [t.recording for t in case.trajectories]
    )
    return {
        "protocols": {
            protocol_of(t.recording): float(np.ptp(t.recording.press.stamp_s))
            for t in case.trajectories
        },
        "effects": {
            name: {
                "whitened_size": float(size[k]),
                "probe": float(moved[k]),
                "smallest_found": smallest[name],
                "unit": library[name].parameters[0].unit,
            }
            for k, name in enumerate(names)
        },
        "cosines": {
            name: {other: float(rho[i, j]) for j, other in enumerate(names)}
            for i, name in enumerate(names)
        },
        "alike": [
            {
                "first": p.first,
                "second": p.second,
                "cosine": p.cosine,
                "add": p.remedy,
                "best_trajectory": p.best_trajectory,
                "separation_per_s": p.best_per_s,
            }
            for p in pairs
            if abs(p.cosine) > ALIKE
        ],
        "silent": {name: library[name].protocol for name in silent},
        "add": {} if data_set.weights or FORCE not in request.channels else {"weight": WEIGHT},
        "warnings": [*warnings, *left_out, *failures],
    }


def plan_lines(planned: Mapping[str, Any]) -> list[str]:
    """Return a plan as lines of text."""
    lines = [f"{'effect':<26}{'whitened':>9}{'smallest found':>16}"]
    for name, found in planned["effects"].items():
        lines.append(
            f"{name:<26}{found['whitened_size']:9.1f}{found['smallest_found']:14.3g} "
            f"{found['unit']}"
        )
    lines += [
        f"{pair['first']} and {pair['second']} look alike (cosine {pair['cosine']:.3f}); add "
        f"{pair['add']}; of these, {pair['best_trajectory']} separates them most per second"
        for pair in planned["alike"]
    ]
    for name, protocol in planned["silent"].items():
        lines.append(f"{name}: nothing excites it; add {protocol}")
    lines += [f"add the protocol {name}: {how}" for name, how in planned["add"].items()]
    lines += [f"- {text}" for text in planned["warnings"]]
    return lines
