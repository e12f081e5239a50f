# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the files around the code say of it: citation, changelog, lint, hooks, workflow, forms."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import yaml

import dotsim_ros

ROOT = Path(__file__).parents[2]
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
FORMS = sorted(
    path
    for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml")
    if path.name != "config.yml"
)
SCHEMAS = {
    "CITATION.cff": "citation-file-format",
    ".github/workflows/ci.yml": "github-workflows",
    "compose.yaml": "compose-spec",
    ".github/ISSUE_TEMPLATE/config.yml": "github-issue-config",
    **{str(path.relative_to(ROOT)): "github-issue-forms" for path in FORMS},
}
PAGES = (
    "CODE_OF_CONDUCT.md",
    "CONTRIBUTING.md",
    "QUALITY_DECLARATION.md",
    "README.md",
    "SECURITY.md",
    ".github/pull_request_template.md",
)
KINDS_OF_CHANGE = ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security")


def text_of(name: str) -> str:
    """Return a file of the repository's root."""
    return (ROOT / name).read_text(encoding="utf-8")


def workflow() -> dict[Any, Any]:
    """Return the workflow; YAML reads its key `on` as True."""
    content: dict[Any, Any] = yaml.safe_load(WORKFLOW.read_text(encoding="utf-8"))
    return content


def lint_commands() -> list[str]:
    """Return the commands of `make lint`."""
    recipe = re.search(r"^lint:.*\n((?:\t.+\n)+)", text_of("Makefile"), re.MULTILINE)
    assert recipe, "the Makefile has no target lint"
    return [line.removeprefix("\t$(RUN) ") for line in recipe[1].splitlines()]


def hooks() -> list[dict[str, Any]]:
    """Return the hooks of pre-commit."""
    repositories = yaml.safe_load(text_of(".pre-commit-config.yaml"))["repos"]
    return [hook for repository in repositories for hook in repository["hooks"]]


def extra(name: str) -> str:
    """Return the source of a list of setup.py."""
    found = re.search(rf"^{name} = \[\n(.*?)^\]", text_of("setup.py"), re.MULTILINE | re.DOTALL)
    assert found, f"setup.py has no list {name}"
    return found[1]


def sections(changelog: str) -> dict[str, str]:
    """Return the text of each version in a changelog, by its heading, newest first."""
    parts = re.split(r"^## (.+)\n", changelog, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def test_citation_has_the_version_of_the_package() -> None:
    citation = yaml.safe_load(text_of("CITATION.cff"))
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    assert citation["version"] == dotsim_ros.__version__ == manifest.findtext("version")
    assert citation["license"] == manifest.findtext("license")


@pytest.mark.parametrize(("name", "schema"), SCHEMAS.items(), ids=SCHEMAS)
def test_file_matches_its_schema(name: str, schema: str) -> None:
    pytest.importorskip("check_jsonschema", reason="needs the extra dev: pip install '.[dev]'")
    from check_jsonschema import main
    from click.testing import CliRunner

    checked = CliRunner().invoke(main, ["--builtin-schema", f"vendor.{schema}", str(ROOT / name)])
    assert checked.exit_code == 0, checked.output


def test_containers_install_extras_that_there_are_and_run_commands_that_there_are() -> None:
    setup = text_of("setup.py")
    dockerfile = text_of("docker/Dockerfile")
    (extras,) = re.findall(r'"\.\[(.+)\]"', dockerfile)
    for extra in extras.split(","):
        assert f'"{extra}": ' in setup
    commands = [
        service["command"]
        for service in yaml.safe_load(text_of("compose.yaml"))["services"].values()
    ]
    (default,) = re.findall(r"^CMD (.+)$", dockerfile, re.MULTILINE)
    for command in [*commands, *json.loads(default)]:
        assert f'"{command.split()[0]} = dotsim_ros.' in setup
    assert (
        "make setup" in json.loads(text_of(".devcontainer/devcontainer.json"))["postCreateCommand"]
    )


def test_workflow_runs_the_checks_on_each_supported_python() -> None:
    (job,) = workflow()["jobs"].values()
    commands = [step["run"] for step in job["steps"] if "run" in step]
    assert "bash .ci/run" in commands
    # A step or a job that may fail checks nothing; without its history no clone knows which figures
    # are older than the code.
    assert not any("continue-on-error" in part for part in (job, *job["steps"]))
    (checkout,) = [s for s in job["steps"] if s.get("uses", "").startswith("actions/checkout@")]
    assert checkout["with"]["fetch-depth"] == 0
    minimum, limit = re.findall(r'python_requires=">=3\.(\d+),<3\.(\d+)"', text_of("setup.py"))[0]
    supported = [f"3.{minor}" for minor in range(int(minimum), int(limit))]
    assert job["strategy"]["matrix"]["python"] == supported
    assert job["runs-on"] == "ubuntu-24.04", "the platform of ROS 2 Jazzy"


def test_hooks_are_the_commands_of_make_lint() -> None:
    assert [hook["entry"].removeprefix(".venv/bin/") for hook in hooks()] == lint_commands()
    for hook in hooks():
        assert hook["entry"].startswith(".venv/bin/"), "the tool that make setup installs"
        assert hook["pass_filenames"] is False, "the whole tree, as make lint looks at it"


def test_ci_runs_the_commands_of_make_lint() -> None:
    script = text_of(".ci/run")
    run = re.findall(r'^ *check "[^"]+" "\$venv/bin/([\w-]+)"(.*)$', script, re.MULTILINE)
    assert set(lint_commands()) <= {program + arguments for program, arguments in run}


def test_codespell_passes_over_no_text() -> None:
    settings = tomllib.loads(text_of("pyproject.toml"))["tool"]["codespell"]
    binary = {".npz", ".onnx", ".safetensors", ".stl", ".png", ".jpg"}
    suffixes = {Path(entry).suffix for entry in settings["skip"].split(",") if "*." in entry}
    assert suffixes <= binary | {".egg-info"}
    assert settings["check-hidden"], ".ci and .github are hidden"


def test_changelog_is_kept_by_kinds_of_change() -> None:
    for version, text in sections(text_of("CHANGELOG.md")).items():
        kinds = re.findall(r"^### (.+)$", text, re.MULTILINE)
        assert kinds or version == "[Unreleased]", version
        assert kinds == [kind for kind in KINDS_OF_CHANGE if kind in kinds], version


@pytest.mark.parametrize("name", PAGES)
def test_files_that_a_page_names_are_there(name: str) -> None:
    path = r"`((?:docs|params|\.ci|\.github)/[\w./]*\w|[A-Z_]+\.(?:md|cff))"
    named = set(re.findall(path, text_of(name)))
    assert not {path for path in named if not (ROOT / path).exists()}


@pytest.fixture
def license_headers(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT / ".ci"))
    return importlib.import_module("license_headers")


def test_every_source_file_says_its_licence(license_headers: Any) -> None:
    assert license_headers.main(["--check", "--root", str(ROOT)]) == 0


def test_a_licence_is_written_once_below_what_must_stay_first(
    license_headers: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.py").write_text("#!/usr/bin/env python3\nprint()\n")
    (tmp_path / "sensor.xacro").write_text('<?xml version="1.0"?>\n<robot/>\n')
    (tmp_path / "empty.py").write_text("")
    subprocess.run(["git", "init", "--quiet", str(tmp_path)], check=True)
    asked = ["--root", str(tmp_path)]
    assert license_headers.main([*asked, "--check"]) == 1
    assert "run.py: no licence at its top" in capsys.readouterr().out
    assert license_headers.main(asked) == license_headers.main([*asked, "--check"]) == 0
    assert (tmp_path / "run.py").read_text() == (
        "#!/usr/bin/env python3\n# Copyright 2026 The dotsim_ros authors\n"
        "# SPDX-License-Identifier: Apache-2.0\n\nprint()\n"
    )
    assert (
        (tmp_path / "sensor.xacro")
        .read_text()
        .startswith('<?xml version="1.0"?>\n<!-- Copyright 2026 The dotsim_ros authors -->\n')
    )
    assert not (tmp_path / "empty.py").read_text().endswith("\n\n")
