# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The examples run as a user runs them, and leave what they say; test/ros runs those of ROS."""

from __future__ import annotations

import contextlib
import io
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from dotsim_ros import load_effects, load_sensor, read_data_set
from dotsim_ros.optics.picture import TITLE_HEIGHT_PX

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(path.name for path in EXAMPLES.glob("*.py"))
TESTS = (Path(__file__), Path(__file__).parents[1] / "ros" / "test_ros_examples.py")
MOST_LINES = 120


def run(name: str, *arguments: object) -> str:
    """Run an example to its end in this process, which has imported most of what it needs; return
    what it printed."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        # Python looks next to a script first, and gives it its own arguments.
        patch.syspath_prepend(str(EXAMPLES))
        patch.setattr(sys, "argv", [str(EXAMPLES / name), *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return printed.getvalue()


def number_before(unit: str, text: str) -> float:
    """Return the last number that stands before a unit."""
    found = re.findall(rf"(-?[\d.]+(?:e[+-]?\d+)?) {unit}", text)
    assert found, f"no number of {unit} in {text}"
    return float(found[-1])


@pytest.mark.parametrize("name", SCRIPTS)
def test_an_example_is_short_listed_and_run_by_a_test(name: str) -> None:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    # Below its licence.
    assert len(text[text.index('"""') :].splitlines()) <= MOST_LINES
    assert re.search(rf"(python|pytest) examples/{name}", text)
    assert f"[`{name}`]({name})" in (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert any(f'"{name}"' in test.read_text(encoding="utf-8") for test in TESTS)


def test_a_press_is_saved(tmp_path: Path) -> None:
    # As a process of its own.
    command = [sys.executable, str(EXAMPLES / "press_and_save.py"), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    force_n = json.loads(re.search(r"force (\[.*\]) N", done.stdout)[1])  # type: ignore[index]
    assert 2.5 < force_n[2] < 3.5
    assert cv2.imread(str(tmp_path / "press.png")).shape == (480 + TITLE_HEIGHT_PX, 3 * 640, 3)
    with np.load(tmp_path / "press.npz") as arrays:
        np.testing.assert_allclose(arrays["force_n"], force_n, atol=1e-3)


def test_a_ball_rests_on_the_sensor_in_a_mujoco_world(tmp_path: Path) -> None:
    carried_n, weight_n = re.findall(r"[\d.]+(?= N)", run("sensor_in_mujoco.py", tmp_path))
    assert float(carried_n) == pytest.approx(float(weight_n), rel=0.05)
    assert cv2.imread(str(tmp_path / "touch.png")).shape == (480 + TITLE_HEIGHT_PX, 3 * 640, 3)


def test_a_descent_comes_closer_to_the_true_stiffness() -> None:
    printed = run("calibrate_by_gradient.py", 2)
    youngs_pa = [float(value) for value in re.findall(r"youngs_modulus_pa (\S+),", printed)]
    off_mn = [float(value) for value in re.findall(r"off by (\S+) mN", printed)]
    assert off_mn[-1] < 0.95 * off_mn[0]
    assert youngs_pa[-1] == 2.2e5
    assert abs(youngs_pa[-2] - youngs_pa[-1]) < abs(youngs_pa[0] - youngs_pa[-1])


def test_derivatives_find_the_push_that_turns_a_box() -> None:
    printed = run("turn_by_gradient.py", 4)
    force_n, angle_deg = re.findall(r"box: (\S+) N, the box turns by (\S+) degrees", printed)[-1]
    assert float(force_n) == pytest.approx(2.0, abs=0.01)
    assert float(angle_deg) == pytest.approx(10.0, abs=0.05)


def test_an_arm_in_mujoco_holds_what_the_gel_pushes_back(tmp_path: Path) -> None:
    run("mujoco_peg.py", tmp_path)
    _, force, torque, held = np.split(
        np.loadtxt(tmp_path / "forces.csv", delimiter=","), [1, 4, 7], axis=1
    )
    assert force[0] == pytest.approx(np.zeros(3))
    assert force[-1, 2] > 1.0
    # The motors hold the hand's weight, and what the gel adds to it: force and torque in the plane.
    assert held[-1, :2] == pytest.approx(force[-1, [0, 2]], abs=0.005)
    assert held[-1, 2] == pytest.approx(torque[-1, 1], abs=5e-5)
    assert cv2.imread(str(tmp_path / "peg.png")).shape == (480 + TITLE_HEIGHT_PX, 3 * 640, 3)


def test_two_fingers_lift_turn_and_hold_by_friction_alone(tmp_path: Path) -> None:
    printed = run("two_fingers.py", tmp_path, "ball", 0.5)
    assert re.findall(r"(\w+) after .*, 0 contacts in MuJoCo", printed) == [
        "lifted",
        "turned",
        "held",
    ]
    rows = [
        [float(number) for number in re.findall(r"-?\d+\.\d*(?:e[+-]\d+)?", line)]
        for line in printed.splitlines()
        if line.startswith("  ")
    ]
    *force_n, weight_n = rows[-2]
    assert force_n == pytest.approx([0.0, 0.0, weight_n], abs=0.01 * weight_n)
    *squeeze_n, x_mm, y_mm, angle_deg = rows[-1]
    assert squeeze_n[0] == pytest.approx(squeeze_n[1], rel=0.01)
    assert angle_deg == pytest.approx(90.0, abs=0.5)
    # It has not slipped since it was turned.
    assert [x_mm, y_mm] == pytest.approx(rows[-3][2:4], abs=5e-3)
    assert cv2.imread(str(tmp_path / "grip.png")).shape == (480, 1280, 3)


def test_a_slip_detector_learns_from_touches(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    printed = run("slip_detector.py", tmp_path, 5)
    found, slips, right, others = map(
        int, re.findall(r"(\d+) of (\d+) slips.* (\d+) of (\d+) frames", printed)[0]
    )
    # One touch of ten frames is left out.
    assert 0 < slips + others < 10
    assert found + right > 0.6 * (slips + others)
    assert cv2.imread(str(tmp_path / "slip.png")) is not None

    with pytest.raises(SystemExit, match="2"):
        run("grip_policy.py", tmp_path, 20, 1)
    assert "of another plan" in capsys.readouterr().err


def test_a_grip_policy_learns_from_touches(tmp_path: Path) -> None:
    printed = run("grip_policy.py", tmp_path, 20, 1)
    found = re.findall(r"(\w+): (\d) of 1 held, ([\d.]+) of", printed)
    ends = {name: (int(held), float(over)) for name, held, over in found}
    assert [held for held, _ in ends.values()] == [1, 0, 0, 1], printed
    # It needs no more than the network's share of the friction says, and some error.
    assert 1.0 < ends["trained"][1] < 2.0


def test_a_task_of_ones_own_is_solved_by_touch() -> None:
    printed = run("your_own_task.py")
    rewards = [float(reward) for reward in re.findall(r"reward (-[\d.]+)", printed)]
    assert 2 < len(rewards) < 30
    assert rewards[-1] > -0.02 > max(rewards[:-1])
    assert number_before("mm", printed) < 0.5


def test_a_mesh_of_ones_own_presses(tmp_path: Path) -> None:
    assert number_before("N", run("your_own_stl.py", tmp_path)) > 1.0
    again = run("your_own_stl.py", tmp_path / "given", tmp_path / "hexagon.stl")
    assert number_before("N", again) > 1.0
    images = [cv2.imread(str(tmp_path / name)) for name in ("hexagon.png", "given/hexagon.png")]
    assert np.array_equal(*images)


def test_a_slide_is_plotted(tmp_path: Path) -> None:
    assert 0.3 < number_before("N", run("slide_force.py", tmp_path)) < 1.5
    assert cv2.imread(str(tmp_path / "slide.png")) is not None


def test_a_batch_presses_less_the_farther_aside() -> None:
    lines = [line for line in run("batch.py", 3).splitlines() if "aside" in line]
    force_n = [number_before("N", line) for line in lines]
    assert len(force_n) == 3
    assert force_n == sorted(force_n, reverse=True)
    assert force_n[-1] > 0.1


def test_many_sensors_slip_at_a_force_by_their_friction() -> None:
    printed = run("many_sensors.py", 3)
    assert "input of shape (3, 64, 64)" in printed
    lines = [line for line in printed.splitlines() if "friction" in line]
    normal_n = [number_before("N normal", line) for line in lines]
    aside_n = [number_before("N aside", line) for line in lines]
    # The most slippery slips, and has Coulomb's force.
    assert aside_n[0] == pytest.approx(0.1 * normal_n[0], rel=0.1)
    assert aside_n == sorted(aside_n)
    assert all(0.9 < number_before("mm", line) < 1.1 for line in lines)


def test_a_recorded_unit_is_calibrated(tmp_path: Path) -> None:
    printed = run("record_and_calibrate.py", tmp_path)
    assert number_before("Pa", printed) == pytest.approx(2.2e5, rel=0.05)
    fitted = load_sensor(tmp_path / "calibrated.yaml")
    assert fitted.material.youngs_modulus_pa == pytest.approx(2.2e5, rel=0.05)
    assert fitted.contact.friction_coefficient == pytest.approx(0.3, rel=0.15)
    assert (tmp_path / "calibrated_report" / "report.html").is_file()
    entries = read_data_set(tmp_path / "measured").entries
    assert [(entry.frame_count, entry.has_images) for entry in entries] == [(4, True)] * 2


def test_an_effect_of_ones_own_is_found(tmp_path: Path) -> None:
    assert load_effects([EXAMPLES / "effects"])["crosstalk"].parameters[0].name == "share"
    printed = run("your_own_effect.py", tmp_path)
    assert "Crosstalk of the force gauge is missing" in printed
    findings = json.loads((tmp_path / "report" / "findings.json").read_text(encoding="utf-8"))
    assert (findings["verdict"], findings["named"]) == ("named", ["crosstalk"])
    (share,) = next(c for c in findings["candidates"] if c["name"] == "crosstalk")["estimates"]
    assert share["low"] < 0.3 < share["high"]
