# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The documentation: its examples run, its tables are those of the code and of the results, and the
checks of its links find what is broken."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import trimesh
import yaml
from cyclopts import App, Parameter
from programs import program

from dotsim_ros.effects.effect import Active, Response, response_filters
from dotsim_ros.effects.library import load_effects
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.nodes.common.parameters import known_parameters
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters
from dotsim_ros.nodes.tactile_sim.profiles import PROFILES
from dotsim_ros.specification import load_sensor
from studies import results_page

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def text_of(name: str) -> str:
    return (DOCS / name).read_text(encoding="utf-8")


def section(text: str, heading: str) -> str:
    """Return what stands below a heading of the second level."""
    return text.split(f"\n## {heading}\n")[1].split("\n## ")[0]


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def rows(text: str) -> list[list[str]]:
    """Return the cells of the first table of a text, without its head."""
    table = next(part for part in text.split("\n\n") if part.lstrip().startswith("|"))
    lines = table.strip().splitlines()
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]


def test_the_example_of_an_effect_works() -> None:
    effect = load_effects([ROOT / "examples" / "effects"])["crosstalk"]
    mixed = response_filters([Active(effect, effect.checked({}))])
    nowhere = np.zeros((1, 3))
    given = Response(0.0, 0.0, Pose(np.zeros(3)), 1e-3, nowhere, nowhere, np.array([0.1, 0.0, 2.0]))
    assert mixed(given).force_n == pytest.approx([0.3, 0.0, 2.0])
    assert not effect.needs_solve


def test_the_example_of_a_sensor_is_one(tmp_path: Path) -> None:
    path = tmp_path / "my_pad.yaml"
    path.write_text(blocks(section(text_of("sensors.md"), "Your own sensor"), "yaml")[0])
    sensor = load_sensor(path)
    assert sensor.name == "my_pad"
    assert (sensor.markers.columns, sensor.markers.rows) == (7, 5)


def test_the_example_of_an_indenter_is_one(tmp_path: Path) -> None:
    part = section(text_of("extend.md"), "An indenter")
    trimesh.creation.cylinder(radius=2.0, height=10.0).export(tmp_path / "screw.stl")
    (tmp_path / "screw.yaml").write_text(blocks(part, "yaml")[0])
    screw = load_indenter(tmp_path / "screw.yaml")
    assert screw.mesh is not None
    assert screw.mesh.bounds_m()[0, 2] == pytest.approx(0.0, abs=1e-9)
    inline = re.search(r"indenter '(.*\))'", part)
    assert inline is not None
    # As ros2 param set reads a value.
    assert load_indenter(yaml.safe_load(inline[1])).parameters == (0.003,)


def test_the_example_of_a_command_runs(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    exec(blocks(section(text_of("extend.md"), "A command"), "python")[0], names)
    app = App(default_parameter=Parameter(consume_multiple=True))
    app.default(names["run"])
    assert app(["densetact2", "--scale", "1000"], result_action="return_value") == 0
    assert capsys.readouterr().out == "15.75\n"


def test_the_table_of_effects_is_up_to_date() -> None:
    assert program(".ci/effects_table.py").table() in text_of("api/effects.md"), (
        "run python .ci/effects_table.py"
    )


def test_no_profile_was_measured_to_be_off_by_more_than_is_documented() -> None:
    figures = json.loads((DOCS / "results" / "profiles.json").read_text(encoding="utf-8"))
    for name, profile in PROFILES.items():
        assert figures["worst"][name]["skin_max_mm"] <= 1e3 * profile.skin_error_m
        assert figures["worst"][name]["documented_mm"] == pytest.approx(1e3 * profile.skin_error_m)
    for case in figures["cases"]:
        for row in case["handovers"]:
            assert row["largest_jump_mm"] <= 1e3 * PROFILES["fast"].skin_error_m


def test_the_table_of_parameters_is_that_of_the_node() -> None:
    written = {
        cells[0].split("`")[1]: (cells[0].endswith("*"), cells[1].strip("`"))
        for cells in rows(section(text_of("run.md"), "Parameters"))
    }
    known = {}
    for name, (default, parameter) in known_parameters(TactileSimParameters).items():
        if isinstance(default, tuple):
            default = ", ".join(f"{number:g}" for number in default)
        shown = str(default).lower() if isinstance(default, bool) else str(default)
        known[name] = (not parameter.fixed, shown or "empty")
    assert written == known


def test_the_layout_is_that_of_the_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(c["layers"] for c in contracts["contracts"] if c["id"] == "layers")
    table = rows(section(text_of("architecture.md"), "Layout"))
    written = [re.findall(r"`(\w+)(?:/|\.py)`", cells[0]) for cells in table]
    assert [sorted(names) for names in written] == [
        sorted(layer.replace(" ", "").split("|")) for layer in layers
    ]


def test_the_walks_name_functions_that_there_are() -> None:
    walks = section(text_of("architecture.md"), "Three walks").split("\n### ")[1:]
    assert len(walks) == 3
    for walk in walks:
        steps = re.findall(r"^\d+\. `([a-z_.]+)\.([A-Z][\w.]+|\w+)`", walk, re.MULTILINE)
        assert 5 <= len(steps) <= 10
        for module, names in steps:
            source = ROOT / "dotsim_ros" / f"{module.replace('.', '/')}.py"
            for name in names.split("."):
                defined = rf"^ *(?:class|def) {name}\b"
                assert re.search(defined, source.read_text(), re.MULTILINE), (module, name)


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return the script of the page of results, for results and entries in a folder of a test."""
    module = results_page
    monkeypatch.setattr(module, "RESULTS", tmp_path)
    monkeypatch.setattr(module, "ENTRIES", tmp_path / "entries.yaml")
    return module


RECORD = {
    "machine": "one core",
    "date": "2026-01-02T03:04:05+00:00",
    "command": "python speed.py",
    "commit": "0123456789ab",
    "rate_hz": 23.13,
    "share": {"share": 0.75, "low": -0.0, "of": 4, "unknown": None},
    "gels": {"soft": {"error": 0.061}, "hard": {"error": 0.05}, "other": {}},
}
ENTRY = """
Speed:
  - file: speed.json
    title: The node
    note: On two cores.
    tables:
      - figures:
          - [rate, rate_hz, "{:.1f} Hz", "25 +- 0.2"]
          - [named, share, "{share:.0%} of {of} from {low:.0%}", ">= 0.75"]
      - rows: [gel, "gels/*"]
        columns:
          - [error, error, "{:.1%}", "<= 0.06"]
"""


def test_the_page_of_results_is_what_the_files_say() -> None:
    written = results_page.PAGE.read_text(encoding="utf-8")
    assert written == results_page.page(), "run python -m studies.results_page"


def test_a_result_shows_its_figures_its_misses_and_where_it_comes_from(
    results: ModuleType, tmp_path: Path
) -> None:
    # One that has not been made yet is left out.
    (tmp_path / "entries.yaml").write_text(ENTRY + "  - file: later.json\n")
    (tmp_path / "speed.json").write_text(json.dumps(RECORD))
    *_, figures, rows_of_gels, origin = results.page().rstrip().split("\n\n")
    assert figures.splitlines()[2:] == [
        "|rate|23.1 Hz|25 ± 0.2 Hz|missed|",
        "|named|75 % of 4 from 0 %|≥ 75 %||",
    ]
    assert rows_of_gels.splitlines() == [
        "|gel|error (≤ 6.0 %)|missed|",
        "|---|---:|---|",
        "|soft|6.1 %|error|",
        "|hard|5.0 %||",
        "|other|-||",
    ]
    measured = "Measured at commit 0123456 on one core, 2026-01-02, by `python speed.py`: "
    assert origin == f"{measured}[speed.json](speed.json)."
    (tmp_path / "speed.json").write_text(json.dumps(RECORD | {"sealed": True}))
    assert (
        f"\n\n**Judged once**, on data that nobody had seen; it is not made again. {measured}"
        in (results.page())
    )


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ("Speed: []\n", "no entry for speed.json"),
        (ENTRY.replace("rate_hz", "rate"), "speed.json: 0 values at rate"),
        (ENTRY.replace("error, error", "error, errors"), r"no row at gels/\* has error"),
    ],
)
def test_a_result_that_is_left_out_or_has_no_such_figure_is_found(
    results: ModuleType, tmp_path: Path, entry: str, complaint: str
) -> None:
    (tmp_path / "entries.yaml").write_text(entry)
    (tmp_path / "speed.json").write_text(json.dumps(RECORD))
    with pytest.raises(ValueError, match=complaint):
        results.page()


def site_with(folder: Path, body: str) -> Path:
    (folder / "index.html").write_text(f'<p id="here"><a href="#here">up</a>{body}</p>')
    return folder


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        ('<a href="gone.html">x</a>', "leads nowhere"),
        ('<a href="index.html#gone">x</a>', "no such anchor"),
        ('<a href="../x.html">x</a>', "leads out of"),
        ('<img src="gone.png">', "leads nowhere"),
        ('<script src="https://elsewhere.org/x.js"></script>', "fetches"),
        ('<link rel="stylesheet" href="//elsewhere.org/x.css">', "fetches"),
    ],
)
def test_the_check_of_links_finds(body: str, complaint: str, tmp_path: Path) -> None:
    checker = program(".ci/check_links.py").Checker(site_with(tmp_path, body))
    checker.check_site()
    assert len(checker.bad) == 1
    assert complaint in checker.bad[0]


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        ("[x](#gone)", "no such anchor"),
        ("[x](OTHER.md#gone)", "no such anchor"),
        ("[x][1]\n\n[1]: gone.md", "gone.md leads nowhere"),
        ("[x][2]\n\n[1]: OTHER.md", "[x][2]: no such reference"),
        ('<img src="gone.png" width="80">', "gone.png leads nowhere"),
        ('<a href="gone.md">x</a>', "gone.md leads nowhere"),
        ("[x](../out.md)", "leads out of"),
    ],
)
def test_the_check_of_links_finds_in_a_markdown_file(
    body: str, complaint: str, tmp_path: Path
) -> None:
    sound = "# A *new* page: `make x` (2)\n\n## Twice\n\n## Twice\n\n"
    sound += "[x](#a-new-page-make-x-2) [y](OTHER.md#twice-1) [z][1] <a href='OTHER.md'>o</a>\n"
    sound += "`[x](gone.md)` [w](https://elsewhere.org)\n\n[1]: OTHER.md#twice\n\n"
    (tmp_path / "README.md").write_text(sound)
    (tmp_path / "OTHER.md").write_text("## Twice\n\n```\n# no heading\n```\n\n## Twice\n")
    checker = program(".ci/check_links.py").Checker(tmp_path / "site", tmp_path)
    checker.check_markdown(tmp_path / "README.md")
    assert checker.bad == []
    (tmp_path / "BAD.md").write_text(body)
    checker.check_markdown(tmp_path / "BAD.md")
    assert len(checker.bad) == 1
    assert complaint in checker.bad[0]
