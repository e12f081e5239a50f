# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the camera saw of measured presses, next to what the calibrated sensor renders for them.

Poses, images and idle images of a data set go in; the calibrated gel follows the poses, and its
skin is rendered by the sensor's camera at the measured resolution. Following the poses takes most
of the time, so the skins are kept on disk, under a key of everything that they depend on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dotsim_ros.data.data_set import find_indenter, read_data_set
from dotsim_ros.data.presses import Press
from dotsim_ros.data.reading import read_bag, read_press_images
from dotsim_ros.data.trajectory import MEASURED_TOPICS, Topics
from dotsim_ros.gel.make import Gel, make_gel, skin_of
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.skin_mesh import SkinMesh, tip_depth_m
from dotsim_ros.io.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from dotsim_ros.io.cache import PHYSICS, content_key, keep_arrays, load_arrays
from dotsim_ros.io.documents import ArrayForm
from dotsim_ros.io.files import cache_directory, short_name
from dotsim_ros.optics.idle import lit_region
from dotsim_ros.optics.idle_check import check_untouched, mean_idle_image, read_idle_images
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.lighting import Lighting, Vignetting
from dotsim_ros.optics.network import completion_network
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.twin.follow import SimulatedPress, SolveError, follow
from dotsim_ros.twin.simulator import base_in_data_m, seen_from

Progress = Callable[[str], None]

LEAST_FRAMES = 10
"""Frames with images below which nothing can be learned or judged."""

CLEARANCE_M = 0.05e-3
"""An indenter farther than this from the skin at rest touches nothing; poses are noisy."""


@dataclass(frozen=True)
class Rest:
    """What the camera sees of the gel untouched.

    Attributes:
        idle: (H, W, 3) uint8, the mean of the idle images.
        depth_m: (H, W) distance along the ray; NaN where no skin is seen.
        normal: (H, W, 3) unit normal in the optical frame; NaN where no skin is seen.
        lit: (H, W) the lit disc of the idle image.
    """

    idle: ImageArray
    depth_m: Float32Array
    normal: Float32Array
    lit: BoolArray


@dataclass(frozen=True)
class OpticalPress:
    """Frames of one trajectory: what the model renders next to what was measured.

    Attributes:
        name: of the trajectory.
        indenter: name of the indenter.
        tip_depth_m: (F,) how deep the indenter's tip lies below the skin at rest; negative outside.
        measured: (F, H, W, 3) uint8, red, green, blue.
        depth_m: (F, H, W) distance along the ray; NaN where no skin is seen.
        normal: (F, H, W, 3) unit normal in the optical frame; NaN where no skin is seen.
        warped: (F, H, W, 3) uint8, the idle image warped by the skin and shaded to first order.
    """

    name: str
    indenter: str
    tip_depth_m: FloatArray
    measured: ImageArray
    depth_m: Float32Array
    normal: Float32Array
    warped: ImageArray


@dataclass(frozen=True)
class OpticalData:
    """What a camera, at the measured resolution, saw of several presses and of the gel at rest."""

    camera: Camera
    rest: Rest
    presses: tuple[OpticalPress, ...]


@dataclass(frozen=True)
class FilmedPress:
    """Measured images of one trajectory, and the simulated skin that they show.

    Attributes:
        name: of the trajectory.
        indenter: name of the indenter.
        tip_depth_m: (F,) how deep the indenter's tip lies below the skin at rest; negative outside.
        measured: (F, H, W, 3) uint8, red, green, blue.
        skin_position_m: (F, V, 3) of the sensor's skin, base frame.
        stamp_s: (F,) of the images.
    """

    name: str
    indenter: str
    tip_depth_m: FloatArray
    measured: ImageArray
    skin_position_m: Float32Array
    stamp_s: FloatArray


@dataclass(frozen=True)
class FilmedData:
    """What no camera model enters: images, and shapes of the skin.

    Attributes:
        skin: the sensor's own, at rest.
        idle: (H, W, 3) uint8, the mean of the idle images.
        presses: in the order asked for.
        fine: (2 H - 1, 2 W - 1, 3) uint8, the idle image with samples half-way between its own;
            None where they are not known.
        base_m: (3,) where the sensor's base lies in the data set's base frame.
    """

    skin: SkinMesh
    idle: ImageArray
    presses: tuple[FilmedPress, ...]
    fine: ImageArray | None = None
    base_m: FloatArray = field(default_factory=lambda: np.zeros(3))


def read_filmed_data(
    directory: str | Path,
    sensor: SensorSpecification,
    *,
    presses: Sequence[str] | None = None,
    cache: Path | None = None,
    progress: Progress = lambda _line: None,
    topics: Topics = MEASURED_TOPICS,
) -> FilmedData:
    """Read the images of presses, and let the sensor's gel follow their poses.

    Args:
        directory: of the data set.
        sensor: its calibrated gel; its camera plays no part.
        presses: names of the trajectories; None for all that hold images.
        cache: folder of the skins that were computed before; None for the user's cache.
        progress: called with a line that says what is being done.
        topics: where pose and image lie in the bags.

    Raises:
        FileNotFoundError: no data set, bag or indenter there.
        ValueError: a press without images or poses, images of another size than the idle images,
            fewer than ten frames in all, idle images with a contact in them, or a gel that could
            not be solved; the message says where.
    """
    data_set = read_data_set(directory)
    paths = data_set.idle_images()
    idle = mean_idle_image(read_idle_images(paths), paths)
    entries = data_set.filmed() if presses is None else data_set.named(presses)
    base_m = base_in_data_m(sensor, data_set)
    footage = []
    for entry in entries:
        one = read_press_images(entry, idle=idle, topics=topics)
        footage.append((seen_from(one.press, base_m), one.pixels))
    frame_count = sum(press.frame_count for press, _ in footage)
    if frame_count < LEAST_FRAMES:
        raise ValueError(
            f"{data_set.directory}: {frame_count} frames with images in "
            f"{', '.join(entry.name for entry in entries)}, expected {LEAST_FRAMES} at least; "
            "record or name more presses"
        )
    skin = skin_of(sensor.gel)
    indenters = {entry.indenter: find_indenter(data_set, entry.indenter) for entry in entries}
    check_untouched(
        idle,
        [
            (f"{press.name}, frame {frame}", pixels[frame])
            for press, pixels in footage
            for frame in _untouched_frames(press, indenters[press.indenter], skin)
        ],
    )
    skin_of_press = SkinFollower(sensor, skin, cache or cache_directory() / "skins", progress)
    filmed = tuple(
        FilmedPress(
            press.name,
            press.indenter,
            tip_depth_m(skin, press.poses),
            pixels,
            skin_of_press(press, indenters[press.indenter]),
            press.stamp_s,
        )
        for press, pixels in footage
    )
    return FilmedData(skin, idle, filmed, base_m=base_m)


def with_measured_skin(
    filmed: FilmedData, directory: str | Path, *, topics: Topics = MEASURED_TOPICS
) -> FilmedData:
    """Return the same images with the skin as the data set has it measured next to them.

    Raises:
        ValueError: a press without a measured skin, or one that was measured at other times than
            the images.
    """
    data_set = read_data_set(directory)
    skin, base_m = data_set.skin_mesh(), filmed.base_m
    presses = []
    names = [press.name for press in filmed.presses]
    for press, entry in zip(filmed.presses, data_set.named(names), strict=True):
        bag = read_bag(
            entry, topics=topics, channels=("pose", "skin"), vertex_count=skin.vertex_count
        )
        measured = bag.press()
        if measured.skin_position_m is None:
            raise ValueError(f"{entry.bag} holds no skin on {topics.skin}")
        if not np.array_equal(measured.stamp_s, press.stamp_s):
            raise ValueError(f"{entry.bag}: the skin was measured at other times than the images")
        position_m = (measured.skin_position_m - base_m).astype(np.float32)
        presses.append(replace(press, skin_position_m=position_m))
    skin = replace(skin, rest_position_m=skin.rest_position_m - base_m)
    return FilmedData(skin, filmed.idle, tuple(presses), base_m=base_m)


def camera_for(sensor: SensorSpecification, image: ImageArray, source: str) -> Camera:
    """Return the sensor's camera at the resolution of a measured image (H, W, 3) from a source.

    Raises:
        ValueError: the image has another aspect ratio than the camera's.
    """
    height, width = image.shape[:2]
    try:
        return Camera.from_specification(sensor.camera).scaled(width, height)
    except ValueError as error:
        raise ValueError(f"{source}: measured images do not fit the camera: {error}") from error


def twin_renderers(
    sensor: SensorSpecification, camera: Camera, *, idle: ImageArray | None = None
) -> tuple[SkinRenderer, ImageRenderer, ImageArray]:
    """Return what renders a sensor's skin, what makes its image of that, and its idle image.

    Args:
        sensor: with its lights, its idle image and its network.
        camera: its own, of any size.
        idle: (H, W, 3) uint8 of that size in place of the sensor's own.

    Raises:
        FileNotFoundError: the sensor's idle image or network is missing.
        ValueError: a network of another sensor.
    """
    frame = idle_frame_of(sensor, camera)
    image = frame.image if idle is None else idle
    skin = skin_of(sensor.gel)
    renderer = SkinRenderer(camera, skin)
    network = completion_network(sensor, camera)
    completion = None
    if network is not None:
        completion = network.at_rest(renderer.render(skin.rest_position_m), image)
    made = ImageRenderer(
        camera,
        skin,
        image,
        lighting=frame.lighting,
        vignetting=frame.vignetting,
        fine=frame.fine if idle is None else None,
        completion=completion,
    )
    return renderer, made, image


def render_filmed(
    filmed: FilmedData, camera: Camera, *, lighting: Lighting, vignetting: Vignetting
) -> OpticalData:
    """Return what a camera at the images' resolution sees of presses.

    Raises:
        ValueError: the camera has another size than the images.
    """
    renderer = SkinRenderer(camera, filmed.skin)
    image = ImageRenderer(
        camera,
        filmed.skin,
        filmed.idle,
        lighting=lighting,
        vignetting=vignetting,
        fine=filmed.fine,
    )
    untouched = renderer.render(filmed.skin.rest_position_m)
    seen = []
    for press in filmed.presses:
        views = [renderer.render(position) for position in press.skin_position_m]
        seen.append(
            OpticalPress(
                press.name,
                press.indenter,
                press.tip_depth_m,
                press.measured,
                np.stack([view.depth_m for view in views]),
                np.stack([view.normal for view in views]),
                np.stack([image.warp(view) for view in views]),
            )
        )
    rest = Rest(filmed.idle, untouched.depth_m, untouched.normal, lit_region(filmed.idle))
    return OpticalData(camera, rest, tuple(seen))


def _untouched_frames(press: Press, indenter: Indenter, skin: SkinMesh) -> list[int]:
    """Return the frames before anything touched the skin."""
    untouched = []
    for frame, pose in enumerate(press.poses):
        if indenter.distance_from(skin.rest_position_m, pose).min() <= CLEARANCE_M:
            break
        untouched.append(frame)
    return untouched


class SkinFollower:
    """Lets one gel follow presses, or finds in a folder of skins where its skin went before."""

    def __init__(
        self, sensor: SensorSpecification, skin: SkinMesh, cache: Path, say: Progress
    ) -> None:
        self._sensor, self._skin, self._cache, self._say = sensor, skin, cache, say
        self._gel: Gel | None = None
        self._indenter: Indenter | None = None

    def __call__(self, press: Press, indenter: Indenter) -> Float32Array:
        """Return the skin (F, V, 3) at the poses of a press.

        Raises:
            SolveError: the gel could not follow them.
        """
        path = self._cache / f"{short_name(press.name)}-{self._key(press, indenter)}.npz"
        shape = (press.frame_count, self._skin.vertex_count, 3)
        known = load_arrays(path, {"skin_position_m": ArrayForm(shape)})
        if known is not None:
            return known["skin_position_m"]
        self._say(f"{press.name}: following {press.frame_count} poses")
        try:
            found = self._follow(press, indenter)
        except SolveError as error:
            raise SolveError(
                f"{press.name}: the gel could not follow its poses: {error}"
            ) from error
        position = found.skin_position_m.astype(np.float32)
        keep_arrays(path, {"skin_position_m": position})
        return position

    def _key(self, press: Press, indenter: Indenter) -> str:
        s = self._sensor
        return content_key(
            PHYSICS,
            (s.gel, s.material, s.contact, s.solver),
            replace(indenter, name=""),
            press.poses,
            np.diff(press.stamp_s),
        )

    def _follow(self, press: Press, indenter: Indenter) -> SimulatedPress:
        gel = self._gel
        if gel is None:
            gel = self._gel = make_gel(self._sensor, self._skin, indenter)
        elif self._indenter is not indenter:
            gel.set_indenter(indenter)
        self._indenter = indenter
        gel.reset()
        return follow(gel.step, press.poses, press.stamp_s)
