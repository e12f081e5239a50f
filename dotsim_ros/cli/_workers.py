# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Options of the verbs that spread their work: how many workers, and where; and its progress."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dotsim_ros.io.worker_pool.pool import Crew

COUNT = 2


def add_worker_arguments(parser: argparse.ArgumentParser) -> None:
    """Add `--workers` and `--ray-address`."""
    parser.add_argument(
        "--workers",
        type=int,
        default=COUNT,
        help=f"processes, or with --ray-address workers of the cluster, at most ({COUNT})",
    )
    parser.add_argument(
        "--ray-address",
        metavar="ADDRESS",
        help="work on a Ray cluster: HOST:PORT of its head; auto, the one that this machine is "
        "part of; local, Ray on this machine alone (processes of this machine, without Ray)",
    )


def crew_of(arguments: argparse.Namespace) -> Crew:
    """Return the workers that were asked for.

    Raises:
        ValueError: no worker, or an address of another form.
    """
    from dotsim_ros.io.worker_pool.pool import crew

    return crew(arguments.workers, arguments.ray_address)


def show_stage(stage: str, done: int, total: int) -> None:
    """Draw a bar on a terminal; elsewhere print each stage's beginning and end."""
    if sys.stderr.isatty():
        filled = 30 * done // max(total, 1)
        end = "\n" if done == total else ""
        print(f"\r{stage:<10} [{'#' * filled:<30}] {done}/{total}", end=end, file=sys.stderr)
    elif done in (0, total):
        print(f"{stage}: {done}/{total}", file=sys.stderr, flush=True)
