# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The study of images: frames, rows that are kept, figures and sheets."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dotsim_ros.geometry.camera import Camera, FisheyeCamera
from dotsim_ros.twin.footage import OpticalData, OpticalPress, Rest
from dotsim_ros.twin.image_metrics import LARGEST_PSNR_DB, psnr_db
from studies.optics import rows as optics_rows
from studies.optics.image_scores import score_image, ssim_map
from studies.optics.judge import (
    Idle,
    WarpedIdle,
    ceilings,
    score_frames,
    splits_of,
    summarize,
)
from studies.optics.models import FitSettings, factory_of
from studies.optics.rows import RowMaker
from studies.optics.sheet import write_sheets
from studies.optics.split import LEVELS, WAYS, OpticalSplit, Recorded, optical_splits
from studies.optics.study import evaluate_optics, shown_frames

SIZE = (24, 32)
DEPTHS_M = np.array([-0.0001, 0.001, 0.0021, 0.0032])
CAMERA = FisheyeCamera(
    width=SIZE[1], height=SIZE[0], focal_px=12.0, principal_point_px=np.array([15.5, 11.5])
)


def rest_of() -> Rest:
    """Return a gel at rest with a pattern of noise, lit in the middle."""
    random = np.random.default_rng(0)
    lit = np.zeros(SIZE, dtype=np.bool_)
    lit[2:-2, 4:-4] = True
    idle = random.integers(80, 140, size=(*SIZE, 3)).astype(np.uint8) * lit[..., None]
    normal = np.zeros((*SIZE, 3), dtype=np.float32)
    normal[..., 2] = -1.0
    return Rest(idle, np.full(SIZE, 0.01, dtype=np.float32), normal, lit)


REST = rest_of()


def press(name: str, indenter: str) -> OpticalPress:
    """Return a press that makes the gel brighter, of which the warped image knows half."""
    frames = len(DEPTHS_M)
    measured = np.stack([REST.idle + np.uint8(10 * k) * REST.lit[..., None] for k in range(frames)])
    warped = np.stack([REST.idle + np.uint8(5 * k) * REST.lit[..., None] for k in range(frames)])
    return OpticalPress(
        name=name,
        indenter=indenter,
        tip_depth_m=DEPTHS_M,
        measured=measured,
        depth_m=np.stack([REST.depth_m] * frames),
        normal=np.stack([REST.normal] * frames),
        warped=warped,
    )


DATA = OpticalData(
    CAMERA,
    REST,
    tuple(press(f"{n}_shape_{k}", f"{n}_shape") for n in range(1, 5) for k in range(3)),
)
PRESSES = {p.name: p for p in DATA.presses}


def no_clipping() -> dict[str, OpticalPress]:
    """Stand in for the clipped skins where no model needs them."""
    raise AssertionError("nothing here needs a clipped skin")


def brighter(split: OpticalSplit) -> OpticalData:
    """Return the data by an idle image that is a grey level brighter."""
    return replace(DATA, rest=replace(REST, idle=REST.idle + np.uint8(1)))


def maker(folder: Path, **settings: Any) -> RowMaker:
    """Return what makes rows of the data."""
    return RowMaker(DATA, no_clipping, brighter, folder, FitSettings(**settings))


# Scores


def test_the_idle_image_scores_what_was_added():
    scores, _ = score_frames(Idle(), PRESSES, [("1_shape_0", k) for k in range(4)], REST)
    assert [s.full_depth for s in scores] == [False, False, False, True]
    assert scores[0].frame_score.psnr_db == LARGEST_PSNR_DB
    for k in (1, 2, 3):
        assert scores[k].disc_score.psnr_db == pytest.approx(20 * np.log10(255.0 / (10 * k)))
        assert scores[k].disc_score.mean_l2 == pytest.approx(np.sqrt(3.0) * 10 * k / 255.0)
    lit_share = REST.lit.mean()
    ratio = scores[3].disc_score.mean_l2 / scores[3].frame_score.mean_l2
    assert ratio == pytest.approx(1.0 / lit_share)


def test_summaries_by_depth():
    keys = [(name, k) for name in ("1_shape_0", "2_shape_0") for k in range(4)]
    figures = summarize(score_frames(WarpedIdle(), PRESSES, keys, REST)[0])
    assert (figures["frames"], figures["trajectories"]) == (8, 2)
    assert figures["full_depth"]["frames"] == 2
    assert figures["deep"]["frames"] == 4
    assert figures["full_depth"]["disc"]["psnr_db"] == pytest.approx(20 * np.log10(255.0 / 15))
    assert set(figures["indenters"]) == {"1_shape", "2_shape"}
    assert figures["psnr_db"] > figures["deep"]["psnr_db"] > figures["full_depth"]["psnr_db"]


def test_images_of_another_size_are_refused():
    @dataclass(frozen=True)
    class Small:
        name: str = "small"

        def predict(self, judged: OpticalPress, rest: Rest) -> NDArray[np.uint8]:
            return judged.measured[:, ::2]

    with pytest.raises(ValueError, match=r"small gives images of shape \(1, 12, 32, 3\)"):
        score_frames(Small(), PRESSES, [("1_shape_0", 2)], REST)


def test_ceilings_come_from_the_data() -> None:
    random = np.random.default_rng(3)
    grey = np.full((5, 100, 100, 3), 120.0)
    idle = np.rint(grey + 2.0 * random.standard_normal(grey.shape)).astype(np.uint8)
    figures = ceilings(DATA, idle)
    variance = 2.0**2 + 1.0 / 12.0
    assert figures["camera_noise_db"] == pytest.approx(10 * np.log10(255.0**2 / variance), abs=0.1)
    assert figures["two_renderings_db"] == figures["one_rendering_db"] == LARGEST_PSNR_DB


def test_one_rendering_is_noisier_than_its_mean():
    random = np.random.default_rng(4)
    noisy = np.rint(120.0 + 4.0 * random.standard_normal((2, *SIZE, 3))).astype(np.uint8)
    presses = tuple(
        replace(p, measured=np.concatenate([image[None], p.measured[1:]]))
        for p, image in zip(DATA.presses, noisy, strict=False)
    )
    figures = ceilings(replace(DATA, presses=presses), noisy[:1])
    assert "camera_noise_db" not in figures
    assert figures["one_rendering_db"] == pytest.approx(10 * np.log10(255.0**2 / 16.0), abs=0.3)


# Rows


def test_a_row_is_made_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    split = splits_of(DATA)["easy"]["by_trajectory"]
    shown = shown_frames(split, PRESSES, seed=0)
    first = maker(tmp_path).make("carried", split, shown)
    capsys.readouterr()
    again = maker(tmp_path).make("carried", split, shown)
    made_before = f"easy, by_trajectory, carried: made before, on {first.date}\n"
    assert capsys.readouterr().out == made_before
    assert again.scores == first.scores
    assert list(again.images) == list(first.images) == shown
    for key, image in first.images.items():
        assert np.array_equal(image, PRESSES[key[0]].warped[key[1]])
        assert np.array_equal(again.images[key], image)


def test_a_broken_row_is_made_again(tmp_path: Path) -> None:
    split = splits_of(DATA)["easy"]["by_frame"]
    first = maker(tmp_path).make("idle", split, [])
    (path,) = tmp_path.glob("*.json")
    path.write_text(path.read_text()[:50])
    assert maker(tmp_path).make("idle", split, []).scores == first.scores


def test_taxim_is_fitted_on_the_frames_given(tmp_path, monkeypatch):
    seen: list[int] = []

    def watched(name: str, settings: FitSettings, **options: Any) -> Any:
        make = factory_of(name, settings, **options)

        def made(train: Any, rest: Rest, camera: Camera) -> Any:
            seen.append(sum(len(p.measured) for p in train))
            return make(train, rest, camera)

        return made

    monkeypatch.setattr(optics_rows, "factory_of", watched)
    split = splits_of(DATA)["medium"]["by_trajectory"]
    row = maker(tmp_path).make("taxim", split, [])
    assert seen == [len(split.train)]
    assert len(row.scores) == len(split.test)


# Figures and sheets


def test_figures_and_sheets(tmp_path):
    drawn = splits_of(DATA)
    splits = [drawn[level][way] for level in ("easy", "hard") for way in drawn[level]]
    rows_of = maker(tmp_path / "rows")
    figures, rows = evaluate_optics(rows_of, splits, ["idle", "carried"], sensor="made_up.yaml")
    for level in ("easy", "hard"):
        for way in ("by_frame", "by_trajectory"):
            idle, warped = (figures[level][way][name] for name in ("idle", "carried"))
            assert set(idle) >= {"psnr_db", "mean_l2", "significant_l2", "ssim"}
            assert warped["psnr_db"] > idle["psnr_db"]
            assert warped["mean_l2"] < idle["mean_l2"]
    assert figures["failures"] == []
    write_sheets(tmp_path / "images", rows_of, rows)
    for level in ("easy", "hard"):
        assert (tmp_path / "images" / f"optics_{level}.jpg").stat().st_size > 1000
    json.dumps(figures)


# Splits

RECORDINGS = [
    Recorded(f"{number}_shape_{k}", f"{number}_shape", 6 + k)
    for number in range(1, 7)
    for k in range(4)
]
FRAMES = {(r.name, frame) for r in RECORDINGS for frame in range(r.frame_count)}


def indenters(frames: tuple[tuple[str, int], ...]) -> set[str]:
    """Return the numbers of the indenters of frames."""
    return {name[0] for name, _ in frames}


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("way", WAYS)
def test_nothing_judged_is_fitted_on(level: str, way: str) -> None:
    split = optical_splits(RECORDINGS)[level][way]
    assert (split.level, split.way) == (level, way)
    assert not set(split.train) & set(split.test)
    assert set(split.train) | set(split.test) <= FRAMES
    assert list(split.train) == sorted(split.train)
    assert list(split.test) == sorted(split.test)
    names = ({name for name, _ in frames} for frames in (split.train, split.test))
    assert way != "by_trajectory" or set.isdisjoint(*names)


def test_levels_take_the_indenters_of_the_paper() -> None:
    splits = optical_splits(RECORDINGS)
    for way in WAYS:
        easy, medium, hard = (splits[level][way] for level in LEVELS)
        assert indenters(easy.train + easy.test) == {"1", "3"}
        assert indenters(medium.train + medium.test) == {"1", "2", "3", "4", "5", "6"}
        assert indenters(hard.train) == {"2", "4", "5", "6"}
        assert indenters(hard.test) == {"1", "3"}


def test_neighbours_of_judged_frames_are_fitted_on_by_frame() -> None:
    split = optical_splits(RECORDINGS)["medium"]["by_frame"]
    train = set(split.train)
    beside = [(n, f - 1) in train or (n, f + 1) in train for n, f in split.test]
    assert sum(beside) > 0.8 * len(beside)


def test_a_longer_trajectory_of_another_level_changes_no_draw() -> None:
    more = [*RECORDINGS, Recorded("2_shape_9", "2_shape", 5)]
    assert optical_splits(more)["easy"] == optical_splits(RECORDINGS)["easy"]


# Scores of an image

IMAGE_SIZE = (40, 50)
WHOLE = {"frame": None}


def noise_image(seed: int = 0) -> NDArray[np.uint8]:
    """Return an image of noise far from both ends of the scale."""
    random = np.random.default_rng(seed)
    return random.integers(100, 156, size=(*IMAGE_SIZE, 3), dtype=np.uint8)


def test_a_shift_of_all_colours_is_every_error() -> None:
    image = noise_image()
    same = score_image(image, image, WHOLE)["frame"]
    assert same.psnr_db == LARGEST_PSNR_DB
    assert (same.mean_l2, same.significant_l2) == (0.0, 0.0)
    assert same.ssim == pytest.approx(1.0)
    score = score_image(image + np.uint8(51), image, WHOLE)["frame"]
    assert score.psnr_db == pytest.approx(20.0 * np.log10(5.0))
    assert (score.mean_l2, score.significant_l2) == pytest.approx((0.2 * 3**0.5,) * 2)


def test_the_worst_hundredth_is_significant() -> None:
    image = noise_image()
    wrong = image.copy()
    wrong.reshape(-1, 3)[:20, 1] += 51
    score = score_image(wrong, image, WHOLE)["frame"]
    assert IMAGE_SIZE[0] * IMAGE_SIZE[1] == 2000
    assert score.significant_l2 == pytest.approx(0.2)
    assert score.mean_l2 == pytest.approx(0.002)
    assert score.psnr_db == pytest.approx(psnr_db(0.2**2 * 20 / 6000))


def test_a_region_is_judged_by_itself() -> None:
    image = noise_image()
    wrong = image.copy()
    wrong[:, :10] += np.uint8(51)
    left = np.zeros(IMAGE_SIZE, dtype=np.bool_)
    left[:, :10] = True
    scores = score_image(wrong, image, {"frame": None, "left": left, "right": ~left})
    assert scores["left"].mean_l2 == pytest.approx(0.2 * np.sqrt(3.0))
    assert scores["frame"].mean_l2 == pytest.approx(0.2 * np.sqrt(3.0) / 5.0)
    assert scores["right"].psnr_db == LARGEST_PSNR_DB
    assert scores["left"].ssim < scores["frame"].ssim < scores["right"].ssim


def test_ssim_falls_with_structure_not_with_brightness() -> None:
    image = noise_image()
    shuffled = noise_image(seed=5)
    brighter = image + np.uint8(10)
    assert ssim_map(shuffled, image).mean() < 0.2
    assert ssim_map(brighter, image).mean() > 0.95


def test_wrong_shapes_are_refused() -> None:
    image = noise_image()
    with pytest.raises(ValueError, match=r"shapes \(40, 49, 3\) and \(40, 50, 3\)"):
        score_image(image[:, :-1], image, WHOLE)
    with pytest.raises(ValueError, match="float64"):
        score_image(image.astype(np.float64), image, WHOLE)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="region 'disc' has shape"):
        score_image(image, image, {"disc": np.zeros(IMAGE_SIZE, dtype=np.bool_)})
