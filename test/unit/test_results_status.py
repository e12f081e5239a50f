# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where figures come from and whether they are stale, on made-up checkouts and on this one."""

from __future__ import annotations

import ast
import importlib
import itertools
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from dotsim_ros.nodes.loop import closed_loop
from dotsim_ros.provenance import commit_of
from dotsim_ros.tasks import environments

ROOT = Path(__file__).resolve().parents[2]
FILES = {
    "dotsim_ros/__init__.py": '"""A package."""\n',
    "dotsim_ros/gel.py": 'def depth():\n    """Return a depth."""\n    return 1.0\n',
    "dotsim_ros/light.py": "def gain():\n    return 0.5\n",
    "dotsim_ros/node.py": "RATE_HZ = 25\n\n\ndef main():\n    pass\n",
    "dotsim_ros/cli/evaluate.py": (
        "def _geometry():\n    from dotsim_ros.gel import depth\n    return _twice(depth())\n\n\n"
        "def _optics():\n    from dotsim_ros.light import gain\n    return gain()\n\n\n"
        "def _twice(value):\n    return 2 * value\n"
    ),
    "benchmarks/soak.py": "from dotsim_ros.provenance import commit\nprint(commit)\n",
    "dotsim_ros/provenance.py": "commit = 1\n",
    "setup.py": 'ENTRY_POINTS = ["tactile_sim = dotsim_ros.node:main"]\n',
    "README.md": "# Name\n\n[0.1 mm](docs/results/geometry.md) of error.\n",
    "docs/gel.md": "Speed: [here](results/soak.json#rate).\n",
}
GEOMETRY = "dotsim_ros evaluate geometry --out docs/results"
SOAK = "python benchmarks/soak.py --json docs/results/soak.json"


@pytest.fixture
def tool(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / ".ci"))
    yield importlib.import_module("results_status")
    for name in ("results_status", "measured_code"):
        sys.modules.pop(name, None)


class MadeUp:
    """A checkout in a folder."""

    def __init__(self, root: Path, tool) -> None:
        self.root = root
        self.tool = tool
        self.git("init", "--quiet", "--initial-branch=main")
        for name, value in {"user.name": "A", "user.email": "a@example.org"}.items():
            self.git("config", name, value)
        self.commit(FILES)

    def git(self, *arguments: str) -> str:
        command = ["git", "-C", str(self.root), *arguments]
        # Whoever runs this may sign, or have hooks.
        bare = {**os.environ, "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=bare)
        return done.stdout.strip()

    def write(self, files: dict[str, str]) -> None:
        for name, text in files.items():
            path = self.root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")

    def change(self, file: str, old: str, new: str) -> None:
        before = (self.root / file).read_text(encoding="utf-8")
        assert old in before
        self.write({file: before.replace(old, new)})

    def commit(self, files: dict[str, str] | None = None) -> str:
        self.write(files or {})
        self.git("add", "--all")
        self.git("commit", "--quiet", "--allow-empty", "--message", "Change")
        return commit_of(self.root)

    def record(self, name: str, command: str, commit: str | None = None) -> None:
        made = {"commit": commit or commit_of(self.root), "date": "2026-01-02", "command": command}
        self.write({f"docs/results/{name}.json": json.dumps({"x": 1, "provenance": made})})

    def run(self, *arguments: str) -> int:
        status_page = str(self.root / "docs/results/status.md")
        given = ["--root", str(self.root), "--markdown", status_page, *arguments]
        return self.tool.main(given)

    def states(self) -> dict[str, str]:
        checkout = self.tool.Checkout(self.root)
        results = self.tool.read_results(checkout).results
        return {str(r.file.with_suffix("")): r.state.name for r in results}


@pytest.fixture
def made_up(tmp_path, tool):
    return MadeUp(tmp_path, tool)


def test_a_clean_result_is_current_and_passes(made_up, capsys):
    made_up.record("geometry", GEOMETRY)
    assert made_up.states() == {"geometry": "CURRENT"}
    assert made_up.run("--mark") == 0
    assert made_up.run("--check") == 0
    row = capsys.readouterr().out.splitlines()[1]
    assert row.split(maxsplit=4) == [
        "geometry.json",
        commit_of(made_up.root),
        "2026-01-02",
        "current",
        GEOMETRY,
    ]
    assert (made_up.root / "README.md").read_text() == FILES["README.md"]


@pytest.mark.parametrize("commit", ["0123456789ab-dirty", "unknown: not run from a checkout"])
def test_a_result_without_a_clean_commit_fails(made_up, capsys, commit):
    made_up.record("geometry", GEOMETRY, commit)
    assert made_up.states() == {"geometry": "REFUSED"}
    assert made_up.run() == 1
    assert "docs/results/geometry.json: " in capsys.readouterr().out


def test_what_a_changed_tree_records_is_refused(made_up):
    made_up.change("dotsim_ros/gel.py", "1.0", "1.5")
    made_up.record("geometry", GEOMETRY)
    assert made_up.states() == {"geometry": "REFUSED"}
    assert made_up.run("--mark") == 1
    assert f"(measured at commit {commit_of(made_up.root)[:7]}, with uncommitted changes)" in (
        made_up.root / "README.md"
    ).read_text(encoding="utf-8")


def test_only_what_figures_may_depend_on_makes_a_tree_dirty(made_up):
    clean = made_up.commit()
    made_up.write({"README.md": "new", "docs/results/new.json": "{}", "log.txt": "new"})
    assert commit_of(made_up.root) == clean
    made_up.write({"dotsim_ros/added.py": ""})
    assert commit_of(made_up.root) == f"{clean}-dirty"
    (made_up.root / "dotsim_ros/added.py").unlink()
    made_up.write({"setup.py": ""})
    assert commit_of(made_up.root) == f"{clean}-dirty"


def test_a_copy_that_the_checkout_ignores_has_no_commit(made_up):
    made_up.commit({".gitignore": "venv/\n"})
    made_up.write({"venv/dotsim_ros/__init__.py": ""})
    assert commit_of(made_up.root / "venv").startswith("unknown")


@pytest.mark.parametrize(
    "figures",
    [
        {"x": 1},
        [1, 2],
        {"x": 1, "provenance": {"date": "2026-01-02", "command": GEOMETRY}},
    ],
)
def test_a_result_without_provenance_fails(made_up, figures):
    made_up.write({"docs/results/geometry.json": json.dumps(figures)})
    assert made_up.states() == {"geometry": "REFUSED"}
    assert made_up.run() == 1


@pytest.mark.parametrize(
    "command",
    ["", "python", "dotsim_ros", "dotsim_ros evaluate --out x", "make bench", "bash x.sh"],
)
def test_a_command_that_names_no_code_fails(made_up, capsys, command):
    made_up.record("geometry", command)
    assert made_up.run() == 1
    assert "neither `python SCRIPT.py ...` nor `dotsim_ros VERB ...`" in capsys.readouterr().out


def test_a_command_whose_code_is_not_there_fails(made_up, capsys):
    made_up.record("geometry", "dotsim_ros evaluate tumour")
    assert made_up.run() == 1
    assert "dotsim_ros/cli/evaluate.py has no function _tumour" in capsys.readouterr().out


def test_a_result_is_older_once_its_code_changes(made_up, capsys):
    made_up.record("geometry", GEOMETRY)
    made_up.record("optics", "dotsim_ros evaluate optics")
    made_up.change("dotsim_ros/gel.py", "1.0", "1.5")
    assert made_up.states() == {"geometry": "OLDER", "optics": "CURRENT"}
    made_up.commit()
    assert made_up.states() == {"geometry": "OLDER", "optics": "CURRENT"}
    assert made_up.run("--mark") == 0
    assert "\nOLDER THAN THE CODE: geometry.json\n" in capsys.readouterr().out


def test_the_verbs_own_function_is_code_and_its_neighbours_are_not(made_up):
    made_up.record("geometry", GEOMETRY)
    made_up.record("optics", "dotsim_ros evaluate optics")
    made_up.change("dotsim_ros/cli/evaluate.py", "2 * value", "3 * value")
    assert made_up.states() == {"geometry": "OLDER", "optics": "CURRENT"}


def test_a_variable_that_has_a_functions_name_is_not_that_function(made_up):
    made_up.change("dotsim_ros/cli/evaluate.py", "    return gain()", "    _twice = gain()")
    made_up.commit()
    made_up.record("optics", "dotsim_ros evaluate optics")
    made_up.change("dotsim_ros/cli/evaluate.py", "2 * value", "3 * value")
    assert made_up.states() == {"optics": "CURRENT"}


def test_a_process_that_a_script_starts_is_its_code_and_what_records_figures_is_not(made_up):
    made_up.record("soak", SOAK)
    made_up.change("dotsim_ros/provenance.py", "1", "2")
    assert made_up.states() == {"soak": "CURRENT"}
    made_up.change("dotsim_ros/node.py", "25", "50")
    assert made_up.states() == {"soak": "OLDER"}


def test_moved_modules_and_new_docstrings_make_nothing_older(made_up):
    made_up.record("geometry", GEOMETRY)
    made_up.change("dotsim_ros/gel.py", "Return a depth.", "Return how deep it is.")
    made_up.change("dotsim_ros/gel.py", "    return", "    # One.\n    return")
    (made_up.root / "dotsim_ros/body").mkdir()
    made_up.git("mv", "dotsim_ros/gel.py", "dotsim_ros/body/shell.py")
    made_up.change("dotsim_ros/cli/evaluate.py", "dotsim_ros.gel", "dotsim_ros.body.shell")
    made_up.commit({"dotsim_ros/body/__init__.py": ""})
    assert made_up.states() == {"geometry": "CURRENT"}


def test_a_script_that_moved_is_found_by_its_new_path(made_up, tool, monkeypatch):
    made_up.record("soak", "python benchmarks/endurance.py")
    assert made_up.states() == {"soak": "REFUSED"}
    monkeypatch.setitem(
        sys.modules["measured_code"].MOVED, "benchmarks/endurance.py", SOAK.split()[1]
    )
    assert made_up.states() == {"soak": "CURRENT"}


def test_a_commit_outside_of_the_history_is_unknown(made_up, capsys):
    made_up.git("checkout", "--quiet", "-b", "aside")
    aside = made_up.commit({"dotsim_ros/gel.py": "x = 1"})
    made_up.git("checkout", "--quiet", "main")
    for commit in (aside, "0123456789ab"):
        made_up.record("geometry", GEOMETRY, commit)
        assert made_up.states() == {"geometry": "UNKNOWN"}
        assert made_up.run("--mark") == 0
        assert "OLDER: UNKNOWN COMMIT: geometry.json" in capsys.readouterr().out


def test_a_shallow_clone_knows_no_commits_and_is_no_place_to_compare(
    made_up, tmp_path_factory, capsys
):
    made_up.record("geometry", GEOMETRY)
    made_up.commit()
    clone = tmp_path_factory.mktemp("clone")
    made_up.git("clone", "--quiet", "--depth", "1", f"file://{made_up.root}", str(clone))
    assert made_up.tool.main(["--root", str(clone)]) == 0
    assert "older: unknown commit" in capsys.readouterr().out
    for option in ("--check", "--mark"):
        assert made_up.tool.main(["--root", str(clone), option]) == 1
        out = capsys.readouterr().out
        assert "Errors:\n  this is no clone with its whole history" in out
        assert "fetch-depth: 0" in out


def test_an_unmarked_stale_figure_fails_and_marking_mends_it(made_up, capsys):
    made_up.record("geometry", GEOMETRY)
    commit = commit_of(made_up.root)
    made_up.record("soak", SOAK)
    made_up.change("dotsim_ros/gel.py", "1.0", "1.5")
    made_up.commit()
    assert made_up.run() == 0  # only writes docs/results/status.md
    assert made_up.run("--check") == 1
    out = capsys.readouterr().out
    mark = f" (measured at commit {commit[:7]}, before later changes)"
    assert f"README.md:3: expected docs/results/geometry.md{mark}, found" in out
    assert "docs/gel.md" not in out

    assert made_up.run("--mark") == 0
    assert f"[0.1 mm](docs/results/geometry.md){mark} of error." in (
        made_up.root / "README.md"
    ).read_text(encoding="utf-8")
    assert made_up.run("--check") == 0

    made_up.record("geometry", GEOMETRY)
    assert made_up.run("--check") == 1
    assert made_up.run("--mark") == 0
    assert (made_up.root / "README.md").read_text(encoding="utf-8") == FILES["README.md"]


def test_links_in_pages_of_docs_are_marked_and_those_in_code_are_not(made_up):
    made_up.record("soak", SOAK, "0123456789ab")
    made_up.write({"README.md": "```\n[x](docs/results/soak.json)\n```\n[y](docs/other.json)\n"})
    made_up.run("--mark")
    assert "measured" not in (made_up.root / "README.md").read_text(encoding="utf-8")
    assert (made_up.root / "docs/gel.md").read_text(encoding="utf-8") == (
        "Speed: [here](results/soak.json#rate) (measured at commit 0123456, not in this history).\n"
    )


@pytest.mark.parametrize(
    "link",
    [
        '[x](docs/results/soak.json "A title")',
        "[x](<docs/results/soak.md>)",
        "[x](docs/../docs/results/soak.json#rate)",
        "[x\nover lines](docs/results/soak.json)",
    ],
)
def test_every_way_to_write_a_link_in_place_is_marked(made_up, link):
    made_up.record("soak", SOAK, "0123456789ab")
    made_up.write({"README.md": f"See {link}.\n"})
    made_up.run("--mark")
    assert (made_up.root / "README.md").read_text(encoding="utf-8") == (
        f"See {link} (measured at commit 0123456, not in this history).\n"
    )
    assert made_up.run("--check") == 0


@pytest.mark.parametrize(
    "text", ["[x][1]\n\n[1]: docs/results/soak.json", '<a href="docs/results/soak.json">x</a>']
)
def test_a_link_that_cannot_be_marked_fails(made_up, capsys, text):
    made_up.record("soak", SOAK)
    made_up.write({"README.md": text})
    assert made_up.run("--mark") == 0
    assert made_up.run("--check") == 1
    assert "write the link to a result as [text](path)" in capsys.readouterr().out


def test_the_page_of_states_must_be_up_to_date(made_up, capsys):
    made_up.record("geometry", GEOMETRY)
    assert made_up.run("--check") == 1
    assert "status.md is not up to date" in capsys.readouterr().out
    assert made_up.run("--mark") == 0
    page = (made_up.root / "docs/results/status.md").read_text(encoding="utf-8")
    assert f"[geometry](geometry.json) | `{commit_of(made_up.root)}` | 2026-01-02 | current" in page
    assert made_up.run("--check") == 0
    made_up.change("dotsim_ros/gel.py", "1.0", "1.5")
    assert made_up.run("--check") == 1


def test_rows_of_other_runs_are_judged_by_their_own_commit(made_up, capsys):
    first = commit_of(made_up.root)
    made_up.change("dotsim_ros/gel.py", "1.0", "1.5")
    second = made_up.commit()
    origin = {"commit": first, "date": "2026-01-01", "command": GEOMETRY}
    figures = {
        "ours": {"by_frame": {"x": 1, "commit": first, "date": "2026-01-01"}},
        "tacto": {"x": 2, "origin": origin},
        "provenance": {"commit": second, "date": "2026-01-02", "command": GEOMETRY},
    }
    made_up.write({"docs/results/geometry.json": json.dumps(figures)})
    assert made_up.states() == {"geometry": "OLDER"}
    assert made_up.run("--mark") == 0
    page = (made_up.root / "docs/results/status.md").read_text(encoding="utf-8")
    assert f"`{first}` | older than the code | ours.by_frame, tacto |" in page
    assert f"`{second}` | current | the rest |" in page
    assert f"(measured at commit {first[:7]} and 1 other, some before later changes)" in (
        made_up.root / "README.md"
    ).read_text(encoding="utf-8")


def test_a_record_of_first_sight_stays_beside_what_is_made_anew(made_up, capsys):
    record = (
        "geometry.json:\n  again: again/geometry.json\n  reason: No one had seen the presses.\n"
    )
    first = commit_of(made_up.root)
    made_up.record("geometry", GEOMETRY)
    made_up.write({"docs/results/first_sight.yaml": record})
    assert made_up.run("--mark") == 1
    assert "there is no again/geometry.json, which geometry.json names" in capsys.readouterr().out
    made_up.record("again/geometry", GEOMETRY)
    assert made_up.states() == {"geometry": "CURRENT", "again/geometry": "CURRENT"}

    made_up.change("dotsim_ros/gel.py", "1.0", "1.5")
    made_up.commit()
    assert made_up.states() == {"geometry": "FIRST_SIGHT", "again/geometry": "OLDER"}
    made_up.record("again/geometry", GEOMETRY)
    assert made_up.states() == {"geometry": "FIRST_SIGHT", "again/geometry": "CURRENT"}
    assert made_up.run("--mark") == 0
    assert "RECORD OF FIRST SIGHT: geometry.json" in capsys.readouterr().out
    readme = (made_up.root / "README.md").read_text(encoding="utf-8")
    assert f"(measured at commit {first[:7]}, judged once, before later changes)" in readme
    page = (made_up.root / "docs/results/status.md").read_text(encoding="utf-8")
    linked = "| [geometry](geometry.json) | [again/geometry](again/geometry.json) |"
    assert f"{linked} No one had seen the presses. |" in page

    made_up.record("geometry", GEOMETRY, "0123456789ab-dirty")
    assert made_up.states()["geometry"] == "REFUSED"
    made_up.write({"docs/results/first_sight.yaml": "geometry.json:\n  reason: It is old.\n"})
    assert made_up.run("--mark") == 1
    assert "geometry.json needs `again`" in capsys.readouterr().out


def test_a_page_of_figures_without_its_file_fails(made_up, capsys):
    made_up.write({"docs/results/speed.md": "| 1 |"})
    assert made_up.run() == 1
    assert "docs/results/speed.md: no JSON file beside it" in capsys.readouterr().out


def test_every_result_of_this_package_has_its_code(tool):
    measured_code = importlib.import_module("measured_code")
    files = list((ROOT / tool.RESULTS).rglob("*.json"))
    assert files
    # Whether each is older than its code, CI asks of the tool itself.
    commands = {
        origin.command
        for file in files
        for origin in tool.origins_of(json.loads(file.read_text(encoding="utf-8")))
    }
    commands |= {f"python benchmarks/{path.name}" for path in (ROOT / "benchmarks").glob("*.py")}
    # Of commands that differ in options only, the code is the same.
    by_code = {measured_code.parts_of(command): command for command in commands}
    checkout = tool.Checkout(ROOT)
    for command in by_code.values():
        behind, sources = measured_code.files_behind(command, checkout.now)
        missing = started_by(behind, sources) - set(behind)
        assert not missing, f"{command} starts them: name them in STARTED of .ci/measured_code.py"


def started_by(behind, sources):
    """Return the files of the processes and environments that scripts and the loop start by name.

    Those are nodes, verbs of the command line and environments of Gymnasium, which no import shows.
    """
    entries = dict(re.findall(r'"(\w+) = ([\w.]+):main"', (ROOT / "setup.py").read_text()))
    files = {name: module for name, module in entries.items() if module.endswith(".node")}
    for name, place in environments._CLASSES.items():
        files[name] = f"{environments.__name__}.{place.partition(':')[0]}"
    # Of that last file `sources` holds what the subject uses alone.
    own = [p for p in behind if p.startswith("benchmarks/") or p == "dotsim_ros/cli/evaluate.py"]
    trees = {path: list(ast.walk(ast.parse(sources[path]))) for path in own}
    nodes = [node for tree in trees.values() for node in tree]
    constants = [
        node.value
        for path, tree in trees.items()
        for node in tree
        if isinstance(node, ast.Constant) and path.startswith("benchmarks/")
    ]
    imported = {
        alias.name for node in nodes if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    if imported & {"ClosedLoop", "TrialLoop"}:
        constants += [closed_loop.SENSOR, closed_loop.ARM, closed_loop.POLICY]
    started = {files[value] for value in constants if value in files}
    for before, value in itertools.pairwise(constants):
        if before == "dotsim_ros.cli.main":
            started.add(f"dotsim_ros.cli.{value.replace('-', '_')}")
    return {module.replace(".", "/") + ".py" for module in started}


def test_the_processes_of_a_script_are_told_from_its_text():
    text = 'run([sys.executable, "-m", "dotsim_ros.cli.main", "find-gap"]); Node("tactile_sim")'
    sources = {"benchmarks/x.py": text.encode()}
    assert started_by(list(sources), sources) == {
        "dotsim_ros/cli/find_gap.py",
        "dotsim_ros/nodes/tactile_sim/node.py",
    }


def test_what_has_changed_since_an_older_result_is_named(made_up):
    extra = {f"dotsim_ros/part_{number}.py": f"x = {number}\n" for number in range(5)}
    made_up.commit(extra)
    imports = "".join(f"    from dotsim_ros.part_{number} import x\n" for number in range(5))
    made_up.change("dotsim_ros/gel.py", "    return", imports + "    return")
    first = made_up.commit()
    made_up.record("geometry", GEOMETRY)

    def row() -> str:
        made_up.run()
        page = (made_up.root / "docs/results/status.md").read_text(encoding="utf-8")
        _, _, section = page.partition("## Older: what has changed since")
        return section.rstrip().rpartition("\n")[2]

    assert row() == ""
    made_up.change("dotsim_ros/part_2.py", "2", "12")
    # A comment is no change, nor is another place.
    made_up.change("dotsim_ros/part_3.py", "3", "3  # Three.")
    made_up.git("mv", "dotsim_ros/part_4.py", "dotsim_ros/fourth.py")
    made_up.change("dotsim_ros/gel.py", "part_4", "fourth")
    begin = f"| [geometry](geometry.json) | `{first}` | "
    assert row() == begin + "`part_2.py` |"
    for number in (0, 1, 3):
        made_up.change(f"dotsim_ros/part_{number}.py", f"x = {number}", f"x = {number}.5")
    assert row() == begin + "`part_0.py`, `part_1.py`, `part_2.py`, and 1 more |"
    (made_up.root / "dotsim_ros/part_0.py").unlink()
    made_up.change("dotsim_ros/gel.py", "part_0", "part_1")
    assert row() == begin + "`gel.py`, `part_0.py`, `part_1.py`, and 2 more |"
    assert made_up.run("--check") == 1  # README.md has no mark yet
    made_up.run("--mark")
    assert made_up.run("--check") == 0
