# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fuzzer finds what is planted: it would be of no use if every answer passed."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from random import Random

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from fuzz import run
from fuzz.mutate import flipped_bit, spoilt_bytes, spoilt_text, spoilt_tree
from fuzz.target import Finding, Target, answer

TREE = {"gel": {"radius_m": 0.016, "shape": "dome", "sizes": [1.0, 2.0]}, "name": "ball"}


def _hang(_prepared: object, _random: Random, _folder: Path) -> None:
    time.sleep(60.0)


def _grow(_prepared: object, _random: Random, _folder: Path) -> None:
    bytearray(3 * 2**30)


def _die(_prepared: object, _random: Random, _folder: Path) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _trace(_prepared: object, _random: Random, _folder: Path) -> None:
    {}["radius_m"]


def _hold(_prepared: object, random: Random, folder: Path) -> None:
    (folder / "kept").write_text(str(random.random()))


@pytest.mark.parametrize(
    ("attempt", "words", "hang_s"),
    [
        (_hang, "no answer within 0.5 s", 0.5),
        # Long enough that a stall of the machine is not taken for the fault.
        (_grow, "MemoryError", run.HANG_S),
        (_die, "the process died (-9)", run.HANG_S),
        (_trace, "KeyError: 'radius_m'", run.HANG_S),
    ],
)
def test_what_goes_wrong_is_found(
    attempt: object, words: str, hang_s: float, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(run, "HANG_S", hang_s)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    target = Target("planted", lambda folder: None, attempt)  # type: ignore[arg-type]
    summary = run.run_target(target, seconds=0.3, first_case=7)
    assert summary.found[0].words.startswith(words)
    assert summary.found[0].case == 7
    # A killed process leaves nothing behind.
    assert not list(tmp_path.iterdir())


def test_what_is_answered_is_no_finding() -> None:
    summary = run.run_target(
        Target("planted", lambda folder: None, _hold), seconds=2.0, first_case=0
    )
    assert not summary.found
    assert summary.case_count > 10


def _refuse(words: str) -> object:
    def read() -> None:
        raise ValueError(words)

    return read


@pytest.mark.parametrize(
    "words", ["no radius", "ball.yaml:\nno radius", "ball.yaml" + 3000 * "x", "ball.yaml: pickle"]
)
def test_a_refusal_that_does_not_help_is_a_finding(words: str) -> None:
    with pytest.raises(Finding):
        answer(_refuse(words), ["ball.yaml"])  # type: ignore[arg-type, func-returns-value]


def test_a_refusal_that_helps_is_an_answer() -> None:
    read = _refuse("ball.yaml has no radius")
    assert answer(read, ["ball.yaml"]) is None  # type: ignore[arg-type, func-returns-value]
    assert answer(lambda: 3, ["ball.yaml"]) == 3


def test_a_case_is_the_same_again() -> None:
    def once(number: int) -> list[object]:
        random = Random(number)
        return [
            spoilt_bytes(bytes(200), random),
            flipped_bit(bytes(200), random),
            spoilt_text("a: 1\nb: {c: 2}\n", random),
            repr(spoilt_tree(TREE, random)),
        ]

    assert once(3) == once(3)
    assert once(3) != once(4)


def test_mutations_change_what_they_are_given_and_nothing_else() -> None:
    content, before = bytes(range(200)), repr(TREE)
    changed = [spoilt_bytes(content, Random(n)) != content for n in range(200)]
    assert sum(changed) > 150
    for number in range(200):
        one = flipped_bit(content, Random(number))
        assert sum(bin(a ^ b).count("1") for a, b in zip(one, content, strict=True)) == 1
        spoilt_tree(TREE, Random(number))
    assert repr(TREE) == before
