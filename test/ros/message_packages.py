"""Builds xarm_msgs, as far as `xarm_adapter` speaks it, from its public definitions.

UFACTORY's package is not on PyPI. ROS's own generators and a compiler make the same messages from
the fields that xArm-Developer/xarm_ros2 defines: same names, types, order, and so the same on the
wire, where the hash of a type counts neither comments nor defaults. Run as a program it builds into
the folder that it is given.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

PACKAGE = "xarm_msgs"
DEFINITIONS = {
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
}
DEPENDENCIES = ("std_msgs", "builtin_interfaces", "service_msgs")
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


def build(folder: Path) -> Path:
    """Build the package in a process of its own; return the folder to import it from.

    Raises:
        RuntimeError: the build failed; with what it said.
    """
    environment = dict(os.environ)
    # ROS from wheels lives in the interpreter's own prefix and names it nowhere.
    environment.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    done = subprocess.run(
        [sys.executable, __file__, str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"xarm_msgs cannot be built:\n{done.stdout}\n{done.stderr}")
    return folder / "python"


def _generate(folder: Path) -> None:
    """Write the sources: C and type support in `c`, introspection apart, Python in `python`."""
    from ament_index_python.packages import get_package_share_directory
    from rosidl_cli.command.translate.api import translate
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    for name, text in DEFINITIONS.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    os.chdir(folder)
    shares = [get_package_share_directory(name) for name in DEPENDENCIES]
    files = translate(
        package_name=PACKAGE,
        interface_files=list(DEFINITIONS),
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
        generator.generate(PACKAGE, files, shares, folder / part / PACKAGE)
    (folder / "python" / PACKAGE / "__init__.py").touch()


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


def _compile(folder: Path) -> None:
    """Make the extension that Python imports and the two libraries that type support opens."""
    import numpy
    from ament_index_python.packages import get_package_prefix

    prefixes = sorted({get_package_prefix(name) for name in (*DEPENDENCIES, *GENERATORS)})
    roots = [Path(prefix) / "include" for prefix in prefixes]
    folders = [folder / "c", folder / "introspection", *roots]
    folders += [each for root in roots for each in sorted(root.iterdir()) if each.is_dir()]
    folders += [Path(numpy.get_include()), Path(sysconfig.get_path("include"))]
    includes = [f"-I{each}" for each in folders]
    libraries = [f"-L{Path(prefix) / 'lib'}" for prefix in prefixes]
    libraries += [f"-l{name}" for name in LIBRARIES]
    libraries += [
        f"-l{package}__{kind}"
        for package in DEPENDENCIES
        for kind in (*GENERATORS[:3], FAST, INTROSPECTION)
    ]
    home = folder / "python" / PACKAGE
    beside = ["-Wl,-rpath,$ORIGIN", f"-L{home}"]

    def link(objects: list[str], name: str, *options: str) -> None:
        target = ["-shared", f"-Wl,-soname,{name}", "-o", str(home / name)]
        subprocess.run(["g++", *target, *objects, *beside, *options, *libraries], check=True)

    fast, introspection = f"{PACKAGE}__{FAST}", f"{PACKAGE}__{INTROSPECTION}"
    link(_compiled(folder, "c", includes), f"lib{fast}.so")
    link(_compiled(folder, "introspection", includes), f"lib{introspection}.so", f"-l{fast}")
    # Type support opens both libraries by name: they must be loaded already.
    link(
        _compiled(folder, "python", includes),
        f"{PACKAGE}_s__rosidl_typesupport_c.so",
        "-Wl,--no-as-needed",
        f"-l{fast}",
        f"-l{introspection}",
    )


if __name__ == "__main__":
    root = Path(sys.argv[1]).absolute()
    _generate(root)
    _compile(root)
