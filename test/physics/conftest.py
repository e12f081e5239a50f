# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Worker processes and parts of gels that are made once for all tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from shared_work import share
from warm_workers import WarmWorkers

from dotsim_ros.io.worker_pool import pool


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
