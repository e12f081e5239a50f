# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Builds packages of messages that are not on PyPI, as far as the nodes speak them, from their
public definitions.

ROS's own generators and a compiler make the same messages from the fields that their owners define:
same names, types, order, and so the same on the wire, where the hash of a type counts neither
comments nor defaults. Run as a program it builds a package into a folder.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.io.files import cache_directory


@dataclass(frozen=True)
class Definitions:
    """Texts of a package's files by name, and the packages of messages that they use."""

    files: Mapping[str, str]
    dependencies: tuple[str, ...]


PACKAGES = {
    # https://github.com/xArm-Developer/xarm_ros2, xarm_msgs
    "xarm_msgs": Definitions(
        {
            "msg/RobotMsg.msg": """\
std_msgs/Header header
int16 state
int16 mode
int16 cmdnum
int16 mt_brake
int16 mt_able
int16 err
int16 warn
float32[] angle
float32[6] pose
float32[6] offset
""",
            "srv/MoveVelocity.srv": """\
float32[] speeds
bool is_sync true
bool is_tool_coord false
float32 duration -1.0
---
int16 ret
string message
""",
        },
        ("std_msgs", "builtin_interfaces", "service_msgs"),
    ),
    # https://github.com/ros2/geometry2, tf2_msgs
    "tf2_msgs": Definitions(
        {"msg/TFMessage.msg": "geometry_msgs/TransformStamped[] transforms\n"},
        ("geometry_msgs", "std_msgs", "builtin_interfaces"),
    ),
    # https://github.com/gazebosim/ros_gz, ros_gz_interfaces
    "ros_gz_interfaces": Definitions(
        {
            "msg/Entity.msg": """\
uint8 NONE=0
uint8 LIGHT=1
uint8 MODEL=2
uint8 LINK=3
uint8 VISUAL=4
uint8 COLLISION=5
uint8 SENSOR=6
uint8 JOINT=7
uint64 id
string name
uint8 type
""",
            "msg/EntityWrench.msg": """\
std_msgs/Header header
ros_gz_interfaces/Entity entity
geometry_msgs/Wrench wrench
""",
        },
        ("geometry_msgs", "std_msgs", "builtin_interfaces"),
    ),
}
FAST, INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"
GENERATORS = (
    "rosidl_generator_c",
    "rosidl_generator_py",
    "rosidl_typesupport_c",
    FAST,
    INTROSPECTION,
)
LIBRARIES = (
    "rosidl_runtime_c",
    "rosidl_typesupport_c",
    INTROSPECTION,
    FAST,
    "rosidl_typesupport_fastrtps_cpp",
    "fastcdr",
    "rcutils",
)


def missing() -> str:
    """Return what the build needs and this machine lacks; empty where it has all."""
    lacking = [name for name in ("gcc", "g++") if shutil.which(name) is None]
    lacking += [name for name in GENERATORS if importlib.util.find_spec(name) is None]
    if not (Path(sysconfig.get_path("include")) / "Python.h").is_file():
        lacking.append("Python.h")
    return ", ".join(lacking)


@contextmanager
def importable(package: str) -> Iterator[Path]:
    """Put a package on the paths of this process and of those that it starts, built unless ROS has
    it; give the folder of the build, and skip the test where it cannot be built."""
    folder = kept_folder(package)
    if importlib.util.find_spec(package) is not None:
        yield folder
        return
    if lacking := missing():
        pytest.skip(f"{package} cannot be built here: {lacking} is missing")
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as draft:
            build(package, Path(draft) / package)
            with suppress(OSError):
                # Another process may have been first.
                (Path(draft) / package).rename(folder)
    built = str(folder / "python")
    before = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [built, before]))
    sys.path.insert(0, built)
    yield folder
    sys.path.remove(built)
    os.environ["PYTHONPATH"] = before


def kept_folder(package: str) -> Path:
    """Return where a build is kept: by what it is made of and by."""
    made_by = [Path(__file__).read_text(encoding="utf-8"), sys.version, np.__version__]
    found = filter(None, map(importlib.util.find_spec, GENERATORS))
    made_by += [f"{spec.origin} {Path(spec.origin or '').stat().st_mtime_ns}" for spec in found]
    digest = hashlib.sha256("\0".join(made_by).encode()).hexdigest()[:16]
    return cache_directory() / "test_messages" / f"{package}-{digest}"


def build(package: str, folder: Path) -> None:
    """Build a package in a process of its own.

    Raises:
        RuntimeError: the build failed; with what it said.
    """
    environment = dict(os.environ)
    # ROS from wheels lives in the interpreter's own prefix and names it nowhere.
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    done = subprocess.run(
        [sys.executable, __file__, package, str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{package} cannot be built:\n{done.stdout}\n{done.stderr}")


def _generate(package: str, folder: Path) -> None:
    """Write the sources: C and type support in `c`, introspection apart, Python in `python`."""
    from ament_index_python.packages import get_package_share_directory
    from rosidl_cli.command.translate.api import translate
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    definitions = PACKAGES[package]
    for name, text in definitions.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    os.chdir(folder)
    shares = [get_package_share_directory(name) for name in definitions.dependencies]
    files = translate(
        package_name=package,
        interface_files=list(definitions.files),
        include_paths=shares,
        output_format="idl",
        output_path=folder / "idl",
    )
    supports = [FAST, INTROSPECTION]
    generators = [
        (GenerateC("c"), "c"),
        (GenerateCTypesupport("c", typesupport_implementations=supports), "c"),
        (GenerateFastRTPSCTypesupport("fastrtps_c"), "c"),
        # Its files have the names of the first one's.
        (GenerateIntrospectionCTypesupport("introspection_c"), "introspection"),
        (
            GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]),
            "python",
        ),
    ]
    for generator, part in generators:
        generator.generate(package, files, shares, folder / part / package)
    (folder / "python" / package / "__init__.py").touch()


def _compiled(folder: Path, part: str, includes: list[str]) -> list[str]:
    """Compile the sources of a part; return the objects."""
    objects = []
    for source in sorted([*(folder / part).rglob("*.c"), *(folder / part).rglob("*.cpp")]):
        compiler = ["g++", "-std=c++17"] if source.suffix == ".cpp" else ["gcc"]
        target = source.with_suffix(source.suffix + ".o")
        subprocess.run(
            [*compiler, "-fPIC", "-c", str(source), "-o", str(target), *includes], check=True
        )
        objects.append(str(target))
    return objects


def _compile(package: str, folder: Path) -> None:
    """Make the extension that Python imports and the two libraries that type support opens."""
    from ament_index_python.packages import get_package_prefix

    dependencies = PACKAGES[package].dependencies
    prefixes = sorted({get_package_prefix(name) for name in (*dependencies, *GENERATORS)})
    roots = [Path(prefix) / "include" for prefix in prefixes]
    folders = [folder / "c", folder / "introspection", *roots]
    folders += [each for root in roots for each in sorted(root.iterdir()) if each.is_dir()]
    folders += [Path(np.get_include()), Path(sysconfig.get_path("include"))]
    includes = [f"-I{each}" for each in folders]
    libraries = [f"-L{Path(prefix) / 'lib'}" for prefix in prefixes]
    libraries += [f"-l{name}" for name in LIBRARIES]
    libraries += [
        f"-l{name}__{kind}"
        for name in dependencies
        for kind in (*GENERATORS[:3], FAST, INTROSPECTION)
    ]
    home = folder / "python" / package
    beside = ["-Wl,-rpath,$ORIGIN", f"-L{home}"]

    def link(objects: list[str], name: str, *options: str) -> None:
        target = ["-shared", f"-Wl,-soname,{name}", "-o", str(home / name)]
        subprocess.run(["g++", *target, *objects, *beside, *options, *libraries], check=True)

    fast, introspection = f"{package}__{FAST}", f"{package}__{INTROSPECTION}"
    link(_compiled(folder, "c", includes), f"lib{fast}.so")
    link(_compiled(folder, "introspection", includes), f"lib{introspection}.so", f"-l{fast}")
    # Type support opens both libraries by name: they must be loaded already.
    link(
        _compiled(folder, "python", includes),
        f"{package}_s__rosidl_typesupport_c.so",
        "-Wl,--no-as-needed",
        f"-l{fast}",
        f"-l{introspection}",
    )


if __name__ == "__main__":
    name, root = sys.argv[1], Path(sys.argv[2]).absolute()
    _generate(name, root)
    _compile(name, root)
