# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fit of camera and lights: the idle image, warped by the skin, against what was measured.

Least squares over pixels of training presses, by turns for the lens (pixels that the skin moves
across) and for the lights (every lit pixel, blurred more). Errors of the skin are shared by whole
patches and by all frames of a press, so that the many pixels count as few observations; against
those weigh the priors, which decide where the images identify two parameters only in combination,
such as focal length and radial term, or centre and tilt.

The idle image constrains the lens by its rim alone, which is round about the optical axis: the
camera's own stop cuts it out. Where a circle fits the rim, its centre is a prior of the principal
point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dotsim_ros.calibration.camera.model import (
    CENTRE_NAMES,
    LENS,
    LIGHTS,
    REFERENCE_HEIGHT_PX,
    RIM_MARGIN_PX,
    CameraModel,
    CameraParameter,
    moved,
    seen_motion_px,
    with_gloss,
)
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from dotsim_ros.optics.idle import lit_region
from dotsim_ros.optics.renderer import SkinRenderer, View
from dotsim_ros.twin.footage import FilmedData, FilmedPress

Progress = Callable[[str], None]

LEAST_DEPTH_M = 1.0e-3
"""Shallower frames hold little information."""
LARGEST_FRAME_COUNT = 40

PATCH_PX = 16.0
"""Size over which errors of the skin are alike: one observation."""
MOVED_PX = 0.3
"""Least motion of the skin in the image for a pixel to be used to fit the lens."""
STRIDE_PX = 3
LENS_BLUR_PX = 1.0
LENS_SPAN_PX = 6.0
"""The lens is fitted to what is left of a blurred image once one blurred so much is taken off: the
pattern, without the shading."""
LIGHTS_BLUR_PX = 2.0

RIM_DEVIATION_PX = 0.5
"""How far the rim's centre lies from the principal point, one standard deviation."""
RIM_SHARE = 0.3
"""Share of the disc's median brightness at which its rim is taken."""
RIM_RESIDUAL_PX = 1.0
"""Root mean square distance of the rim from a circle above which it is none."""

BEND_DEVIATIONS = 3.0
"""Differences larger than so many deviations count linearly: the pattern is off by its contrast."""

ROUNDS = 2
EVALUATIONS = 6


@dataclass(frozen=True)
class Rim:
    """A circle through the rim of the lit disc, pixels: its centre (2,), x then y, its radius, and
    the root mean square distance of the rim from it."""

    centre_px: FloatArray
    radius_px: float
    residual_px: float


@dataclass(frozen=True)
class FittedParameter:
    """One parameter of the fit: its value before and after, its posterior standard deviation, and
    that before the images were seen."""

    name: str
    before: float
    after: float
    deviation: float
    prior: float


@dataclass(frozen=True)
class CameraFit:
    """What a fit found.

    Attributes:
        model: camera and lights.
        parameters: all that were free.
        rim: the lit disc's circle; None where it is none.
        frames: how many were fitted to.
        exposure: (3,) median ratio of measured to idle brightness in the first frames, for each
            colour: one where exposure and white balance were held.
    """

    model: CameraModel
    parameters: tuple[FittedParameter, ...]
    rim: Rim | None
    frames: int
    exposure: FloatArray


def rim_circle(idle: ImageArray) -> Rim | None:
    """Return the circle through the rim of the lit disc of an image (H, W, 3), of which the image's
    border may cut off a part; None where there is no such circle."""
    lit = lit_region(idle)
    if not lit.any():
        return None
    level = idle.max(axis=2)
    # A soft rim lies where its brightness is half-way; dark spots of the pattern are no darker.
    bright = (level > RIM_SHARE * np.median(level[lit])) & lit
    contours, _ = cv2.findContours(
        bright.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    if not contours:
        return None
    height, width = level.shape
    rim = max(contours, key=len)[:, 0, :].astype(np.float64)
    inner = (rim > 1.0).all(axis=1) & (rim < np.array([width - 2.0, height - 2.0])).all(axis=1)
    rim = rim[inner]
    if len(rim) < 0.5 * min(height, width):
        return None
    # |p|^2 = 2 c.p + (r^2 - |c|^2) is linear in centre and constant.
    system = np.column_stack([2.0 * rim, np.ones(len(rim))])
    solution = np.linalg.lstsq(system, np.sum(rim**2, axis=1), rcond=None)[0]
    centre = solution[:2]
    square = float(solution[2] + centre @ centre)
    if square <= 0.0:
        return None
    distance = np.linalg.norm(rim - centre, axis=1) - np.sqrt(square)
    residual = float(np.sqrt(np.mean(distance**2)))
    # The contour runs through the outermost lit pixels, half a pixel inside the rim.
    if residual > RIM_RESIDUAL_PX:
        return None
    return Rim(centre, float(np.sqrt(square)) + 0.5, residual)


def exposure_ratio(filmed: FilmedData) -> FloatArray:
    """Return (3,) median ratios of measured to idle brightness in the lit disc of each press's
    first frame."""
    lit = lit_region(filmed.idle)
    idle = filmed.idle[lit].astype(np.float64)
    ratios = [
        np.median(press.measured[0][lit] / np.maximum(idle, 1.0), axis=0)
        for press in filmed.presses
    ]
    return np.asarray(np.median(ratios, axis=0))


def fit_camera(
    filmed: FilmedData,
    start: CameraModel,
    *,
    lens_filmed: FilmedData | None = None,
    lens: Sequence[CameraParameter] = LENS,
    rounds: int = ROUNDS,
    progress: Progress = lambda _line: None,
) -> CameraFit:
    """Fit a camera and its lights to presses.

    Args:
        filmed: images and shapes of the skin, of the presses to fit to.
        start: at the images' resolution; the priors are centred there.
        lens_filmed: the same images with better shapes of the skin, for the lens alone; by default
            those of `filmed`. Measured vertices are noisy, which ruins their normals.
        lens: parameters of the lens that are free.
        rounds: how often lens and lights take turns.
        progress: called with a line that says what is being done.

    Raises:
        ValueError: no frame is deep enough.
    """
    rim = rim_circle(filmed.idle)
    first = with_gloss(start)
    groups = [
        _Group("lens", lens_filmed or filmed, lens, LENS_BLUR_PX, True, *_priors(first, lens, rim)),
        _Group("lights", filmed, LIGHTS, LIGHTS_BLUR_PX, False, *_priors(first, LIGHTS, None)),
    ]
    steps = [group.centre for group in groups]
    deviations = [group.deviation for group in groups]
    for turn in range(rounds):
        for index, group in enumerate(groups):
            others = moved(first, groups[1 - index].parameters, steps[1 - index])
            steps[index], deviations[index] = _solve(others, group, steps[index])
            model = moved(others, group.parameters, steps[index])
            listing = ", ".join(f"{p.name} {p.value(model):.5g}" for p in group.parameters)
            progress(f"round {turn + 1}, {group.name}: {listing}")
    model = first
    for group, taken in zip(groups, steps, strict=True):
        model = moved(model, group.parameters, taken)
    fitted = [
        _fitted(parameter, start, model, float(deviation))
        for group, found in zip(groups, deviations, strict=True)
        for parameter, deviation in zip(group.parameters, found, strict=True)
    ]
    return CameraFit(
        model, tuple(fitted), rim, len(_chosen_frames(filmed.presses)), exposure_ratio(filmed)
    )


def _fitted(
    parameter: CameraParameter, start: CameraModel, model: CameraModel, steps: float
) -> FittedParameter:
    """Return a parameter with its posterior deviation, which is given in steps."""
    after = parameter.value(model)
    # A number at its limit moves one way only.
    unit = max(
        abs(parameter.value(parameter.moved(model, way * parameter.step)) - after)
        for way in (-1.0, 1.0)
    )
    prior = unit * parameter.prior / parameter.step
    return FittedParameter(parameter.name, parameter.value(start), after, unit * steps, prior)


@dataclass(frozen=True)
class _Group:
    """Parameters that are fitted together, and on what.

    Attributes:
        name: for the progress.
        filmed: images and shapes.
        parameters: P of them.
        blur_px: of the images, at the height that parameters are stated for.
        pattern_only: whether shading, and pixels that the skin does not move across, are left out.
        centre, deviation: (P,) of the priors, in steps from the model that is given.
    """

    name: str
    filmed: FilmedData
    parameters: Sequence[CameraParameter]
    blur_px: float
    pattern_only: bool
    centre: FloatArray
    deviation: FloatArray


def _chosen_frames(presses: Sequence[FilmedPress]) -> list[tuple[FilmedPress, int]]:
    deep = [
        (press, int(frame))
        for press in presses
        for frame in np.flatnonzero(press.tip_depth_m >= LEAST_DEPTH_M)
    ]
    if not deep:
        raise ValueError(
            f"no frame is {1e3 * LEAST_DEPTH_M:g} mm deep, so the images do not identify the "
            "camera; press deeper, or leave the camera as stated"
        )
    count = min(len(deep), LARGEST_FRAME_COUNT)
    return [deep[index] for index in np.unique(np.linspace(0, len(deep) - 1, count).astype(int))]


def _priors(
    first: CameraModel, parameters: Sequence[CameraParameter], rim: Rim | None
) -> tuple[FloatArray, FloatArray]:
    """Return centre and deviation (P,) of the priors, in steps from the first model."""
    centre = np.zeros(len(parameters))
    deviation = np.array([parameter.prior / parameter.step for parameter in parameters])
    if rim is None:
        return centre, deviation
    offset = rim.centre_px - first.camera.principal_point_px
    offset = offset * REFERENCE_HEIGHT_PX / first.camera.height
    for index, parameter in enumerate(parameters):
        if parameter.name in CENTRE_NAMES:
            centre[index] = offset[CENTRE_NAMES.index(parameter.name)] / parameter.step
            deviation[index] = RIM_DEVIATION_PX / parameter.step
    return centre, deviation


class _Problem:
    """Differences between warped and measured images at chosen pixels."""

    def __init__(
        self,
        filmed: FilmedData,
        model: CameraModel,
        blur_px: float,
        *,
        pattern_only: bool,
    ) -> None:
        self._filmed, self._pattern_only = filmed, pattern_only
        self._chosen = chosen = _chosen_frames(filmed.presses)
        scale = model.camera.height / REFERENCE_HEIGHT_PX
        self._blur_px, self._span_px = blur_px * scale, LENS_SPAN_PX * scale
        self._lens: object = None
        self._views: list[View] = []
        views, rest = self._render(model)
        lit = lit_region(filmed.idle).astype(np.uint8)
        inside = cv2.erode(lit, np.ones((RIM_MARGIN_PX, RIM_MARGIN_PX))) > 0
        grid = np.zeros_like(inside)
        grid[::STRIDE_PX, ::STRIDE_PX] = True
        self._masks, measured, area = [], [], 0.0
        per_press = {press.name: 0 for press, _ in chosen}
        for press, _ in chosen:
            per_press[press.name] += 1
        for (press, frame), view in zip(chosen, views, strict=True):
            region = inside & view.mask
            if pattern_only:
                region &= _moved(view, rest, filmed.skin.triangles)
            area += float(region.sum()) / per_press[press.name]
            mask = region & grid
            self._masks.append(mask)
            measured.append(self._blurred(press.measured[frame])[mask].ravel())
        self._measured = np.concatenate(measured)
        if self._measured.size == 0:
            deepest_m = max(float(press.tip_depth_m[frame]) for press, frame in chosen)
            raise ValueError(
                f"no pixel of the {len(chosen)} chosen frames shows skin that moves, though the "
                f"deepest goes {1e3 * deepest_m:.1f} mm into the gel, expected to see the dent: "
                "check that the skin of these frames moves (or fit with --skin gel), and that the "
                "stated camera looks at it"
            )
        self.observations = max(area / (PATCH_PX * scale) ** 2, 1.0)

    def _blurred(self, image: ImageArray) -> Float32Array:
        if not self._pattern_only:
            return _blur(image.astype(np.float32), self._blur_px)
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.float32)
        return _blur(grey, self._blur_px) - _blur(grey, self._span_px)

    def _render(self, model: CameraModel) -> tuple[list[View], View]:
        renderer = SkinRenderer(model.camera, self._filmed.skin)
        views = [renderer.render(press.skin_position_m[frame]) for press, frame in self._chosen]
        return views, renderer.render(self._filmed.skin.rest_position_m)

    def residual(self, model: CameraModel) -> Float32Array:
        """Return (N,) grey levels by which the warped images differ."""
        if self._lens is not model.camera:
            self._views, _ = self._render(model)
            self._lens = model.camera
        image = model.images(self._filmed)
        warped = [
            self._blurred(image.warp(view))[mask].ravel()
            for view, mask in zip(self._views, self._masks, strict=True)
        ]
        return np.concatenate(warped) - self._measured


def _blur(image: Float32Array, size_px: float) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), size_px), dtype=np.float32)


def _moved(view: View, rest: View, triangles: NDArray[np.int32]) -> BoolArray:
    """Return (H, W) where the skin that is seen has moved in the image, and a little around."""
    seen = seen_motion_px(view, rest, triangles) > MOVED_PX
    around = cv2.dilate((seen & view.mask).astype(np.uint8), np.ones((7, 7)))
    return np.asarray(around > 0)


def _solve(
    others: CameraModel,
    group: _Group,
    start: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return steps (P,) of a group at the optimum and their deviations.

    Args:
        others: the model with all other parameters where they are, and those of the group not
            moved.
        group: what is fitted.
        start: (P,) steps to start from.
    """

    def at(steps: FloatArray) -> CameraModel:
        return moved(others, group.parameters, steps)

    problem = _Problem(group.filmed, at(start), group.blur_px, pattern_only=group.pattern_only)
    first = problem.residual(at(start))
    noise = 1.4826 * float(np.median(np.abs(first))) + 1e-3
    weight = np.sqrt(problem.observations / len(first)) / noise
    bend = BEND_DEVIATIONS * weight * noise

    def data(steps: FloatArray) -> FloatArray:
        # Robust by hand, since the priors must stay quadratic: its square grows linearly.
        residual = weight * problem.residual(at(steps)).astype(np.float64)
        size = np.sqrt(2.0 * (np.sqrt(1.0 + (residual / bend) ** 2) - 1.0))
        return np.copysign(bend * size, residual)

    def value(steps: FloatArray) -> FloatArray:
        return np.concatenate([data(steps), (steps - group.centre) / group.deviation])

    def jacobian(steps: FloatArray) -> FloatArray:
        columns = [0.5 * (data(steps + unit) - data(steps - unit)) for unit in np.eye(len(steps))]
        return np.concatenate([np.stack(columns, axis=1), np.diag(1.0 / group.deviation)])

    # Unlike the trust region's, the first step of Levenberg and Marquardt's is not bounded.
    found = least_squares(
        value, start, jac=jacobian, method="lm", max_nfev=EVALUATIONS, xtol=1e-2, ftol=1e-4
    )
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    return found.x, np.sqrt(np.diag(covariance))
