# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How the node starts, refuses to start, and ends."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from harness import Executable, refused_starts, with_parameters

from dotsim_ros.effects.overlay import Estimate, FoundEffect, Overlay, overlay_text
from dotsim_ros.nodes.tactile_sim.node import TactileSim

REFUSED: dict[str, dict[str, object]] = {
    "rate_hz": {"rate_hz": 1000.0},
    "expected one of realtime, lockstep": {"clock": "sundial"},
    "no_such_sensor": {"sensor": "no_such_sensor"},
    "no mesh file": {"indenter": "/no/such/mesh.stl"},
    "must differ": {"base_frame": "indenter"},
    "no idle image /no/such/image.png": {"idle_image": "/no/such/image.png"},
    "expected one of by_clock, exact, realtime, fast, auto": {"profile": "quick"},
    "lockstep shows each pose": {"profile": "fast", "clock": "lockstep"},
    "of type 'INTEGER', expecting type 'STRING': profile": {"profile": 3},
    "of type 'STRING_ARRAY', expecting type 'STRING': profile": {"profile": "[fast, auto]"},
    "GB of memory, expected at most 16 GB": {"grid_spacing_m": 0.0005},
}
"""Parameters that cannot work, by words of the reason."""
OVERLAYS = {
    "no overlay of effects at": None,
    "unknown effect 'ghost'; known are": ("ghost", Estimate("size", "", 1.0, 1.0, 1.0)),
    "force_scale.scale is 3, expected 0.8": (
        "force_scale",
        Estimate("scale", "", 3.0, 3.0, 3.0),
    ),
}
"""Effects that cannot work, by words of the reason."""
MILLIMETRES = "gel.outer_radius_m is 15.75, expected a number from 0.001 to 0.2 m; did you mean"


@pytest.fixture(scope="module")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return the log of each start that must be refused, by words of the reason."""
    folder = tmp_path_factory.mktemp("refused")
    given = dict(REFUSED)
    for number, (reason, found) in enumerate(OVERLAYS.items()):
        path = folder / f"{number}.yaml"
        if found is not None:
            effect = FoundEffect(found[0], (found[1],))
            path.write_text(overlay_text(Overlay("densetact2", "0123456789abcdef", (effect,))))
        given[reason] = {"effects": path}
    given[MILLIMETRES] = {"sensor": folder / "millimetres.yaml"}
    (folder / "millimetres.yaml").write_text("gel: {outer_radius_m: 15.75}\n")
    starts = {reason: with_parameters(parameters) for reason, parameters in given.items()}
    return refused_starts(TactileSim, starts)


@pytest.mark.parametrize("reason", [*REFUSED, *OVERLAYS, MILLIMETRES])
def test_a_start_that_cannot_work_is_refused_with_the_reason(
    refusals: dict[str, str], reason: str
) -> None:
    assert reason in refusals[reason]
    assert "Traceback" not in refusals[reason]


def test_simulated_time_without_a_clock_is_told_and_two_sigints_end_it() -> None:
    told = {
        "tactile_sim": "/clock is silent",
        "xarm_sim": "/clock is silent",
        "indenter_player": "no /clock comes",
    }
    with ExitStack() as stack:
        # All at once: each is silent for seconds before it says so.
        nodes = {
            name: Executable(f"dotsim_ros.nodes.{name}.node", {"use_sim_time": True})
            for name in told
        }
        for node in nodes.values():
            stack.callback(node.end)
        for name, node in nodes.items():
            node.wait_for_line(told[name])
            # test_in_the_middle.py interrupts a node that is at work.
            assert node.interrupt(2) == 0, node.log
            assert "Traceback" not in node.log


@pytest.mark.fault("node parameters", "a home that cannot be written, for the logs of ROS")
def test_a_home_that_cannot_be_written_ends_no_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answered: Callable[..., None]
) -> None:
    (tmp_path / "home").write_text("a file")
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    for name in ("ROS_HOME", "ROS_LOG_DIR"):
        monkeypatch.delenv(name, raising=False)
    node = Executable("dotsim_ros.nodes.xarm_sim.node", {})
    try:
        node.wait_for_line("ready:")
        assert node.interrupt(1) == 0, node.log
    finally:
        node.end()
    (line,) = (each for each in node.log.splitlines() if "nothing can be kept in" in each)
    assert "set ROS_LOG_DIR to a folder that can be written" in line
    answered(line)
    (kept,) = (tmp_path / "temporary").glob("dotsim_ros-*")
    assert list(kept.glob("*.log"))
