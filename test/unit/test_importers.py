# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Importers of published recordings: what they write is read back, and bad files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.cli.main import main
from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.data.importers.densetact import import_densetact
from dotsim_ros.data.importers.ecoflex_compression import (
    HEIGHT_M,
    import_ecoflex_compression,
    read_compression_tests,
)
from dotsim_ros.data.importers.force_depth import ForceDepth, check_in_step, read_force_table
from dotsim_ros.data.importers.gelsight_mini_force import (
    PAD_SIZE_M,
    import_gelsight_mini_force,
    read_gelsight_mini_force,
)

REAL = Path(__file__).parents[3] / "shared" / "real"
needs_real = pytest.mark.skipif(not REAL.is_dir(), reason="the published sets are not here")
PRESS = "depth_mm,normal_force_N\n0.5,1.6\n1.0,5.9\n"


def table(folder: Path, text: str) -> Path:
    (folder / "force_depth.csv").write_text(text, encoding="utf-8")
    return folder


def loading(late_s: float = 0.0, force_per_n: float = 1.0) -> NDArray[np.float32]:
    """Return a test of a gel of 0.1 MPa to 18 mm at 10 mm/min, rows of s, mm and N."""
    time_s = np.arange(0.0, 108.0, 0.4)
    stretch = 1.0 - np.maximum(time_s - late_s, 0.0) / 6.0 / (1e3 * HEIGHT_M)
    force_n = 65.4 * (stretch**-2 - stretch) * force_per_n
    return np.stack([time_s, time_s / 6.0, force_n], axis=1).astype(np.float32)


def going_back() -> NDArray[np.float32]:
    rows = loading()
    rows[135:, 1:] = rows[135:0:-1, 1:]
    return rows


def saved(folder: Path, **arrays: NDArray[np.float32]) -> Path:
    np.savez(folder / "compression.npz", **arrays)
    return folder


def test_a_press_becomes_poses_and_a_wrench(tmp_path):
    made = import_gelsight_mini_force(table(tmp_path, PRESS), tmp_path / "set")
    (entry,) = read_data_set(made.directory).entries
    press = entry.read()
    assert press.image is None
    depth = PAD_SIZE_M[2] - press.pose.position_m[:, 2]
    np.testing.assert_allclose(depth, [-0.5e-3, 0.5e-3, 1.0e-3], atol=1e-12)
    np.testing.assert_allclose(press.wrench.force_n[:, 2], [0.0, 1.6, 5.9])


def test_units_are_those_that_the_columns_name(tmp_path):
    for column, scale in (("normal_force_g", 1e3 / 9.80665), ("normal_force_mN", 1e3)):
        path = table(tmp_path, f"depth_in,{column}\n{0.5 / 25.4},{1.6 * scale}\n")
        read = read_force_table(path / "force_depth.csv")
        np.testing.assert_allclose([read.depth_m[0], read.force_n[0]], [0.5e-3, 1.6])


@pytest.mark.fault("bags and data sets", "a table of force and depth that no gel gives")
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("depth_mm,normal_force\n0.5,1.6\n", "normal_force has no unit that is known"),
        ("depth_mm,normal_force_N\n1.0,5.9\n0.5,1.6\n", "line 3, column depth_mm: 0.5 mm after 1"),
        ("depth_mm,normal_force_N\n0.5,heavy\n", "line 2, column normal_force_N: 'heavy' is not"),
        ("depth_mm,normal_force_N\n0.5,163\n", "Young's modulus of .*grams"),
        ("depth_mm,normal_force_N\n0.0197,1.6\n", "Young's modulus of .*inches"),
        ("depth_m,normal_force_N\n0.5,1.6\n", "a depth of 500 mm in a gel of 4 mm"),
        ("depth_mm,normal_force_N\n", "got none below the names"),
        # Decimal commas.
        ("depth_mm,normal_force_N\n1,1,6,9\n", "line 2, column 3: '6' has no name above it"),
        ('depth_mm,normal_force_N\n"1,1","6,9"\n', "line 2, column depth_mm: '1,1' is not a numb"),
        ("depth_mm;normal_force_N\n1,1;6,9\n", "line 1: semicolons divide the names"),
        ("", "no column of depth among none"),
    ],
)
def test_a_bad_table_is_refused_with_the_reason(tmp_path, text, reason, answered):
    with pytest.raises(ValueError, match=reason) as refused:
        import_gelsight_mini_force(table(tmp_path, text), tmp_path / "set")
    answered(refused.value, what=f"the table {', '.join(text.split()) or 'of no line'}")
    assert not (tmp_path / "set").exists()


def test_tests_of_cylinders_become_trajectories(tmp_path):
    source = saved(tmp_path, EF30_25T_A1=loading(), EF30_25T_B2=loading(force_per_n=1.1))
    made = import_ecoflex_compression(source, tmp_path / "set")
    assert [entry.name for entry in made.entries] == ["EF30_25T_A1", "EF30_25T_B2"]
    press = made.entries[1].read()
    assert press.pose.position_m[0, 2] == pytest.approx(HEIGHT_M)
    assert press.wrench.force_n[-1, 2] == pytest.approx(loading()[-1, 2] * 1.1, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "rows", "reason"),
    [
        ("first", loading(), "no name of a test"),
        ("EF30_A1", loading()[:, :2], r"expected numbers of shape \(N, 3\)"),
        ("EF30_A1", loading(force_per_n=0.102e3), "Young's modulus of .*grams"),
        ("EF30_A1", loading() / [1.0, 25.4, 1.0], "at least 6 mm .*inches"),
        ("EF30_A1", loading() * [1.0, 1e3, 1.0], "a depth of .* in a gel of 30 mm"),
        ("EF30_A1", loading(late_s=15.0), "no force until 2.*runs late"),
        ("EF30_A1", np.concatenate([loading(), loading()]), "not later than the one before"),
        ("EF30_A1", going_back(), r"goes back by .* expected loading only"),
        ("EF30_A1", loading() * np.where(np.arange(270) < 200, 1, np.nan)[:, None], "not finite"),
    ],
)
def test_a_bad_test_is_refused_with_the_reason(tmp_path, name, rows, reason):
    with pytest.raises(ValueError, match=reason):
        read_compression_tests(saved(tmp_path, **{name: rows}))


@pytest.mark.fault("bags and data sets", "a force that runs late behind its depth")
def test_a_force_behind_its_depth_is_refused(answered):
    time_s = np.linspace(0.0, 2.0, 41)
    depth = 1e-3 * np.sin(0.5 * np.pi * time_s)
    check_in_step("press", time_s, ForceDepth(depth, 1e3 * depth))
    late = np.interp(time_s - 0.3, time_s, 1e3 * depth)
    with pytest.raises(ValueError, match=r"largest 0.3 s after the depth.*runs late") as refused:
        check_in_step("press", time_s, ForceDepth(depth, late))
    answered(refused.value)


def test_presses_of_a_stage_become_poses_alone(tmp_path):
    first = np.array([-22.38, 7.80 + 20.1, -22.85])
    np.savez(
        tmp_path / "presses.npz",
        position_mm=first - np.outer(np.arange(3), [0.0, 0.1, 0.0]),
        offset=np.array([0, 3]),
        sensor=np.array(["hard_gel_sensor_2_auto"]),
    )
    made = import_densetact(tmp_path, tmp_path / "set")
    press = made.entries[0].read()
    assert set(press.channels()) == {"pose"}
    np.testing.assert_allclose(press.pose.position_m[:, 2], [0.0161, 0.0160, 0.0159], atol=1e-9)


def test_the_command_says_what_it_wrote_or_why_not(tmp_path, monkeypatch, capsys):
    # Its paths may begin with the home.
    monkeypatch.setenv("HOME", str(tmp_path))
    call = ["import-data", "gelsight_mini_force", "--from=~", "--out=~/set"]
    assert main(call) == 1
    assert f"no file {tmp_path / 'force_depth.csv'}" in capsys.readouterr().err
    table(tmp_path, PRESS)
    assert main(call) == 0
    assert "1 trajectories, 3 frames" in capsys.readouterr().out
    assert read_data_set(tmp_path / "set").entries


@needs_real
def test_the_published_sets_are_taken():
    press = read_gelsight_mini_force(REAL / "gelsight_mini_force")
    np.testing.assert_allclose(press.depth_m, [0.5e-3, 1.0e-3, 2.0e-3])
    tests = read_compression_tests(REAL / "ecoflex_compression")
    assert len(tests) == 140
    assert {test.specimen for test in tests} == {"A", "B"}
