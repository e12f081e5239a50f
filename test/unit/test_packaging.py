# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the package says of itself, and what its launch files ask for.

The launch library comes with a ROS installation only, and importing a node needs rclpy: the files
are read as source text.
"""

from __future__ import annotations

import ast
import re
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
import setuptools

ROOT = Path(__file__).parents[2]
PACKAGES = ("dotsim_ros", "msg_adapters")
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))
each_launch_file = pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)

FOREIGN_NODES = {
    ("ros_gz_bridge", "parameter_bridge"),
    ("tf2_ros", "static_transform_publisher"),
}
"""What launch files start of others: packages and executables as their documentation names them."""

NAMES_ELSEWHERE = {
    "PIL": "pillow",
    "backports": "backports.zstd",
    "cv2": "opencv-python-headless",
    "drjit": "mitsuba",
    "imageio_ffmpeg": "imageio-ffmpeg",
    "pinocchio": "pin",
    "rerun": "rerun-sdk",
    "warp": "warp-lang",
    "yaml": "PyYAML",
}
"""The distribution on PyPI of a module with another name."""

ROS_KEYS = {
    "PyYAML": "yaml",
    "opencv-python-headless": "opencv",
    "backports.zstd": "backports-zstd",
    "pillow": "pil",
}
"""What rosdep calls a distribution that it does not call by its name."""


def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a Python file."""
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def setup_keyword(name: str) -> Any:
    """Return a literal keyword argument of the call of `setup`."""
    for call in calls(tree_of(ROOT / "setup.py"), "setup"):
        return ast.literal_eval(keywords(call)[name])
    raise AssertionError("setup.py calls no setup")


def calls(tree: ast.AST, name: str) -> list[ast.Call]:
    """Return the calls of a plain name."""
    return [
        found
        for found in ast.walk(tree)
        if isinstance(found, ast.Call)
        and isinstance(found.func, ast.Name)
        and found.func.id == name
    ]


def keywords(call: ast.Call) -> dict[str, ast.expr]:
    """Return the keyword arguments of a call."""
    return {entry.arg: entry.value for entry in call.keywords if entry.arg is not None}


def executables() -> dict[str, str]:
    """Return module:function of each installed command."""
    entries = setup_keyword("entry_points")["console_scripts"]
    return dict(entry.split(" = ") for entry in entries)


def installed_files() -> dict[str, set[str]]:
    """Return the files that the package installs below share/, by top folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setuptools, "setup", lambda **_: None)
        entries = runpy.run_path(str(ROOT / "setup.py"))["shared_files"]()
    found: dict[str, set[str]] = {}
    for folder, files in entries:
        found.setdefault("/".join(folder.split("/")[:3]), set()).update(files)
    return found


def requirements() -> set[str]:
    """Return the distributions that the library needs."""
    return {entry.partition(">=")[0] for entry in setup_keyword("install_requires")}


def extra(name: str) -> set[str]:
    """Return the distributions of a list of setup.py that an extra asks for, by the list's name."""
    for found in tree_of(ROOT / "setup.py").body:
        if isinstance(found, ast.Assign) and ast.unparse(found.targets[0]) == name:
            return {re.split("[<>=]", entry)[0] for entry in ast.literal_eval(found.value)}
    raise AssertionError(f"setup.py has no list {name}")


def ros_depends(kind: str) -> set[str]:
    """Return the dependencies of one kind in package.xml."""
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()
    return {element.text or "" for element in manifest.iter(kind)}


def imported_modules() -> set[str]:
    """Return the top-level modules of others that the installed packages import."""
    names: set[str] = set()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for found in ast.walk(tree_of(path)):
                if isinstance(found, ast.Import):
                    names |= {alias.name for alias in found.names}
                elif isinstance(found, ast.ImportFrom) and found.level == 0 and found.module:
                    names.add(found.module)
    roots = {name.partition(".")[0] for name in names}
    return roots - set(sys.stdlib_module_names) - set(PACKAGES)


def passed_names(node: str) -> set[Any]:
    """Return the literals that the sources of a node pass to calls, its topics among them."""
    return {
        argument.value
        for source in (ROOT / "dotsim_ros" / "nodes" / node).glob("*.py")
        for call in ast.walk(tree_of(source))
        if isinstance(call, ast.Call)
        for argument in call.args
        if isinstance(argument, ast.Constant)
    }


def test_every_executable_has_its_function() -> None:
    for name, target in executables().items():
        module, function = target.split(":")
        tree = tree_of(ROOT / Path(*module.split(".")).with_suffix(".py"))
        defined = {found.name for found in tree.body if isinstance(found, ast.FunctionDef)}
        for found in tree.body:
            if isinstance(found, ast.Assign):
                defined |= {each.id for each in found.targets if isinstance(each, ast.Name)}
        assert function in defined, name


def test_executables_say_whose_they_are_or_are_the_ones_that_others_rely_on() -> None:
    targets = executables()
    named = {name for name in targets if not name.startswith("dotsim_")}
    old = {name for name in named if targets[name].endswith("_by_old_name")}
    assert named - old == {
        "indenter_player",
        "tactile_policy",
        "tactile_record",
        "tactile_sim",
        "time_stepper",
        "xarm_adapter",
        "xarm_sim",
    }
    assert all(f"{targets[f'dotsim_{name}']}_by_old_name" == targets[name] for name in old)


def test_every_node_with_a_main_is_an_executable() -> None:
    found = {
        f"dotsim_ros.nodes.executables:{path.parent.name}"
        for path in (ROOT / "dotsim_ros" / "nodes").glob("*/node.py")
        if any(isinstance(f, ast.FunctionDef) and f.name == "main" for f in tree_of(path).body)
    }
    assert found
    assert found <= set(executables().values())


def test_what_is_imported_is_required() -> None:
    ros = ros_depends("exec_depend")
    foreign = {NAMES_ELSEWHERE.get(name, name) for name in imported_modules() - ros}
    lists = ("ARM", "LEARNING", "RENDERING", "ENVIRONMENTS", "MUJOCO", "REINFORCEMENT", "SCALE")
    extras = set().union(*map(extra, (*lists, "DATASET", "LIVE", "MANISKILL", "MJLAB", "RERUN")))
    assert foreign - requirements() - extras == set()


def test_what_is_required_is_imported() -> None:
    used = {NAMES_ELSEWHERE.get(name, name) for name in imported_modules()}
    assert requirements() - used == set()


def test_pip_and_rosdep_know_the_same_requirements() -> None:
    keys = {
        key.removeprefix("python3-").removesuffix("-pip")
        for key in ros_depends("exec_depend")
        if key.startswith("python3-")
    }
    # The live page and the arm are extras of pip's; a workspace has none.
    needed = requirements() | extra("LIVE") | extra("ARM")
    assert {ROS_KEYS.get(name, name) for name in needed} == keys


def own_nodes(path: Path) -> list[ast.Call]:
    """Return the calls that start a node of this package, also by `start`, which says what nodes of
    a file have in common."""
    return [call for name in ("own_node", "start") for call in calls(tree_of(path), name)]


@each_launch_file
def test_launched_nodes_are_executables_of_this_package(path: Path) -> None:
    own = {ast.literal_eval(call.args[0]) for call in own_nodes(path)}
    assert own
    assert own <= set(executables())
    foreign = {
        (ast.literal_eval(node["package"]), ast.literal_eval(node["executable"]))
        for node in map(keywords, calls(tree_of(path), "Node"))
    }
    assert foreign <= FOREIGN_NODES
    assert {package for package, _ in foreign} <= ros_depends("exec_depend")


@each_launch_file
def test_remapped_topics_are_those_of_the_node(path: Path) -> None:
    for call in own_nodes(path):
        rules = keywords(call).get("remappings", ast.List(elts=[]))
        assert isinstance(rules, ast.List)
        for rule in rules.elts:
            assert isinstance(rule, ast.Tuple)
            # Of several nodes in one process a rule names one.
            which, _, topic = ast.literal_eval(rule.elts[0]).rpartition(":")
            assert topic in passed_names(which or ast.literal_eval(call.args[0])), topic


@each_launch_file
def test_launched_parameter_files_are_shipped(path: Path) -> None:
    names = {
        ast.literal_eval(call.args[0]) for call in calls(tree_of(path), "parameter_file_argument")
    }
    assert names
    share = installed_files()["share/dotsim_ros/params"]
    assert {f"params/{name}" for name in names} <= share, "name its folder in setup.py"
