# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Every node ends at its first SIGINT, while it is imported or at a random moment once it is ready.

`test_xarm_adapter.py` does the same with the adapter, whose messages have to be built first.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from harness import START_PATIENCE_S, check_interrupts


@pytest.mark.parametrize(
    ("node", "count", "parameters"),
    [
        ("indenter_player", 2, {}),  # while it waits for a subscriber
        ("xarm_sim", 2, {}),
        ("tactile_policy", 2, {"policy": "densetact2_sphere"}),
        ("tactile_sim", 2, {"grid_spacing_m": 0.0048}),
    ],
)
def test_a_node_ends_at_the_first_sigint(
    node: str, count: int, parameters: dict[str, object]
) -> None:
    check_interrupts(node, count=count, parameters=parameters)


def test_a_recorder_ends_at_the_first_sigint(tmp_path: Path) -> None:
    topics = {"topics": "['wrench']"}
    check_interrupts(
        "tactile_record", count=2, ready="recording", parameters=topics, output=tmp_path
    )


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
