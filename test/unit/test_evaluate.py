# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presses, splits, scores and the studies of the gel, on a small data set with a known answer."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.data.data_set import DataSet, DataSetEntry, read_data_set
from dotsim_ros.data.data_set_writer import DataSetWriter
from dotsim_ros.data.presses import Prediction, Press
from dotsim_ros.data.reading import MeasuredBag, PressReader
from dotsim_ros.data.split import (
    hold_out_of_protocols,
)
from dotsim_ros.data.trajectory import (
    PoseChannel,
    SkinChannel,
    Topics,
    Trajectory,
    WrenchChannel,
    write_trajectory,
)
from dotsim_ros.gel.explicit.gel import PAPER_FRAME_S
from dotsim_ros.gel.material import NeoHookean
from dotsim_ros.geometry.indenter import sphere
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.geometry.skin_mesh import dome_skin, tip_depth_m
from dotsim_ros.specification import MaterialSpecification, SensorSpecification
from dotsim_ros.twin import press_metrics
from dotsim_ros.twin.follow import steps
from dotsim_ros.twin.press_metrics import (
    contact_region,
    judged_frames,
    score_press,
    summarize,
)
from dotsim_ros.twin.surface_metrics import SAMPLE_COUNT
from studies import run
from studies.geometry.explicit import (
    COARSE_SETTINGS,
    ExplicitFit,
    ExplicitModel,
)
from studies.geometry.registry import sensor_file
from studies.geometry.runtime import Effort, model_of, runtime
from studies.geometry.scores import (
    Split,
    floor_scores,
    leave_one_indenter_out,
    measurement_noise,
)
from studies.geometry.study import geometry_later, read_measured, read_with_later
from studies.rivals import taxim

FloatArray = NDArray[np.float64]

RADIUS_M = 0.01575
SKIN = dome_skin(RADIUS_M, 0.0016)
BALL = sphere(0.004)
DEPTHS_M = (-0.2e-3, 1.0e-3, 2.5e-3, 3.0e-3)
NOISE_M = 0.03e-3
STIFFNESS_N_M = 1000.0


def dented(depth_m: float) -> FloatArray:
    """Return the skin clipped by a ball that presses from the top."""
    position = SKIN.rest_position_m.copy()
    centre = np.array([0.0, 0.0, RADIUS_M - depth_m + 0.004])
    beyond = position - centre
    distance = np.linalg.norm(beyond, axis=1)
    inside = distance < 0.004
    position[inside] = centre + beyond[inside] / distance[inside, None] * 0.004
    return position


def trajectory(*, seed: int = 0, **changes: Any) -> Trajectory:
    """Return a press from the top, with noise on its skin."""
    random = np.random.default_rng(seed)
    stamps = np.array([1_000_000_000 + 100_000_000 * k for k in range(len(DEPTHS_M))])
    tips = np.array([[0.0, 0.0, RADIUS_M - depth] for depth in DEPTHS_M])
    skins = np.stack([dented(depth) for depth in DEPTHS_M])
    forces = np.array([[0.0, 0.1, STIFFNESS_N_M * max(depth, 0.0)] for depth in DEPTHS_M])
    channels = {
        "pose": PoseChannel(stamps, tips, np.tile([0.0, 0.0, 0.0, 1.0], (len(tips), 1))),
        "wrench": WrenchChannel(stamps, forces, np.zeros_like(forces)),
        "skin": SkinChannel(
            stamps, (skins + NOISE_M * random.normal(size=skins.shape)).astype(np.float32)
        ),
    }
    return Trajectory(**{**channels, **changes})


def press_of(measured: Trajectory) -> Press:
    """Return the press of what a bag holds."""
    entry = DataSetEntry("ball_0", Path(), "ball", len(DEPTHS_M), has_images=False)
    return MeasuredBag(entry, Topics(), measured, {}, {}).press()


def press(**changes: Any) -> Press:
    """Return the press of `trajectory`."""
    return replace(press_of(trajectory()), **changes)


def write_data_set(directory: Path) -> DataSet:
    """Write six presses of two indenters, which are the same ball."""
    names = [f"{indenter}_{k}" for indenter in ("ball", "other") for k in range(3)]
    return write_presses(directory, names, first_seed=0)


def write_presses(directory: Path, names: Sequence[str], *, first_seed: int) -> DataSet:
    writer = DataSetWriter(directory, SKIN, indenter_step_m=0.6e-3)
    for seed, name in enumerate(names, first_seed):
        writer.add(trajectory(seed=seed, name=name), replace(BALL, name=name[:-2]))
    return read_data_set(directory)


SAMPLES = 512
"""A quarter of those that surfaces are compared by: the earth mover's way takes a tenth of the
time."""


@pytest.fixture(autouse=True)
def few_samples(monkeypatch):
    monkeypatch.setattr(press_metrics, "SAMPLE_COUNT", SAMPLES)


@pytest.fixture(scope="module")
def data_set(tmp_path_factory):
    """The data set, written once."""
    return write_data_set(tmp_path_factory.mktemp("data"))


def perfect(measured: Press) -> Prediction:
    """Return what was there before the noise."""
    return Prediction(np.stack([dented(depth) for depth in DEPTHS_M]), measured.force_n)


# Presses


def test_press_is_what_was_written(data_set):
    entry = data_set.entries[0]
    read = PressReader(data_set, SKIN, True).read(entry).press
    assert (read.name, read.indenter, read.frame_count) == ("ball_0", "ball", 4)
    assert read.stamp_s == pytest.approx([1.0, 1.1, 1.2, 1.3])
    assert read.force_n == pytest.approx(trajectory().wrench.force_n)
    assert read.skin_position_m.shape == (4, SKIN.vertex_count, 3)


def test_channels_stamped_otherwise_are_refused():
    wrench = trajectory().wrench
    late = WrenchChannel(wrench.stamp_ns + 1, wrench.force_n, wrench.torque_nm)
    with pytest.raises(ValueError, match="every stamp of the wrench is 1e-09 s after"):
        press_of(trajectory(wrench=late))


def test_times_that_do_not_increase_are_named():
    with pytest.raises(ValueError, match="ball_0: frame 2 is not later"):
        press(stamp_s=np.array([1.0, 1.1, 1.1, 1.2]))


def test_steps_divide_what_is_too_long():
    pressed = press()
    way = list(steps(pressed.poses, pressed.stamp_s, longest_step_s=0.04))
    assert [ends for _, _, ends in way] == [True, *[False, False, True] * 3]
    assert sum(dt_s for _, dt_s, _ in way[1:]) == pytest.approx(0.3)
    assert way[3][0] is press_poses(way)[1]
    assert way[1][0].position_m[2] == pytest.approx(RADIUS_M + 0.2e-3 - 0.4e-3)


def press_poses(way: list[tuple[Pose, float, bool]]) -> list[Pose]:
    """Return the poses that end a frame."""
    return [pose for pose, _, ends in way if ends]


# Splits


def test_held_out_presses_depend_on_the_seed_alone():
    names = [f"press_{k}" for k in range(28)]
    train, test = hold_out_of_protocols(names)
    assert (len(train), len(test)) == (19, 9)
    assert sorted(train + test) == sorted(names)
    assert hold_out_of_protocols(names[::-1]) == (train, test)
    assert hold_out_of_protocols(names, seed=1)[1] != test


def test_a_stratified_draw_fits_and_judges_every_protocol():
    names = [f"{kind}_{k}" for kind in ("press", "slide", "1_hold") for k in range(3)] + ["odd_0"]
    train, test = hold_out_of_protocols(names, 4)
    assert sorted(train + test) == sorted(names)
    for kind in ("press", "slide", "1_hold"):
        assert any(name.startswith(kind) for name in train)
        assert any(name.startswith(kind) for name in test)
    assert "odd_0" in train
    assert hold_out_of_protocols(names[::-1], 4) == (train, test)
    assert {hold_out_of_protocols(names, 4, seed)[1] for seed in range(5)} != {test}
    with pytest.raises(ValueError, match="hold out 6 at most"):
        hold_out_of_protocols(names, 7)
    with pytest.raises(ValueError, match="cannot be held out; expected 1 to 2"):
        hold_out_of_protocols(["a_0", "a_1", "a_2"], 3)
    with pytest.raises(ValueError, match="a more than once"):
        hold_out_of_protocols(["a", "b", "a"], 1)


def test_every_indenter_is_left_out_once():
    splits = list(leave_one_indenter_out({"b_0": "b", "a_0": "a", "a_1": "a"}))
    assert splits == [Split("a", ("b_0",), ("a_0", "a_1")), Split("b", ("a_0", "a_1"), ("b_0",))]
    with pytest.raises(ValueError, match="two at least"):
        list(leave_one_indenter_out({"a_0": "a"}))


# Scores


def test_depth_is_that_of_the_tip():
    # The nearest vertex is the apex, on which the ball presses.
    assert tip_depth_m(SKIN, press().poses) == pytest.approx(DEPTHS_M, abs=1e-9)
    assert judged_frames(press(), SKIN).tolist() == [2, 3]
    assert judged_frames(press(), SKIN, from_depth_m=0.0).tolist() == [1, 2, 3]


def test_contact_region_is_what_the_indenter_touches():
    region = contact_region(dented(3e-3), press().poses[3], BALL)
    nearer = np.linalg.norm(dented(3e-3) - [0, 0, RADIUS_M - 3e-3 + 0.004], axis=1) < 0.0045
    assert region.any()
    assert np.array_equal(region, nearer)


def test_what_is_right_scores_the_noise():
    summary = summarize(score_press(press(), perfect(press()), BALL, SKIN))
    # Of the noise of three axes a surface sees one, a vertex all.
    assert summary.skin_rms_mm == pytest.approx(1e3 * NOISE_M, rel=0.1)
    assert summary.vertex_rms_mm == pytest.approx(1e3 * NOISE_M * np.sqrt(3.0), rel=0.05)
    assert summary.normal_force_error == 0.0
    assert (summary.frames, summary.presses) == (2, 1)
    noise = measurement_noise([press()], SKIN)
    assert noise.skin_rms_m == pytest.approx(NOISE_M, rel=0.1)
    assert noise.frames == 1


@pytest.fixture(scope="module")
def right():
    """The scores of what was there before the noise, with all samples."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(press_metrics, "SAMPLE_COUNT", SAMPLE_COUNT)
        return summarize(score_press(press(), perfect(press()), BALL, SKIN))


def test_floor_is_that_of_the_samples(right, monkeypatch):
    monkeypatch.setattr(press_metrics, "SAMPLE_COUNT", SAMPLE_COUNT)
    floor = summarize(floor_scores(press(), BALL, SKIN))
    assert floor.chamfer_mm == pytest.approx(0.44, abs=0.03)
    assert right.chamfer_mm == pytest.approx(floor.chamfer_mm, rel=0.05)
    assert right.emd_mm == pytest.approx(floor.emd_mm, rel=0.1)
    assert floor.skin_rms_mm == 0.0


def test_depth_of_the_measured_skin_in_the_indenter_is_told():
    rigid = perfect(press()).skin_position_m
    shallow = np.stack([dented(max(0.0, depth - 3e-4)) for depth in DEPTHS_M])
    scores = score_press(press(skin_position_m=shallow), Prediction(rigid), BALL, SKIN)
    for score in scores:
        centre = np.array([0.0, 0.0, RADIUS_M - DEPTHS_M[score.frame] + 0.004])
        distance = np.linalg.norm(shallow[score.frame] - centre, axis=1) - 0.004
        region = distance < 0.5e-3
        depth = np.maximum(0.0, -distance[region])
        area = SKIN.rest_area_m2[region]
        assert depth.max() == pytest.approx(3e-4, rel=0.05)
        assert score.inside_m == pytest.approx(np.sqrt(np.sum(area * depth**2) / area.sum()))
    clear = score_press(press(skin_position_m=rigid), Prediction(rigid), BALL, SKIN)
    assert all(score.inside_m < 1e-6 for score in clear)


def test_a_skin_that_stays_at_rest_is_wrong_in_the_contact(right, monkeypatch):
    monkeypatch.setattr(press_metrics, "SAMPLE_COUNT", SAMPLE_COUNT)
    rest = Prediction(np.tile(SKIN.rest_position_m, (4, 1, 1)))
    still = summarize(score_press(press(), rest, BALL, SKIN))
    assert still.contact_rms_mm is not None
    assert right.contact_rms_mm is not None
    assert still.contact_rms_mm > 10.0 * right.contact_rms_mm
    assert still.significant_chamfer_mm > right.significant_chamfer_mm
    assert still.normal_force_error is None


def test_force_errors_are_shares():
    measured = press()
    assert measured.force_n is not None
    scaled = Prediction(perfect(measured).skin_position_m, measured.force_n * [1.0, 0.5, 1.2])
    summary = summarize(score_press(measured, scaled, BALL, SKIN))
    assert summary.normal_force_error == pytest.approx(0.2)
    assert summary.tangential_force_error == pytest.approx(0.5)
    assert summary.shear_force_error is not None
    assert summary.shear_force_error < 0.05


def test_same_seed_same_scores():
    first, again = (
        summarize(score_press(press(), perfect(press()), BALL, SKIN, seed=7)) for _ in range(2)
    )
    assert first == again
    other = summarize(score_press(press(), perfect(press()), BALL, SKIN, seed=8))
    assert other.chamfer_mm != first.chamfer_mm


@pytest.mark.parametrize(
    ("prediction", "message"),
    [
        (Prediction(np.zeros((4, 7, 3))), "expected"),
        (Prediction(np.full((4, SKIN.vertex_count, 3), np.nan)), "not finite"),
        (
            Prediction(np.tile(SKIN.rest_position_m, (4, 1, 1)), np.zeros((3, 3))),
            "predicted forces",
        ),
    ],
)
def test_bad_predictions_are_refused(prediction, message):
    with pytest.raises(ValueError, match=f"ball_0: .*{message}"):
        score_press(press(), prediction, BALL, SKIN)


# The data set, the models and the studies


def test_broken_bag_is_left_out_and_named(tmp_path):
    data = write_data_set(tmp_path)
    write_trajectory(tmp_path / "bags" / "blind", trajectory(pose=None))
    broken = DataSetEntry("blind", tmp_path / "bags" / "blind", "ball", 4, False)
    unknown = replace(data.entries[0], name="odd", indenter="teapot")
    measured = read_measured(DataSet(tmp_path, (*data.entries, broken, unknown)))
    assert len(measured.presses) == 6
    assert "no message on /indenter/pose" in measured.left_out["blind"]
    assert "teapot" in measured.left_out["odd"]


def test_folder_of_sensors_holds_one_for_each_split(tmp_path: Path) -> None:
    (tmp_path / "ball.yaml").write_text("")
    assert sensor_file("ball", tmp_path) == tmp_path / "ball.yaml"
    assert sensor_file("ball", "densetact2") == "densetact2"
    with pytest.raises(FileNotFoundError, match=r"no other\.yaml: calibrate"):
        sensor_file("other", tmp_path)


def test_the_study_judges_every_split(data_set, tmp_path, capsys):
    options = ["--data", str(data_set.directory), "--models", "tacto", "--splits", "all"]
    options += ["--count", "2", "--from-depth-mm", "2.7"]
    assert run.run("geometry", options, json_directory=tmp_path)
    figures = json.loads((tmp_path / "geometry.json").read_text())
    # The data is Tacto's own model, so that only the noise and the triangles are left.
    drawn = figures["tacto"]["held_out"]
    assert drawn["presses"] == 2
    assert drawn["skin_rms_mm"] < 0.2
    assert figures["tacto"]["failures"] == []
    assert set(figures["tacto"]["indenter_left_out"]) == {"ball", "other"}
    # Samples are the farther apart, the fewer they are on a surface.
    apart = np.sqrt(SAMPLE_COUNT / SAMPLES)
    assert 0.4 * apart < figures["floor"]["held_out"]["chamfer_mm"] < 0.5 * apart
    assert figures["floor"]["held_out"]["skin_rms_mm"] == pytest.approx(1e3 * NOISE_M, rel=0.1)
    assert figures["options"]["models"] == ["tacto"]
    assert figures["options"]["seed"] == 0
    # The tables have the rows of the models that were asked for alone.
    said = capsys.readouterr().out
    assert "|Tacto|" in said
    assert "|Taxim|" not in said


def write_later(directory: Path, *names: str) -> DataSet:
    """Write presses that come without the mesh of the ball."""
    written = write_presses(directory, names, first_seed=10)
    shutil.rmtree(directory / "indenters")
    index = directory / "dataset.yaml"
    index.write_text(index.read_text().replace("indenter: later", "indenter: ball"))
    return read_data_set(written.directory)


def test_all_presses_are_fitted_on_and_all_later_ones_judged(data_set, tmp_path, monkeypatch):
    write_later(tmp_path, "later_0", "later_1")
    monkeypatch.setattr(taxim, "GENERATIONS", 1)
    monkeypatch.setattr(taxim, "POPULATION_FACTOR", 2)
    monkeypatch.setattr(press_metrics, "SAMPLE_COUNT", 128)
    seen: list[list[str]] = []
    fit = taxim.fit

    def watched(train: list[Press], *rest: Any) -> Any:
        seen.append([press.name for press in train])
        return fit(train, *rest)

    monkeypatch.setattr(taxim, "fit", watched)
    found = geometry_later(data=tmp_path, fit_data=data_set.directory, models=("taxim",))
    assert seen == [sorted(entry.name for entry in data_set.entries)]
    assert found["splits"]["held_out"]["test"] == ("later_0", "later_1")
    assert found["judged_frames"] == {"later_0": [2, 3], "later_1": [2, 3]}
    assert found["taxim"]["held_out"]["presses"] == 2


def test_a_press_is_not_judged_that_was_fitted_on(data_set, tmp_path):
    later = write_later(tmp_path, "later_0", "ball_1")
    with pytest.raises(ValueError, match=r"ball_1 in both .*give the later ones other names"):
        read_with_later(data_set, later)


def test_the_explicit_gels_modulus_is_that_of_the_forces():
    sensor = SensorSpecification()
    truth = ExplicitModel(sensor, NeoHookean(1.0e5, 0.45), COARSE_SETTINGS)
    # Down to 1 mm, which is a third of the way, in one frame of the paper's.
    whole = press()
    shallow = replace(
        whole,
        poses=whole.poses[:2],
        stamp_s=np.array([0.0, PAPER_FRAME_S]),
        skin_position_m=whole.skin_position_m[:2],
        force_n=whole.force_n[:2],
    )
    answer = truth.predict(shallow, BALL, SKIN)
    measured = replace(shallow, skin_position_m=answer.skin_position_m, force_n=answer.force_n)
    fits = ExplicitFit(sensor, COARSE_SETTINGS)
    with pytest.raises(ValueError, match="ball_0: no force was measured"):
        fits.fit_with_force([replace(measured, force_n=None)], {"ball": BALL}, SKIN)
    fitted = fits.fit_with_force([measured], {"ball": BALL}, SKIN)
    assert fitted.material.poisson_ratio == 0.45
    assert fitted.material.youngs_modulus_pa == pytest.approx(1.0e5, rel=1e-3)
    as_published = fits.fit([measured], {"ball": BALL}, SKIN)
    assert as_published.material.youngs_modulus_pa == 27_575.0


def test_the_runtime_tables_explicit_gel_has_the_moduli_of_the_sensors_law():
    # A Yeoh sensor's file has moduli of its own that its law does not use.
    law = MaterialSpecification(law="yeoh", c10_pa=3.0e4, c20_pa=2.0e3, bulk_modulus_pa=1.2e6)
    sensor = replace(SensorSpecification(), material=law)
    model = model_of(Effort("explicit", 2.4e-3, substeps=50), sensor)
    assert isinstance(model, ExplicitModel)
    # mu = 2 C10, E = 9 K mu / (3 K + mu), nu = E / (2 mu) - 1.
    youngs = 9.0 * 1.2e6 * 6.0e4 / (3.0 * 1.2e6 + 6.0e4)
    assert model.material.youngs_modulus_pa == pytest.approx(youngs)
    assert model.material.poisson_ratio == pytest.approx(youngs / 1.2e5 - 1.0)


def test_a_press_or_a_data_set_that_is_not_there_is_named(data_set, tmp_path):
    with pytest.raises(ValueError, match="no press nothing; the data set holds ball_0"):
        runtime(data=data_set.directory, presses=("nothing",))
    with pytest.raises(FileNotFoundError, match="is no data set"):
        runtime(data=tmp_path)
