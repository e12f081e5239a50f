# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A report takes the place of another whole, whatever ends the writer, and nobody's files go."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from gap_findings import named, no_gap, unusable

from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import FILE_NAME, FoundEffect, Overlay
from dotsim_ros.gap.findings import Verdict
from dotsim_ros.gap.report.write import REPORT_BEFORE, write_report
from dotsim_ros.io.replacement import (
    MANIFEST,
    SET_ASIDE,
    STAGED,
    finish_replacement,
    note_made,
    remove_made,
    replace_files,
)

OLD = {"report.html": b"slip is missing", "findings.json": b"{slip}", FILE_NAME: b"slip"}
NEW: dict[str, bytes | None] = {
    "report.html": b"no gap",
    "findings.json": b"{no gap}",
    "tiles.png": b"new",
    FILE_NAME: None,
}
HIDDEN = (MANIFEST, STAGED, SET_ASIDE)


def shown(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name not in HIDDEN}


KILLED = """
import json, os, sys
from pathlib import Path
from dotsim_ros.io import replacement
OLD = {"report.html": b"slip is missing", "findings.json": b"{slip}",
       "effects_overlay.yaml": b"slip"}
NEW = {"report.html": b"no gap", "findings.json": b"{no gap}", "tiles.png": b"new",
       "effects_overlay.yaml": None}
statuses = []
while not statuses or statuses[-1]:
    folder = Path(sys.argv[1]) / str(len(statuses))
    replacement.replace_files(folder, OLD)
    child = os.fork()
    if child == 0:
        left = len(statuses)
        def dying(call):
            def one(*given, **named):
                global left
                left -= 1
                if left < 0:
                    os.kill(os.getpid(), 9)
                return call(*given, **named)
            return one
        os.replace, os.fsync = dying(os.replace), dying(os.fsync)
        os.rmdir, os.unlink = dying(os.rmdir), dying(os.unlink)
        replacement.replace_files(folder, NEW)
        os._exit(0)
    statuses.append(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
print(json.dumps(statuses))
"""


def what_of(found: dict[str, bytes], new: dict[str, bytes]) -> str:
    """Return of which report the files are."""
    for files, name in ((OLD, "the report before"), (new, "the new report")):
        if found == files:
            return name
        if found.items() <= files.items():
            return f"a part of {name}"
    return "files of both reports"


@pytest.mark.fault("find-gap", "SIGKILL while a report takes the place of another, at every step")
def test_a_killed_writer_leaves_no_mix_of_two_reports(tmp_path, answered):
    whole = {name: content for name, content in NEW.items() if content is not None}
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], capture_output=True, text=True, check=True
    )
    outcomes = []
    seen: dict[str, set[str]] = {"found": set(), "completed": set()}
    for step, status in enumerate(json.loads(done.stdout)):
        folder = tmp_path / str(step)
        seen["found"].add(what_of(shown(folder), whole))
        finish_replacement(folder)
        after = shown(folder)
        seen["completed"].add(what_of(after, whole))
        outcomes.append((status, after == whole))
    # Killed before the new one was whole, killed after, and not killed.
    assert (-9, False) in outcomes
    assert (-9, True) in outcomes
    assert outcomes[-1] == (0, True)
    assert "files of both reports" not in seen["found"]
    assert seen["completed"] == {"the report before", "the new report"}
    found, completed = (" or ".join(sorted(states)) for states in seen.values())
    answered(f"the folder holds {found}; after the next run {completed}")


FULL = """
import resource, sys
from dotsim_ros.io.replacement import replace_files
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
try:
    replace_files(sys.argv[1], {"report.html": b"new", "tiles.png": bytes(300_000)})
except OSError as error:
    print(error)
"""


@pytest.mark.fault("find-gap", "the disk is full while the report is written")
def test_a_full_disk_leaves_the_report_before(tmp_path, answered):
    replace_files(tmp_path / "report", OLD)
    done = subprocess.run(
        [sys.executable, "-B", "-c", FULL, str(tmp_path / "report")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith(f"{tmp_path / 'report'} could not be written (File too large)")
    assert shown(tmp_path / "report") == OLD
    assert not (tmp_path / "report" / STAGED).exists()
    # A limit of the process stands for the disk; only the system's words differ.
    answered(done.stdout.replace("File too large", "No space left on device"))


def test_what_the_user_wrote_or_changed_is_kept(tmp_path):
    (tmp_path / "report.html").write_bytes(b"of the user")
    (tmp_path / "notes.md").write_bytes(b"notes")
    replace_files(tmp_path, OLD)
    assert shown(tmp_path) == {
        **OLD,
        "report.html.kept": b"of the user",
        "notes.md": b"notes",
    }
    (tmp_path / FILE_NAME).write_bytes(b"slip, corrected by hand")
    replace_files(tmp_path, NEW)
    found = shown(tmp_path)
    # It must not stand next to another verdict under the name that the sensor loads.
    assert FILE_NAME not in found
    assert found[f"{FILE_NAME}.kept"] == b"slip, corrected by hand"


def overlay() -> Overlay:
    found = FoundEffect("coulomb_slip", named().candidates[0].estimates)
    return Overlay("sensor_a", "0123", (found,))


@pytest.mark.fault("find-gap", "unusable data, in the folder of a good report")
def test_unusable_data_keep_the_good_report_beside_theirs(tmp_path, answered):
    library = load_effects()
    write_report(
        tmp_path, replace(named(), worst=None, places=()), effects=library, overlay=overlay()
    )
    good = shown(tmp_path)
    for _ in range(2):
        write_report(tmp_path, unusable(), effects=library)
        assert FILE_NAME not in shown_files(tmp_path)
        assert shown(tmp_path / REPORT_BEFORE) == good
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_dir()) == [REPORT_BEFORE]
    write_report(tmp_path, replace(no_gap(), places=()), effects=library)
    write_report(tmp_path, unusable(), effects=library)
    assert (tmp_path / f"{REPORT_BEFORE}2" / "findings.json").is_file()
    assert shown(tmp_path / REPORT_BEFORE) == good
    told = json.loads((tmp_path / "findings.json").read_text(encoding="utf-8"))
    status = Verdict(told["verdict"]).exit_status
    kept = [name for name in sorted(shown(tmp_path / REPORT_BEFORE)) if not name.endswith(".png")]
    answered(
        f"{told['sentence']} (status {status}); {REPORT_BEFORE}/ holds {', '.join(kept)} and the "
        "pictures"
    )


def shown_files(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir() if p.is_file()}


@pytest.mark.fault("bags and data sets", "demo --out DIR, where DIR/presses is somebody's data")
def test_only_what_was_made_so_is_removed(tmp_path, answered):
    own = tmp_path / "presses"
    own.mkdir()
    bag = own / "metadata.yaml"
    bag.write_text("of the user")
    with pytest.raises(FileExistsError, match="did not make it") as refused:
        remove_made(tmp_path, "presses")
    answered(refused.value)
    assert bag.read_text() == "of the user"

    note_made(tmp_path, "presses")
    (own / "notes.txt").write_text("of the user")
    with pytest.raises(FileExistsError, match=r"presses holds notes\.txt"):
        remove_made(tmp_path, "presses")
    (own / "notes.txt").unlink()
    bag.write_text("changed by the user")
    with pytest.raises(FileExistsError, match=r"presses holds metadata\.yaml"):
        remove_made(tmp_path, "presses")
    note_made(tmp_path, "presses")
    remove_made(tmp_path, "presses")
    assert not own.exists()
