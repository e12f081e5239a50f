# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gels, worker processes and parts of gels that are made once for all tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from gel_cases import FRICTIONLESS, YOUNGS_PA, pad_gel, pad_skin
from shared_work import share
from warm_workers import WarmWorkers

from dotsim_ros.gel.implicit.gel import ImplicitGel
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.worker_pool import pool


def _refined_pad(poisson_ratio: float) -> ImplicitGel:
    return pad_gel(
        law=NeoHookean(YOUNGS_PA, poisson_ratio),
        skin=pad_skin(0.6e-3),
        contact=FRICTIONLESS,
        indenter=sphere(20.0e-3),
        solver={"grid_spacing_m": 2.4e-3, "refined": True},
    )


@pytest.fixture(scope="session")
def refined_pads(tmp_path_factory: pytest.TempPathFactory) -> dict[float, ImplicitGel]:
    """Refined pads under a sphere of 20 mm, by Poisson's ratio; reset them before use."""
    # In a cache of their own, so that they are computed; what follows finds the user's.
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DOTSIM_ROS_CACHE", str(tmp_path_factory.mktemp("cache")))
        return {ratio: _refined_pad(ratio) for ratio in (0.3, 0.49)}


@pytest.fixture(scope="session", autouse=True)
def warm_workers() -> Iterator[None]:
    """Give one worker after the other to the pools of all tests."""
    workers = WarmWorkers()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "open_worker_pool", workers.open_pool)
        yield
    workers.close()


@pytest.fixture(scope="session", autouse=True)
def shared_work() -> Iterator[None]:
    """Let all tests share what they make of the same content."""
    with pytest.MonkeyPatch.context() as patch:
        share(patch)
        yield
