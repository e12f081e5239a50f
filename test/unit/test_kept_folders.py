# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where tables and compiled kernels are kept, and that nothing ends where they cannot be."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.io.cache import keep_arrays, keep_table, load_arrays
from dotsim_ros.io.files import cache_directory, usable_folder

KEPT = """
from dotsim_ros.io.files import cache_directory
from dotsim_ros.io.warp_runtime import wp
wp.config.log_level = 30
wp.init()
print(cache_directory(), wp.config.kernel_cache_dir, sep="\\n")
"""
CHOICES = ("DOTSIM_ROS_CACHE", "XDG_CACHE_HOME", "WARP_CACHE_PATH", "HOME")


def kept(tmp_path: Path, **choices: str) -> tuple[Path, Path, list[str]]:
    """Return where a process keeps tables and kernels, and what it said of that."""
    (tmp_path / "temporary").mkdir(exist_ok=True)
    environment = {name: value for name, value in os.environ.items() if name not in CHOICES}
    done = subprocess.run(
        [sys.executable, "-c", KEPT],
        env={**environment, "TMPDIR": str(tmp_path / "temporary"), **choices},
        capture_output=True,
        text=True,
        check=True,
    )
    tables, kernels = done.stdout.splitlines()[-2:]
    said = [line for line in done.stderr.splitlines() if not line.startswith("Warp CUDA")]
    return Path(tables), Path(kernels), said


def test_one_variable_moves_tables_and_kernels(tmp_path):
    home = tmp_path / "home"
    tables, kernels, said = kept(tmp_path, HOME=str(home))
    assert (tables, kernels.parent) == (home / ".cache/dotsim_ros", tables / "warp")
    assert kernels.is_dir()
    assert said == []
    compiled = tmp_path / "compiled"
    tables, kernels, said = kept(
        tmp_path, HOME=str(home), DOTSIM_ROS_CACHE="~/tables", WARP_CACHE_PATH=str(compiled)
    )
    assert (tables, kernels.parent, said) == (home / "tables", compiled, [])


@pytest.mark.fault("sensor and YAML files", "a home that cannot be written, for tables and kernels")
def test_a_home_that_cannot_be_written_gives_way_to_a_temporary_folder(tmp_path, answered):
    (tmp_path / "home").write_text("a file")
    tables, kernels, said = kept(tmp_path, HOME=str(tmp_path / "home"))
    assert tables.parent == tmp_path / "temporary"
    assert (tables.stat().st_mode & 0o077, kernels.parent) == (0, tables / "warp")
    (line,) = said
    assert f"{tables} serves; set DOTSIM_ROS_CACHE to a folder that can be written" in line
    answered(line)
    # The next process finds there what this one has kept.
    chosen = {"DOTSIM_ROS_CACHE": str(tmp_path / "chosen"), "WARP_CACHE_PATH": "/proc/nowhere"}
    chosen_tables, kernels, (line,) = kept(tmp_path, **chosen)
    assert (chosen_tables, kernels.parent) == (tmp_path / "chosen", tables)
    assert "/proc/nowhere" in line
    assert "set WARP_CACHE_PATH" in line


def test_a_temporary_folder_that_others_can_write_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    open_to_all = tmp_path / f"dotsim_ros-{os.getuid()}"
    open_to_all.mkdir()
    open_to_all.chmod(0o777)
    monkeypatch.setenv("DOTSIM_ROS_CACHE", "/proc/nowhere")
    found = usable_folder("DOTSIM_ROS_CACHE", None)
    assert (found.parent, found.stat().st_mode & 0o777) == (tmp_path, 0o700)
    # Processes that this one starts keep in the same folder.
    assert cache_directory() == found == Path(os.environ["DOTSIM_ROS_CACHE"])


def test_an_answer_that_cannot_be_kept_ends_nothing(tmp_path, caplog):
    (tmp_path / "file").write_text("a file")
    path = tmp_path / "file" / "answer.npz"
    keep_arrays(path, {"answer": np.ones(3)})
    assert "is not kept, and will be computed again" in caplog.text
    assert load_arrays(path) is None


def test_tables_that_were_not_read_for_the_longest_time_go_first(tmp_path):
    paths = [tmp_path / f"{name}.npz" for name in "abcd"]
    table = {"answer": np.ones(1000)}
    for age, path in enumerate(paths[:3]):
        keep_table(path, table)
        os.utime(path, (1000.0 + age, 1000.0 + age))
    assert load_arrays(paths[0]) is not None
    size = paths[0].stat().st_size
    keep_table(paths[3], table, limit_bytes=2 * size)
    assert [path.exists() for path in paths] == [True, False, False, True]
    # One that takes more than the limit is kept all the same: it would be computed each time.
    keep_table(paths[1], table, limit_bytes=size // 2)
    assert [path.exists() for path in paths] == [False, True, False, False]
