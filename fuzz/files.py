# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Indenters and their meshes, overlays of effects, idle images, and arrays."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import trimesh
import yaml

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.effects.effect import Effect
from dotsim_ros.effects.library import load_effects
from dotsim_ros.effects.overlay import active_effects, read_overlay
from dotsim_ros.geometry.camera import Camera
from dotsim_ros.geometry.indenter import MAXIMUM_EXTENT_M, Indenter, load_indenter
from dotsim_ros.io.files import parameter_path
from dotsim_ros.optics.idle import read_idle_frame
from dotsim_ros.specification import load_sensor
from fuzz.mutate import spoilt_bytes, spoilt_text, spoilt_tree
from fuzz.target import Finding, Target, answer

MESHES = ("stl", "obj", "ply", "off", "glb")


def _indenters(_folder: Path) -> list[dict[str, Any]]:
    paths = sorted(parameter_path("indenters").glob("*.yaml"))
    return [yaml.safe_load(path.read_text()) for path in paths]


def _attempt_indenter(documents: list[dict[str, Any]], random: Random, folder: Path) -> None:
    path = folder / "indenter.yaml"
    text = yaml.safe_dump(spoilt_tree(random.choice(documents), random))
    path.write_text(spoilt_text(text, random) if random.random() < 0.3 else text)
    _check_indenter(answer(lambda: load_indenter(path), [path.name]))


def _check_indenter(indenter: Indenter | None) -> None:
    if indenter is None:
        return
    numbers = [
        *indenter.mount.position_m,
        *indenter.mount.quaternion_xyzw,
        *(n for n in indenter.parameters if isinstance(n, float)),
    ]
    if indenter.mesh is not None:
        extent = np.ptp(indenter.mesh.vertices_m, axis=0).max()
        if not extent <= MAXIMUM_EXTENT_M:
            raise Finding(f"a mesh of {extent} m was taken")
    if not np.isfinite(numbers).all():
        raise Finding(f"an indenter of {numbers} was taken")


def _meshes(folder: Path) -> list[tuple[str, bytes]]:
    solid = trimesh.creation.icosphere(subdivisions=1, radius=4e-3)
    found = []
    for suffix in MESHES:
        path = folder / f"ball.{suffix}"
        solid.export(path)
        found.append((suffix, path.read_bytes()))
    found.append(("stl", trimesh.exchange.stl.export_stl_ascii(solid).encode()))
    return found


def _attempt_mesh(meshes: list[tuple[str, bytes]], random: Random, folder: Path) -> None:
    suffix, content = random.choice(meshes)
    path = folder / f"ball.{suffix}"
    path.write_bytes(spoilt_bytes(content, random))
    _check_indenter(answer(lambda: load_indenter(path), [path.name]))


@dataclass(frozen=True)
class _Overlays:
    library: dict[str, Effect]
    records: list[dict[str, Any]]


def _overlays(_folder: Path) -> _Overlays:
    library = load_effects()
    records = []
    for effect in library.values():
        middle = {
            p.name: {"unit": p.unit, "value": v, "low": v, "high": v}
            for p in effect.parameters
            if (v := 0.5 * (p.low + p.high)) is not None
        }
        records.append(
            {
                "version": 1,
                "dotsim_ros": "0.1.0",
                "sensor": "densetact2",
                "data_hash": "0" * 16,
                "effects": [{"name": effect.name, "parameters": middle}],
            }
        )
    return _Overlays(library, records)


def _attempt_overlay(known: _Overlays, random: Random, folder: Path) -> None:
    path = folder / "overlay.yaml"
    text = yaml.safe_dump(spoilt_tree(random.choice(known.records), random))
    path.write_text(spoilt_text(text, random) if random.random() < 0.3 else text)
    read = partial(_active, path, known.library)
    for effect, values in answer(read, [path.name]) or ():
        for parameter in effect.parameters:
            if not parameter.low <= values[parameter.name] <= parameter.high:
                raise Finding(f"{effect.name}.{parameter.name} is {values[parameter.name]}")


def _active(path: Path, library: dict[str, Effect]) -> list[tuple[Effect, Any]]:
    overlay = read_overlay(path)
    active = active_effects(overlay, library, place=str(path))
    return [(one.effect, one.values) for one in active]


@dataclass(frozen=True)
class _Idle:
    camera: Camera
    image: bytes
    description: str


def _idle_images(_folder: Path) -> _Idle:
    sensor = load_sensor("densetact2")
    path = parameter_path("images/densetact2_idle.png")
    return _Idle(
        Camera.from_specification(sensor.camera),
        path.read_bytes(),
        path.with_suffix(".yaml").read_text(),
    )


def _attempt_idle(idle: _Idle, random: Random, folder: Path) -> None:
    path = folder / "idle.png"
    spoil_image = random.random() < 0.5
    path.write_bytes(spoilt_bytes(idle.image, random) if spoil_image else idle.image)
    text = idle.description
    if not spoil_image:
        tree = spoilt_tree(yaml.safe_load(text), random)
        text = spoilt_text(text, random) if random.random() < 0.5 else yaml.safe_dump(tree)
    path.with_suffix(".yaml").write_text(text)
    frame = answer(lambda: read_idle_frame(path, idle.camera), ["idle.png", "idle.yaml"])
    if frame is not None and frame.image.shape != (idle.camera.height, idle.camera.width, 3):
        raise Finding(f"an image of shape {frame.image.shape} was taken")


def _skins(folder: Path) -> bytes:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    path = folder / "skin.npz"
    np.savez_compressed(
        path,
        rest_position_m=np.asarray(ball.vertices),
        triangles=np.asarray(ball.faces, dtype=np.int32),
        on_base=ball.vertices[:, 2] < -0.009,
    )
    return path.read_bytes()


def _attempt_skin(content: bytes, random: Random, folder: Path) -> None:
    (folder / "press").mkdir()
    (folder / "dataset.yaml").write_text("trajectories: [{bag: press}]")
    (folder / "skin_mesh.npz").write_bytes(spoilt_bytes(content, random))
    mesh = answer(lambda: read_data_set(folder).skin_mesh(), ["skin_mesh.npz"])
    if mesh is not None and not np.isfinite(mesh.rest_position_m).all():
        raise Finding("a skin with a vertex that is not finite was taken")


TARGETS = (
    Target("indenter", _indenters, _attempt_indenter),
    Target("mesh", _meshes, _attempt_mesh),
    Target("overlay", _overlays, _attempt_overlay),
    Target("idle_image", _idle_images, _attempt_idle),
    Target("skin", _skins, _attempt_skin),
)
