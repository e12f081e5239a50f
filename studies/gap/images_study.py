# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How often the gap finder is right about effects of the camera: nulls, and hidden laws by size.

The images are those of a measured data set. What images show where nothing is missing is learnt
from the trajectories that the twin's network was fitted on (`--noise` writes the file that the
package ships); all that is judged comes from the others: nulls are subsets of them as they were
measured, cases are hidden laws (`evaluation.gap.hidden.images`) applied to one subset. The nulls
are also drawn the other way round, learnt from the held-out trajectories and judged on subsets of
the fitted ones. Subsets overlap, so these are fewer independent draws than their number.

example:
  python benchmarks/gap_images.py --data ../shared/measured/sensor_a --run out/gap_images \
      --noise params/gap/optical_noise.npz --json docs/results/gap_images.json
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.arrays import FloatArray
from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.library import load_effects
from dotsim_ros.files import given_path, write_json
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.images.case import IDLE, OpticalCase
from dotsim_ros.gap.images.find import case_of
from dotsim_ros.gap.images.fit import ImageSearch
from dotsim_ros.gap.images.null import OpticalNull, fit_optical_null, save_optical_null
from dotsim_ros.gap.images.search import Signature, signatures_of
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.optics.network.card import read_network
from dotsim_ros.progress import PrintedProgress
from dotsim_ros.provenance import provenance
from dotsim_ros.specification import load_sensor
from studies.hidden.images import LAWS, ImageLaw, Takes, taken

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


def nulls(
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
        print(f"null {number}: {answer.verdict.value}, {answer.statistic:.1f}", flush=True)
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
    result = {
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
    print(
        f"{law.name} {size:g}: {answer.verdict.value} {named} {list(answer.alternatives)}, "
        f"{answer.statistic:.0f}",
        flush=True,
    )
    return result


def main() -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--sensor", default="sensor_a", help="name or file of the twin (sensor_a)")
    parser.add_argument("--run", type=Path, required=True, help="folder of the solves")
    parser.add_argument("--noise", type=Path, help="write what nulls show here")
    parser.add_argument("--nulls", type=int, default=12, help="of each of the two ways (12)")
    parser.add_argument("--laws", nargs="*", default=list(LAWS), choices=list(LAWS), help="(all)")
    parser.add_argument("--json", type=Path, help="write the figures here")
    arguments = parser.parse_args()
    begun_s = time.monotonic()
    # Before the noise is written, which may be a file that the repository holds.
    made_by = provenance()
    sensor = load_sensor(arguments.sensor)
    card = read_network(given_path(sensor.camera.residual))
    effects = [effect for effect in load_effects().values() if effect.image is not None]
    request = GapRequest(arguments.data, sensor, arguments.run, workers=1)
    study = Study(case_of(request, PrintedProgress()), effects)
    there = {shot.name for shot in study.case.shots}
    fitted = [name for name in card.data["train"] if name in there]
    others = [name for name in card.data["held_out"] if name in there]
    data = arguments.data.name
    source = f"{len(fitted)} trajectories of {data} that the network of {sensor.name} was fitted on"
    null = study.null(fitted, sensor.name, source)
    if arguments.noise is not None:
        save_optical_null(null, arguments.noise)
    swapped = study.null(others, sensor.name, f"{len(others)} trajectories held out")
    search = study.search(others[:: len(others) // SUBSET or 1][:SUBSET], null)
    held_out = nulls(study, null, others, arguments.nulls, 1)
    the_other_way = nulls(study, swapped, fitted, arguments.nulls, 2)
    cases = [(LAWS[name], size) for name in arguments.laws for size in LAWS[name].sizes]
    figures = {
        "provenance": made_by,
        "source": source,
        "pictures": sum(len(shot.measured) for shot in study.case.shots),
        "held_out": held_out,
        "swapped": the_other_way,
        "power_trajectories": [shot.name for shot in search.shots],
        "power": [power(search, law, size) for law, size in cases],
        "seconds": time.monotonic() - begun_s,
    }
    if arguments.json is not None:
        write_json(arguments.json, figures)
    wrong = [one for one in (*held_out, *the_other_way) if one["verdict"] != "no_gap"]
    print(f"{len(wrong)} false names in {len(held_out) + len(the_other_way)} nulls")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
