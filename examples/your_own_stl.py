# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Press with a shape of your own: a closed mesh in an STL, OBJ or PLY file, in metres.

The tip of the mesh is its origin, and +z points away from the gel. For a file in millimetres, or
with another axis, load_indenter takes a mapping: {"kind": "mesh", "path": "screw.stl",
"scale": 0.001, "away_axis": "-y", "origin": "tip"}. Writes hexagon.stl, unless a mesh is given,
and the image of its press.

python examples/your_own_stl.py [FOLDER [MESH]]
"""

import sys
from pathlib import Path

import trimesh

from dotsim_ros import Pose, TactileSensor


def write_hexagon(path: Path) -> Path:
    """Write the end of a hexagonal key, 4 mm across its corners, standing on its tip."""
    key = trimesh.creation.cylinder(radius=0.002, height=0.006, sections=6)
    key.apply_translation([0.0, 0.0, 0.003])
    path.parent.mkdir(parents=True, exist_ok=True)
    key.export(path)
    return path


def main(folder: Path, mesh: Path | None) -> None:
    path = mesh or write_hexagon(folder / "hexagon.stl")
    sensor = TactileSensor.load("densetact2", indenter=path)
    frame = sensor.step(Pose.above_apex(depth_m=0.0012, yaw_rad=0.3))
    print(f"{path.name} presses with {frame.wrench.force_n[2]:.2f} N")
    frame.save(folder / f"{path.stem}.png")


if __name__ == "__main__":
    given = [Path(argument) for argument in sys.argv[1:]]
    main(given[0] if given else Path("out/your_own_stl"), given[1] if len(given) > 1 else None)
