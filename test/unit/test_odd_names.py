# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names that a file system takes and a report, figure or terminal would trip over."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np
import pytest
from calibration_result import calibration
from gap_findings import named

from dotsim_ros import calibrate, load_sensor
from dotsim_ros.calibration import calibrate as calibrate_module
from dotsim_ros.calibration.calibrate import report_folder
from dotsim_ros.calibration.run import Calibration
from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set_writer import write_data_set
from dotsim_ros.data.reading import Omission
from dotsim_ros.data.trajectory import (
    RECORDED_TOPICS,
    ImageChannel,
    PoseChannel,
    Trajectory,
    WrenchChannel,
    write_trajectory,
)
from dotsim_ros.effects.library import load_effects
from dotsim_ros.gap.report.write import write_report
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.io.page import Bullets, Page, Section, Table, as_markdown
from dotsim_ros.io.printable import figure_label, one_line

NAMES = (
    r"costs $5 and $x_{2$",
    r"a_b^{c}\frac{1}%",
    "<script>alert(1)</script>|&\"'",
    "`code` [a](b) *c* _d_ ~~e~~",
    "# first\nsecond\tthird",
    "bell \x07, escape \x1b[31m, byte \udcff",
    "right \u202eto left",
    "Fläche 圧力 \N{GRINNING FACE}",
    "x" * 240,
)
TIMES_NS = np.array([1_000_000_000, 1_040_000_000, 1_080_000_000])


def renamed(found: Calibration) -> Calibration:
    """Return a calibration whose presses have the odd names."""
    of = dict(zip(found.fits, NAMES, strict=False))

    def again(values: dict) -> dict:
        return {of.get(name, name): value for name, value in values.items()}

    return replace(
        found,
        fits=again(found.fits),
        linearisations=again(found.linearisations),
        solve_counts=again(found.solve_counts),
        omissions=[Omission(name, f"{name}: no message on /indenter/pose") for name in NAMES],
    )


def shown_in(page: str) -> str:
    """Return how a page shows some of the names, where it says why they were left out."""
    shown = re.findall(r"<li>([^<]+?)(?:: no message| was left out)", page)
    some = [html.unescape(name) for name in shown if name.startswith(("costs", "&lt;", "bell"))]
    assert len(some) == 3
    return f"names stand there as {' / '.join(some)}"


@pytest.fixture
def data(tmp_path):
    still = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    press = Trajectory(
        pose=PoseChannel(TIMES_NS, np.full((3, 3), 0.015), still),
        wrench=WrenchChannel(TIMES_NS, np.ones((3, 3)), np.zeros((3, 3))),
        name="press",
    )
    write_data_set(tmp_path / "data", [(press, sphere(0.004))], skin=dome_skin(0.01575, 4e-3))
    return tmp_path / "data"


@pytest.mark.fault("calibrate", "a bag's name with $, <script>, a newline, 240 letters or a bell")
def test_a_calibration_reports_presses_of_any_name(tmp_path, data, monkeypatch, capsys, answered):
    found = renamed(calibration(len(NAMES)))
    monkeypatch.setattr(calibrate_module, "run_calibration", lambda *_: found)
    out = tmp_path / "fitted.yaml"
    assert main(["calibrate", "--data", str(data), "--out", str(out)]) == 0
    assert load_sensor(out).name == "fitted"
    page = (report_folder(out) / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 5
    assert "<script>" not in page
    assert all(one_line(name) in one_line(html.unescape(page)) for name in NAMES)
    printed = capsys.readouterr().out
    assert "\x07" not in printed
    assert "\x1b" not in printed
    written = sorted(path.name for path in (out, report_folder(out) / "report.html"))
    answered(f"{' and '.join(written)} are written; {shown_in(page)}")


@pytest.mark.fault("calibrate", "the report cannot be written after all solves")
def test_the_sensor_is_written_before_the_report(tmp_path, data, monkeypatch, answered):
    def full(*_given: object, **_named: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(calibrate_module, "run_calibration", lambda *_: calibration())
    monkeypatch.setattr(calibrate_module, "write_report", full)
    with pytest.raises(OSError, match="holds the calibrated sensor, but its report") as refused:
        calibrate(data, out=tmp_path / "fitted.yaml")
    assert load_sensor(tmp_path / "fitted.yaml").name == "fitted"
    answered(refused.value)


@pytest.mark.fault("find-gap", "a bag's name with $, <script>, a newline, 240 letters or a bell")
def test_a_gap_is_reported_for_trajectories_of_any_name(tmp_path, answered):
    findings = named()
    of = dict(zip(sorted({p.trajectory for p in findings.places}), NAMES, strict=False))
    assert findings.worst is not None
    places = [
        [replace(p, trajectory=name) for p in findings.places if p.trajectory == "slide_1"]
        for name in NAMES
    ]
    odd = replace(
        findings,
        places=tuple(p for group in places for p in group),
        worst=replace(findings.worst, trajectory=NAMES[0]),
        trajectories=NAMES,
        warnings=tuple(f"{name} was left out: no pose" for name in NAMES),
    )
    assert len(of) > 1
    report = write_report(tmp_path, odd, effects=load_effects())
    page = report.read_text(encoding="utf-8")
    assert "<script>" not in page
    assert all(one_line(name) in one_line(html.unescape(page)) for name in NAMES)
    answered(f"{report.name} is written; {shown_in(page)}")


@pytest.mark.fault("view", "a bag's name with $ or markup")
def test_a_bag_of_any_name_is_shown(tmp_path, answered):
    name = "".join(NAMES[:5]).replace("/", "")
    image = np.random.default_rng(0).integers(0, 255, (3, 24, 32, 3)).astype(np.uint8)
    force = np.array([[0.0, 0.0, 1.0]] * 3)
    press = Trajectory(
        wrench=WrenchChannel(TIMES_NS, force, 0.0 * force), image=ImageChannel(TIMES_NS, image)
    )
    write_trajectory(tmp_path / name, press, topics=RECORDED_TOPICS)
    out = tmp_path / "out"
    assert main(["view", str(tmp_path / name), "--out", str(out), "--format", "none"]) == 0
    (made,) = out.iterdir()
    assert made.name == f"{name}.png"
    answered(f"the sheet is made: {one_line(made.name)}")


def test_markup_in_names_is_no_markup_in_a_report():
    page = Page("t", NAMES[3], (Section("s", (Bullets(NAMES), Table(("a",), ((NAMES[2],),)))),))
    text = as_markdown(page)
    assert r"\`code\` \[a](b) \*c\* \_d\_ \~\~e\~\~" in text
    assert "press_1_of_2" in as_markdown(Page("t", "press_1_of_2", ()))
    assert as_markdown(Page("t", "# no heading", ())).endswith("\n\n\\# no heading\n")
    assert r"\|&amp;" in text
    assert "\n# first" not in text


def test_a_label_is_short_and_no_formula():
    from matplotlib import cbook

    for label in map(figure_label, NAMES):
        assert len(label.replace(r"\$", "$")) <= 28
        assert not cbook.is_math_text(label)
        assert re.search(r"[\x00-\x1f\u202e\udc00-\udfff]", label) is None
