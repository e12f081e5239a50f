# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The models of the image on real flat sensors: presses of a ball on GelSights.

The recordings hold photographs of a ball, with the circle of contact marked by hand in each, and
one photograph without contact. The pose of the ball and the force were not recorded, so the shape
of the gel is inferred from the circle:

- by this package's gel, see `twin.ball_presses`;
- as a cap: the ball's surface inside the circle and a flat gel around it, which is how Taxim and
  FOTS label such presses for their own calibration.

The cameras set their white balance and exposure in every photograph, which no model of the gel
can know. Next to the plain scores each row has `balanced` ones: of the image with the three gains
that the photograph shows beyond the contact, for every model alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dotsim_ros.data.contact_circle import BallPress
from dotsim_ros.io.arrays import ImageArray
from dotsim_ros.io.cache import content_key
from dotsim_ros.io.files import cache_directory
from dotsim_ros.specification import (
    GelSpecification,
    SensorSpecification,
    SolverSpecification,
)
from dotsim_ros.twin.ball_presses import (
    CAMERA_DISTANCE_M,
    FlatScene,
    flat_scene,
    gel_presses,
    press_profiles,
)
from dotsim_ros.twin.footage import OpticalPress
from studies.data import REAL
from studies.optics.ball_recordings import (
    FOTS,
    TAXIM_SUBSETS,
    BallRecording,
    read_ball_recording,
    with_circles_found,
)
from studies.optics.image_scores import score_image
from studies.optics.judge import Factory, mean_score
from studies.optics.models import FitSettings, factory_of
from studies.optics.sheet import write_optics_sheet
from studies.rivals.optics import per_pixel

EVERY = 4
"""Every fourth press of Taxim's recordings is held out."""
BEYOND_CONTACT = 2.5
"""Radii from a contact beyond which a photograph's gains are read."""
CAP = "_cap"
BallModel = Literal["idle", "taxim", "taxim_cap", "fots", "fots_cap", "carried", "local", "ours"]
"""`local` is the network of the DenseTact's table, `ours` the one of `learning.neighbourhood`."""
AS_MARKED = "_as_marked"
MARKED_MODELS = ("idle", "taxim", "fots", "ours")
MARKED_BALL_RADIUS_M = 2.0e-3
"""Of a ball that was not recorded: one as wide as the circles that were marked."""
CANDIDATE_RADII_M = (0.75e-3, 1.0e-3, 1.5e-3)
"""Of a ball that was not recorded, for the circles found."""
SHOWN_MODELS = ("ours", "taxim", "fots")
SHOWN_PRESSES = 2
RADIUS_STEPS = 500
"""Steps of training where only candidates of a radius are compared."""

SENSOR = SensorSpecification(
    name="gelsight",
    gel=GelSpecification(
        shape="flat_pad", pad_size_m=(0.021, 0.025, 0.004), skin_spacing_m=0.25e-3
    ),
    solver=SolverSpecification(grid_spacing_m=1.0e-3, refined=False),
)
"""The pad's thickness is not recorded; silicone as its maker states that of a DenseTact."""


def cap_presses(
    presses: Sequence[BallPress],
    given: Sequence[OpticalPress],
    scene: FlatScene,
    ball_radius_m: float,
) -> list[OpticalPress]:
    """Return the presses with the ball's cap on a flat pad instead of the gel's shape.

    Args:
        presses: their circles; that the cap is nearer to the camera moves no pixel.
        given: the same presses, whose other arrays are kept.
        scene: camera and rest.
        ball_radius_m: of the ball.
    """
    height, width = scene.rest.lit.shape
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    capped = []
    for press, other in zip(presses, given, strict=True):
        across = (np.stack([x, y], axis=-1) - press.centre_px) / scene.pixels_per_metre
        square = np.sum(across**2, axis=-1)
        # A circle as wide as the ball has nowhere deeper to be.
        contact = min(press.radius_px / scene.pixels_per_metre, 0.999 * ball_radius_m)
        inside = square < contact**2
        height_m = np.sqrt(np.where(inside, ball_radius_m**2 - square, 1.0))
        sunk = np.where(inside, height_m - np.sqrt(ball_radius_m**2 - contact**2), 0.0)
        nearer = 1.0 - sunk / CAMERA_DISTANCE_M
        ball = np.concatenate([across, -height_m[..., None]], axis=-1) / ball_radius_m
        normal = np.where(inside[..., None], ball, scene.rest.normal)
        capped.append(
            replace(
                other,
                depth_m=(scene.rest.depth_m * nearer).astype(np.float32)[None],
                normal=normal.astype(np.float32)[None],
            )
        )
    return capped


@dataclass(frozen=True)
class BallStudy:
    """A recording, with the shapes of the gel under its presses.

    Attributes:
        recording: the photographs, with circles that say where models are judged.
        scene: camera and pad.
        by_gel: the presses with the pad's shape.
        by_cap: the presses with the ball's cap.
    """

    recording: BallRecording
    scene: FlatScene
    by_gel: tuple[OpticalPress, ...]
    by_cap: tuple[OpticalPress, ...]

    @classmethod
    def of(
        cls,
        recording: BallRecording,
        placed: Sequence[BallPress] | None = None,
        sensor: SensorSpecification = SENSOR,
    ) -> BallStudy:
        """Press the ball into a pad, and lay the pad's shape under each photograph.

        Args:
            recording: the photographs.
            placed: the same presses with the circles to lay it at; None for the recording's.
            sensor: whose pad is pressed.

        Raises:
            ValueError: the gel could not be solved, or is smaller than the image.
        """
        scene = flat_scene(recording.idle, sensor, recording.pixels_per_metre)
        profiles = press_profiles(sensor, recording.ball_radius_m)
        placed = recording.presses if placed is None else placed
        by_gel = gel_presses(placed, scene, profiles)
        by_cap = cap_presses(placed, by_gel, scene, recording.ball_radius_m)
        return cls(recording, scene, tuple(by_gel), tuple(by_cap))

    def training_key(self, test: Sequence[int]) -> str:
        """Return a key of what a network learns from with some presses held out: photographs, and
        the gel's shapes under them, which another gel changes."""
        return content_key((), self.by_gel, sorted(test))

    def judged(
        self, make: Factory, test: Sequence[int], *, cap: bool = False
    ) -> tuple[dict[str, Any], list[ImageArray]]:
        """Return the mean scores of a model on some presses, fitted on the others, and its images
        of them."""
        shapes = self.by_cap if cap else self.by_gel
        presses = self.recording.presses
        fitted = make(
            [shape for k, shape in enumerate(shapes) if k not in test],
            self.scene.rest,
            self.scene.camera,
        )
        images = [fitted.predict(shapes[k], self.scene.rest)[0] for k in test]
        plain, balanced = [], []
        for k, predicted in zip(test, images, strict=True):
            regions = {"frame": None, "contact": presses[k].near_contact()}
            plain.append(score_image(predicted, presses[k].image, regions))
            balanced.append(
                score_image(with_gains_of(predicted, presses[k]), presses[k].image, regions)
            )
        row = {
            **mean_score([score["frame"] for score in plain]),
            "contact": mean_score([score["contact"] for score in plain]),
            "balanced": {
                **mean_score([score["frame"] for score in balanced]),
                "contact": mean_score([score["contact"] for score in balanced]),
            },
        }
        return row, images


def with_gains_of(predicted: ImageArray, press: BallPress) -> ImageArray:
    """Return an image (H, W, 3) with the gains of a photograph: of each colour, what its mean
    beyond the contact is of the image's."""
    beyond = ~press.within(BEYOND_CONTACT)
    if not beyond.any():
        return predicted
    measured = press.image[beyond].astype(np.float64).mean(axis=0)
    gains = measured / np.maximum(predicted[beyond].astype(np.float64).mean(axis=0), 1.0)
    return np.clip(np.rint(predicted * gains), 0.0, 255.0).astype(np.uint8)


def evaluate_recording(
    recording: BallRecording,
    test: Sequence[int],
    *,
    placed: Sequence[BallPress] | None = None,
    models: Sequence[str],
    settings: FitSettings,
    state: Path,
    sheets: Path | None = None,
) -> dict[str, Any]:
    """Return the figures of the models on some presses, fitted on the others.

    Args:
        recording: the photographs.
        test: numbers of the presses held out.
        placed: the presses with the circles at which the gel's shape is laid, for every model
            alike; None for the recording's own.
        models: names of `BallModel`.
        settings: how models are fitted.
        state: folder of the networks' trainings, one in it for each gel and choice of presses.
        sheets: folder of a sheet of images, named by the recording; None for none.

    Raises:
        ValueError: the gel could not be solved.
    """
    presses = recording.presses
    print(f"{recording.name}: pressing the ball into a pad, {len(presses)} images to explain")
    study = BallStudy.of(recording, placed)
    training = state / f"{recording.name}-{study.training_key(test)}"
    rows, shown = {}, {}
    for model in models:
        print(f"{recording.name}, {model}: fitting on {len(presses) - len(test)} presses")
        make = _factory(model.removesuffix(CAP), settings, training)
        rows[model], images = study.judged(make, test, cap=model.endswith(CAP))
        if model in SHOWN_MODELS:
            keys = [(presses[k].name, 0) for k in test[:SHOWN_PRESSES]]
            shown[model] = dict(zip(keys, images, strict=False))
    if sheets is not None:
        write_optics_sheet(
            sheets / f"balls_{recording.name}.jpg",
            {(presses[k].name, 0): presses[k].image for k in test[:SHOWN_PRESSES]},
            {model: shown[model] for model in SHOWN_MODELS if model in shown},
            study.scene.rest.lit,
            title=f"{recording.name}: presses held out, and errors x 3",
        )
    scale = recording.pixels_per_metre
    return {
        "rows": rows,
        "train": [press.name for k, press in enumerate(presses) if k not in test],
        "test": [presses[k].name for k in test],
        "scale_known": recording.scale_known,
        "contact_radius_mm": [1e3 * press.radius_px / scale for press in presses],
    }


def gelsight(
    *,
    data: Path = REAL / "gelsight",
    models: tuple[BallModel, ...] = ("idle", "taxim", "taxim_cap", "fots", "ours"),
    count: int = 8,
    seed: int = 0,
    network_epochs: int | None = None,
    network_width: int | None = None,
    images: Path | None = Path("docs/images"),
    cache: Path | None = None,
) -> dict[str, Any]:
    """Images of every model on real presses of a ball on a flat sensor.

    Args:
        data: folder of FOTS's recording.
        models: which.
        count: presses held out, drawn by the seed.
        seed: of all draws.
        network_epochs: of a published network's training (its own number).
        network_width: of the published networks' images, pixels (their own).
        images: folder of a sheet of images.
        cache: folder of the networks' trainings (the user's cache).

    Raises:
        FileNotFoundError, ValueError: as `read_ball_recording`, or too few presses.
    """
    recording = read_ball_recording(data, FOTS)
    presses = len(recording.presses)
    if not 0 < count < presses:
        raise ValueError(
            f"{count} of {presses} presses cannot be held out; expected 1 to {presses - 1}"
        )
    settings = FitSettings(seed, network_epochs, network_width)
    test = np.random.default_rng(seed).choice(presses, size=count, replace=False)
    return evaluate_recording(
        recording,
        sorted(test.tolist()),
        models=models,
        settings=settings,
        state=_trainings(cache, seed),
        sheets=images,
    )


def gelsight_taxim(
    *,
    data: Path = REAL / "gelsight_taxim",
    models: tuple[BallModel, ...] = ("idle", "taxim", "fots", "ours"),
    seed: int = 0,
    network_epochs: int | None = None,
    network_width: int | None = None,
    images: Path | None = Path("docs/images"),
    cache: Path | None = None,
) -> dict[str, Any]:
    """Images of every model on real presses of a ball on two more flat sensors.

    Every fourth press is held out. Of the ball that was not recorded the others say what radius
    explains them.

    Args:
        data: folder of Taxim's recordings.
        models: which.
        seed: of all draws.
        network_epochs: of a published network's training (its own number).
        network_width: of the published networks' images, pixels (their own).
        images: folder of the sheets of images.
        cache: folder of the networks' trainings (the user's cache).

    Raises:
        FileNotFoundError, ValueError: as `read_ball_recording`.
    """
    figures: dict[str, Any] = {}
    settings = FitSettings(seed, network_epochs, network_width)
    given: dict[str, Any] = {"settings": settings, "state": _trainings(cache, seed)}
    for subset in TAXIM_SUBSETS:
        recording = read_ball_recording(data, f"taxim_{subset}")
        test = list(range(EVERY - 1, len(recording.presses), EVERY))
        if recording.scale_known:
            figures[subset] = evaluate_recording(
                recording, test, models=models, sheets=images, **given
            )
            continue
        # Its marks lie next to what is seen, by up to half their radius.
        found = with_circles_found(recording).presses
        figures[subset] = evaluate_recording(
            recording, test, placed=found, models=models, sheets=images, **given
        )
        fitted_on = [k for k in range(len(recording.presses)) if k not in test]
        figures[subset]["by_ball_radius_mm"] = radius_profile(
            replace(recording, presses=tuple(recording.presses[k] for k in fitted_on)),
            [found[k] for k in fitted_on],
            settings,
        )
        figures[subset + AS_MARKED] = evaluate_recording(
            replace(recording, ball_radius_m=MARKED_BALL_RADIUS_M),
            test,
            models=[model for model in models if model in MARKED_MODELS],
            **given,
        )
    return {"subsets": figures}


def _trainings(cache: Path | None, seed: int) -> Path:
    return (cache or cache_directory() / "optics") / f"gelsight-{seed}"


def radius_profile(
    recording: BallRecording,
    placed: Sequence[BallPress],
    settings: FitSettings,
) -> dict[str, float]:
    """Return the contact's PSNR on every fourth press, of our model fitted on the others, for
    candidates of the radius of a ball that was not recorded, by the radius in mm. A flat profile:
    images do not tell it."""
    # Loaded on use: it needs torch.
    from dotsim_ros.learning.neighbourhood import NeighbourhoodRecipe, fit_neighbourhood

    recipe = NeighbourhoodRecipe(steps=RADIUS_STEPS)
    found = {}
    for radius in CANDIDATE_RADII_M:
        print(f"{recording.name}: a ball of {1e3 * radius:g} mm radius")
        study = BallStudy.of(replace(recording, ball_radius_m=radius), placed)
        row, _images = study.judged(
            lambda t, r, c: fit_neighbourhood(t, r, c, seed=settings.seed, recipe=recipe),
            range(0, len(recording.presses), EVERY),
        )
        found[f"{1e3 * radius:g}"] = row["contact"]["psnr_db"]
    return found


def _factory(model: str, settings: FitSettings, state: Path) -> Factory:
    match model:
        case "fots":
            return lambda t, r, c: per_pixel.fit(
                t, r, c, seed=settings.seed, settings=per_pixel.FOTS
            )
        case "ours":
            # Loaded on use: it needs torch.
            from dotsim_ros.learning.neighbourhood import fit_neighbourhood

            return lambda t, r, c: fit_neighbourhood(t, r, c, seed=settings.seed)
        case "local":
            return factory_of("ours", settings, state=state)
        case _:
            return factory_of(model, settings, state=state)
