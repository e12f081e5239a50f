# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What an effect is: a named term of the model with a few parameters, and what excites it.

A term acts in one or several places, each with a hook of its own: on the gel's material before
anything is solved, on the indenter's pose before the gel is pressed, on skin and force after, on
the image at the end. Hooks are filters that are called frame by frame in the order of time, so that
one implementation serves a recorded trajectory and the live sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from dotsim_ros.data.recording import Recording
from dotsim_ros.gel.values import GelValues, specification_with, values_of
from dotsim_ros.geometry.camera import Camera, FisheyeCamera
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray
from dotsim_ros.io.documents import value_text
from dotsim_ros.io.printable import one_line
from dotsim_ros.specification import SensorSpecification

Values = Mapping[str, float]
Returned = TypeVar("Returned")

SKIN, FORCE, IMAGE = "skin", "force", "image"

END_SHARE = 0.01
"""A value that is nearer to an end of its range than this share of it stands at the end."""


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    Attributes:
        name: of the parameter.
        unit: of its value; SI.
        none: value at which the effect is absent; None for one that shapes the effect but cannot
            make it absent, such as a relaxation time.
        low, high: plausible range.
        probes: values at which the effect is tried first, at least one.
        natural_ends: those of low and high beyond which nothing can be, such as more than all of
            something; the others are judgements of what is plausible.
    """

    name: str
    unit: str
    none: float | None
    low: float
    high: float
    probes: tuple[float, ...]
    natural_ends: tuple[float, ...] = ()

    def end_at(self, value: float) -> float | None:
        """Return the end of the plausible range that a value stands at; None for one within it, and
        for an end by nature."""
        near = END_SHARE * (self.high - self.low)
        for end in (self.low, self.high):
            if abs(value - end) <= near and end != self.none and end not in self.natural_ends:
                return end
        return None

    def beyond(self, end: float) -> float:
        """Return where the range ends once it is opened at an end: farther from the absent effect
        by as much again; a ratio stays above zero. An end by nature stays."""
        if self.none is None or end == self.none or end in self.natural_ends:
            return end
        is_small_ratio = 0.0 < end < self.none
        return end * end / self.none if is_small_ratio else 2.0 * end - self.none

    @property
    def opened(self) -> EffectParameter:
        """The same with a range that is opened at both ends."""
        return replace(self, low=self.beyond(self.low), high=self.beyond(self.high))


@dataclass(frozen=True)
class GelTerm:
    """What the gel is made of: the elastic gel with its friction, and its relaxation."""

    values: GelValues
    prony_shares: tuple[float, ...] = ()
    prony_times_s: tuple[float, ...] = ()


def with_gel(term: GelTerm, **changes: Any) -> GelTerm:
    """Return a gel with some of its `GelValues` replaced."""
    return replace(term, values=replace(term.values, **changes))


@dataclass(frozen=True)
class Response:
    """What the gel answers in one frame.

    Attributes:
        stamp_s: time of the frame, within its trajectory.
        session_s: time since the session's start.
        pose: where the indenter truly is, base frame.
        depth_m: of the tip below the skin at rest.
        rest_position_m: (V, 3) the skin at rest.
        skin_position_m: (V, 3).
        force_n: (3,) of the gel on the indenter, base frame.
    """

    stamp_s: float
    session_s: float
    pose: Pose
    depth_m: float
    rest_position_m: FloatArray
    skin_position_m: FloatArray
    force_n: FloatArray


@dataclass(frozen=True)
class SeenImage:
    """An image that the camera is about to give.

    Attributes:
        stamp_s: time of the frame, within its trajectory.
        session_s: time since the session's start.
        pixels: (H, W, 3) linear to the sensor's numbers, 0 to 255, not rounded.
        idle: (H, W, 3) the same without contact.
        centre_px: (2,) x and y of the optical axis.
        focal_px: pixels a radian at the optical axis, along y.
        flow_px_s: (H, W, 2) how fast the image moves; zero where it is not known.
        depth_m: (H, W) distance of the skin along each pixel's ray; NaN where no skin is seen.
        normal: (H, W, 3) unit normal of the skin, optical frame, on the camera's side; NaN where
            no skin is seen.
        projection: of the camera, as a sensor's file names it.
        pixel_aspect: the focal length along x over that along y.
    """

    stamp_s: float
    session_s: float
    pixels: FloatArray
    idle: FloatArray
    centre_px: FloatArray
    focal_px: float
    flow_px_s: FloatArray
    depth_m: FloatArray
    normal: FloatArray
    projection: str = FisheyeCamera.projection
    pixel_aspect: float = 1.0

    @property
    def focal_x_px(self) -> float:
        """Pixels a radian at the optical axis, along x."""
        return self.pixel_aspect * self.focal_px


MotionFilter = Callable[[float, Pose, FloatArray], Pose]
"""Maps time (s), commanded pose, and the force (3,) on the indenter to the true pose."""
ResponseFilter = Callable[[Response], Response]
ImageFilter = Callable[[SeenImage], FloatArray]
"""Returns (H, W, 3) pixels."""


@dataclass(frozen=True)
class Effect:
    """An effect: of the library, where a module of `effects/builtin` holds a family of them, or of
    a user's file, which holds one as `EFFECT`.

    Attributes:
        name: of the effect, and of a user's file.
        title: as reports name it, at the start of a sentence.
        parameters: its numbers; the first one is its size.
        channels: where it shows: `SKIN`, `FORCE`, `IMAGE`.
        protocol: what excites it, in words for the user.
        excited_by: whether a trajectory of a data set does.
        taken_for: effects, or parameters, that look alike.
        summary: what it does, in one sentence, for tables.
        gel, motion, response, image: its hooks, each None where it does not act. The first three
            are given the recording that they are for; in the live sensor there is none.
    """

    name: str
    title: str
    parameters: tuple[EffectParameter, ...]
    channels: tuple[str, ...]
    protocol: str
    excited_by: Callable[[Recording], bool]
    taken_for: tuple[str, ...] = ()
    gel: Callable[[GelTerm, Values, Recording | None], GelTerm] | None = None
    motion: Callable[[Values], MotionFilter] | None = None
    response: Callable[[Values], ResponseFilter] | None = None
    image: Callable[[Values], ImageFilter] | None = None
    summary: str = ""

    @property
    def needs_solve(self) -> bool:
        """Whether another size of the effect takes another solve of the gel."""
        return self.gel is not None or self.motion is not None

    def checked(self, values: Values) -> dict[str, float]:
        """Return values for all parameters, those not given at their first probe.

        Raises:
            ValueError: an unknown parameter, or a value that is not finite.
        """
        known = {parameter.name: parameter for parameter in self.parameters}
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise ValueError(
                f"effect {self.name!r} has no parameter {value_text(', '.join(unknown))}; it has "
                f"{', '.join(known)}"
            )
        result = {name: float(values.get(name, p.probes[0])) for name, p in known.items()}
        for name, value in result.items():
            if not np.isfinite(value):
                raise ValueError(f"{self.name}.{name} is {value}, expected a number")
        return result


def by_frame(function: Callable[..., Returned]) -> Callable[[Values], Callable[..., Returned]]:
    """Return a hook whose filter remembers nothing: the function of the effect's values and of what
    the filter is given."""
    return lambda values: partial(function, values)


@dataclass(frozen=True)
class Active:
    """An effect at work, with the values (all of its parameters) that it has."""

    effect: Effect
    values: Mapping[str, float]


class EffectError(ValueError):
    """A hook of an effect that fails or returns what it must not; the text names both."""


def _called(
    active: Active, hook: str, expected: type[Returned], call: Callable[[], Any]
) -> Returned:
    """Return what a hook gives.

    Raises:
        EffectError: it raises an error, or gives something else.
    """
    try:
        found = call()
    # A user's code fails in whatever way; the search or the sensor says which code it was.
    except Exception as error:
        raise EffectError(
            f"the effect {active.effect.name}: its hook {hook} fails with "
            f"{type(error).__name__}: {one_line(error)}; mend its file"
        ) from error
    if not isinstance(found, expected):
        raise EffectError(
            f"the effect {active.effect.name}: its hook {hook} gives "
            f"{one_line(repr(found))[:80]}, expected a {expected.__name__}; mend its file"
        )
    return found


def gel_with(effects: Sequence[Active], term: GelTerm, recording: Recording | None) -> GelTerm:
    """Return the gel that the effects make of one.

    Raises:
        EffectError: a hook fails.
    """
    for active in effects:
        if active.effect.gel is not None:
            call = partial(active.effect.gel, term, active.values, recording)
            term = _called(active, "gel", GelTerm, call)
    return term


def specification_with_effects(
    specification: SensorSpecification, effects: Sequence[Active]
) -> SensorSpecification:
    """Return a sensor whose gel is what the effects make of it.

    Raises:
        ValueError: an effect acts on a gel that has another law than neo-Hooke's or Yeoh's, or
            gives it a value that it cannot have, or makes a pad thicker or thinner.
    """
    if not any(active.effect.gel for active in effects):
        return specification
    own = specification.material
    term = gel_with(
        effects, GelTerm(values_of(specification), own.prony_shares, own.prony_times_s), None
    )
    changed = specification_with(specification, term.values)
    if specification.gel.shape != "dome" and changed.gel != specification.gel:
        raise ValueError(
            "an effect changes the thickness of a pad; its base would come up and its face stay, "
            "which a sensor whose base is at z = 0 cannot show: set gel.pad_size_m in the sensor's "
            "file, whose face is then at another height"
        )
    material = replace(
        changed.material, prony_shares=term.prony_shares, prony_times_s=term.prony_times_s
    )
    return replace(changed, material=material)


def _filters(effects: Sequence[Active], hook: str) -> list[tuple[Active, Callable[..., Any]]]:
    """Return a fresh filter of each effect that has the hook."""
    made = []
    for active in effects:
        make = getattr(active.effect, hook)
        if make is not None:
            one: Any = _called(active, hook, object, partial(make, active.values))
            made.append((active, one))
    return made


def motion_filters(effects: Sequence[Active]) -> MotionFilter:
    """Return fresh filters of the pose, one after the other; they raise EffectError."""
    filters = _filters(effects, "motion")

    def filtered(stamp_s: float, pose: Pose, force_n: FloatArray) -> Pose:
        for active, one in filters:
            pose = _called(active, "motion", Pose, partial(one, stamp_s, pose, force_n))
        return pose

    return filtered


def response_filters(effects: Sequence[Active]) -> ResponseFilter:
    """Return fresh filters of skin and force, one after the other; they raise EffectError."""
    filters = _filters(effects, "response")

    def filtered(response: Response) -> Response:
        for active, one in filters:
            before = response
            response = _called(active, "response", Response, partial(one, before))
            _check_shape(active, "skin", response.skin_position_m, before.skin_position_m)
            _check_shape(active, "force", response.force_n, before.force_n)
        return response

    return filtered


def image_filters(effects: Sequence[Active]) -> ImageFilter:
    """Return fresh filters of the image, one after the other; they raise EffectError."""
    filters = _filters(effects, "image")

    def filtered(image: SeenImage) -> FloatArray:
        for active, one in filters:
            pixels = _called(active, "image", np.ndarray, partial(one, image))
            _check_shape(active, "image", pixels, image.pixels)
            image = replace(image, pixels=pixels)
        return image.pixels

    return filtered


def seen_through(
    shown: ImageFilter,
    camera: Camera,
    *,
    stamp_s: float,
    session_s: float,
    image: ImageArray,
    idle: ImageArray,
    depth_m: Float32Array,
    normal: Float32Array,
    flow_px_s: FloatArray | None,
) -> ImageArray:
    """Return the image (H, W, 3) that filters make of a rendered one; the arguments are those of
    `SeenImage`, with None for a flow that is not known."""
    pixels = shown(
        SeenImage(
            stamp_s=stamp_s,
            session_s=session_s,
            pixels=image.astype(np.float64),
            idle=idle.astype(np.float64),
            centre_px=camera.principal_point_px,
            focal_px=camera.focal_px,
            flow_px_s=np.zeros((*image.shape[:2], 2)) if flow_px_s is None else flow_px_s,
            depth_m=depth_m.astype(np.float64),
            normal=normal.astype(np.float64),
            projection=camera.projection,
            pixel_aspect=camera.pixel_aspect,
        )
    )
    return np.clip(np.rint(pixels), 0.0, 255.0).astype(np.uint8)


def _check_shape(active: Active, what: str, found: FloatArray, before: FloatArray) -> None:
    shape = np.shape(found)
    if shape != before.shape or not np.isfinite(np.sum(found)):
        wrong = f"of shape {shape}" if shape != before.shape else "that is not finite"
        raise EffectError(
            f"the effect {active.effect.name} gives the {what} {wrong}, expected finite numbers of "
            f"shape {before.shape}; mend its file"
        )
