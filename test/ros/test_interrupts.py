# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every node ends at its first SIGINT, while it is imported or at a random moment once it is ready.

`benchmarks/interrupts.py` does the same a hundred times; `test_xarm_adapter.py` does it with the
adapter, whose messages have to be built first.
"""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from harness import START_PATIENCE_S, check_interrupts


@pytest.mark.parametrize("node", ["indenter_player", "tactile_record", "xarm_sim"])
def test_a_light_node_ends_at_the_first_sigint(node: str) -> None:
    check_interrupts(node, count=4)


@pytest.mark.parametrize("node", ["tactile_policy", "tactile_sim"])
def test_a_heavy_node_ends_at_the_first_sigint(node: str) -> None:
    check_interrupts(node, count=2)


def test_a_node_that_is_being_imported_ends_quietly() -> None:
    code = "from dotsim_ros.nodes.executables import tactile_sim; tactile_sim()"
    # Python says on stderr what it has imported.
    command = [sys.executable, "-X", "importtime", "-c", code]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        assert any("numpy" in line for line in lines)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=START_PATIENCE_S)
    assert process.returncode == 0
    assert "tactile_sim.node\n" not in errors, "it was imported before the signal came"
    assert "Traceback" not in output + errors
