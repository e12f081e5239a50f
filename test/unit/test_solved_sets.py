# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Hidden effects that finite elements solve: what is drawn, what is solved, what is written."""

import fcntl
import hashlib
import json
import os
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.scripted import Site
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import Estimate
from dotsim_ros.gap.ask import search_and_ask
from dotsim_ros.gap.findings import Candidate, Findings, Verdict, as_record
from dotsim_ros.gap.presses import questions
from dotsim_ros.gap.presses.catalogue import Planned
from dotsim_ros.gap.presses.covariance import load_discrepancy, save_discrepancy
from dotsim_ros.gel.material import Yeoh
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.files import parameter_path, write_json
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies import run
from studies.gap import solved_score
from studies.gap.solved_score import (
    LEARNT_SINCE,
    ScoreRequest,
    gap_physics,
    kind_of,
    outcome_of,
    rates_of,
    score_sets,
)
from studies.hidden import solved_sets, solved_unit
from studies.hidden.asked import hidden_unit
from studies.hidden.solved_draw import (
    COMPOSITION,
    DECLARED,
    HALVES,
    KNOWN,
    LAWS,
    NULL,
    SINGLE,
    draw_series,
)
from studies.hidden.solved_sets import SeriesPlan, hide, make_sets, read_series
from studies.hidden.solved_unit import Protocol, protocols
from studies.reference.blocks import StepControl
from studies.reference.press import ReferenceSettings, press_poses, reference_deck
from studies.reference.run import solve
from studies.reference.unit_deck import MaxwellBranch, OgdenStiffening, StiffPart, UnitDeck

SENSOR = load_sensor("sensor_a")
PRESS = "press_sphere_4mm_0"
FRAMES = (0, 2, 5)
"""Of a press's six, those that are solved here."""
COMMISSIONED = 2
"""Meshes that the unit as declared is solved on here."""

needs_calculix = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="CalculiX is not installed: apt-get install calculix-ccx"
)


def test_a_series_has_the_composition_and_each_effect_lies_in_both_halves() -> None:
    units = draw_series(SENSOR, 32, 3)
    assert Counter(unit.kind for unit in units) == COMPOSITION
    assert Counter(unit.half for unit in units) == dict.fromkeys(HALVES, 16)
    singles = [unit for unit in units if unit.kind == SINGLE]
    for name in KNOWN:
        halves = {unit.half for unit in singles if unit.effects[0].name == name}
        assert halves == set(HALVES), name
    assert len({unit.name for unit in units}) == 32


def test_units_are_within_what_is_declared_and_decoys_nearly_out_of_it() -> None:
    for unit in draw_series(SENSOR, 64, 1):
        own = unit.constants
        deviations = {
            "youngs_modulus": np.log(own.youngs_modulus_pa / 1.8642e5) / 0.08,
            "friction": np.log(own.friction / SENSOR.contact.friction_coefficient) / 0.2,
            "thickness": own.thickness_share / 0.01,
            "clock": own.clock_s / 0.003,
            "force_gain": (own.force_gain - 1.0) / 0.03,
        }
        assert bool(unit.decoys) == (unit.kind == NULL)
        assert set(unit.decoys) <= set(DECLARED)
        for name, deviation in deviations.items():
            low, high = (0.99, 1.51) if name in unit.decoys else (0.0, 1.01)
            assert low <= abs(deviation) <= high, (unit.name, name)


def test_a_seed_draws_the_same_again_and_another_one_something_else() -> None:
    first, again, other = (draw_series(SENSOR, 8, seed) for seed in (4, 4, 5))
    assert [unit.digest() for unit in first] == [unit.digest() for unit in again]
    assert not {unit.digest() for unit in first} & {unit.digest() for unit in other}


def test_the_library_has_the_effects_that_the_laws_say_it_has() -> None:
    library = load_effects()
    for law in LAWS.values():
        assert not law.library or law.library in library
    for unit in draw_series(SENSOR, 64, 2):
        for effect in unit.effects:
            law = LAWS[effect.name]
            assert law.low <= effect.size <= law.high
            if effect.against_twin is None:
                assert law.name in {"ogden_stiffening", "two_branches"} or not law.library
                continue
            parameter = library[law.library].parameters[0]
            assert parameter.low <= effect.against_twin <= parameter.high


@pytest.mark.parametrize(
    ("verdict", "named", "alternatives", "hidden", "outcome"),
    [
        ("no_gap", [], [], set(), "right"),
        ("named", ["latency"], [], set(), "false name"),
        ("set", ["latency"], ["backlash"], set(), "false name"),
        ("unknown", [], [], set(), "called unknown"),
        ("no_gap", [], [], {"latency"}, "missed"),
        ("named", ["latency"], [], {"latency"}, "right"),
        ("named", ["backlash"], [], {"latency"}, "wrong name"),
        ("named", ["backlash", "latency"], [], {"latency"}, "with a wrong one"),
        ("set", ["backlash"], ["latency"], {"latency"}, "in the set"),
        ("set", ["backlash"], ["gamma"], {"latency"}, "wrong name"),
        ("unknown", [], [], {"latency"}, "called unknown"),
        ("named", ["latency"], [], {"latency", "backlash"}, "one of two"),
        ("named", ["latency", "backlash"], [], {"latency", "backlash"}, "right"),
        ("unknown", [], [], {""}, "right"),
        ("named", ["latency"], [], {""}, "wrong name"),
        ("unusable", [], [], {"latency"}, "refused"),
    ],
)
def test_an_answer_is_worth(
    verdict: str, named: list[str], alternatives: list[str], hidden: set[str], outcome: str
) -> None:
    assert outcome_of(verdict, named, alternatives, hidden) == outcome


def test_what_the_library_learnt_since_is_no_longer_outside_of_it() -> None:
    slides = {"kind": "outside", "effects": [{"name": "slipping_core", "library": ""}]}
    uneven = {"kind": "outside", "effects": [{"name": "uneven_cure", "library": ""}]}
    assert (kind_of(slides), kind_of(uneven)) == ("single", "outside")
    assert kind_of({"kind": "null", "effects": []}) == "null"
    assert set(LEARNT_SINCE.values()) <= set(load_effects())


def _deck(depth_m: float = 1.2e-3, hold_s: float = 0.0, **changed: object) -> UnitDeck:
    """Return the deck of a quick press, held after it where a time is given."""
    site = Site(outer_radius_m=SENSOR.gel.outer_radius_m, tilt_rad=0.2)
    poses = press_poses(site, depth_m=depth_m, frame_count=1)
    poses += [poses[-1]] * (hold_s > 0.0)
    control = StepControl(first=1.0)
    plain = reference_deck(
        SENSOR,
        dome_skin(SENSOR.gel.outer_radius_m, 2.5e-3),
        load_indenter("sphere_4mm"),
        poses,
        ReferenceSettings(4.5e-3, 1.2e-3, control=control, drag_control=control),
    )
    made = {"law": Yeoh(3.2e4, 2.0e3, 0.0, 1.2e6), "duration_s": (1e-3, hold_s)[: len(poses) - 1]}
    return UnitDeck(
        plain.gel, plain.surface, poses, contact=SENSOR.contact, controls=plain.controls,
        **(made | changed),  # type: ignore[arg-type]
    )  # fmt: skip


def _force_n(deck: UnitDeck) -> np.ndarray:
    solution = solve(deck, time_limit_s=400.0)
    assert not solution.failure
    return np.array([np.linalg.norm(step.force_n) for step in solution.steps])


@pytest.fixture(scope="module")
def plain_n() -> float:
    """Force of the quick press with nothing wrong."""
    return float(_force_n(_deck())[0])


@needs_calculix
def test_branches_relax_by_their_shares_in_their_times(plain_n: float) -> None:
    branches = (MaxwellBranch(0.2, 0.6), MaxwellBranch(0.1, 3.0))
    hold_s = 0.7
    fast, slow = _force_n(_deck(hold_s=hold_s, branches=branches))
    # Of the shear modulus; the bulk modulus does not relax.
    left = 1.0 - sum(b.share * (1.0 - np.exp(-hold_s / b.time_s)) for b in branches)
    softer = _force_n(_deck(law=Yeoh(left * 3.2e4, left * 2.0e3, 0.0, 1.2e6)))[0]
    assert fast == pytest.approx(plain_n, rel=0.02)
    assert slow == pytest.approx(softer, rel=0.02)
    assert slow < 0.9 * fast


@needs_calculix
def test_ogden_s_stiffening_is_that_of_yeoh_s_at_the_strain_of_a_press() -> None:
    plain, like_yeoh = (
        _deck(1.8e-3, law=Yeoh(3.2e4, 0.0, 0.0, 1.2e6)),
        Yeoh(3.2e4, 1.28e4, 0, 1.2e6),
    )
    soft, yeoh = _force_n(plain)[0], _force_n(replace(plain, law=like_yeoh))[0]
    ogden = _force_n(replace(plain, stiffening=OgdenStiffening.like(0.4)))[0]
    assert yeoh > 1.05 * soft
    # From the sixth order on it is another law.
    assert (ogden - soft) / (yeoh - soft) == pytest.approx(1.0, abs=0.3)


@needs_calculix
def test_a_base_that_gives_way_takes_depth_in_proportion_to_the_force(plain_n: float) -> None:
    compliance_m_n = 1.0e-4
    given = _force_n(_deck(base_compliance_m_n=compliance_m_n))[0]
    assert given < 0.95 * plain_n
    shallower = _force_n(_deck(1.2e-3 - compliance_m_n * given))[0]
    assert given == pytest.approx(shallower, rel=0.02)


@needs_calculix
def test_a_stiff_part_is_stiffer_and_a_core_that_slips_softer(plain_n: float) -> None:
    deck = _deck()
    whole = StiffPart(np.arange(len(deck.gel.element)), 2.0)
    # The contact's own stiffness stays.
    assert 1.7 * plain_n < _force_n(replace(deck, stiff=whole))[0] < 2.0 * plain_n
    radius_m = np.linalg.norm(deck.gel.node_m[deck.gel.bonded], axis=1)
    on_core = radius_m < SENSOR.gel.core_radius_m * (1.0 + 1e-6)
    above = deck.gel.node_m[deck.gel.bonded][:, 2] > 1e-3
    slipping = deck.gel.bonded[on_core & above]
    assert _force_n(replace(deck, slipping=slipping))[0] < 0.99 * plain_n


def _thinned(sensor: SensorSpecification, random: np.random.Generator) -> list[Protocol]:
    """Return the protocols with the first, a middle and the last frame of each press."""
    return [
        replace(one, time_s=one.time_s[list(FRAMES)]) if one.name.startswith("press") else one
        for one in protocols(sensor, random)
    ]


@pytest.fixture(scope="module", autouse=True)
def small_series() -> Iterator[None]:
    """Make the sets of presses of few frames, and few of these."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solved_sets, "protocols", _thinned)
        patch.setattr(solved_sets, "COMMISSIONED", COMMISSIONED)
        yield


def _hide(out: Path, *, seed: int = 6, retry: bool = False) -> dict[str, Any]:
    given: dict[str, Any] = {"count": 1, "trajectories": (PRESS,), "coarseness": 1.6}
    return hide(out=out, seed=seed, retry=retry, **given)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with one set of one trajectory."""
    out = tmp_path_factory.mktemp("hidden") / "sets"
    found = _hide(out)
    assert (found["sets"], found["trajectories"], found["failed"]) == (1, 1 + COMMISSIONED, {})
    return out


@needs_calculix
def test_a_set_is_made_resumed_and_its_truth_sealed(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = Path(shutil.copytree(made, tmp_path / "sets"))
    index, (record,) = read_series(out)
    assert record.is_ready
    assert record.made == (PRESS,)
    assert index["seed"] == 6
    truth = (out / "set_00" / "truth.json").read_bytes()
    assert hashlib.sha256(truth).hexdigest() == record.truth_sha256
    stem, number = PRESS.rsplit("_", 1)
    commissioned = {f"{stem}_{int(number) + mesh}" for mesh in range(COMMISSIONED)}
    assert {entry.name for entry in read_data_set(out / "commissioning").entries} == commissioned
    data_set = read_data_set(out / "set_00")
    (entry,) = data_set.entries
    trajectory = entry.read()
    assert trajectory.skin is not None
    assert trajectory.wrench is not None
    assert trajectory.skin.position_m.shape == (len(FRAMES), data_set.skin_mesh().vertex_count, 3)
    load = np.linalg.norm(trajectory.wrench.force_n, axis=1)
    assert load[0] < 0.1
    assert all(after > before for before, after in pairwise(load))
    assert load[-1] > 0.5
    names = {effect["name"] for effect in json.loads(truth)["effects"]}
    assert not any(name in (out / "set_00" / "dataset.yaml").read_text() for name in names)

    bag = data_set.entries[0].bag / f"{PRESS}.mcap"
    before = bag.stat().st_mtime_ns
    # As a run that was ended before it could say that the set is whole.
    index["sets"][0] |= {"ready": False, "made": []}
    (out / "index.json").write_text(json.dumps(index))
    _hide(out)
    assert bag.stat().st_mtime_ns == before
    assert read_series(out)[1][0] == record
    _hide(out)
    assert "there already" in capsys.readouterr().out

    handle = os.open(out, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with pytest.raises(BlockingIOError, match="another run is making sets"):
        _hide(out)
    os.close(handle)

    with pytest.raises(ValueError, match="holds sets of seed 6, asked for were 7"):
        _hide(out, seed=7)
    half = next(half for half in HALVES if half != record.half)
    with pytest.raises(ValueError, match="no set of the half"):
        score_sets(ScoreRequest(out, half, SENSOR, tmp_path / "run"))


@needs_calculix
def test_answers_of_before_are_scored_without_another_search(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(solved_score, "UNFINISHED", 1)
    _, (record,) = read_series(made)
    (effect,) = json.loads((made / "set_00" / "truth.json").read_text())["effects"]
    true = effect["against_twin"] if effect["against_twin"] is not None else 1.0
    estimate = Estimate("parameter", "", true * 1.01, *sorted((0.9 * true, 1.1 * true)))
    name = effect["library"]
    found = Findings(
        Verdict.NAMED,
        "",
        named=(name,),
        statistic=50.0,
        threshold=40.0,
        candidates=(Candidate(name, name, True, 50.0, 0.0, estimates=(estimate,)),),
        share_closed=0.9,
    )
    cache = tmp_path / "run"
    error = parameter_path(solved_score.SHIPPED)
    asked = ScoreRequest(made, record.half, SENSOR, cache).asked()
    kept = {"truth_sha256": record.truth_sha256, "made": [PRESS], "asked": asked}
    kept["commit"] = "0123456789ab"
    write_json(cache / "set_00" / "findings.json", kept | {"findings": as_record(found)})
    given: dict[str, Any] = {"half": record.half, "discrepancy": error, "cache": cache}
    figures = gap_physics(sets=made, sensor="sensor_a", **given)
    (row,) = figures["halves"][record.half]["sets"]
    assert row["outcome"] == "right"
    assert row["searched_at"] == "0123456789ab"
    assert all(one["covers"] for one in row["estimates"])
    assert len(row["estimates"]) == (effect["against_twin"] is not None)

    # Another twin, or another error of its own, is another question.
    another = tmp_path / "discrepancy.npz"
    save_discrepancy(replace(load_discrepancy(), source="another"), another)
    assert ScoreRequest(made, record.half, SENSOR, cache, discrepancy=another).asked() != asked
    other = replace(SENSOR, contact=replace(SENSOR.contact, friction_coefficient=0.3))
    assert ScoreRequest(made, record.half, other, cache).asked() != asked

    with pytest.raises(ValueError, match="give --sensor sensor_a"):
        gap_physics(sets=made, sensor="densetact2", **given)
    tampered = Path(shutil.copytree(made, tmp_path / "tampered"))
    (tampered / "set_00" / "truth.json").write_text("{}")
    with pytest.raises(ValueError, match="is not the truth whose SHA-256"):
        gap_physics(sets=tampered, sensor="sensor_a", **given)


@needs_calculix
def test_a_trajectory_that_is_not_solved_is_listed_and_is_no_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Increments of which CalculiX cannot solve any.
    hopeless = StepControl(first=1.0, smallest=1.0, count=1)
    monkeypatch.setattr(solved_unit, "EFFORTS", ((1.0, hopeless),))
    monkeypatch.setattr(solved_unit, "TIME_LIMIT_S", 0.2)
    assert f"set_00/{PRESS}" in _hide(tmp_path / "sets")["failed"]
    _, (record,) = read_series(tmp_path / "sets")
    assert record.is_ready
    assert record.made == ()
    assert "did not finish it in 1 tries" in record.failures[PRESS]
    assert not (tmp_path / "sets" / "set_00" / "bags").exists()
    monkeypatch.setattr(solved_unit, "LEAST_FREE_BYTES", 10**18)
    assert _hide(tmp_path / "sets")["failed"]  # before, and not tried again
    with pytest.raises(OSError, match="MB left for its files"):
        _hide(tmp_path / "sets", retry=True)
    assert read_series(tmp_path / "sets")[1] == [record]
    row = score_sets(ScoreRequest(tmp_path / "sets", record.half, SENSOR, tmp_path / "run"))
    assert row["sets"][0]["outcome"] == "too few trajectories"


def test_what_stands_in_the_way_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if shutil.which("ccx"):
        (tmp_path / "mine.txt").write_text("mine")
        with pytest.raises(FileExistsError, match=r"holds files, and no index\.json"):
            _hide(tmp_path)
        with pytest.raises(ValueError, match="no trajectory somersault"):
            make_sets(tmp_path / "new", SeriesPlan(SENSOR, 1, 0, ("somersault",)))
    monkeypatch.setenv("PATH", "")
    assert run.main(["hide", "--out", str(tmp_path / "new")]) == 1
    assert "hide: CalculiX is not installed" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    with pytest.raises(ValueError, match="coarseness is 3, expected 1 to 2"):
        SeriesPlan(SENSOR, 1, 0, coarseness=3.0)
    assert run.main(["gap_physics", "--sets", str(tmp_path / "new")]) == 1
    assert "make the sets with python -m studies hide" in capsys.readouterr().err


@needs_calculix
def test_a_hidden_unit_answers_what_a_search_asks_as_it_answered_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sets, hidden = tmp_path / "sets", ("late", "mounted_off")
    made = hide(out=sets, seed=6, count=1, trajectories=(PRESS,), coarseness=1.6, hidden=hidden)
    assert (made["sets"], made["trajectories"], made["failed"]) == (1, 1, {})
    truth = json.loads((sets / "set_00" / "truth.json").read_text())
    assert truth["kind"] == "pair"
    assert tuple(effect["name"] for effect in truth["effects"]) == hidden

    def as_before(*_: object) -> list[Planned]:
        plan = SeriesPlan(SENSOR, 1, 6, (PRESS,), 1.6, hidden)
        (one,) = solved_sets._protocols(plan, plan.units()[0])
        poses = tuple(one.motion.at(float(t)) for t in one.time_s)
        return [Planned("press", one.indenter, "the press of before", one.time_s, poses)]

    monkeypatch.setattr(questions, "catalogue", as_before)
    monkeypatch.setattr(questions, "LEAST_NATS", -1.0)
    monkeypatch.setenv("PYTHONPATH", str(run.ROOT))
    search_and_ask(
        sets / "set_00",
        f"{sys.executable} -m studies unit --of {sets / 'set_00'}",
        # A refined gel needs tables for each skin: minutes.
        sensor=replace(SENSOR, solver=replace(SENSOR.solver, refined=False, grid_spacing_m=4.8e-3)),
        out=tmp_path / "report",
        next_presses=1,
        rounds=1,
        announce=print,
        candidates=("pose_offset",),
        workers=1,
    )
    before, again = (entry.read() for entry in read_data_set(tmp_path / "report/asked").entries)
    # The same gel, mesh, lateness and mounting; noise of its own.
    for one, other, deviation in (
        (again.wrench.force_n, before.wrench.force_n, solved_unit.FORCE_NOISE_N),
        (again.skin.position_m, before.skin.position_m, solved_unit.SKIN_NOISE_M),
        (again.pose.position_m, before.pose.position_m, solved_unit.POSE_NOISE_M),
    ):
        assert 0.0 < np.abs(one - other).max() < 8.0 * deviation
    with pytest.raises(ValueError, match="is no set of its series; choose of set_00"):
        hidden_unit(sets / "set_07")


def test_rates_are_shares_of_each_kind() -> None:
    rows = [
        {"kind": "null", "outcome": "right"},
        {"kind": "null", "outcome": "false name"},
        {
            "kind": "single",
            "outcome": "right",
            "estimates": [{"covers": True}],
            "share_closed": 0.8,
        },
        {"kind": "outside", "outcome": "right"},
    ]
    rates = rates_of(rows)
    assert rates["nulls_right"]["share"] == 0.5
    assert rates["single_right"]["of"] == 1
    assert rates["intervals_that_cover"]["share"] == 1.0
    assert rates["pairs_both"]["share"] is None
    assert rates["median_share_closed"] == 0.8
