"""What the twin's camera should see of measured trajectories, and what it did see.

The picture of the calibrated gel is made by the frozen network from the twin's own idle frame, that
of its commissioning. The data set's idle images are not used for it: whatever changed since then
would be carried into every prediction and be seen no more. Optical effects act on these pictures.

Importing this loads neither Warp nor ONNX Runtime.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.gap.effect import Active, Array, SeenImage, image_filters

if TYPE_CHECKING:
    from dotsim_ros.geometry.camera import FisheyeCamera
    from dotsim_ros.geometry.specification import SensorSpecification
    from dotsim_ros.optics.renderer import View

ByteImage = NDArray[np.uint8]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

IDLE = "idle"
"""Name of the trajectory that the data set's idle images make: one frame, their mean."""


@dataclass(frozen=True)
class Film:
    """Pictures of one trajectory, as the twin has them.

    Attributes:
        stamp_s: (F,) times of the frames, within the trajectory.
        session_s: (F,) times since the session's start.
        pixels: (F, H, W, 3) linear to the sensor's numbers, 0 to 255, not rounded.
        flow_px_s: (F, H, W, 2) how fast the picture moves.
        idle: (H, W, 3) the same camera's picture without contact.
        centre_px: (2,) x and y of the optical axis.
        focal_px: pixels a radian.
    """

    stamp_s: Array
    session_s: Array
    pixels: Float32Array
    flow_px_s: Float32Array
    idle: Array
    centre_px: Array
    focal_px: float

    def seen(self) -> Iterator[SeenImage]:
        """Yield the frames as effects take them."""
        for frame in range(len(self.stamp_s)):
            yield SeenImage(
                float(self.stamp_s[frame]),
                float(self.session_s[frame]),
                self.pixels[frame].astype(np.float64),
                self.idle,
                self.centre_px,
                self.focal_px,
                self.flow_px_s[frame].astype(np.float64),
            )

    def with_effects(self, effects: Sequence[Active]) -> Float32Array:
        """Return the pixels (F, H, W, 3) with effects at work, by fresh filters."""
        filtered = image_filters(effects)
        return np.stack([filtered(image) for image in self.seen()]).astype(np.float32)


@dataclass(frozen=True)
class FilmedTrajectory:
    """A measured trajectory beside the twin's.

    Attributes:
        name: of the trajectory.
        indenter: name of the indenter; empty for `IDLE`.
        tip_depth_m: (F,) how deep the tip lies below the skin at rest.
        measured: (F, H, W, 3), 0 to 255.
        film: what the twin says.
    """

    name: str
    indenter: str
    tip_depth_m: Array
    measured: NDArray[np.generic]
    film: Film


class PictureModel:
    """Makes the pictures of skins with a sensor's calibrated camera and its frozen network.

    Args:
        sensor: the twin; without a network its picture is the carried one.
        width, height: of the pictures.

    Attributes:
        camera: of that size.
        idle: (H, W, 3) uint8, the twin's own idle frame.

    Raises:
        FileNotFoundError: the sensor's idle image or network is missing.
        ValueError: a size of another aspect ratio, or a network of another sensor.
    """

    def __init__(self, sensor: SensorSpecification, *, width: int, height: int) -> None:
        # Loaded on use: they start Warp.
        from dotsim_ros.geometry.camera import FisheyeCamera
        from dotsim_ros.optics.idle import read_idle_frame
        from dotsim_ros.optics.image import ImageRenderer
        from dotsim_ros.optics.renderer import SkinRenderer
        from dotsim_ros.sensor import given_path, residual_network, skin_of

        full = FisheyeCamera.from_specification(sensor.camera)
        self.camera: FisheyeCamera = full.scaled(width, height)
        frame = read_idle_frame(given_path(sensor.camera.idle_image), self.camera)
        self.idle: ByteImage = frame.image
        skin = skin_of(sensor.gel)
        self._triangles = skin.triangles
        self._renderer = SkinRenderer(self.camera, skin)
        network = residual_network(sensor, self.camera)
        residual = None
        if network is not None:
            untouched = self._renderer.render(skin.rest_position_m)
            residual = network.at_rest(untouched, frame.image)
        self._residual = residual
        self._image = ImageRenderer(
            self.camera, skin, frame.image, lighting=frame.lighting, vignetting=frame.vignetting
        )

    def film(self, skin_position_m: NDArray[np.floating], stamp_s: Array, start_s: float) -> Film:
        """Return what the camera sees of a skin that moves.

        Args:
            skin_position_m: (F, V, 3) of the sensor's skin, base frame.
            stamp_s: (F,) times of the frames.
            start_s: time of the first frame since the session's start.
        """
        pictures, flows = [], []
        before: View | None = None
        for frame, position in enumerate(skin_position_m):
            view = self._renderer.render(position)
            pictures.append(self._picture(view))
            if before is None:
                flows.append(np.zeros((*view.triangle.shape, 2), dtype=np.float32))
            else:
                lapse_s = float(stamp_s[frame] - stamp_s[frame - 1])
                flows.append(flow_of(before, view, self._triangles) / np.float32(lapse_s))
            before = view
        return self._film(
            stamp_s, start_s + (stamp_s - stamp_s[0]), np.stack(pictures), np.stack(flows)
        )

    def idle_film(self) -> Film:
        """Return the film of one frame that shows the gel untouched, at the session's start."""
        height, width = self.idle.shape[:2]
        flow = np.zeros((1, height, width, 2), dtype=np.float32)
        return self._film(np.zeros(1), np.zeros(1), self.idle[None].astype(np.float32), flow)

    def _film(
        self, stamp_s: Array, session_s: Array, pixels: Float32Array, flow_px_s: Float32Array
    ) -> Film:
        return Film(
            stamp_s,
            session_s,
            pixels,
            flow_px_s,
            self.idle.astype(np.float64),
            self.camera.principal_point_px,
            self.camera.focal_px,
        )

    def _picture(self, view: View) -> Float32Array:
        carried = self._image.carry(view)
        picture = carried.astype(np.float32)
        if self._residual is not None:
            picture = picture + self._residual(view, carried)
        return np.clip(picture, np.float32(0.0), np.float32(255.0))


def flow_of(before: View, view: View, triangles: NDArray[np.integer]) -> Float32Array:
    """Return (H, W, 2) how far, px, what each pixel of a view shows has moved since another view;
    zero where no skin is seen.

    Args:
        before, view: of one skin.
        triangles: (T, 3) of it.
    """
    moved = view.vertex_pixel - before.vertex_pixel
    seen = view.mask
    corners = np.asarray(triangles)[view.triangle[seen]]
    second, third = view.barycentric[seen].T
    weight = np.stack([1.0 - second - third, second, third], axis=1)
    flow = np.zeros((*view.triangle.shape, 2), dtype=np.float32)
    flow[seen] = np.einsum("nk,nkd->nd", weight, np.nan_to_num(moved[corners]))
    return flow


def accept_untouched(idle: ByteImage, untouched: Iterable[tuple[str, ByteImage]]) -> None:
    """Refuse nothing: how frames without contact differ from the idle image is what is looked
    for."""


@dataclass(frozen=True)
class OpticalMeasurement:
    """What the camera saw of a data set.

    Attributes:
        model: of the twin's pictures, at the measured size.
        lit: (H, W) the lit disc of the twin's idle frame.
        idle_images: (N, H, W, 3) uint8, as measured.
        names: of the trajectories with images, in the order of the index.
    """

    model: PictureModel
    lit: BoolArray
    idle_images: ByteImage
    names: tuple[str, ...]
    _films: tuple[tuple[str, Callable[[], FilmedTrajectory]], ...]

    def trajectories(self) -> Iterator[FilmedTrajectory]:
        """Yield `IDLE`, then the trajectories, each made when it is asked for."""
        yield FilmedTrajectory(
            IDLE,
            "",
            np.array([-np.inf]),
            self.idle_images.mean(axis=0, dtype=np.float64)[None],
            self.model.idle_film(),
        )
        for _, make in self._films:
            yield make()


def read_optical_measurement(
    directory: str | Path,
    sensor: SensorSpecification,
    start_s: Mapping[str, float],
    *,
    cache: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> OpticalMeasurement:
    """Read the images of a data set, and let the twin's gel follow their poses.

    Args:
        directory: of the data set.
        sensor: the twin.
        start_s: when each trajectory began, since the session's start, by name: `session_s` of the
            recordings. Those not named are left out.
        cache: folder of the skins that were computed before; None for the user's cache.
        progress: told what is being done.

    Raises:
        FileNotFoundError: no data set, bag, indenter, idle image or network there.
        ValueError: as `read_filmed_data`, but frames without contact may differ from the idle
            image; or none of the named trajectories holds images.
    """
    # Loaded on use: they start Warp.
    from dotsim_ros.measured.data_set import read_data_set
    from dotsim_ros.optics.frames import FilmedPress, read_filmed_data
    from dotsim_ros.optics.idle import lit_region
    from dotsim_ros.optics.idle_check import read_idle_images

    data_set = read_data_set(directory)
    names = [e.name for e in data_set.entries if e.has_images and e.name in start_s]
    if not names:
        raise ValueError(
            f"{directory}: none of {', '.join(sorted(start_s)) or 'no trajectory'} holds images"
        )
    idle_images = read_idle_images(data_set.idle_images())
    filmed = read_filmed_data(
        directory, sensor, presses=names, cache=cache, progress=progress, check=accept_untouched
    )
    height, width = idle_images.shape[1:3]
    model = PictureModel(sensor, width=width, height=height)

    def maker(press: FilmedPress) -> Callable[[], FilmedTrajectory]:
        return lambda: FilmedTrajectory(
            press.name,
            press.indenter,
            press.tip_depth_m,
            press.measured,
            model.film(press.skin_position_m, press.stamp_s, start_s[press.name]),
        )

    return OpticalMeasurement(
        model,
        lit_region(model.idle),
        idle_images,
        tuple(names),
        tuple((press.name, maker(press)) for press in filmed.presses),
    )
