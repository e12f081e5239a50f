# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where a command's files cannot be written, it says so before it begins."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dotsim_ros import calibrate, find_gap
from dotsim_ros.cli.main import main
from dotsim_ros.io.files import check_output_file, check_output_folder

COMMANDS = (
    "calibrate --data DATA --out OUT.yaml",
    "calibrate-camera --data DATA --sensor sensor_a --out OUT.yaml",
    "find-gap --measured DATA --out OUT",
    "plan-gap --protocols DATA --out OUT",
    "train-optics --data DATA --sensor sensor_a --out OUT",
    "demonstrate --out OUT",
    "view DATA --out OUT",
    "demo-loop --out OUT",
    "plan-gap --protocols DATA --json OUT",
)


@pytest.mark.fault("calibrate", "--out below a file, on a read-only or a full disk")
@pytest.mark.parametrize("line", COMMANDS, ids=lambda line: " ".join(line.split()[:2]))
@pytest.mark.parametrize("place", ["file/below", "/proc/below"])
def test_no_command_begins_where_it_cannot_write(tmp_path, line, place, capsys, answered):
    (tmp_path / "file").write_text("no folder")
    out = str(tmp_path / place)
    # That there are no data is not reached.
    given = line.replace("OUT", out).replace("DATA", str(tmp_path / "nothing")).split()
    assert main(given) == 1
    answer = capsys.readouterr().err
    assert answer.count("\n") == 1
    assert f"nothing can be written to {Path(out).parent}" in answer
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    if line == COMMANDS[0] and place == "file/below":
        answered(answer)


FULL = """
import resource, sys
from dotsim_ros.cli.main import main
resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000))
sys.exit(main(["find-gap", "--measured", sys.argv[1], "--out", sys.argv[1] + "/report"]))
"""


@pytest.mark.fault("find-gap", "--out on a disk that is full")
def test_no_room_is_seen_beforehand(tmp_path, answered):
    done = subprocess.run(
        [sys.executable, "-B", "-c", FULL, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "name another, or make room" in done.stderr
    assert list(tmp_path.iterdir()) == []
    # A limit of the process stands for the disk; only the system's words differ.
    answered(done.stderr.replace("File too large", "No space left on device"))


def test_the_calls_look_as_the_commands_do(tmp_path):
    (tmp_path / "file").write_text("no folder")
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "dataset.yaml").write_text("trajectories: []")
    with pytest.raises(OSError, match="is a folder, expected the name of a file"):
        check_output_file(tmp_path / "folder.yaml")
    with pytest.raises(OSError, match="File name too long"):
        check_output_folder(tmp_path / ("x" * 300))
    check_output_folder(tmp_path / "new" / "newer")
    assert not (tmp_path / "new").exists()
    with pytest.raises(OSError, match="no data set"):
        find_gap(tmp_path / "nothing", out=tmp_path / "file" / "below")
    with pytest.raises(OSError, match="no data set"):
        calibrate(tmp_path / "nothing", out=tmp_path / "file" / "below.yaml")
