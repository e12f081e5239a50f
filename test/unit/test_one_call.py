# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`calibrate` and `find_gap`: what cannot be done is refused before anything is touched, and what
the command line asks for is what the calls are given."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calibration_result import calibration

from dotsim_ros import Findings, Verdict, calibrate, find_gap, load_sensor, read_data_set
from dotsim_ros.calibration import calibrate as calibrate_module
from dotsim_ros.calibration.run import CalibrationRequest
from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set import find_indenter
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.trajectory import PoseChannel, SkinChannel, Trajectory, WrenchChannel
from dotsim_ros.gap import find as find_module
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.geometry.indenter import flat_punch, sphere
from dotsim_ros.geometry.skin_mesh import dome_skin

SKIN = dome_skin(0.01575, 4.0e-3)
BALL, PUNCH = sphere(0.004), flat_punch(0.004, 0.01)


def press(name: str) -> Trajectory:
    stamp_ns = np.arange(1, 4) * 40_000_000
    still = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    return Trajectory(
        pose=PoseChannel(stamp_ns, np.full((3, 3), 0.015), still),
        wrench=WrenchChannel(stamp_ns, np.ones((3, 3)), np.zeros((3, 3))),
        skin=SkinChannel(stamp_ns, np.repeat(SKIN.rest_position_m[None], 3, axis=0).astype("f4")),
        name=name,
    )


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("one_call") / "data"
    presses = [(press(f"press_{number}"), BALL) for number in range(3)]
    write_data_set(folder, [*presses, (press("flat"), PUNCH)], skin=SKIN)
    return folder


def files_below(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"out": "fitted.json"}, r"out is .*fitted\.json, expected a file that ends in \.yaml"),
        ({"fit": ("E", "mass")}, r"unknown parameters \['mass'\]"),
        ({"fit": ("offset",)}, "nothing to fit; name a parameter"),
        ({"losses": ("points", "area")}, "losses are points, area, expected of points, chamfer"),
        ({"trajectories": ["press_0", "press_9"]}, "has no trajectory press_9"),
        ({"leave_out": "cone"}, r"leaves 4 trajectories to fit on and 0 to judge on; indenters"),
        ({"leave_out": "sphere", "hold_out": 1}, "not both"),
        ({"hold_out": 4}, "cannot be held out"),
        ({"joint_steps": 5}, "joint_steps is 5, expected 0 to 4"),
    ],
)
def test_a_calibration_that_cannot_be_run_touches_nothing(tmp_path, data, given, reason):
    before = files_below(data)
    given = {
        "out": tmp_path / given.get("out", "fitted.yaml"),
        **{k: v for k, v in given.items() if k != "out"},
    }
    with pytest.raises(ValueError, match=reason):
        calibrate(data, **given)
    assert files_below(data) == before
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def asked(monkeypatch):
    """What was to be calibrated; nothing is solved."""
    requests: list[CalibrationRequest] = []

    def record(request: CalibrationRequest, _progress: object) -> object:
        requests.append(request)
        return replace(calibration(), specification=request.sensor)

    monkeypatch.setattr(calibrate_module, "run_calibration", record)
    return requests


def test_the_command_asks_for_what_the_call_is_given(tmp_path, data, asked, capsys):
    out, copy = tmp_path / "a.yaml", tmp_path / "figures" / "a.json"
    line = f"calibrate --data {data} --out {out} --sensor sensor_a --fit E friction offset"
    line += " --loss chamfer force --leave-out flat_punch --joint-steps 1 --solves 12 --workers 3"
    line += " --seed 4 --name mine --noise-force-n 0.02 --wrench-topic /force"
    assert main([*line.split(), "--json", str(copy)]) == 0
    report = tmp_path / "a_report" / "report.html"
    printed = capsys.readouterr().out.splitlines()
    assert printed[-2:] == [f"sensor: {out}", f"report: {report}"]
    assert copy.read_text() == report.with_name("report.json").read_text()
    calibrate(
        data,
        out=out,
        sensor="sensor_a",
        fit=("E", "friction", "offset"),
        losses=("chamfer", "force"),
        leave_out="flat_punch",
        joint_steps=1,
        solves=12,
        workers=3,
        seed=4,
        name="mine",
        noise=replace(asked[0].noise, force_n=0.02),
        topics=replace(asked[0].topics, wrench="/force"),
    )
    assert asked[0] == asked[1]
    request = asked[0]
    assert request.train == ("press_0", "press_1", "press_2")
    assert request.held_out == ("flat",)
    assert (request.fit, request.with_offset) == (("E", "friction"), True)
    assert request.directory == tmp_path / "a_report" / "run"
    assert request.noise.force_n == 0.02
    assert load_sensor(out).name == "mine"
    assert report.is_file()


def test_without_a_file_to_write_nothing_is_left(tmp_path, data, asked, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = calibrate(read_data_set(data), sensor=load_sensor("densetact2"))
    assert found.specification == load_sensor("densetact2")
    assert list(tmp_path.iterdir()) == []
    assert not asked[0].directory.exists()
    assert (asked[0].held_out, asked[0].losses) == ((), ("points", "force"))


@pytest.mark.parametrize(
    ("given", "error", "reason"),
    [
        ({"alpha": 0.0}, ValueError, r"alpha is 0\.0, expected between 0 and 1"),
        ({"workers": 0}, ValueError, "workers is 0, expected 1 or more"),
        (
            {"channels": ("force",), "candidates": ("gamma",)},
            ValueError,
            "none of gamma shows in force; name another effect or channel",
        ),
        ({"indenters": __file__}, ValueError, "expected a folder of meshes"),
        ({"reference": "nowhere"}, FileNotFoundError, "nowhere is no data set"),
        ({"channels": ("skin", "sound")}, ValueError, "no channel sound; known are skin, force"),
        ({"candidates": ("gravity",)}, ValueError, "no effect gravity; known are adhesion"),
        ({"effects": ("nowhere",)}, FileNotFoundError, "no folder of effects at nowhere"),
        ({"discrepancy": "no.npz"}, FileNotFoundError, r"there is nothing at no\.npz"),
        ({"sensor": "sensor_x"}, FileNotFoundError, "did you mean 'sensor_a'"),
    ],
)
def test_a_search_that_cannot_be_run_touches_nothing(tmp_path, data, given, error, reason):
    with pytest.raises(error, match=reason):
        find_gap(data, out=tmp_path / "report", **given)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.fault("find-gap", "a wrong argument, in the folder of a finished report")
@pytest.mark.parametrize(
    ("line", "status", "said"),
    [
        ("--alpha 7", 1, "alpha is 7.0, expected between 0 and 1"),
        ("--seed -1", 1, "seed is -1, expected 0 or more"),
        ("--measured nowhere", 1, "nowhere is no data set"),
        ("--demo", 1, "name a data set with --measured, or ask for --demo"),
    ],
)
def test_a_wrong_argument_leaves_a_finished_report_as_it_is(
    tmp_path, data, line, status, said, searched, capsys, answered
):
    searched(None)
    out = tmp_path / "report"
    find_gap(data, out=out)
    before = [path for path in files_below(tmp_path).items() if path[0].is_file()]
    assert main(["find-gap", "--measured", str(data), "--out", str(out), *line.split()]) == status
    answer = capsys.readouterr().err
    assert answer.count("\n") == 1
    assert said in answer
    assert [path for path in files_below(tmp_path).items() if path[0].is_file()] == before
    if line.startswith("--alpha 7"):
        answered(f"{answer} The report is as it was.", what="a wrong argument (--alpha 7)")


def test_the_demonstration_takes_no_argument_that_it_would_ignore(tmp_path, capsys):
    line = f"find-gap --demo --out {tmp_path / 'demo'} --candidates gamma --alpha 0.1"
    assert main(line.split()) == 1
    assert "leave out --candidates, --alpha" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("seed", "hidden", "answer", "status"),
    [
        (0, "hidden was slippery 0.437 of friction", "wrong", 1),
        (2, "hidden was nothing", "right", 0),
    ],
)
def test_the_demonstration_opens_the_truth_after_the_search_of_a_shipped_set(
    tmp_path, searched, capsys, seed, hidden, answer, status
):
    requests = searched(None)
    line = f"find-gap --demo --seed {seed} --out {tmp_path / 'demo'} --workers 1"
    assert main(line.split()) == status
    printed = capsys.readouterr().out
    assert "one of 3 sets, its truth sealed, sha256" in printed.splitlines()[0]
    assert hidden in printed
    assert f"the finder was {answer}" in printed
    (request,) = requests
    data = read_data_set(request.measured)
    assert len(data.entries) == 8
    assert {find_indenter(data, entry.indenter, None).name for entry in data.entries}


@pytest.fixture
def searched(monkeypatch):
    """Return what makes every search end in no gap, or in an error, and says what was searched."""

    def end_in(error: Exception | None) -> list[GapRequest]:
        requests: list[GapRequest] = []

        def record(request: GapRequest, _progress: object) -> tuple[Findings, None]:
            requests.append(request)
            if error is not None:
                raise error
            return Findings(Verdict.NO_GAP, "No gap."), None

        monkeypatch.setattr(find_module, "find_gap_with_images", record)
        return requests

    return end_in


def test_the_search_of_the_command_is_that_of_the_call(tmp_path, data, searched, capsys):
    requests = searched(None)
    out = tmp_path / "report"
    line = f"find-gap --measured {data} --out {out} --sensor densetact2 --alpha 0.05 --budget 7"
    line += f" --candidates adhesion gamma --reference {data} --seed 3 --workers 1"
    assert main([*line.split(), "--json", str(tmp_path / "found.json")]) == 0
    assert capsys.readouterr().out.splitlines() == ["", "No gap.", f"{out / 'report.html'}: no_gap"]
    findings = find_gap(
        data,
        out=out,
        sensor="densetact2",
        alpha=0.05,
        budget=7,
        candidates=["adhesion", "gamma"],
        reference=data,
        seed=3,
        workers=1,
    )
    assert findings.verdict is Verdict.NO_GAP
    assert requests[0] == requests[1]
    assert requests[0].channels == ("skin", "force")
    assert requests[0].directory == out / "run"
    assert (out / "findings.json").read_text() == (tmp_path / "found.json").read_text()


def test_data_that_cannot_be_used_are_a_verdict_with_a_report(tmp_path, data, searched):
    searched(ValueError("no force in any bag"))
    findings = find_gap(data, out=tmp_path / "report")
    assert findings.verdict is Verdict.UNUSABLE
    assert findings.sentence == "The data cannot be used: no force in any bag"
    assert "no force in any bag" in (tmp_path / "report" / "report.md").read_text()
    line = ["find-gap", "--measured", str(data), "--out", str(tmp_path / "other")]
    assert main(line) == 20
    assert (tmp_path / "other" / "report.html").is_file()


@pytest.mark.parametrize(
    ("verdict", "status"),
    [
        (Verdict.NO_GAP, 0),
        (Verdict.NAMED, 10),
        (Verdict.SET, 11),
        (Verdict.UNKNOWN, 12),
        (Verdict.UNUSABLE, 20),
    ],
    ids=lambda given: getattr(given, "value", given),
)
def test_each_verdict_ends_the_command_with_the_documented_status(
    tmp_path, data, verdict, status, monkeypatch
):
    found = Findings(verdict, "What was found.")
    monkeypatch.setattr(find_module, "find_gap_with_images", lambda *_: (found, None))
    assert main(["find-gap", "--measured", str(data), "--out", str(tmp_path / "report")]) == status
    page = (Path(__file__).parents[2] / "docs" / "gap_finder.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (\d+) \| ([^|]+) \|", page, re.MULTILINE))
    words = {Verdict.NAMED: "named", Verdict.UNUSABLE: "cannot be used"}
    assert words.get(verdict, verdict.value.replace("_", " ")) in rows[str(status)]


def test_a_search_without_a_report_leaves_nothing(tmp_path, data, searched, monkeypatch):
    requests = searched(None)
    monkeypatch.chdir(tmp_path)
    assert find_gap(data).sentence == "No gap."
    assert list(tmp_path.iterdir()) == []
    assert not requests[0].directory.parent.exists()


def test_a_data_set_that_is_not_there_is_no_verdict(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"is no data set: it holds no dataset\.yaml"):
        find_gap(tmp_path / "nowhere", out=tmp_path / "report")
    with pytest.raises(FileNotFoundError, match=r"is no data set: it holds no dataset\.yaml"):
        calibrate(tmp_path / "nowhere", out=tmp_path / "fitted.yaml")
    assert list(tmp_path.iterdir()) == []
