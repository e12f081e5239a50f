# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The virtual sensor: a pose of the indenter goes in, a frame comes out."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dotsim_ros.gel.explicit.gel import DivergenceError
from dotsim_ros.gel.make import GelFrame, body_of, make_gel, skin_of
from dotsim_ros.gel.rest_depth import RestDepth
from dotsim_ros.gel.solver_changes import SolverChanges
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import Indenter, load_indenter
from dotsim_ros.geometry.markers import MarkerMotion, PrintedMarkers
from dotsim_ros.geometry.pose import ApexPose, Pose, Wrench
from dotsim_ros.io import tracing
from dotsim_ros.io.arrays import Float32Array, FloatArray, ImageArray
from dotsim_ros.io.exclusive_use import ExclusiveUse, exclusive
from dotsim_ros.io.files import whole_file, write_image
from dotsim_ros.io.progress import FirstTimeNotice
from dotsim_ros.io.warp_runtime import known_device, say_if_kernels_compile
from dotsim_ros.optics.idle import IdleFrame, LitDisc, fit_idle_image, part_of_idle
from dotsim_ros.optics.image import ImageRenderer
from dotsim_ros.optics.network import completion_network
from dotsim_ros.optics.noise import with_noise
from dotsim_ros.optics.pattern import idle_frame_of
from dotsim_ros.optics.picture import frame_picture
from dotsim_ros.optics.renderer import SkinRenderer, View
from dotsim_ros.specification import SensorSpecification, SolverSpecification, given_sensor
from dotsim_ros.twin.force_control import pose_at_force

FRAME_S = 0.04
"""Usual time from one frame to the next: that of `tactile_sim` at its 25 Hz."""
FARTHEST_M = 100.0
"""No indenter is farther away; a larger number is in another unit, or none at all."""
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")


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
        view: what the camera sees, of which the arrays below are taken; not to be written to.
        skin_position_m: (V, 3) skin markers, base frame.
        skin_normal: (V, 3) unit normals out of the gel, base frame.
        wrench: force and torque of the gel on the indenter, about the base frame's origin.
        max_penetration_m: largest penetration of a marker into the indenter.
        timings_s: seconds spent on contact, solve, depth, image.
        converged: whether the gel's solver expects to be within its tolerance of an equilibrium,
            on the skin and in the force: docs/gel.md.
        idle_image: (H, W, 3) uint8, the image without contact; shared by all frames, not to be
            written to.
        max_skin_motion_m: largest distance of a skin marker from its position at rest.
    """

    time_s: float
    indenter_pose: Pose | None
    image: ImageArray
    view: View
    skin_position_m: FloatArray
    skin_normal: FloatArray
    wrench: Wrench
    max_penetration_m: float
    timings_s: dict[str, float]
    converged: bool
    idle_image: ImageArray
    max_skin_motion_m: float

    @property
    def depth_m(self) -> Float32Array:
        """(H, W) range, the distance along the ray; NaN where no skin is seen."""
        return self.view.depth_m

    @property
    def normal(self) -> Float32Array:
        """(H, W, 3) unit normal in the optical frame, towards the camera; computed when read."""
        return self.view.normal

    @property
    def material_point_m(self) -> Float32Array:
        """(H, W, 3) rest position, base frame, of the skin point that is seen; computed when
        read."""
        return self.view.material_point_m

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        force = ", ".join(f"{newton:.3f}" for newton in self.wrench.force_n)
        return (
            f"Frame at {self.time_s:.2f} s: force [{force}] N, skin moved by up to "
            f"{1e3 * self.max_skin_motion_m:.2f} mm, "
            f"{'converged' if self.converged else 'not converged'}, image {width} x {height} px"
        )

    def save(self, path: str | Path) -> None:
        """Write a picture (.png, .jpg, .jpeg) or all arrays (.npz), whole or not at all.

        The picture shows the image, its difference to the idle image and the range (the distance
        along the ray), as `frame_picture` draws them. The arrays have the names of the attributes;
        the wrench is `force_n` and `torque_nm`, the indenter's pose `indenter_position_m` and
        `indenter_quaternion_xyzw`, NaN where there is none. `timings_s`, `idle_image` and
        `max_skin_motion_m` are left out.

        Args:
            path: of the file, by whose suffix the format is chosen.

        Raises:
            ValueError: the suffix is another.
            OSError: it could not be written.
        """
        suffix = Path(path).suffix.lower()
        if suffix in IMAGE_SUFFIXES:
            write_image(path, frame_picture(self.image, self.idle_image, self.depth_m))
            return
        if suffix != ".npz":
            raise ValueError(
                f"{path} ends in {suffix or 'no suffix'}, expected {', '.join(IMAGE_SUFFIXES)} for "
                "the frame's picture or .npz for all of its arrays"
            )
        pose = self.indenter_pose
        with whole_file(path) as part, part.open("wb") as file:
            np.savez_compressed(
                file,
                time_s=self.time_s,
                indenter_position_m=np.full(3, np.nan) if pose is None else pose.position_m,
                indenter_quaternion_xyzw=(
                    np.full(4, np.nan) if pose is None else pose.quaternion_xyzw
                ),
                image=self.image,
                depth_m=self.depth_m,
                normal=self.normal,
                material_point_m=self.material_point_m,
                skin_position_m=self.skin_position_m,
                skin_normal=self.skin_normal,
                force_n=self.wrench.force_n,
                torque_nm=self.wrench.torque_nm,
                max_penetration_m=self.max_penetration_m,
                converged=self.converged,
            )


_View = tuple[tuple[int, int, int, int], tuple[int, int]]
"""A part of an image, and the size that it is seen at."""


def _whole_view(camera: Camera) -> _View:
    return (0, 0, camera.width, camera.height), (camera.width, camera.height)


class TactileSensor:
    """One sensor with one indenter.

    For one thread at a time, since a press goes on from the one before it. A call that moves the
    gel raises RuntimeError while another thread's is running, and, once two threads were found to
    do so, in any thread but that of the last reset. Threads that hold a lock of their own from a
    reset to the last step of a motion may share a sensor. `see` waits for its turn instead.

    The noise of an image is drawn by the sensor's `noise.seed` and the frame's `time_s`, so the
    same motion after a reset gives the same images to the last bit; `reset` can take another seed.

    Args:
        specification: what the sensor is.
        indenter: what presses it.
        device: where the gel is computed, "cpu" or "cuda".
        progress: called with the finished share of tables that are computed once and cached; None
            for one line on stderr where that, or the compilation of kernels, takes seconds.

    Raises:
        ValueError: the specification contradicts itself, or there is no such device; the message
            says where.
    """

    def __init__(
        self,
        specification: SensorSpecification,
        *,
        indenter: Indenter,
        device: str = "cpu",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.exclusive_use = ExclusiveUse("sensor")
        # Images have no past: what two threads ask for is right one after the other.
        self._images = threading.RLock()
        device = known_device(device)
        self.specification, self.device, self.indenter = specification, device, indenter
        self.skin = skin_of(specification.gel)
        self.whole_camera = Camera.from_specification(specification.camera)
        self.camera = self.whole_camera
        self._view = self._whole_view = _whole_view(self.camera)
        # Before the gel, whose tables take longer: a network of another sensor is refused at once.
        self._network = completion_network(specification, self.camera)
        if progress is None:
            say_if_kernels_compile()
            progress = FirstTimeNotice("computing the tables of this gel")
        self._progress = progress
        self._gel = make_gel(specification, self.skin, indenter, device=device, progress=progress)
        self._solvers = SolverChanges(self._gel, specification.solver)
        self._rest_depth = RestDepth(body_of(specification.gel), indenter)
        self._own_idle = idle_frame_of(specification, self.camera)
        self._make_images()
        self._warn_of_misfit()
        self.markers: PrintedMarkers | None = None
        if specification.markers.columns:
            self.markers = PrintedMarkers(specification.markers, self.skin)
        self._noise = specification.noise
        self._time_s = 0.0

    @classmethod
    def load(
        cls,
        sensor: str | Path | SensorSpecification = "densetact2",
        *,
        indenter: str | Path | Mapping[str, Any] | Indenter = "sphere_4mm",
        device: str = "cpu",
        progress: Callable[[float], None] | None = None,
    ) -> TactileSensor:
        """Return a sensor from names or files.

        Args:
            sensor: a name below `params/sensors`, a YAML file, or a specification.
            indenter: a name below `params/indenters`, a YAML file, a mesh in metres, a mapping as
                `load_indenter` takes it, or an indenter.
            device, progress: as for the class.

        Raises:
            FileNotFoundError: no such name or file.
            ValueError: a file is not valid; the message says where.
        """
        return cls(
            given_sensor(sensor),
            indenter=indenter if isinstance(indenter, Indenter) else load_indenter(indenter),
            device=device,
            progress=progress,
        )

    def _placed(self, pose: Pose | ApexPose | None) -> Pose | None:
        """Return a pose in the base frame.

        Raises:
            ValueError: it lies below the base of the gel, or nowhere near.
        """
        if isinstance(pose, ApexPose):
            height_m = float(self.skin.apex_m[2])
            if pose.depth_m > height_m:
                raise ValueError(
                    f"a depth of {pose.depth_m:g} m below the apex is below the base of the gel, "
                    f"which is {height_m:g} m high; expected metres"
                )
            pose = pose.on(self.skin.apex_m)
        if pose is not None and np.abs(pose.position_m).max() > FARTHEST_M:
            raise ValueError(
                f"the indenter is at {pose.position_m.tolist()}, expected metres in the base frame "
                f"and at most {FARTHEST_M:g} m; None takes it away"
            )
        return pose

    @property
    def remembers(self) -> bool:
        """Whether the gel goes on moving under an indenter that is held: it relaxes or swings."""
        return self.specification.remembers

    @property
    def idle_image(self) -> ImageArray:
        """The image without contact and without noise, (H, W, 3) uint8."""
        return self._idle.image

    @property
    def has_network(self) -> bool:
        """Whether a network completes the image, which then has the camera's own view."""
        return self._network is not None

    def set_view(
        self,
        crop_px: tuple[int, int, int, int] | None = None,
        size_px: tuple[int, int] | None = None,
    ) -> None:
        """Render a part of the camera's image from now on, or another number of its pixels.

        `camera`, `idle_image` and the frames are those of the part; every pixel is rendered at its
        own ray, so none is interpolated from others.

        Args:
            crop_px: x, y, width, height of the part, in pixels of the sensor's file; None: all.
            size_px: width and height that it is rendered at; None: as many as it has.

        Raises:
            ValueError: the part reaches beyond the image, the size has another aspect ratio, or a
                network completes the image, which knows the whole view only.
        """
        crop = crop_px or self._whole_view[0]
        view = (crop, size_px or crop[2:])
        if view == self._view:
            return
        camera = self.whole_camera.part(*crop).scaled(*view[1])
        if self.has_network:
            raise ValueError(
                "a network completes the image of this sensor, and knows its whole view only: cut "
                "and resize the finished image"
            )
        with self._images:
            before = self.camera, self._view
            self.camera, self._view = camera, view
            try:
                self._make_images()
            except ValueError:
                self.camera, self._view = before
                raise

    def _make_images(self) -> None:
        """Make what renders for the camera, from the idle frame of the whole one."""
        renderer = SkinRenderer(self.camera, self.skin, device=self.device)
        idle = self._own_idle
        if self._view != self._whole_view:
            idle = part_of_idle(idle, *self._view)
        completion = None
        if self._network is not None:
            untouched = renderer.render(self.skin.rest_position_m)
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
        self._renderer, self._idle = renderer, idle
        # Most of the time nothing touches the gel: what is seen then is drawn once.
        self._untouched = renderer.render(self.skin.rest_position_m)
        self._untouched_image = self._image.render(self._untouched)

    def set_idle_image(self, image: ImageArray, *, disc: LitDisc | None = None) -> None:
        """Replace the idle image; lighting and vignetting stay.

        Args:
            image: (h, w, 3) uint8, red, green, blue, of any size.
            disc: where the lit disc lies in it; without it the image must show the camera's own
                view, at any resolution.

        Raises:
            ValueError: as `fit_idle_image`; the image before stays.
        """
        fitted = fit_idle_image(image, self.whole_camera, disc=disc)
        with self._images:
            before = self._own_idle
            self._own_idle = IdleFrame(fitted, before.lighting, before.vignetting)
            if self.specification.camera.colour == "grey":
                self._own_idle = self._own_idle.as_grey()
            self._make_images()
            self._warn_of_misfit()

    def _warn_of_misfit(self) -> None:
        """Warn where the idle image was not taken through this sensor's camera."""
        camera = self.specification.camera
        reason = self._idle.misfit(self._untouched.mask, camera.half_height_angle_deg)
        if reason:
            warnings.warn(
                f"the idle image of sensor {self.specification.name!r} does not fit its camera: "
                f"{reason}. Frames show that image where nothing moves: correct the section "
                "camera, or name in camera.idle_image one that was taken through this camera; "
                'with "" one is drawn',
                stacklevel=3,
            )

    @exclusive(begins=True)
    def set_indenter(self, indenter: Indenter) -> None:
        """Replace the indenter and return to rest."""
        self._solvers.set_indenter(indenter)
        self.indenter = indenter
        self._rest_depth = RestDepth(body_of(self.specification.gel), indenter)
        # The explicit gel only takes its next pose for the first: it would stay pressed.
        self.reset()

    def prepare_solver(self, solver: SolverSpecification) -> None:
        """Make the gel that another solver needs, so that `set_solver` has not to wait for it.

        Raises:
            ValueError: the gel remembers more than its contact, so that no other can go on with
                it, or the solver is none of this sensor's.
        """
        specification = replace(self.specification, solver=solver)
        if self.remembers or specification.remembers:
            raise ValueError(
                "the solver of a gel that relaxes, swings or is solved explicitly cannot be "
                "changed: what it remembers would be lost; make another sensor"
            )
        self._solvers.prepare(
            solver,
            lambda: make_gel(
                specification, self.skin, self.indenter, device=self.device, progress=self._progress
            ),
        )

    @exclusive()
    def set_solver(self, solver: SolverSpecification, *, largest_jump_m: float = np.inf) -> float:
        """Go on with another solver from where the indenter is, with the friction that there is.

        Args:
            solver: the new one.
            largest_jump_m: how far a marker of the skin may jump by the change of the grid.

        Returns:
            How far it jumped, in metres: 0 between solvers of one grid.

        Raises:
            SkinJumpError: it would jump farther; the solver stays as it was.
            ValueError: as `prepare_solver`.
        """
        self.prepare_solver(solver)
        jump_m = self._solvers.change(solver, largest_jump_m=largest_jump_m)
        self._gel = self._solvers.gel
        self.specification = replace(self.specification, solver=solver)
        return jump_m

    @exclusive(begins=True)
    def reset(self, *, noise_seed: int | None = None) -> None:
        """Return to rest; time begins again, and with it the noise of the images.

        Args:
            noise_seed: that the noise is drawn by from now on, in place of the one before.

        Raises:
            ValueError: the seed is out of range.
        """
        if noise_seed is not None:
            self._noise = replace(self._noise, seed=noise_seed)
        self._gel.reset()
        self._time_s = 0.0

    def check_depth(self, pose: Pose | ApexPose) -> None:
        """Refuse a pose that `press` would refuse, without moving there.

        Raises:
            ValueError: the pose presses too deep.
        """
        placed = self._placed(pose)
        assert placed is not None
        self._gel.check_depth(placed)

    def rest_depth_m(self, pose: Pose | ApexPose) -> float:
        """Return how deep the indenter's deepest point at a pose lies in the gel at rest, in
        metres; negative outside, where it is at least so far from the gel."""
        placed = self._placed(pose)
        assert placed is not None
        return self._rest_depth(placed)

    @exclusive()
    def place(self, pose: Pose | ApexPose) -> None:
        """Put the indenter to a pose at which it does not touch the gel, without a way there.

        The gel lets go of what pressed it: one that remembers goes on from where it is, any other
        is at rest. The next `press` leads on from this pose, and no time passes.

        Args:
            pose: of the indenter's frame, as for `press`.
        """
        placed = self._placed(pose)
        assert placed is not None
        self._gel.place(placed)

    @exclusive()
    def wrench_stiffness(self) -> FloatArray:
        """Return minus the derivative (6, 6) of the wrench on the indenter by its twist at the last
        pose, both about the base frame's origin: as `wrench_stiffness.wrench_stiffness` has it.

        Raises:
            ValueError: the gel is the explicit one, which has none.
        """
        return self._gel.wrench_stiffness()

    @exclusive()
    def press(self, pose: Pose | ApexPose | None, dt_s: float = FRAME_S) -> GelFrame:
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
        pose = self._placed(pose)
        try:
            with tracing.span("gel"):
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

    @exclusive()
    def press_to_force(
        self, start: Pose | ApexPose, force_n: float, dt_s: float = FRAME_S
    ) -> tuple[GelFrame, Pose]:
        """Press along the indenter's axis until the gel's normal force is the one that is asked
        for; for recordings that have a force and no depth. Return the gel and the pose.

        Time passes once, by `dt_s`; the trials on the way take as much of it as a step takes.

        Args:
            start: where the search begins, in contact or outside of the gel; its tilt and its place
                across the axis are kept.
            force_n: along the indenter's +z, above 0.
            dt_s: seconds since the last step.

        Raises:
            ForceNotReachedError: the gel does not give this force.
            ValueError: the force is not above 0, or as `press`.
            GelFailureError: as `press`.
        """
        placed = self._placed(start)
        assert placed is not None
        begun_s, last = self._time_s, None

        def press(pose: Pose) -> FloatArray:
            nonlocal last
            last = self.press(pose, dt_s)
            return last.wrench.force_n

        found = pose_at_force(press, placed, force_n)
        assert last is not None
        self._time_s = begun_s + dt_s
        return replace(last, time_s=self._time_s), found.pose

    def see(self, gel: GelFrame, pose: Pose | ApexPose | None) -> Frame:
        """Return the frame that shows a gel.

        It may run in a second thread next to `press`: it reads nothing of the gel but its argument.

        Args:
            gel: from `press`.
            pose: of the indenter, that `press` was given.
        """
        with self._images:
            return self._seen(gel, self._placed(pose))

    def _seen(self, gel: GelFrame, pose: Pose | None) -> Frame:
        clock = time.perf_counter
        start = clock()
        is_untouched = np.array_equal(gel.skin_position_m, self.skin.rest_position_m)
        with tracing.span("view"):
            if is_untouched:
                view = replace(self._untouched, depth_m=self._untouched.depth_m.copy())
            else:
                view = self._renderer.render(gel.skin_position_m)
        seen = clock()
        moment = (self._noise.seed, round(1e9 * gel.time_s))
        image = with_noise(
            self._untouched_image.copy() if is_untouched else self._image.render(view),
            self._noise.deviation_levels,
            moment,
            channel_count=self.specification.camera.channel_count,
        )
        timings = {**gel.timings_s, "depth": seen - start, "image": clock() - seen}
        return Frame(
            time_s=gel.time_s,
            indenter_pose=pose,
            image=image,
            view=view,
            skin_position_m=gel.skin_position_m,
            skin_normal=view.vertex_normal @ self.camera.pose.rotation().T,
            wrench=gel.wrench,
            max_penetration_m=gel.max_penetration_m,
            timings_s=timings,
            converged=gel.converged,
            idle_image=self.idle_image,
            max_skin_motion_m=float(
                np.linalg.norm(gel.skin_position_m - self.skin.rest_position_m, axis=1).max()
            ),
        )

    def image_motion_px(self, before_m: FloatArray, after_m: FloatArray) -> FloatArray:
        """Return how far (H, W, 2) what each pixel shows has moved in the image, x then y.

        Args:
            before_m, after_m: (V, 3) the skin then and now, base frame.
        """
        with self._images:
            view = self._renderer.render(after_m)
        return view.motion_px(self.skin.triangles, self.camera.project(before_m))

    def marker_motion(self, skin_position_m: FloatArray) -> MarkerMotion:
        """Return where the markers that are printed on the skin are at rest and now.

        Args:
            skin_position_m: (V, 3) the skin now, base frame, as a frame has it.

        Raises:
            ValueError: the sensor has no printed markers.
        """
        if self.markers is None:
            raise ValueError(
                f"sensor {self.specification.name!r} has no printed markers; give its file a "
                "section markers with columns and rows"
            )
        return self.markers.motion(skin_position_m, self.camera)

    @exclusive()
    def step(self, pose: Pose | ApexPose | None, dt_s: float = FRAME_S) -> Frame:
        """Return the frame after a move of the indenter: `press`, then `see`.

        Args:
            pose: of the indenter's frame in the base frame, as for `press`.
            dt_s: seconds since the last step.

        Raises:
            ValueError: the pose presses too deep or dt_s is not positive; the state stays.
            GelFailureError: the gel could not be solved; it has been reset.
        """
        return self.see(self.press(pose, dt_s), pose)
