# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files of effects are programs: only what is named is run, and a broken one is one line."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dotsim_ros import find_gap
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.trajectory import PoseChannel, Trajectory, WrenchChannel
from dotsim_ros.effects.effect import (
    Active,
    EffectError,
    Response,
    gel_with,
    motion_filters,
    response_filters,
)
from dotsim_ros.effects.library import effect_names, load_effects
from dotsim_ros.gap import find as find_module
from dotsim_ros.gap.findings import Findings, Verdict
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin

GOOD = """
from __future__ import annotations
from dataclasses import dataclass, replace
from dotsim_ros.effects.effect import FORCE, Effect, EffectParameter

@dataclass
class State:
    share: float

def _response(values):
    state = State(values["share"])
    return lambda response: replace(response, force_n=(1.0 + state.share) * response.force_n)

EFFECT = Effect(
    name="own", title="My own", channels=(FORCE,), protocol="any",
    parameters=(EffectParameter("share", "", 0.0, 0.0, 1.0, (0.5,)),),
    excited_by=lambda recording: True, response=_response,
)
"""

BROKEN: dict[str, tuple[str | bytes, str]] = {
    "a syntax error": ("EFFECT = Effect(\n", r"own\.py is no Python, line 1: .*never closed"),
    "an error at its import": (
        "EFFECT = 1 / 0\n",
        "cannot be run: ZeroDivisionError: division by",
    ),
    "sys.exit": (
        "import sys\nEFFECT = sys.exit(3)\n",
        "cannot be run: SystemExit: 3; expected a",
    ),
    "not UTF-8": ("# gr\u00f6\u00dfer\n".encode("latin-1"), "is no Python.*a program in UTF-8"),
    "a zero byte": (b"x = 1\x00\n", r"is no Python|cannot be run"),
    "another name": (
        GOOD.replace('"own"', '"other"'),
        "holds the effect 'other', expected its own",
    ),
    "no parameter": (
        GOOD.replace('(EffectParameter("share", "", 0.0, 0.0, 1.0, (0.5,)),)', "()"),
        "expected at least one EffectParameter",
    ),
    "a first parameter that is never absent": (
        GOOD.replace('"share", "", 0.0,', '"share", "", None,'),
        "expected the value at which the effect is absent",
    ),
    "an unknown channel": (
        GOOD.replace("(FORCE,)", '("sound",)'),
        "expected of skin, force, image",
    ),
    "no hook": (
        GOOD.replace(", response=_response", ""),
        "the effect has no hook, expected one of",
    ),
    "a hook of too many arguments": (
        GOOD.replace("def _response(values)", "def _response(values, recording)"),
        r"the hook response cannot be called with 1 argument .*docs/extend\.md",
    ),
    "a hook that asks for another parameter": (
        GOOD.replace('values["share"]', 'values["size"]'),
        r"the hook response fails with the probes \{'share': 0\.5\}: KeyError: 'size'",
    ),
    "an excited_by without an argument": (
        GOOD.replace("lambda recording: True", "lambda: True"),
        "excited_by cannot be called with 1 argument",
    ),
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "own_effects"
    made.mkdir()
    (made / "own.py").write_text(GOOD, encoding="utf-8")
    return made


def spy(folder: Path, name: str) -> Path:
    """Write a file that leaves a mark when it is run; return the mark."""
    mark = folder.parent / f"{name}_was_run"
    code = f"EFFECT = open({str(mark)!r}, 'w').close()\n"
    (folder / f"{name}.py").write_text(code, encoding="utf-8")
    return mark


@pytest.mark.fault("effects and overlays", "a broken file of an effect of one's own")
@pytest.mark.parametrize("what", list(BROKEN))
def test_a_broken_file_is_one_line(folder: Path, what: str, answered: Callable[..., None]) -> None:
    content, reason = BROKEN[what]
    raw = content if isinstance(content, bytes) else content.encode()
    (folder / "own.py").write_bytes(raw)
    with pytest.raises(ValueError, match=reason) as refused:
        load_effects([folder])
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(str(folder / "own.py"))
    answered(refused.value, what=f"a file of an effect: {what}")
    # A file that nobody asks for harms nobody.
    assert "own" not in load_effects([folder], names=["gamma"])


@pytest.mark.fault("effects and overlays", "files next to the effects that are asked for")
def test_only_what_is_named_is_run(
    folder: Path, caplog: pytest.LogCaptureFixture, answered: Callable[..., None]
) -> None:
    mark, hidden = spy(folder, "other"), spy(folder, "_helper")
    assert effect_names([folder])[-2:] == ("other", "own")
    said: list[str] = []
    found = load_effects([folder], names=["own", "gamma"], announce=said.append)
    assert found["own"].title == "My own"
    assert not mark.exists()
    assert said == [f"runs the code of effects of your own: {folder / 'own.py'}"]
    answered(f"{said[0]} (no other file of the folder)")
    # Once is enough, until the file changes.
    load_effects([folder], names=["own"], announce=said.append)
    assert len(said) == 1
    (folder / "own.py").write_text(GOOD.replace("My own", "Mine"), encoding="utf-8")
    assert load_effects([folder], names=["own"], announce=said.append)["own"].title == "Mine"
    assert len(said) == 2
    # The whole folder is run where all of it is asked for, and said before.
    with caplog.at_level(logging.WARNING), pytest.raises(ValueError, match="holds no EFFECT"):
        load_effects([folder])
    assert mark.exists()
    assert not hidden.exists()
    assert f"runs the code of effects of your own: {folder / 'other.py'}" in caplog.text


@pytest.mark.fault("effects and overlays", "a folder of other programs for the effects")
def test_programs_that_hold_no_effect_are_not_run(
    folder: Path, tmp_path: Path, answered: Callable[..., None]
) -> None:
    mark = tmp_path / "was_run"
    (folder / "a_program.py").write_text(f"open({str(mark)!r}, 'w').close()\n")
    said: list[str] = []
    with pytest.raises(ValueError, match=r"a_program\.py holds no EFFECT.*was run") as refused:
        load_effects([folder], announce=said.append)
    assert not mark.exists()
    assert not said
    answered(refused.value)


def test_the_search_runs_no_file_that_no_candidate_names(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    libraries = []

    def searched(request: GapRequest, _progress: object) -> tuple[Findings, None]:
        libraries.append(request.library())
        return Findings(Verdict.NO_GAP, "No gap."), None

    monkeypatch.setattr(find_module, "find_gap_with_images", searched)
    mark = spy(folder, "other")
    pose = PoseChannel(
        np.array([1, 2]), np.full((2, 3), 0.5), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    )
    wrench = WrenchChannel(pose.stamp_ns, np.zeros((2, 3)), np.zeros((2, 3)))
    press = Trajectory(pose=pose, wrench=wrench, name="a")
    write_data_set(tmp_path / "data", [(press, sphere(0.004))], skin=dome_skin(0.01575, 4e-3))
    out = tmp_path / "report"
    # The arguments are looked at before any file is run.
    with pytest.raises(ValueError, match=r"no effect ghost; known are .*other, own"):
        find_gap(tmp_path / "data", out=out, effects=[folder], candidates=["ghost"])
    with pytest.raises(ValueError, match="alpha is 7"):
        find_gap(tmp_path / "data", out=out, effects=[folder], alpha=7.0)
    assert not mark.exists()
    find_gap(tmp_path / "data", out=out, effects=[folder], candidates=["own"])
    assert not mark.exists()
    assert "own" in libraries[0]


RESPONSE = Response(
    0.0, 0.0, Pose(np.zeros(3)), 0.0, np.zeros((4, 3)), np.zeros((4, 3)), np.array([0.0, 0.0, 1.0])
)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("* response.force_n", "* response.force"), "hook response fails with AttributeError"),
        (("replace(response, ", "dict("), "hook response gives .*expected a Response"),
        (("* response.force_n", "* response.force_n[:2]"), r"the force of shape \(2,\), expected"),
        (
            ("* response.force_n", "* float('nan') * response.force_n"),
            "the force that is not finite",
        ),
    ],
)
def test_a_hook_that_fails_later_is_named(
    folder: Path, change: tuple[str, str], reason: str
) -> None:
    (folder / "own.py").write_text(GOOD.replace(*change), encoding="utf-8")
    active = Active(load_effects([folder])["own"], {"share": 0.1})
    with pytest.raises(EffectError, match=f"the effect own.*{reason}"):
        response_filters([active])(RESPONSE)
    assert motion_filters([active])(0.0, RESPONSE.pose, np.zeros(3)) is RESPONSE.pose


def test_a_gel_hook_that_returns_no_gel_is_named(folder: Path) -> None:
    text = GOOD.replace("response=_response", "gel=lambda term, values, recording: None")
    (folder / "own.py").write_text(text, encoding="utf-8")
    active = Active(load_effects([folder])["own"], {"share": 0.1})
    with pytest.raises(EffectError, match="its hook gel gives None, expected a GelTerm"):
        gel_with([active], None, None)  # type: ignore[arg-type]
