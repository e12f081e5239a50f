# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a node answers to a command line or an environment that it cannot start from: one line."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import rclpy
from harness import refused_starts, running, with_parameters
from hostile import BOMB

from dotsim_ros.effects.overlay import Estimate, FoundEffect, Overlay, overlay_text
from dotsim_ros.nodes.common.arguments import check_start
from dotsim_ros.nodes.common.declare import declare
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.parameter_file import found_parameter_file, parameters_of
from dotsim_ros.nodes.common.parameters import known_parameters
from dotsim_ros.nodes.tactile_policy.node import TactilePolicy
from dotsim_ros.nodes.tactile_record.node import RecordParameters
from dotsim_ros.nodes.tactile_sim.node import TactileSim
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters
from dotsim_ros.nodes.xarm_sim.node import XarmSim
from dotsim_ros.nodes.xarm_sim.parameters import XarmSimParameters
from msg_adapters import message_class

NODES = Path(__file__).parents[2] / "dotsim_ros" / "nodes"
PARAMETER_FILES = {
    "nothing": b"",
    "no text": b"\xff\xfe\x00garbage",
    "no mapping": b"- 1\n",
    "half a list": b"a: [1\n  b",
    "nested anchors": BOMB.encode(),
}
ARGUMENTS: dict[str, list[str]] = {
    "`--sensor pad` without `--ros-args`": ["--sensor", "pad"],
    "an unknown ROS argument": ["--ros-args", "--sensor"],
    "a parameter without a value": ["--ros-args", "-p", "seed:="],
    "a parameter of another type": ["--ros-args", "-p", "seed:=many"],
    "a parameter that is not a number": ["--ros-args", "-p", "rate_hz:=.nan"],
    "a parameter that is no text in UTF-8": ["--ros-args", "-p", "base_frame:=\udcff"],
    "half a list as a parameter": ["--ros-args", "-p", "start_pose:=[1.0, 2"],
    "an unknown QoS policy": [
        "--ros-args",
        "-p",
        "qos_overrides./cmd_vel.subscription.reliability:=maybe",
    ],
    "a QoS depth below zero": ["--ros-args", "-p", "qos_overrides./ee_pose.publisher.depth:=-5"],
    "a QoS depth of 10^17": [
        "--ros-args",
        "-p",
        "qos_overrides./ee_pose.publisher.depth:=100000000000000000",
    ],
    "a topic renamed to `bad name!`": ["--ros-args", "-r", "cmd_vel:=bad name!"],
    "a namespace with a space": ["--ros-args", "-r", "__ns:=/bad ns"],
    "a file of parameters that is not there": ["--ros-args", "--params-file", "nowhere.yaml"],
}
ARM_PARAMETERS: dict[str, dict[str, Any]] = {
    "start_pose: the arm does not reach": {"start_pose": [1.3, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]},
    "start_pose is": {"start_pose": [0.35, 0.0, 0.3]},
}
"""Of `xarm_sim`, by words of the reason; what its class refuses is in the tests of that."""
SHIPPED = {"policy": "densetact2_sphere"}
POLICY_PARAMETERS: dict[str, dict[str, Any]] = {
    "parameter policy is empty": {},
    "no policy folder": {"policy": "/no/such/policy"},
    "choose one of": {**SHIPPED, "path": "spiral"},
    "no idle image": {**SHIPPED, "idle_image": "/no/such.png"},
}
"""Of `tactile_policy`, by words of the reason."""


SENSOR_PARAMETERS: dict[str, dict[str, Any]] = {
    "no_such_sensor": {"sensor": "no_such_sensor"},
    "no mesh file": {"indenter": "/no/such/mesh.stl"},
    "there is no device 'cuda:99' on this machine": {"device": "cuda:99"},
    "lockstep shows each pose": {"profile": "fast", "clock": "lockstep"},
    "no idle image /no/such/image.png": {"idle_image": "/no/such/image.png"},
    "of type 'INTEGER', expecting type 'STRING': profile": {"profile": 3},
    "of type 'STRING_ARRAY', expecting type 'STRING': profile": {"profile": "[fast, auto]"},
    "GB of memory, expected at most 16 GB": {"grid_spacing_m": 0.0005},
    "world_frame is 'map', but pose_source is topic": {"world_frame": "map"},
}
if find_spec("tf2_msgs") is None:
    SENSOR_PARAMETERS["message package 'tf2_msgs' is not installed"] = {"pose_source": "tf"}
if find_spec("ros_gz_interfaces") is None:
    reason = "without it read external_wrench/indenter and external_wrench/sensor"
    SENSOR_PARAMETERS[reason] = {"entity_sensor": "'arm::tool'"}
"""Of `tactile_sim`, by words of the reason."""
OVERLAYS = {
    "no overlay of effects at": None,
    "unknown effect 'ghost'; known are": ("ghost", Estimate("size", "", 1.0, 1.0, 1.0)),
    "force_scale.scale is 3, expected 0.64": (
        "force_scale",
        Estimate("scale", "", 3.0, 3.0, 3.0),
    ),
}
"""Effects that cannot work, by words of the reason."""
MILLIMETRES = "gel.outer_radius_m is 15.75, expected a number from 0.001 to 0.2 m; did you mean"
STARTS = [
    *((XarmSim, reason) for reason in ARM_PARAMETERS),
    *((TactilePolicy, reason) for reason in POLICY_PARAMETERS),
    *((TactileSim, reason) for reason in (*SENSOR_PARAMETERS, *OVERLAYS, MILLIMETRES)),
]
Refusals = dict[type, dict[str, str]]


@pytest.fixture(scope="module")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> Refusals:
    """Return the log of each start that must be refused, by node and words of the reason."""
    folder = tmp_path_factory.mktemp("refused")
    of_sensor = dict(SENSOR_PARAMETERS)
    for number, (reason, found) in enumerate(OVERLAYS.items()):
        path = folder / f"{number}.yaml"
        if found is not None:
            effect = FoundEffect(found[0], (found[1],))
            path.write_text(overlay_text(Overlay("densetact2", "0123456789abcdef", (effect,))))
        of_sensor[reason] = {"effects": path}
    of_sensor[MILLIMETRES] = {"sensor": folder / "millimetres.yaml"}
    (folder / "millimetres.yaml").write_text("gel: {outer_radius_m: 15.75}\n")

    def logs(
        node: type, parameters: dict[str, dict[str, Any]], **more: list[str]
    ) -> dict[str, str]:
        given = {reason: with_parameters(each) for reason, each in parameters.items()}
        return refused_starts(node, {**more, **given})

    return {
        XarmSim: logs(XarmSim, ARM_PARAMETERS, **ARGUMENTS),
        TactilePolicy: logs(TactilePolicy, POLICY_PARAMETERS),
        TactileSim: logs(TactileSim, of_sensor),
    }


@pytest.mark.parametrize(("node", "reason"), STARTS)
def test_a_start_that_cannot_work_is_refused_with_the_reason(
    refusals: Refusals, node: type, reason: str
) -> None:
    assert reason in refusals[node][reason]
    assert "Traceback" not in refusals[node][reason]


@pytest.mark.fault("node parameters", "a command line that makes no sense")
@pytest.mark.parametrize("what", ARGUMENTS)
def test_a_command_line_that_makes_no_sense_is_answered_in_one_line(
    refusals: Refusals, what: str, answered: Any
) -> None:
    log = refusals[XarmSim][what]
    assert "Traceback" not in log
    (line,) = [line for line in log.splitlines() if "cannot start: " in line]
    answered(line.partition("]: ")[2], what=f"a node is started with {what}")


@pytest.mark.fault("node parameters", "a node is started with `ROS_DOMAIN_ID` 9999")
def test_a_domain_that_does_not_exist_is_refused(
    monkeypatch: pytest.MonkeyPatch, answered: Any
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "9999")
    with pytest.raises(ValueError, match="ROS_DOMAIN_ID") as caught:
        check_start([])
    answered(caught.value)


@pytest.mark.fault("node parameters", "a profile of Fast DDS that is not there")
def test_a_profile_that_is_not_there_is_refused(
    monkeypatch: pytest.MonkeyPatch, answered: Any
) -> None:
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "/no/such/profile.xml")
    with pytest.raises(ValueError, match="is no file") as caught:
        check_start([])
    answered(caught.value)


WITHOUT_PINOCCHIO = """
import sys
sys.modules["pinocchio"] = None
from dotsim_ros.cli.main import main
from dotsim_ros.nodes import executables
print(executables.xarm_sim(), executables.closed_loop(), main(["demo-loop", "--out", "loop"]))
"""


@pytest.mark.fault("node parameters", "`xarm_sim` where Pinocchio is not installed")
def test_the_arm_is_asked_for_where_it_is_missing(tmp_path: Path, answered: Any) -> None:
    command = [sys.executable, "-c", WITHOUT_PINOCCHIO]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == ["2", "2", "1"], done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 3, done.stderr
    assert all("pip install 'dotsim_ros[arm]'" in line for line in lines), done.stderr
    assert not (tmp_path / "loop").exists()
    answered(lines[0].partition("]: ")[2])
    answered(lines[2], what="`demo-loop` where Pinocchio is not installed")


LOADED_WITHOUT_ARM = """
import sys
from importlib import import_module

class Refused:
    def find_spec(self, name, *_):
        assert name != "pinocchio", "the arm is loaded"

sys.meta_path.insert(0, Refused())
for name in sys.argv[1:]:
    import_module(name)
import dotsim_ros
for name in dotsim_ros.__all__:
    getattr(dotsim_ros, name)
try:
    import dotsim_ros.control.arm.kinematics
except AssertionError:
    print("only the arm asks for it")
"""


def test_what_needs_no_arm_does_not_ask_for_pinocchio() -> None:
    names = {path.parent.name for path in NODES.glob("*/node.py")} - {"xarm_sim", "closed_loop"}
    assert {"tactile_sim", "tactile_policy", "xarm_adapter"} < names
    modules = [f"dotsim_ros.nodes.{name}.node" for name in sorted(names)]
    command = [sys.executable, "-c", LOADED_WITHOUT_ARM, *modules]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.stdout == "only the arm asks for it\n", done.stderr


@pytest.mark.fault("node parameters", "a file of parameters that holds none")
@pytest.mark.parametrize("what", PARAMETER_FILES)
def test_a_file_without_parameters_is_refused(tmp_path: Path, what: str, answered: Any) -> None:
    path = tmp_path / "node.yaml"
    path.write_bytes(PARAMETER_FILES[what])
    with pytest.raises(ValueError, match=r"node\.yaml") as caught:
        check_start(["--ros-args", "--params-file", str(path)])
    answered(caught.value, what=f"a node's file of parameters holds {what}")


TOPICS = {
    "a topic with a space": ["bad name=sensor_msgs/msg/Image"],
    "a topic of a type that is a path": ["wrench=../../etc"],
    "a topic of a type that is another module's": ["wrench=os/path/join"],
    "a topic of a service's type": ["wrench=std_srvs/srv/Trigger"],
    "one topic twice": ["wrench", "wrench=sensor_msgs/msg/Image"],
}


def classes_of(topics: list[str]) -> list[Any]:
    types = RecordParameters(topics=tuple(topics)).message_types()
    return [message_class(kind) for kind in types.values()]


@pytest.mark.fault("node parameters", "topics of `tactile_record`")
@pytest.mark.parametrize("what", TOPICS)
def test_topics_that_cannot_be_recorded_are_refused(what: str, answered: Any) -> None:
    with pytest.raises(ValueError, match=r"topics|message type") as caught:
        classes_of(TOPICS[what])
    answered(caught.value, what=f"`tactile_record` is asked for {what}")


def settings_of(arguments: list[str], namespace: str = "") -> TactileSimParameters:
    """Return the parameters that a `tactile_sim` has by its command line."""
    context = rclpy.Context()
    rclpy.init(context=context, args=arguments)
    node = WorkingNode("tactile_sim", namespace=namespace, context=context)
    try:
        return declare(node, TactileSimParameters)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_paths_of_parameters_may_begin_with_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    given = {"idle_image": "~/idle.png", "effects": "~/o.yaml", "effects_folder": "~/my"}
    # A topic of the node's own begins with the same character.
    private = {"image_topic": "~/image_raw"}
    arguments = [f"{name}:={value}" for name, value in (given | private).items()]
    settings = settings_of(["--ros-args", *(x for a in arguments for x in ("-p", a))])
    for name, value in given.items():
        assert getattr(settings.sensor, name) == value.replace("~", str(tmp_path))
    assert found_parameter_file("~/idle.png") == "~/idle.png"
    (tmp_path / "node.yaml").write_text("{}")
    assert found_parameter_file("~/node.yaml") == str(tmp_path / "node.yaml")


@pytest.mark.parametrize("name", ["launch_ros_any_node.yaml", "launch_ros_named_node.yaml"])
def test_parameters_are_read_as_launch_ros_writes_them(name: str) -> None:
    """The files are those that launch_ros 0.26 (ROS 2 Jazzy) wrote for two nodes of a launch file
    in Python, whose lists become tuples."""
    path = str(Path(__file__).parent / "data" / name)
    arguments = ["--ros-args", "--params-file", path]
    check_start(arguments)
    assert parameters_of(path, "/left/tactile_sim")["crop_px"] == [0, 0, 320, 240]
    settings = settings_of(arguments, namespace="left")
    assert settings.image.crop_px == (0, 0, 320, 240)
    assert settings.links.entity_sensor_centre_m == (0.01, 0.0, -0.02)
    assert (settings.sensor.sensor, settings.time.latency_seed) == ("flat_pad", 3)
    assert settings.image.image_noise_levels == 1.5
    # A text that looks like a number stays one.
    assert settings.topics.image_topic == "1"


@pytest.mark.fault("node parameters", "a file of parameters with an object of Python")
def test_objects_of_python_are_refused(tmp_path: Path, answered: Callable[..., None]) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("/**:\n  ros__parameters:\n    seed: !!python/object/apply:os.getpid []\n")
    with pytest.raises(ValueError, match="could not determine a constructor") as refused:
        check_start(["--ros-args", "--params-file", str(path)])
    answered(refused.value)


def test_every_executable_answers_help_with_all_its_parameters() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from dotsim_ros.nodes import executables as e; e.xarm_sim()", "-h"],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "usage: xarm_sim [--ros-args" in done.stdout
    for name, (default, parameter) in known_parameters(XarmSimParameters).items():
        assert f"  {name} ({default!r}): {parameter.help}" in done.stdout


TWO_NODES = """
from dotsim_ros.nodes.common.node import WorkingNode
from dotsim_ros.nodes.common.spin import run_nodes

def node(name, *parameters):
    made = WorkingNode(name)
    for parameter in parameters:
        made.declare_parameter(parameter, 0.0)
    made.get_logger().info("ready:")
    return made

arm, finger = lambda: node("arm", "rate_hz", "latency_s"), lambda: node("finger", "crop_px")
raise SystemExit(run_nodes([arm, finger]))
"""
GIVEN_TO_TWO_NODES = """
/**:
  ros__parameters: {topics: [wrench], latencys: 0.1}
/**/arm:
  ros__parameters: {crop_px: 1.0, qos_overrides: {/nowhere: {publisher: {depth: 3}}}}
"""


@pytest.mark.fault("node parameters", "a parameter that no node has")
def test_parameters_that_no_node_has_are_named_with_the_nearest_name(
    tmp_path: Path, answered: Callable[..., None]
) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(GIVEN_TO_TWO_NODES)
    given = ["--params-file", str(path), "-p", "ratehz:=5.0", "-p", "rate_hz:=5.0"]
    with running(ready="[finger]: given", arguments=["--ros-args", *given], code=TWO_NODES) as node:
        node.wait_for_line("ready:")
        assert node.interrupt() == 0
    lines = [line.partition("] ")[2].partition("] ")[2] for line in node.log.splitlines()]
    wrong = "without effect, since the node has no parameter of the name: "
    other = "given for any node, and not a parameter of this one: "
    quality = "qos_overrides./nowhere.publisher.depth"
    named = [line for line in lines if wrong in line or other in line]
    assert named == [
        # Another node of the process has crop_px, but this one is meant.
        f"[arm]: {wrong}crop_px, latencys (is it latency_s?), {quality}, ratehz (is it rate_hz?)",
        f"[arm]: {other}topics",
        f"[finger]: {wrong}ratehz",
        f"[finger]: {other}latencys, topics",
    ]
    answered(named[0])


def test_without_ros_a_node_says_what_to_install_and_a_verb_runs() -> None:
    hidden = "import sys; sys.modules['rclpy'] = None; import dotsim_ros."
    node, verb = (
        subprocess.run(
            [sys.executable, "-c", f"{hidden}{module} as e; exit(e.{name}())", "-h"],
            capture_output=True,
            text=True,
            check=False,
        )
        for module, name in (
            ("nodes.executables", "tactile_record"),
            ("cli.executables", "find_gap"),
        )
    )
    assert node.returncode == 2
    assert node.stderr.startswith("tactile_record needs ROS 2")
    assert node.stderr.count("\n") == 1
    assert (verb.returncode, verb.stderr) == (0, "")


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("dotsim_ros.cli.executables", "find_gap"),
        ("dotsim_ros.nodes.executables", "closed_loop"),
    ],
)
def test_an_executable_by_its_old_name_does_the_same_and_names_the_new_one(
    module: str, name: str
) -> None:
    old = subprocess.run(
        [sys.executable, "-c", f"import {module} as e; exit(e.{name}_by_old_name())", "-h"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert old.returncode == 0
    assert "usage" in old.stdout.lower()
    assert old.stderr == f"{name} is called dotsim_{name} now; this name will go\n"
