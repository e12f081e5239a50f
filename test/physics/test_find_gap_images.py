# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The search with images from bags to overlay, on small cases with another law of vignetting.

Two trajectories of a unit of `sensor_a` with a coarse gel. Its images are those that the twin's
camera has of its gel, with noise, and with what a hidden law does to them; so what is tested is
that all parts find each other. `python -m studies gap_images` judges the rule on images that were
made by other means.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from dotsim_ros.data.measurement import read_measurement
from dotsim_ros.data.trajectory import ImageChannel, read_trajectory, write_trajectory
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import Overlay, active_effects
from dotsim_ros.effects.simulate import EffectRequest, open_solver
from dotsim_ros.gap.find import find_gap_with_images
from dotsim_ros.gap.findings import Findings, Verdict
from dotsim_ros.gap.images import find as optical_find
from dotsim_ros.gap.images.model import Film, TwinCamera
from dotsim_ros.gap.images.reading import MeasuredImages, read_images
from dotsim_ros.gap.presses.search_state import GapRequest
from dotsim_ros.gel.make import skin_of
from dotsim_ros.gel.values import values_of
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.specification import SensorSpecification, load_sensor
from studies.hidden.images import LAWS, Takes
from studies.hidden.reality import Truth
from studies.hidden.unit import measure_unit

PROTOCOLS = ("hold_0", "slide_0")
SKIN_SPACING_M = 2.0e-3
WIDTH, HEIGHT = 160, 120
SEED = 11
NOISE_LEVELS = 1.2
CANDIDATES = ("gamma", "led_imbalance_red", "saturation", "vignetting")

Law = Callable[[Takes], np.ndarray]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the solves: the cases have the same poses, so they share them."""
    return tmp_path_factory.mktemp("run")


@pytest.fixture(scope="module")
def sensor() -> SensorSpecification:
    sensor = load_sensor("sensor_a")
    # A refined gel needs tables for each skin and Poisson's ratio: minutes.
    return replace(
        sensor,
        # The skin that is measured: its solves serve both parts of the search.
        gel=replace(sensor.gel, skin_spacing_m=SKIN_SPACING_M),
        solver=replace(sensor.solver, refined=False, grid_spacing_m=4.8e-3),
    )


@dataclass(frozen=True)
class Unit:
    """A unit that was measured without images, and what the twin's camera has of it.

    Attributes:
        data: its data set.
        idle: (H, W, 3) without contact.
        films: by trajectory.
    """

    data: Path
    idle: np.ndarray
    films: dict[str, Film]


@pytest.fixture(scope="module")
def unit(sensor: SensorSpecification, run: Path, tmp_path_factory: pytest.TempPathFactory) -> Unit:
    data = tmp_path_factory.mktemp("unit") / "measured"
    skin = dome_skin(sensor.gel.outer_radius_m, SKIN_SPACING_M)
    measure_unit(data, sensor, skin, Truth(()), seed=SEED, only=PROTOCOLS)
    model = TwinCamera(sensor, width=WIDTH, height=HEIGHT)
    dark = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    assert cv2.imwrite(str(data / "idle_0.png"), cv2.cvtColor(model.idle, cv2.COLOR_RGB2BGR))
    blank = _with_images(data, lambda name, count: np.stack([dark + n for n in range(count)]))
    recordings = [one.recording for one in blank.trajectories]
    with open_solver(sensor, skin_of(sensor.gel), run / "solves", workers=1) as solver:
        answers = solver.run([EffectRequest(r, values_of(sensor)) for r in recordings])
    films = {
        r.name: model.film(answer.skin_position_m, r.press.stamp_s, r.session_s)
        for r, answer in zip(recordings, answers, strict=True)
    }
    return Unit(data, model.idle.astype(np.float64), films)


def measure(unit: Unit, directory: Path, law: Law | None = None) -> Path:
    """Write the unit's data set with images that a law changed; return its folder."""
    data = directory / "measured"
    shutil.copytree(unit.data, data)
    random = np.random.default_rng(SEED)

    def camera(pixels: np.ndarray, session_s: np.ndarray) -> np.ndarray:
        takes = Takes(pixels.astype(np.float64), session_s, unit.idle)
        seen = takes.pixels if law is None else law(takes)
        noisy = seen + NOISE_LEVELS * random.standard_normal(seen.shape)
        return np.clip(np.rint(noisy), 0.0, 255.0).astype(np.uint8)

    for number in range(4):
        image = camera(unit.idle[None], np.zeros(1))[0]
        path = str(data / f"idle_{number}.png")
        assert cv2.imwrite(path, cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
    _with_images(data, lambda name, _: camera(unit.films[name].pixels, unit.films[name].session_s))
    return data


def _with_images(data: Path, images: Callable[[str, int], np.ndarray]) -> MeasuredImages:
    """Write bags with images next to those that are there, and an index of them; read them."""
    folder = data / "filmed"
    shutil.rmtree(folder, ignore_errors=True)
    index = yaml.safe_load((data / "dataset.yaml").read_text(encoding="utf-8"))
    for name, entry in zip(PROTOCOLS, index["trajectories"], strict=True):
        trajectory = read_trajectory(data / "bags" / name)
        assert trajectory.pose is not None
        stamps = trajectory.pose.stamp_ns
        pixels = images(name, len(stamps))
        write_trajectory(folder / name, replace(trajectory, image=ImageChannel(stamps, pixels)))
        entry.update(bag=f"filmed/{name}", images=True)
    (data / "dataset.yaml").write_text(yaml.safe_dump(index), encoding="utf-8")
    sensor = load_sensor("sensor_a")
    sensor = replace(sensor, gel=replace(sensor.gel, skin_spacing_m=SKIN_SPACING_M))
    measurement = read_measurement(
        data,
        own_skin=skin_of(sensor.gel),
        indenters=data / "indenters",
        presses=False,
        images=True,
    )
    return read_images(measurement, sensor=sensor)


def searched(
    data: Path,
    sensor: SensorSpecification,
    run: Path,
    *,
    channels: tuple[str, ...] = ("image",),
    candidates: tuple[str, ...] = CANDIDATES,
    reference: Path | None = None,
    effects: tuple[Path, ...] = (),
) -> tuple[Findings, Overlay | None]:
    return find_gap_with_images(
        GapRequest(
            measured=data,
            sensor=sensor,
            directory=run,
            reference=reference,
            indenters=data / "indenters",
            effects=effects,
            channels=channels,
            candidates=candidates,
            seed=1,
            workers=1,
        ),
        lambda step, done, total: None,
    )


OWN_EFFECT = """
from dotsim_ros.effects.effect import IMAGE, Effect, EffectParameter
from dotsim_ros.effects.optical_terms import any_frame, radius_square


def _image(values):
    loss = values["rim_loss"]
    return lambda image: image.pixels * (1.0 - loss * radius_square(image))[..., None]


EFFECT = Effect(
    name="dark_rim",
    title="Dark rim",
    parameters=(EffectParameter("rim_loss", "", 0.0, 0.0, 0.3, (0.05, 0.2)),),
    channels=(IMAGE,),
    protocol="any images",
    excited_by=any_frame,
    image=_image,
)
"""


@pytest.fixture
def own_effect(tmp_path: Path) -> Path:
    """Return the folder of an effect that the shipped noise of images does not know."""
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "dark_rim.py").write_text(OWN_EFFECT, encoding="utf-8")
    return folder


def vignetted(takes: Takes) -> np.ndarray:
    return LAWS["cosine_fourth"].change(takes, 0.12)


def test_a_camera_that_changed_is_in_the_overlay(
    tmp_path: Path, unit: Unit, run: Path, sensor: SensorSpecification
) -> None:
    data = measure(unit, tmp_path, vignetted)
    findings, overlay = searched(data, sensor, run)
    assert findings.verdict is Verdict.NAMED
    assert findings.named == ("vignetting",)
    assert findings.optical is not None
    assert findings.optical.share_closed is not None
    assert findings.optical.share_closed > 0.7
    _, recalibrated_db, after_db = findings.optical.psnr_db
    assert after_db > recalibrated_db + 3.0
    assert overlay is not None
    (active,) = active_effects(overlay, load_effects())
    assert active.values["edge_loss"] == pytest.approx(0.12, rel=0.2)
    # With these images as the commissioning, nothing has changed since.
    again, nothing = searched(data, sensor, run, reference=data)
    assert again.verdict is Verdict.NO_GAP
    assert nothing is None
    assert again.mode == "differential"
    assert again.sentence == "Images: no gap beyond noise and the twin's own error."
    assert again.optical is not None
    assert again.optical.trajectories == ("idle", *PROTOCOLS)
    assert "sensor_a" in again.optical.noise_source


def test_another_unit_s_images_are_refused_and_the_gel_is_still_judged(
    tmp_path: Path, unit: Unit, run: Path, sensor: SensorSpecification
) -> None:
    data = measure(unit, tmp_path, lambda takes: takes.pixels[:, :, ::-1])
    findings, overlay = searched(
        data,
        sensor,
        run,
        channels=("skin", "force", "image"),
        candidates=("gamma", "permanent_set"),
    )
    assert findings.verdict is Verdict.NO_GAP
    assert overlay is None
    assert findings.optical is not None
    assert findings.optical.verdict is Verdict.UNUSABLE
    assert "they belong to another unit" in findings.sentence
    assert findings.sentence.startswith("No gap")


def test_an_effect_of_the_user_is_found_with_a_reference_that_tells_its_limit(
    tmp_path: Path,
    unit: Unit,
    run: Path,
    sensor: SensorSpecification,
    own_effect: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for folder in ("before", "after"):
        (tmp_path / folder).mkdir()
    reference = measure(unit, tmp_path / "before")
    data = measure(unit, tmp_path / "after", vignetted)
    wanted = {"effects": (own_effect,), "candidates": ("dark_rim", "gamma")}
    alone, overlay = searched(data, sensor, run, **{**wanted, "candidates": ("dark_rim",)})
    assert alone.verdict is Verdict.UNUSABLE
    assert overlay is None
    assert alone.sentence == "Images: not searched. Not tried: dark rim."
    assert any("--fit-optical-noise" in text and "dark_rim" in text for text in alone.warnings)
    findings, _ = searched(data, sensor, run, reference=reference, **wanted)
    assert findings.optical is not None
    assert findings.optical.not_tried == ("dark_rim",)
    assert findings.sentence.endswith("Not tried: dark rim.")
    assert any("2 trajectories with images are too few" in text for text in findings.warnings)
    # The unit of these tests has two trajectories.
    monkeypatch.setattr(optical_find, "LEAST_TRAJECTORIES", 1)
    findings, overlay = searched(data, sensor, run, reference=reference, **wanted)
    assert findings.optical is not None
    assert findings.optical.not_tried == ()
    assert findings.named == ("dark_rim",)
    assert any("their limits come from 2 trajectories" in text for text in findings.warnings)
    assert overlay is not None
    (active,) = active_effects(overlay, load_effects([own_effect]))
    assert active.values["rim_loss"] == pytest.approx(0.12, rel=0.2)
