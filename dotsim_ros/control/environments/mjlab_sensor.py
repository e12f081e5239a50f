# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Tactile sensors of an mjlab scene, one in each world, on `TactileArray`.

SceneCfg(sensors=(TactileSensorCfg("touch", body="hand/finger", pressed_geom="peg/tip"),), ...)
scene["touch"].data.depth_m  # (worlds, 64, 64)

mjlab (Zakka et al., "mjlab", 2025) runs MuJoCo's worlds in Warp and keeps their state in torch.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab.sensor import Sensor, SensorCfg
from mjlab.utils.lab_api.math import quat_from_matrix

from dotsim_ros.control.environments.geoms import indenter_of
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.tactile_array import ArrayFrame, TactileArray


@dataclass
class TactileSensorCfg(SensorCfg):
    """Settings of a tactile sensor.

    MuJoCo makes no contact where the gel is: give the body no geom there. `TactileSensor.push` is
    what the gel answers with.

    Attributes:
        body: full name of the body that the sensor is on.
        pressed_geom: full name of the geom that presses it: a sphere, box, cylinder, capsule or
            closed mesh.
        sensor: a name below `params/sensors`, a YAML file, or a specification.
        mount: pose of the sensor's base frame in the frame of its body.
        image_size: width and height of depth, normals and image.
    """

    body: str
    pressed_geom: str
    sensor: str | Path | SensorSpecification = "densetact2"
    mount: Pose = field(default_factory=Pose)
    image_size: tuple[int, int] = (64, 64)

    def build(self) -> TactileSensor:
        """Return the sensor, which has no world yet."""
        return TactileSensor(self)


class TactileSensor(Sensor[ArrayFrame]):
    """What mjlab's scene updates and resets. A gel is solved when its `data` are read, on a
    straight way from where they were read before.

    Args:
        cfg: settings.

    Attributes:
        array: the sensors of all worlds.
    """

    array: TactileArray

    def __init__(self, cfg: TactileSensorCfg) -> None:
        super().__init__()
        self.cfg = cfg

    def edit_spec(self, scene_spec: mujoco.MjSpec, entities: dict[str, Any]) -> None:
        """Check that body and geom are there; nothing is added to the model.

        Raises:
            ValueError: one of them is not.
        """
        for kind, known, name in (
            ("body", scene_spec.bodies, self.cfg.body),
            ("geom", scene_spec.geoms, self.cfg.pressed_geom),
        ):
            names = sorted(one.name for one in known if one.name)
            if name not in names:
                raise ValueError(
                    f"sensor {self.cfg.name!r}: the scene has no {kind} named {name!r}; it has "
                    f"{', '.join(names)}"
                )

    def initialize(self, mj_model: mujoco.MjModel, model: Any, data: Any, device: str) -> None:
        """Make the sensors of all worlds; the geom is expected to come from where it is in the
        model's initial state."""
        self._data = data
        self._body = mj_model.body(self.cfg.body).id
        self._geom = mj_model.geom(self.cfg.pressed_geom).id
        self._pressed_body = int(mj_model.geom_bodyid[self._geom])
        begin = mujoco.MjData(mj_model)
        mujoco.mj_forward(mj_model, begin)
        mount = self.cfg.mount.rotation()
        base = begin.xmat[self._body].reshape(3, 3) @ mount
        away = begin.geom_xmat[self._geom].reshape(3, 3).T @ base[:, 2]
        indenter, placed = indenter_of(mj_model, self._geom, away)
        self._mount_axes, self._mount_m, self._placed_axes = (
            torch.as_tensor(np.array(value), dtype=torch.float32, device=device)
            for value in (mount, self.cfg.mount.position_m, placed.rotation())
        )
        self.array = TactileArray(
            self.cfg.sensor,
            data.nworld,
            indenter,
            image_size=self.cfg.image_size,
            device=device,
        )

    def reset(self, env_ids: torch.Tensor | slice | None = None) -> None:
        """Return the sensors of some worlds to rest."""
        super().reset(env_ids)
        chosen = torch.zeros(self.array.count, dtype=torch.bool, device=self.array.device)
        chosen[slice(None) if env_ids is None else env_ids] = True
        self.array.reset(chosen)

    def image(self) -> torch.Tensor:
        """Return the camera's images (worlds, height, width, 3) uint8 of what `data` shows."""
        assert self.data is not None
        return self.array.image()

    def push(self) -> None:
        """Put the gels' wrenches on the bodies, in place of what `xfrc_applied` held for the two;
        they stay until the next call.

        A wrench that is held is a spring that acts late: a light free body trembles on it. Call it
        each physics step for bodies that an actuator holds.
        """
        frame = self.data
        axes, origin_m = self._base()
        force = _turned(axes, frame.force_n)
        torque = _turned(axes, frame.torque_nm)
        for body, sign in ((self._pressed_body, 1.0), (self._body, -1.0)):
            arm_m = origin_m - self._data.xipos[:, body]
            about_mass = torque + torch.linalg.cross(arm_m, force)
            self._data.xfrc_applied[:, body] = sign * torch.cat([force, about_mass], dim=1)

    def _compute_data(self) -> ArrayFrame:
        axes, origin_m = self._base()
        geom_axes = self._data.geom_xmat[:, self._geom].view(-1, 3, 3) @ self._placed_axes
        position_m = _turned(axes.mT, self._data.geom_xpos[:, self._geom] - origin_m)
        wxyz = quat_from_matrix(axes.mT @ geom_axes)
        return self.array.step(position_m, wxyz[:, [1, 2, 3, 0]])

    def _base(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return axes (B, 3, 3) and origins (B, 3) of the sensors' base frames in their worlds."""
        body = self._data.xmat[:, self._body].view(-1, 3, 3)
        return body @ self._mount_axes, self._data.xpos[:, self._body] + body @ self._mount_m


def _turned(axes: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """Return vectors (B, 3) turned by rotations (B, 3, 3)."""
    return (axes @ vectors[:, :, None])[:, :, 0]
