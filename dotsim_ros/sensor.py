"""The virtual sensor: a pose of the indenter goes in, a frame comes out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dotsim_ros.arrays import Float32Array, FloatArray, ImageArray
from dotsim_ros.files import given_path
from dotsim_ros.gel.explicit.gel import DivergenceError
from dotsim_ros.gel.make import GelFrame, make_gel, skin_of
from dotsim_ros.geometry.camera import FisheyeCamera
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose, Wrench
from dotsim_ros.optics.flow import image_motion_px
from dotsim_ros.optics.idle import IdleFrame, LitDisc, fit_idle_image, read_idle_frame
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.network.loading import completion_network
from dotsim_ros.optics.renderer import SkinRenderer
from dotsim_ros.specification import (
    SensorSpecification,
)

if TYPE_CHECKING:
    pass


class GelFailureError(ValueError):
    """The gel could not be solved on the way to a valid pose; it is at rest again.

    What was pressed before is lost: press again from outside.
    """


@dataclass(frozen=True)
class Frame:
    """What the sensor gives for one pose of the indenter; the arrays belong to this frame alone.

    Attributes:
        time_s: simulated time since the last reset.
        indenter_pose: in the base frame; None where no indenter is near.
        image: (H, W, 3) uint8, red, green, blue.
        depth_m: (H, W) distance along the ray, NaN where no skin is seen.
        normal: (H, W, 3) unit normal in the optical frame, towards the camera.
        material_point_m: (H, W, 3) rest position, base frame, of the skin point that is seen.
        skin_position_m: (V, 3) skin markers, base frame.
        skin_normal: (V, 3) unit normals out of the gel, base frame.
        wrench: force and torque of the gel on the indenter, about the base frame's origin.
        max_penetration_m: largest penetration of a marker into the indenter.
        timings_s: seconds spent on contact, solve, depth, image.
        converged: whether the gel's solver met its tolerance.
    """

    time_s: float
    indenter_pose: Pose | None
    image: ImageArray
    depth_m: Float32Array
    normal: Float32Array
    material_point_m: Float32Array
    skin_position_m: FloatArray
    skin_normal: FloatArray
    wrench: Wrench
    max_penetration_m: float
    timings_s: dict[str, float]
    converged: bool


class TactileSensor:
    """One sensor with one indenter.

    Args:
        specification: what the sensor is.
        indenter: what presses it.
        device: Warp's name of the device, "cpu" or "cuda:0".
        progress: told the finished share of tables that are computed once and cached.

    Raises:
        ValueError: the specification contradicts itself; the message says where.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        *,
        indenter: Indenter,
        device: str = "cpu",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.specification, self.device, self.indenter = specification, device, indenter
        self.skin = skin_of(specification.gel)
        self.camera = FisheyeCamera.from_specification(specification.camera)
        # Before the gel, whose tables take longer: a network of another sensor is refused at once.
        self._network = completion_network(specification, self.camera)
        self._gel = make_gel(specification, self.skin, indenter, device=device, progress=progress)
        self._renderer = SkinRenderer(self.camera, self.skin, device=device)
        self._set_idle(read_idle_frame(given_path(specification.camera.idle_image), self.camera))
        self._time_s = 0.0

    @property
    def remembers(self) -> bool:
        """Whether the gel goes on moving under an indenter that is held: it relaxes or swings."""
        s = self.specification
        return s.solver.method == "explicit" or s.solver.dynamic or bool(s.material.prony_shares)

    @property
    def idle_image(self) -> ImageArray:
        """The image without contact, (H, W, 3) uint8."""
        return self._idle.image

    def _set_idle(self, idle: IdleFrame) -> None:
        completion = None
        if self._network is not None:
            untouched = self._renderer.render(self.skin.rest_position_m)
            completion = self._network.at_rest(untouched, idle.image)
        self._image = ImageRenderer(
            self.camera,
            self.skin,
            idle.image,
            lighting=idle.lighting,
            vignetting=idle.vignetting,
            fine=idle.fine,
            completion=completion,
            device=self.device,
        )
        self._idle = idle

    def set_idle_image(self, image: ImageArray, *, disc: LitDisc | None = None) -> None:
        """Replace the idle image; lighting and vignetting stay.

        Args:
            image: (h, w, 3) uint8, red, green, blue, of any size.
            disc: where the lit disc lies in it; without it the image must show the camera's own
                view, at any resolution.

        Raises:
            ValueError: as `fit_idle_image`; the image before stays.
        """
        fitted = fit_idle_image(image, self.camera, disc=disc)
        self._set_idle(IdleFrame(fitted, self._idle.lighting, self._idle.vignetting))

    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter and return to rest."""
        self._gel.set_indenter(indenter)
        self.indenter = indenter
        self._time_s = 0.0

    def reset(self) -> None:
        """Return to rest."""
        self._gel.reset()
        self._time_s = 0.0

    def check_depth(self, pose: Pose) -> None:
        """Refuse a pose that `press` would refuse, without moving there.

        Raises:
            ValueError: the pose presses too deep.
        """
        self._gel.check_depth(pose)

    def press(self, pose: Pose | None, dt_s: float) -> GelFrame:
        """Move the indenter to a pose in the base frame (None: away) and return the gel.

        The motion from the last pose is followed in substeps; the first pose after a reset is
        approached along the indenter's axis.

        Args:
            pose: of the indenter's frame: origin at its tip, +z away from the gel.
            dt_s: seconds since the last step.

        Raises:
            ValueError: the pose presses too deep or dt_s is not positive; the state stays.
            GelFailureError: the gel could not be solved; it has been reset.
        """
        try:
            gel = self._gel.step(pose, dt_s)
            if not np.all(np.isfinite(gel.skin_position_m)):
                raise DivergenceError("the skin is not finite")
        except (np.linalg.LinAlgError, DivergenceError) as error:
            self.reset()
            place = "away" if pose is None else f"{np.round(pose.position_m * 1e3, 2).tolist()} mm"
            raise GelFailureError(
                f"the gel could not be solved on the way of the indenter to {place} ({error}); the "
                "gel has been reset and what was pressed is lost: press again from outside, in "
                "smaller moves"
            ) from error
        self._time_s += dt_s
        return replace(gel, time_s=self._time_s)

    def see(self, gel: GelFrame, pose: Pose | None) -> Frame:
        """Return the frame that shows a gel.

        It may run in a second thread beside `press`: it reads nothing of the gel but its argument.

        Args:
            gel: from `press`.
            pose: of the indenter, that `press` was given.
        """
        clock = time.perf_counter
        start = clock()
        view = self._renderer.render(gel.skin_position_m)
        seen = clock()
        image = self._image.render(view)
        timings = {**gel.timings_s, "depth": seen - start, "image": clock() - seen}
        return Frame(
            time_s=gel.time_s,
            indenter_pose=pose,
            image=image,
            depth_m=view.depth_m,
            normal=view.normal,
            material_point_m=view.material_point_m,
            skin_position_m=gel.skin_position_m,
            skin_normal=view.vertex_normal @ self.camera.pose.rotation().T,
            wrench=gel.wrench,
            max_penetration_m=gel.max_penetration_m,
            timings_s=timings,
            converged=gel.converged,
        )

    def image_motion_px(self, before_m: FloatArray, after_m: FloatArray) -> FloatArray:
        """Return how far (H, W, 2) what each pixel shows has moved in the image, x then y.

        Args:
            before_m, after_m: (V, 3) the skin then and now, base frame.
        """
        view = self._renderer.render(after_m)
        return image_motion_px(view, self.skin.triangles, self.camera.project(before_m))

    def step(self, pose: Pose | None, dt_s: float) -> Frame:
        """Return the frame after a move of the indenter: `press`, then `see`.

        Args:
            pose: of the indenter's frame in the base frame, as for `press`.
            dt_s: seconds since the last step.

        Raises:
            ValueError: the pose presses too deep or dt_s is not positive; the state stays.
            GelFailureError: the gel could not be solved; it has been reset.
        """
        return self.see(self.press(pose, dt_s), pose)
