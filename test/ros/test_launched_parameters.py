# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The parameters that nodes get from launch files: of a user's file, and of what a user gives.

`launched` stands in for the library `launch`; ROS reads the arguments.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from geometry_msgs.msg import PoseStamped
from harness import Watcher, running
from launched import Started, launched, started

import msg_adapters
from dotsim_ros.io.files import parameter_path
from dotsim_ros.nodes.common.parameter_file import named_parameters, parameters_of
from dotsim_ros.nodes.common.parameters import from_values, known_parameters
from dotsim_ros.nodes.common.reasons import nearest
from dotsim_ros.nodes.indenter_player.launched import BASE_FRAME
from dotsim_ros.nodes.indenter_player.parameters import PlayerParameters
from dotsim_ros.nodes.tactile_policy.parameters import TactilePolicyParameters
from dotsim_ros.nodes.tactile_record.node import RecordParameters
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters
from dotsim_ros.nodes.time_stepper.parameters import TimeStepperParameters
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters
from dotsim_ros.specification import load_sensor

PLAYER = "dotsim_ros.nodes.indenter_player.node"
WriteFile = Callable[[dict[str, dict[str, Any]]], str]


def read_by_ros(arguments: list[str], node: str) -> dict[str, Any]:
    """Return the parameters that ROS has for a node of this name, and use_sim_time."""
    context = rclpy.Context()
    rclpy.init(args=arguments, context=context)
    try:
        made = rclpy.create_node(
            node, context=context, automatically_declare_parameters_from_overrides=True
        )
        found = {name: each.value for name, each in made.get_parameters_by_prefix("").items()}
        made.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    del found["start_type_description_service"]
    return found


def of_node(nodes: list[Started], executable: str, node: str = "") -> dict[str, Any]:
    """Return the parameters of the only node of an executable."""
    (found,) = [each for each in nodes if each.executable == executable]
    return read_by_ros(found.arguments, node or executable)


@pytest.fixture(autouse=True)
def _temporary_files_go_with_the_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


@pytest.fixture
def write(tmp_path: Path) -> WriteFile:
    """Return what writes a file of parameters, in the order of its sections."""

    def write_file(sections: dict[str, dict[str, Any]]) -> str:
        path = tmp_path / "mine.yaml"
        content = {name: {"ros__parameters": values} for name, values in sections.items()}
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        return str(path)

    return write_file


LOOP = "closed_loop.launch.py"
MINE = {"policy": "mine", "path": "my_path"}
POLICIES = {
    "by name": {"/**/tactile_policy": MINE},
    "for any node": {"/**": MINE},
    "by name, behind what is for any node": {"/**": {"stop": 1}, "/**/tactile_policy": MINE},
}


@pytest.mark.parametrize(
    ("how", "one_process"), zip(POLICIES, ("false", "true", "false"), strict=True)
)
def test_the_loop_takes_the_policy_of_a_file_and_first_what_is_given(
    write: WriteFile, how: str, one_process: str
) -> None:
    executable = "dotsim_closed_loop" if one_process == "true" else "tactile_policy"
    # A name that YAML would read as a number is a name.
    for given, path in (({}, "my_path"), ({"path": "1e5"}, "1e5")):
        file = write(POLICIES[how])
        nodes = started(LOOP, params_file=file, one_process=one_process, **given)
        found = of_node(nodes, executable, "tactile_policy")
        assert (found["policy"], found["path"]) == ("mine", path)


def test_the_loop_has_a_policy_of_its_own() -> None:
    found = of_node(started(LOOP), "tactile_policy")
    assert (found["policy"], found["path"]) == ("densetact2_sphere", "")


def test_the_stepper_takes_its_parameters_from_the_file_too(write: WriteFile) -> None:
    own = {"speed": 2.0, "patience_s": 9.0}
    path = write({"/**": {"use_sim_time": True}, "/**/time_stepper": own})
    nodes = started(LOOP, params_file=path, clock="simulated")
    found = of_node(nodes, "time_stepper")
    # It is what makes the time that the others go by.
    assert found == {**own, "use_sim_time": False}
    nodes = started(LOOP, params_file=path, clock="simulated", speed="1")
    assert of_node(nodes, "time_stepper")["speed"] == 1.0
    found = of_node(started(LOOP, clock="simulated"), "time_stepper")
    assert found == {"use_sim_time": False, "patience_s": 600.0}


def prefixes(nodes: list[Started]) -> list[str]:
    return [read_by_ros(node.arguments, "tactile_sim")["frame_prefix"] for node in nodes]


def test_the_fingers_of_a_gripper_have_frames_of_their_own(write: WriteFile) -> None:
    assert prefixes(started("gripper.launch.py")) == ["left_", "right_"]
    of_one = {"/**": {"frame_prefix": ""}, "/right/tactile_sim": {"frame_prefix": "thumb_"}}
    nodes = started("gripper.launch.py", params_file=write(of_one))
    assert prefixes(nodes) == ["left_", "thumb_"]
    of_one.pop("/**")
    nodes = started("gripper.launch.py", params_file=write(of_one))
    assert prefixes(nodes) == ["left_", "thumb_"]


def test_the_frames_of_a_driver_of_two_stay_its_own() -> None:
    nodes = started("gripper.launch.py", params_file="drivers/dual_difference.yaml")
    assert prefixes(nodes) == ["", ""]
    found = [read_by_ros(node.arguments, "tactile_sim") for node in nodes]
    assert [each["base_frame"] for each in found] == ["left_densetact_base", "right_densetact_base"]


def test_a_finger_takes_poses_in_its_own_frame() -> None:
    left, _ = started("gripper.launch.py")
    coarse = {"grid_spacing_m": 0.0048, "rate_hz": 10.0}
    with (
        running(parameters=coarse, arguments=left.arguments),
        closing(Watcher("client", "/left")) as client,
    ):
        states: list[PoseStamped] = []
        client.node.create_subscription(PoseStamped, "indenter/state", states.append, 5)
        poses = client.node.create_publisher(PoseStamped, "indenter/pose", 5)
        client.wait(poses.get_subscription_count, "the finger")
        above = msg_adapters.encode_pose_stamped(
            (0.0, 0.0, 0.03),
            (0.0, 0.0, 0.0, 1.0),
            stamp_ns=client.now_ns(),
            frame_id="left_densetact_base",
        )
        poses.publish(above)
        client.wait(lambda: states, "a frame that shows the indenter")
        assert states[0].header.frame_id == "left_densetact_base"


SENSOR = "tactile_sim.launch.py"
PAD = {"sensor": "digit", "frame_prefix": "left_", "base_frame": "pad", "rate_hz": 30.0}


@pytest.mark.parametrize("section", ["/**", "/**/tactile_sim", "/finger/tactile_sim"])
def test_the_player_presses_the_sensor_of_the_file(write: WriteFile, section: str) -> None:
    nodes = started(SENSOR, params_file=write({section: PAD}), namespace="finger", play="true")
    found = of_node(nodes, "indenter_player")
    assert (found["sensor"], found["frame_id"]) == ("digit", "left_pad")
    assert (found["source"], found["subscriber_count"]) == ("presses", 1)
    # Not that of the frames.
    assert found["rate_hz"] == 0.0


def test_what_a_file_says_of_the_player_counts_unless_it_is_given(write: WriteFile) -> None:
    own = {"source": "slide", "frame_id": "stage", "rate_hz": 50.0, "subscriber_count": 3}
    path = write({"/**": PAD, "/**/indenter_player": own})
    found = of_node(started(SENSOR, params_file=path, play="true"), "indenter_player")
    assert {name: found[name] for name in own} == own
    nodes = started(SENSOR, params_file=path, play="true", source="press")
    assert of_node(nodes, "indenter_player")["source"] == "press"


def test_without_a_file_the_player_presses_the_default_sensor() -> None:
    nodes = started(SENSOR, play="true", record="true")
    found = of_node(nodes, "indenter_player")
    assert (found["sensor"], found["frame_id"]) == ("densetact2", BASE_FRAME)
    assert TactileSimParameters().frames.base_frame == BASE_FRAME
    assert found["subscriber_count"] == 2


def test_a_launched_player_meets_the_face_of_a_pad(write: WriteFile) -> None:
    own = {"exit_at_end": True, "hold_s": 0.0, "depth_m": 0.001}
    path = write({"/**": PAD, "/**/indenter_player": own})
    nodes = started(SENSOR, params_file=path, play="true", source="press")
    (player,) = [node for node in nodes if node.executable == "indenter_player"]
    with closing(Watcher("client")) as client:
        poses: list[PoseStamped] = []
        client.node.create_subscription(PoseStamped, "indenter/pose", poses.append, 1000)
        with running(PLAYER, arguments=player.arguments) as process:
            assert process.exit_status() == 0, process.log
        assert {pose.header.frame_id for pose in poses} == {"left_pad"}
        lowest_m = min(pose.pose.position.z for pose in poses)
        assert lowest_m == pytest.approx(load_sensor("digit").gel.thickness_m - 0.001)


def test_the_recorder_takes_its_topics_from_the_file(write: WriteFile) -> None:
    nodes = started(SENSOR, params_file="drivers/run_camera.yaml", record="true")
    found = of_node(nodes, "tactile_record")
    driver = yaml.safe_load(parameter_path("drivers/run_camera.yaml").read_text())
    sensor = driver["/**"]["ros__parameters"]
    recorded = [topic.partition("=")[0] for topic in found["topics"]]
    assert {sensor["image_topic"], sensor["wrench_topic"]} < set(recorded)


def test_effects_that_are_given_go_before_the_file(write: WriteFile) -> None:
    path = write({"/**": {"effects": "any.yaml"}, "/**/tactile_sim": {"effects": "mine.yaml"}})
    found = of_node(started(SENSOR, params_file=path), "tactile_sim")
    assert found["effects"] == "mine.yaml"
    nodes = started(SENSOR, params_file=path, effects="found.yaml")
    assert of_node(nodes, "tactile_sim")["effects"] == "found.yaml"


SECTIONS = {
    "/**": {"of_all": 1, "a": "any"},
    "/**/tactile_sim": {"a": "by name", "b": "by name"},
    "/left/tactile_sim": {"b": "one", "c": "one"},
    "/*/tactile_sim": {"c": "in one namespace"},
    "/right/tactile_sim": {"a": "another"},
    "/left/**": {"d": "in left"},
    "/left/tactile_simulator": {"a": "another"},
}


@pytest.mark.parametrize("namespace", ["/", "/left", "/right", "/robot/left"])
def test_a_file_is_read_as_ros_reads_it(write: WriteFile, namespace: str) -> None:
    path = write(SECTIONS)
    arguments = ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", path]
    node = f"{namespace}/tactile_sim"
    found = parameters_of(path, node)
    assert {**found, "use_sim_time": False} == read_by_ros(arguments, "tactile_sim")
    named = named_parameters(path, node)
    assert "of_all" not in named
    assert "d" not in named
    assert set(named.items()) <= set(found.items())


CLASSES = {
    "tactile_sim": TactileSimParameters,
    "indenter_player": PlayerParameters,
    "tactile_record": RecordParameters,
    "tactile_policy": TactilePolicyParameters,
    "time_stepper": TimeStepperParameters,
    "xarm_sim": XarmSimParameters,
}
NAMES = {"dotsim_closed_loop": ("xarm_sim", "tactile_policy", "tactile_sim")}
"""Of the nodes of an executable, where they are not its own."""
GAZEBO, MUJOCO, GRIPPER = "gazebo.launch.py", "mujoco_ros2_control.launch.py", "gripper.launch.py"
LAUNCHES: dict[str, tuple[str, dict[str, str]]] = {
    "the loop": (LOOP, {"clock": "simulated", "speed": "2", "path": "line", "record": "true"}),
    "the loop in one process": (LOOP, {"one_process": "true"}),
    "a driver's sensor": (
        SENSOR,
        {"params_file": "drivers/run_camera.yaml", "play": "true", "record": "true"},
    ),
    "a sensor with effects": (SENSOR, {"effects": "found.yaml", "play": "true"}),
    "a gripper": (GRIPPER, {}),
    "Gazebo": (GAZEBO, {}),
    "MuJoCo's arm": (MUJOCO, {}),
    "MuJoCo's free body": (MUJOCO, {"source": "free_body"}),
}


def named(nodes: list[Started]) -> list[tuple[str, dict[str, Any]]]:
    """Return the name and the parameters of each node."""
    return [
        (name, read_by_ros(node.arguments, name))
        for node in nodes
        for name in NAMES.get(node.executable, (node.executable,))
    ]


@pytest.mark.parametrize("what", LAUNCHES)
def test_nodes_can_take_what_they_are_launched_with(what: str) -> None:
    launch, given = LAUNCHES[what]
    for node, found in named(started(launch, **given)):
        kind = CLASSES[node]
        fields = {name: default for name, (default, _) in known_parameters(kind).items()}
        values = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in found.items()
            if name in fields
        }
        from_values(kind, values)
        for field, value in values.items():
            # ROS refuses an int for a float, which the class itself would take.
            assert type(value) is type(fields[field]), field
        # What is for another node of the file must not be taken for a slip.
        assert not [name for name in set(found) - set(fields) if nearest(name, fields)]


@pytest.mark.parametrize(
    ("one_process", "executables"),
    [
        ("false", set(CLASSES) - {"indenter_player"}),
        ("true", {"dotsim_closed_loop", "tactile_record", "time_stepper"}),
    ],
)
def test_the_nodes_of_a_loop_are_started(one_process: str, executables: set[str]) -> None:
    given = {"one_process": one_process, "clock": "simulated", "record": "true"}
    assert {node.executable for node in started(LOOP, **given)} == executables


@pytest.mark.parametrize("what", LAUNCHES)
def test_every_launch_file_takes_the_sensor_that_is_given(write: WriteFile, what: str) -> None:
    launch, given = LAUNCHES[what]
    of_file = {"sensor": "flat_pad", "indenter": "cone", "profile": "exact", "rate_hz": 10.0}
    asked = {"sensor": "digit", "indenter": "8", "profile": "fast", "rate_hz": 30.0}
    texts = {**asked, "rate_hz": "30", "use_sim_time": "true"}
    path = write({"/**": {"sensor": "cone"}, "/**/tactile_sim": of_file})
    for texts_given, expected in (({}, of_file), (texts, asked)):
        nodes = named(started(launch, **{**given, **texts_given, "params_file": path}))
        sensors = [found for name, found in nodes if name == "tactile_sim"]
        assert len(sensors) == (2 if launch == GRIPPER else 1)
        assert [{name: found[name] for name in expected} for found in sensors] == [
            expected for _ in sensors
        ]
    assert {found["use_sim_time"] for name, found in nodes if name != "time_stepper"} == {True}


def test_the_player_presses_the_sensor_that_is_given(write: WriteFile) -> None:
    path = write({"/**": PAD, "/**/indenter_player": {"sensor": "flat_pad"}})
    nodes = started(SENSOR, params_file=path, play="true", sensor="gelslim")
    assert of_node(nodes, "indenter_player")["sensor"] == "gelslim"


def test_in_simulated_time_every_node_of_the_loop_but_the_stepper_is_stepped() -> None:
    for one_process in ("false", "true"):
        nodes = started(LOOP, clock="simulated", record="true", one_process=one_process)
        found = {name: (each["use_sim_time"], each.get("stepped")) for name, each in named(nodes)}
        assert found.pop("time_stepper") == (False, None)
        assert set(found) == {"tactile_sim", "xarm_sim", "tactile_policy", "tactile_record"}
        assert set(found.values()) == {(True, True)}


@pytest.mark.parametrize(
    ("launch", "given", "reason"),
    [
        (SENSOR, {"rate_hz": "fast"}, "rate_hz is 'fast', expected a number"),
        (SENSOR, {"use_sim_time": "1"}, "use_sim_time is '1', expected true or false"),
        (GAZEBO, {"sensor_centre_m": "[0, up]"}, r"'\[0, up\]', expected a list of numbers"),
        (LOOP, {"clock": "simulated", "use_sim_time": "false"}, "give one of the two"),
    ],
)
def test_an_argument_of_another_type_ends_the_launch(
    launch: str, given: dict[str, str], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        started(launch, **given)


@pytest.mark.parametrize("launch", sorted({launch for launch, _ in LAUNCHES.values()}))
def test_a_launch_file_uses_its_arguments_and_names_those_that_it_may_not_know(launch: str) -> None:
    found = launched(launch, ratehz="5", robot="mine")
    assert found.declared <= found.read
    assert found.log == [
        "the launch argument ratehz is not known and has no effect: is it rate_hz?"
    ]
    with pytest.raises(ValueError, match="no node is started: no file nowhere"):
        launched(launch, params_file="nowhere.yaml")


def test_gazebo_s_names_go_to_the_bridge_the_frames_and_the_sensor() -> None:
    given = {"world": "w", "sensor_model": "m", "sensor_link": "m::l", "indenter_link": "p::l"}
    nodes = launched(GAZEBO, **given, sensor_centre_m="[0, 0, 1]").nodes
    bridge, base, tip, sensor = (node.arguments for node in nodes)
    assert bridge[:4] == [
        "/model/m/pose@tf2_msgs/msg/TFMessage[gz.msgs.Pose_V",
        "/model/peg/pose@tf2_msgs/msg/TFMessage[gz.msgs.Pose_V",
        "/clock@rosgraph_msgs/msg/Clock[gz.msgs.Clock",
        "/world/w/wrench@ros_gz_interfaces/msg/EntityWrench]gz.msgs.EntityWrench",
    ]
    assert [base[3], tip[5]] == ["m::l", "p::l"]
    assert sensor[-1] == "entity_wrench:=/world/w/wrench"
    found = read_by_ros(sensor, "tactile_sim")
    assert (found["world_frame"], found["entity_sensor"]) == ("w", "m::l")
    assert (found["entity_indenter"], found["entity_sensor_centre_m"]) == ("p::l", [0.0, 0.0, 1.0])
    assert found["entity_indenter_centre_m"] == [0.0, 0.0, 0.02]
