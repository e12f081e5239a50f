# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Run the fuzzer; see the package."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

from dotsim_ros.io.files import cache_directory
from fuzz import commands, files, learners, measured, messages, networks, sensors, writing
from fuzz.run import TargetSummary, attempt, limit_growth, prepare_in, run_target

TARGETS = {
    target.name: target
    for target in (
        *sensors.TARGETS,
        *files.TARGETS,
        *measured.TARGETS,
        *learners.TARGETS,
        *messages.TARGETS,
        *networks.TARGETS,
        *commands.TARGETS,
        *writing.TARGETS,
    )
}
if find_spec("rclpy") is not None:
    from fuzz import parameters

    TARGETS |= {target.name: target for target in parameters.TARGETS}

WORKER_COUNT = 2
CASES_BEYOND = 10_000_000
"""Between the first cases of one seed and the next."""


def main() -> int:
    """Run the command; return the exit status: 0 where nothing was found."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="for all targets together")
    parser.add_argument("--target", choices=sorted(TARGETS), action="append", help="only these")
    parser.add_argument("--seed", type=int, default=0, help="another one gives other cases")
    parser.add_argument("--case", type=int, help="run one case of one target, and show its error")
    arguments = parser.parse_args()
    # Answers are words for people; a cache of the user's own is no place for them.
    os.environ.setdefault("WARP_CACHE_PATH", str(cache_directory() / "warp"))
    with tempfile.TemporaryDirectory(prefix="fuzz_cache_") as cache:
        os.environ["DOTSIM_ROS_CACHE"] = cache
        targets = [TARGETS[name] for name in arguments.target or TARGETS]
        if arguments.case is not None:
            return _one(targets[0].name, arguments.case)
        slice_s = arguments.seconds * WORKER_COUNT / len(targets)
        first_case = CASES_BEYOND * arguments.seed
        with ThreadPoolExecutor(WORKER_COUNT) as pool:
            summaries = list(
                pool.map(
                    lambda target: run_target(target, seconds=slice_s, first_case=first_case),
                    targets,
                )
            )
    return _report(summaries)


def _one(name: str, case: int) -> int:
    with tempfile.TemporaryDirectory(prefix="fuzz_run_") as folder:
        prepared, cases = prepare_in(TARGETS[name], Path(folder))
        limit_growth()
        wrong = attempt(TARGETS[name], prepared, case, cases)
    print(wrong or f"{name} {case}: answered as it should")
    return int(wrong is not None)


def _report(summaries: list[TargetSummary]) -> int:
    for summary in summaries:
        print(
            f"{summary.target:14} {summary.case_count:7} cases, {len(summary.found)} wrong",
            flush=True,
        )
    known: set[tuple[str, str]] = set()
    for found in (found for summary in summaries for found in summary.found):
        lines = found.words.splitlines()
        # The place in the code, so that one defect is shown once.
        place = next((line for line in reversed(lines) if line.startswith('  File "')), lines[0])
        if (found.target, place) in known:
            continue
        known.add((found.target, place))
        print(f"\n{found.target} {found.case}: {lines[0][:500]}")
        print(f"  {place.strip()}")
        print(f"  again: python -m fuzz --target {found.target} --case {found.case}")
    empty = [summary.target for summary in summaries if not summary.case_count]
    if empty:
        print(f"\nno case of {', '.join(empty)} was tried: give more --seconds")
    return int(bool(known or empty))


if __name__ == "__main__":
    sys.exit(main())
