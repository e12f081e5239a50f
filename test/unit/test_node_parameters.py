"""Parameters of the node, checked in one place, and the files that set them."""

import dataclasses

import pytest
import yaml

from dotsim_ros.files import parameter_path
from dotsim_ros.nodes.common.options import option_of
from dotsim_ros.nodes.tactile_sim.parameters import TactileSimParameters


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"rate_hz": float("nan")}, "rate_hz"),
        ({"clock": "sundial"}, "expected one of realtime, lockstep"),
        ({"crop_px": (0, 0, 10)}, "crop_px needs 4 numbers"),
        ({"crop_px": (5, 0, 0, 0)}, "four zeros"),
        ({"image_size_px": (640, 0)}, "both width and height"),
        ({"grid_spacing_m": 1e-4}, r"grid_spacing_m is 0\.0001, expected a number from 0\.0002"),
        ({"start_quaternion_xyzw": (0.0, 0.0, 0.0, 0.5)}, "length"),
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
        dataclasses.replace(TactileSimParameters(), **changes)


def test_every_parameter_says_what_it_is():
    for field in dataclasses.fields(TactileSimParameters):
        assert option_of(field).description.endswith((".", "zeros: as it is.")), field.name


@pytest.mark.parametrize("name", ["tactile_sim.yaml", "remap_real_driver.yaml"])
def test_the_shipped_files_hold_valid_parameters(name):
    content = yaml.safe_load(parameter_path(name).read_text())
    values = content["/**"]["ros__parameters"]
    plain = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    parameters = TactileSimParameters(**plain)
    if name == "tactile_sim.yaml":
        assert parameters == TactileSimParameters()
        assert set(plain) == {field.name for field in dataclasses.fields(TactileSimParameters)}
