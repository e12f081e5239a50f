# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`make live` and `make demo-loop`: what they install, and what they run, to its end."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import psutil
import pytest
from harness import PATIENCE_S, Executable

ROOT = Path(__file__).parents[2]
INTERRUPTED = 130


def made(target: str, out: Path, *arguments: str) -> Executable:
    """Start what a target runs, with arguments that make it shorter or keep it apart."""
    variables = [f"VENV={sys.prefix}", f"OUT={out}"]
    # Without `setup-demo`, which would install again where the tests have their own ways.
    asked = [
        "make",
        "--no-print-directory",
        "--dry-run",
        "--assume-old=setup-demo",
        "--assume-old=setup-loop",
        target,
        *variables,
    ]
    recipe = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert recipe.count("\n") == 1, recipe
    command = f"exec env {recipe.strip()} {' '.join(arguments)}"
    return Executable("", code=f"import os; os.execvp('sh', ['sh', '-c', {command!r}])")


def installed_by(target: str, venv: Path) -> str:
    """Return the extras that a target would install."""
    asked = ["make", "--dry-run", target, f"VENV={venv}", "ROS_DISTRO="]
    commands = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    found = re.search(r'--editable "\.\[(.*)\]"', commands)
    return found[1] if found else ""


def test_a_demonstration_installs_what_it_lacks(tmp_path: Path) -> None:
    def installed() -> list[str]:
        return [installed_by(target, tmp_path) for target in ("live", "demo", "demo-loop")]

    demo, loop = "ros,live", "ros,live,arm"
    assert installed() == [demo, demo, loop]
    (tmp_path / ".installed-demo-").touch()
    assert installed() == ["", "", loop]
    (tmp_path / ".installed-demo-").rename(tmp_path / ".installed-demo-loop-")
    assert installed() == ["", "", ""]
    (tmp_path / ".installed-demo-loop-").rename(tmp_path / ".installed-")
    assert installed() == ["", "", ""]


def test_live_serves_its_page_to_this_machine_alone_until_it_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("websockets", reason="needs pip install '.[live]'")
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    live = made("live", tmp_path, "--port", "0")
    try:
        live.wait_for_line("open http")
        found = re.search(r"open (http://127\.0\.0\.1:(\d+)/)", live.log)
        assert found is not None
        with urlopen(found[1], timeout=PATIENCE_S) as page:
            assert page.status == 200
            assert b"main.js" in page.read()
        sockets = psutil.Process(live.process.pid).net_connections("inet")
        listening = {tuple(each.laddr) for each in sockets if each.status == psutil.CONN_LISTEN}
        assert listening == {("127.0.0.1", int(found[2]))}
        assert live.interrupt() == INTERRUPTED, live.log
        assert "Traceback" not in live.log
    finally:
        live.end()


def test_demo_loop_leaves_a_bag_a_picture_and_a_report(tmp_path: Path) -> None:
    from dotsim_ros.data.bag import bag_sha256

    demo = made("demo-loop", tmp_path, "--path", "line", "--laps", "0.02")
    try:
        assert demo.exit_status(600.0) == 0, demo.log
    finally:
        demo.end()
    folder = tmp_path / "demo-loop"
    left = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    assert left == {"loop", "path.png", "report.html", "report.md", "report.json"}
    report = json.loads((folder / "report.json").read_text())
    assert report["bag_sha256"] == bag_sha256(folder / "loop")
    assert report["laps"] >= report["laps_asked"] == 0.02
    assert report["mean_error_mm"] < 1.0
    assert report["exceeded"] == []
    assert all(f"{folder / name}\n" in demo.log for name in left)
