# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every node ends at its first SIGINT, at a random moment after it is ready.

`benchmarks/interrupts.py` does the same a hundred times; `test_xarm_adapter.py` does it with the
adapter, whose messages have to be built first.
"""

from __future__ import annotations

import pytest
from harness import check_interrupts


@pytest.mark.parametrize("node", ["indenter_player", "tactile_record", "xarm_sim"])
def test_a_light_node_ends_at_the_first_sigint(node: str) -> None:
    check_interrupts(node, count=4)


@pytest.mark.parametrize("node", ["tactile_policy", "tactile_sim"])
def test_a_heavy_node_ends_at_the_first_sigint(node: str) -> None:
    check_interrupts(node, count=2)
