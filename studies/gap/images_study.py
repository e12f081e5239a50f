# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How often the gap finder is right about effects of the camera: nulls, and hidden laws by size.

The images are those of a measured data set. What images show where nothing is missing is learnt
from the trajectories that the twin's network was fitted on (RUN/optical_noise.npz, which the
package ships); all that is judged comes from the others: nulls are subsets of them as they were
measured, cases are hidden laws (`studies.hidden.images`) applied to one subset. The nulls
are also drawn the other way round, learnt from the held-out trajectories and judged on subsets of
the fitted ones. Subsets overlap, so these are fewer independent draws than their number.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.images.case import IDLE, OpticalCase
from dotsim_ros.gap.images.find import case_of, images_of
from dotsim_ros.gap.images.fit import ImageSearch
from dotsim_ros.gap.images.null import OpticalNull, fit_optical_null, save_optical_null
from dotsim_ros.gap.images.search import Signature, signatures_of
from dotsim_ros.gap.presses.search import read_measurements
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.files import given_path
from dotsim_ros.io.progress import PrintedProgress
from dotsim_ros.optics.network.card import read_network
from dotsim_ros.specification import load_sensor
from studies.data import SENSOR_A
from studies.hidden.images import LAWS, ImageLaw, Takes, taken
from studies.run import expect_known, expect_positive

Signatures = Mapping[str, Sequence[Signature]]

ALPHA = 0.02
SUBSET = 6
"""Trajectories of a case."""


class Study:
    """Images of a data set with the signatures of all effects, made once."""

    def __init__(self, case: OpticalCase, effects: Sequence[Effect]) -> None:
        self.case, self.effects = case, list(effects)
        self._by_name = {shot.name: shot for shot in case.shots}
        progress = PrintedProgress()
        self._signatures: dict[str, Signatures] = {}
        for number, shot in enumerate(case.shots):
            self._signatures[shot.name] = signatures_of(effects, [shot.film], case.meter)
            progress("signatures", number + 1, len(case.shots))

    def signatures(self, names: Sequence[str]) -> dict[str, tuple[Signature, ...]]:
        """Return the signatures of effects on some trajectories."""
        found = {}
        for effect in self.effects:
            several = zip(*(self._signatures[name][effect.name] for name in names), strict=True)
            found[effect.name] = tuple(
                replace(probe[0], blocks=tuple(one.blocks[0] for one in probe)) for probe in several
            )
        return found

    def null(self, names: Sequence[str], sensor: str, source: str) -> OpticalNull:
        """Return what some trajectories show in which nothing is missing."""
        case = replace(self.case, shots=tuple(self._by_name[name] for name in names))
        return fit_optical_null(
            case, self.effects, sensor=sensor, source=source, signatures=self.signatures(names)
        )

    def search(self, names: Sequence[str], null: OpticalNull) -> ImageSearch:
        """Return the search of some trajectories, the idle images among them."""
        all_names = [IDLE, *names]
        shots = [self._by_name[name] for name in all_names]
        signatures = self.signatures(all_names)
        return ImageSearch(
            self.case, shots, self.effects, null, alpha=ALPHA, seed=0, signatures=signatures
        )


def answers_to_nulls(
    study: Study, null: OpticalNull, names: Sequence[str], count: int, seed: int
) -> list[dict[str, Any]]:
    """Return what the finder makes of subsets of trajectories as they were measured."""
    found = []
    for number in range(count):
        random = np.random.default_rng([seed, number])
        drawn = sorted(random.choice(names, SUBSET, replace=False).tolist())
        answer = study.search(drawn, null).answer()
        found.append(
            {
                "trajectories": drawn,
                "verdict": answer.verdict.value,
                "named": [one.effect.name for one in answer.named],
                "statistic": answer.statistic,
                "threshold": answer.threshold,
                "excess": answer.excess,
                "largest_excess": answer.largest_excess,
            }
        )
    return found


def power(search: ImageSearch, law: ImageLaw, size: float) -> dict[str, Any]:
    """Return what the finder makes of a hidden law in the images of a search."""
    idle = np.asarray(search.shots[0].film.idle, dtype=np.float64)
    residuals: list[FloatArray] = []
    for shot in search.shots:
        takes = Takes(shot.measured.astype(np.float64), shot.film.session_s, idle)
        images = taken(takes, law, size)
        residuals.append(search.case.meter.difference(images, shot.film.pixels))
    answer = search.answer(residuals)
    named = [one.effect.name for one in answer.named]
    if law.library:
        is_right = answer.verdict is Verdict.NAMED and named == [law.library]
        is_in_set = answer.verdict is Verdict.SET and law.library in {*named, *answer.alternatives}
    else:
        is_right, is_in_set = answer.verdict is Verdict.UNKNOWN, False
    return {
        "law": law.name,
        "library": law.library,
        "size": size,
        "unit": law.unit,
        "verdict": answer.verdict.value,
        "named": named,
        "alternatives": list(answer.alternatives),
        "is_right": is_right,
        "is_in_set": is_in_set,
        "statistic": answer.statistic,
        "threshold": answer.threshold,
        "explained": answer.explained,
        "excess": answer.excess,
        "stability": answer.stability,
        "estimates": {
            name: {e.name: [e.value, e.low, e.high] for e in estimates}
            for name, estimates in answer.estimates.items()
        },
    }


def gap_images(
    *,
    data: Path = SENSOR_A,
    sensor: str = "sensor_a",
    run: Path = Path("out/gap_images"),
    nulls: int = 12,
    laws: tuple[str, ...] = tuple(LAWS),
) -> dict[str, Any]:
    """How often the gap finder is right about effects of the camera.

    Args:
        data: folder of the data set.
        sensor: name or file of the twin.
        run: folder of the solves, and of what nulls show.
        nulls: of each of the two ways.
        laws: that are hidden, of `studies.hidden.images`.
    """
    expect_positive(nulls=nulls)
    expect_known("law", laws, LAWS)
    begun_s = time.monotonic()
    twin = load_sensor(sensor)
    card = read_network(given_path(twin.camera.residual))
    effects = [effect for effect in load_effects().values() if effect.image is not None]
    request = GapRequest(data, twin, run, channels=("image",), workers=1)
    images, model = images_of(twin, *read_measurements(request))
    study = Study(case_of(request, images, model, PrintedProgress()), effects)
    there = {shot.name for shot in study.case.shots}
    fitted = [name for name in card.data["train"] if name in there]
    others = [name for name in card.data["held_out"] if name in there]
    source = (
        f"{len(fitted)} trajectories of {data.name} that the network of {twin.name} was fitted on"
    )
    null = study.null(fitted, twin.name, source)
    save_optical_null(null, run / "optical_noise.npz")
    swapped = study.null(others, twin.name, f"{len(others)} trajectories held out")
    search = study.search(others[:: len(others) // SUBSET or 1][:SUBSET], null)
    return {
        "source": source,
        "pictures": sum(len(shot.measured) for shot in study.case.shots),
        "held_out": answers_to_nulls(study, null, others, nulls, 1),
        "swapped": answers_to_nulls(study, swapped, fitted, nulls, 2),
        "power_trajectories": [shot.name for shot in search.shots],
        "power": [power(search, LAWS[name], size) for name in laws for size in LAWS[name].sizes],
        "seconds": time.monotonic() - begun_s,
    }
