# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The options of all verbs that spread their work: how many workers, and where."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dotsim_ros.worker_pool.pool import Crew

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
    from dotsim_ros.worker_pool.pool import crew

    return crew(arguments.workers, arguments.ray_address)
