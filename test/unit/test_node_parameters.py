# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the node, checked in one place, and the files that set them."""

import dataclasses

import pytest
import yaml

from dotsim_ros.geometry.camera import Camera
from dotsim_ros.io.files import parameter_path
from dotsim_ros.io.quantity import check_fields, quantity
from dotsim_ros.nodes.common.parameters import from_values, known_parameters
from dotsim_ros.nodes.tactile_sim.framing import Framing
from dotsim_ros.nodes.tactile_sim.parameters import FrameParameters, TactileSimParameters
from dotsim_ros.specification import load_sensor


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"rate_hz": float("nan")}, "rate_hz"),
        ({"clock": "sundial"}, "expected one of realtime, lockstep"),
        ({"crop_px": (0, 0, 10)}, "crop_px is .* expected 4 numbers"),
        ({"crop_px": (5, 0, 0, 0)}, "four zeros"),
        ({"crop_px": (0.5, 0, 0, 0)}, "crop_px is .* expected 4 numbers"),
        ({"ratehz": 5.0}, "ratehz: expected only sensor, device, indenter"),
        ({"image_size_px": (640, 0)}, "both width and height"),
        ({"grid_spacing_m": 1e-4}, r"grid_spacing_m is 0\.0001, expected a number from 0\.0002"),
        ({"start_quaternion_xyzw": (0.0, 0.0, 0.0, 0.5)}, "length"),
        ({"image_topic": ""}, "image_topic is empty"),
        ({"radius_limits_m": (0.016, 0.012)}, "the smaller one first"),
        ({"device": "gpu9"}, "device is 'gpu9', expected cpu"),
        ({"base_frame": "same", "optical_frame": "same"}, "must differ"),
        ({"input_timeout_s": 0.03}, "shorter than a frame"),
        (
            {"clock": "lockstep", "input": "twist", "twist_message": "Twist"},
            "lockstep needs stamps",
        ),
    ],
)
def test_bad_values_and_contradictions_are_refused_with_the_reason(changes, reason):
    with pytest.raises(ValueError, match=reason):
        from_values(TactileSimParameters, changes)


@dataclasses.dataclass(frozen=True)
class Lists:
    """Fields that hold lists."""

    topics: tuple[str, ...] = quantity(("wrench",))
    """Texts."""
    numbers: tuple[int, ...] = quantity((-1,), low=-1, high=9, any_length=True)
    """Any."""

    def __post_init__(self) -> None:
        check_fields("", self)


def test_lists_may_hold_texts_and_be_of_any_length():
    assert Lists(["a", "b"], [1, 2, 3]) == Lists(("a", "b"), (1, 2, 3))
    for given, reason in (({"topics": (1,)}, "list of texts"), ({"numbers": (10,)}, "-1 to 9")):
        with pytest.raises(ValueError, match=reason):
            Lists(**given)


def test_every_parameter_says_what_it_is():
    for name, (_, parameter) in known_parameters(TactileSimParameters).items():
        assert parameter.help.endswith("."), name


def test_the_shipped_file_holds_the_defaults():
    content = yaml.safe_load(parameter_path("tactile_sim.yaml").read_text())
    values = content["/**"]["ros__parameters"]
    plain = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    parameters = from_values(TactileSimParameters, plain)
    assert parameters == TactileSimParameters()
    assert set(plain) == known_parameters(TactileSimParameters).keys()


@pytest.mark.parametrize(
    "name", sorted(path.name for path in parameter_path("drivers").glob("*.yaml"))
)
def test_the_files_for_drivers_hold_valid_parameters(name):
    content = yaml.safe_load(parameter_path(f"drivers/{name}").read_text())
    common = content.pop("/**")["ros__parameters"]
    framings = set()
    own = [each for name, each in content.items() if name.endswith("/tactile_sim")]
    for section in ({}, *(each["ros__parameters"] for each in own)):
        values = {**common, **section}
        qualities = values.pop("qos_overrides", {})
        plain = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
        parameters = from_values(TactileSimParameters, plain)
        framings.add(
            Framing.of_camera(
                Camera.from_specification(load_sensor(parameters.sensor.sensor).camera),
                crop_px=parameters.image.crop_px,
                image_size_px=parameters.image.image_size_px,
                image_aspect=parameters.image.image_aspect,
            )
        )
        topics = {parameters.topics.image_topic, parameters.topics.difference_topic}
        assert {name.removesuffix("/compressed") for name in qualities} <= topics
    assert len(framings) == 1


def test_a_prefix_is_put_before_every_frame():
    plain = FrameParameters(frame_prefix="left_")
    assert plain.base_frame == "densetact_base"
    left = plain.prefixed()
    assert left.base_frame == "left_densetact_base"
    assert left.optical_frame == "left_densetact_optical_frame"
    assert left.indenter_frame == "left_indenter"
    assert left.prefixed() == left
