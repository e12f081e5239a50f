# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tactile sensors of a ManiSkill environment, one in each world, on `TactileArray`.

ManiSkill itself makes cameras only, so an environment holds the sensor. In its methods:

_load_scene:         self.touch = TactileSensor(TactileSensorConfig("touch", body, pressed))
_initialize_episode: self.touch.reset(env_idx)
_get_obs_extra:      self.touch.capture(); return {"touch": self.touch.get_obs()}

ManiSkill (Tao et al., "ManiSkill3", 2024) keeps the state of SAPIEN's worlds in torch. Tested with
its simulation on the CPU, which has one world; that on a GPU has many, and is not tested.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.sensors.base_sensor import BaseSensor, BaseSensorConfig
from mani_skill.utils.structs import Actor, Link
from mani_skill.utils.structs import Pose as WorldPose

from dotsim_ros.control.environments.collision_shapes import indenter_of
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.tactile_array import ArrayFrame, TactileArray


@dataclass
class TactileSensorConfig(BaseSensorConfig):
    """Settings of a tactile sensor.

    Give the body no collision shape where the gel is: PhysX would push there too.

    Attributes:
        body: that the sensor is on.
        pressed: that presses it with its first collision shape: a sphere, box, cylinder, capsule or
            closed mesh.
        sensor: a name below `params/sensors`, a YAML file, or a specification.
        mount: pose of the sensor's base frame in the frame of its body.
        image_size: width and height of depth, normals and image.
    """

    body: Actor | Link
    pressed: Actor | Link
    sensor: str | Path | SensorSpecification = "densetact2"
    mount: Pose = field(default_factory=Pose)
    image_size: tuple[int, int] = (64, 64)


class TactileSensor(BaseSensor):
    """What an environment captures and resets. `capture` solves the gel, on a straight way from
    where it was captured before.

    Args:
        config: settings.
    """

    config: TactileSensorConfig

    def __init__(self, config: TactileSensorConfig) -> None:
        super().__init__(config)
        self._mount = _sapien_pose(config.mount)
        self._frame: ArrayFrame | None = None

    @cached_property
    def array(self) -> TactileArray:
        """The sensors of all worlds, made at the first capture: the body is expected to come from
        where it is then."""
        base = self._base()
        axes = (self.config.pressed.pose.inv() * base).to_transformation_matrix()[0, :3, :3]
        indenter, placed = indenter_of(self.config.pressed, axes[:, 2].cpu().numpy())
        self._placed = _sapien_pose(placed)
        return TactileArray(
            self.config.sensor,
            len(base),
            indenter,
            image_size=self.config.image_size,
            device=str(base.device),
        )

    def reset(self, env_idx: torch.Tensor | None = None) -> None:
        """Return the sensors of some worlds, or of all, to rest."""
        if self._frame is not None:
            chosen = torch.zeros(self.array.count, dtype=torch.bool, device=self.array.device)
            chosen[slice(None) if env_idx is None else env_idx] = True
            self.array.reset(chosen)

    def capture(self) -> None:
        """Solve the gels at the present poses.

        Raises:
            ValueError: the pressed body has no shape that presses a gel.
        """
        array = self.array
        place = self._base().inv() * self.config.pressed.pose * self._placed
        self._frame = array.step(place.p, place.q[:, [1, 2, 3, 0]])

    def get_obs(self, **kwargs: Any) -> dict[str, torch.Tensor]:
        """Return what was captured: the tensors of `ArrayFrame`, by name."""
        return dict(vars(self._captured()))

    def get_params(self) -> dict[str, torch.Tensor]:
        """Return the poses (B, 4, 4) of the sensors' base frames in their worlds."""
        return {"base2world": self._base().to_transformation_matrix()}

    def get_images(self, obs: Any = None) -> torch.Tensor:
        """Return the camera's images (B, H, W, 3) uint8 of what was captured."""
        self._captured()
        return self.array.image()

    def push(self) -> None:
        """Put what was captured as forces on the two bodies, for one step of the physics on the
        CPU: in `_before_simulation_step`, after `capture`. They act late: `sim_freq` must be high.
        """
        frame, base = self._captured(), self._base()
        axes = base.to_transformation_matrix()[0, :3, :3]
        force, torque = axes @ frame.force_n[0], axes @ frame.torque_nm[0]
        for body, sign in ((self.config.pressed, 1.0), (self.config.body, -1.0)):
            if isinstance(body, Link) or body.px_body_type == "dynamic":
                moved = body._bodies[0]
                mass_m = torch.as_tensor((moved.entity_pose * moved.cmass_local_pose).p)
                about_mass = torque + torch.linalg.cross(base.p[0] - mass_m, force)
                moved.add_force_torque(sign * force.numpy(), sign * about_mass.numpy())

    def _captured(self) -> ArrayFrame:
        if self._frame is None:
            raise ValueError(f"sensor {self.uid!r} has captured nothing yet: call capture first")
        return self._frame

    def _base(self) -> WorldPose:
        return self.config.body.pose * self._mount


def _sapien_pose(pose: Pose) -> sapien.Pose:
    return sapien.Pose(pose.position_m, np.roll(pose.quaternion_xyzw, 1))
