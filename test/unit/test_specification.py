# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A sensor's file: what it takes, what it refuses and how it says so, and how large it will be."""

from __future__ import annotations

import dataclasses
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from dotsim_ros.gel.discretization import discretize
from dotsim_ros.gel.make import body_of, skin_of
from dotsim_ros.io.files import given_path, parameter_path
from dotsim_ros.io.quantity import meanings_of, quantities_of, quantity
from dotsim_ros.specification import (
    LARGEST_MEMORY_BYTES,
    SECTIONS,
    CameraSpecification,
    ContactSpecification,
    GelSpecification,
    LightingSpecification,
    NoiseSpecification,
    SensorSpecification,
    SolverSpecification,
    load_sensor,
    sensor_from,
    size_of,
    write_sensor,
)
from dotsim_ros.specification.__main__ import field_page, main

ROOT = Path(__file__).parents[2]
SHIPPED = sorted(path.stem for path in (ROOT / "params" / "sensors").glob("*.yaml"))


def sensor_of(text: str) -> SensorSpecification:
    return sensor_from(yaml.safe_load(text), "sensor.yaml", name="sensor")


def refusal(text: str) -> str:
    """Return why a sensor's file is refused."""
    with pytest.raises(ValueError, match=r"^sensor\.yaml") as caught:
        sensor_of(text)
    return str(caught.value)


def shown(value: object) -> str:
    """Return a value as a message has it."""
    if isinstance(value, list):
        return f"[{', '.join(map(shown, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    words = "empty" if value is None else repr(value)
    return words if len(words) <= 180 else f"{words[:180]}..."


def test_missing_entries_take_their_defaults(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("contact: {friction_coefficient: 1}\nsolver:\n")
    sensor = load_sensor(path)
    assert sensor.name == "mine"
    assert sensor.contact == ContactSpecification(friction_coefficient=1.0)
    assert isinstance(sensor.contact.friction_coefficient, float)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- 1\n- 2", "holds no mapping"),
        ("name: 5", "name is 5, expected text"),
    ],
)
def test_mistakes_in_a_file_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_sensor(path)
    assert str(path) in str(caught.value)


@pytest.mark.fault("sensor and YAML files", "a sensor that is not there")
def test_an_unknown_sensor_is_refused_with_those_that_there_are(
    answered: Callable[..., None],
) -> None:
    expected = (
        r"no sensor is named 'DIGITS' \(did you mean 'digit'\?\), expected one of densetact2, "
        r"digit, .*sensor_a, or the path of a YAML file"
    )
    with pytest.raises(FileNotFoundError, match=expected) as refused:
        load_sensor("DIGITS")
    answered(refused.value)


def test_a_sensor_and_its_image_may_lie_in_the_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "pad.yaml").write_text("camera: {idle_image: ~/idle.png}\n")
    sensor = load_sensor("~/pad.yaml")
    assert given_path(sensor.camera.idle_image) == tmp_path / "idle.png"


@pytest.mark.parametrize(
    ("section", "entry", "value", "expected"),
    [
        # Text: a closed set, or any.
        ("gel", "shape", "cube", "one of dome, flat_pad"),
        ("camera", "idle_image", "3", "text"),
        # Numbers: below, above, not finite, of another type.
        ("gel", "outer_radius_m", "true", "a number from 0.001 to 0.2 m"),
        ("gel", "outer_radius_m", "", "a number from 0.001 to 0.2 m"),
        ("gel", "outer_radius_m", "1" + 400 * "0", "a number from 0.001 to 0.2 m"),
        ("contact", "stiffness", "0", "a number from above 0 to 100000"),
        ("noise", "deviation_levels", "-1", "a number from 0 to 50 grey levels of 255"),
        # Whole numbers.
        ("camera", "width", "640.0", "a whole number from 16 to 4096 px"),
        ("solver", "iterations", "0", "a whole number from 1 to 1000"),
        # True or false.
        ("solver", "dynamic", "1", "true or false"),
        # Lists.
        ("gel", "pad_size_m", "[0.02, 0.02]", "3 numbers from 0.0005 to 0.2 m"),
        ("gel", "pad_size_m", "[0.02, 0.02, true]", "3 numbers from 0.0005 to 0.2 m"),
        ("material", "prony_shares", "0.3", "a list of numbers from above 0 to 1"),
        ("material", "prony_times_s", "[0.0]", "a list of numbers from 1.0e-06 to 1.0e+07 s"),
    ],
)
def test_a_bad_field_is_refused_with_its_name_its_value_and_what_it_takes(
    section: str, entry: str, value: str, expected: str
) -> None:
    message = refusal(f"{section}:\n  {entry}: {value}")
    assert len(message) < 600
    assert message.startswith(f"sensor.yaml: {section}.{entry} is {shown(yaml.safe_load(value))}, ")
    assert f", expected {expected}" in message


@pytest.mark.parametrize(
    ("section", "entry", "value", "meant"),
    [
        ("gel", "pad_size_m", "[20, 25, 4]", "[0.02, 0.025, 0.004] (metres)"),
        ("solver", "grid_spacing_m", "2.4", "0.0024 (metres)"),
        ("material", "youngs_modulus_pa", "0.3", "300000 (pascals)"),
    ],
)
def test_millimetres_and_megapascals_are_recognised(
    section: str, entry: str, value: str, meant: str
) -> None:
    assert refusal(f"{section}: {{{entry}: {value}}}").endswith(f"; did you mean {meant}?")


@pytest.mark.parametrize("text", ["outer_radius_m: 1575", "core_radius_m: -6", "shape: 15"])
def test_nothing_is_guessed_where_no_unit_explains_the_value(text: str) -> None:
    assert "did you mean" not in refusal(f"gel: {{{text}}}")


def test_what_yaml_takes_for_text_is_told() -> None:
    message = refusal("material: {youngs_modulus_pa: '3e5'}")
    assert "material.youngs_modulus_pa is '3e5'" in message
    assert message.endswith("this is text, the number is written 300000")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gel: {core_radius_m: 0.02}", r"gel\.core_radius_m is 0\.02, expected less than"),
        ("gel: {outer_radius_m: 0.008, skin_spacing_m: 0.0045}", r"gel\.skin_spacing_m is 0\.0045"),
        (
            "gel: {shape: flat_pad, pad_size_m: [0.002, 0.02, 0.01], skin_spacing_m: 0.0015}",
            r"gel\.skin_spacing_m is 0\.0015, expected at most half of the shorter side of "
            r"gel\.pad_size_m \(0\.001 m\)",
        ),
        ("gel: {shape: flat_pad}", r"solver\.grid_spacing_m is 0\.0024, .* \(0\.002 m\)"),
        ("material: {law: yeoh}", r"material\.c10_pa is 0\.0, expected a positive .* law yeoh"),
        (
            "material: {law: yeoh, c10_pa: 3.0e+4}",
            r"material\.bulk_modulus_pa is 0\.0, expected a positive .* law yeoh",
        ),
        (
            "material: {law: mooney_rivlin, c10_pa: 1.0e+4, c01_pa: -2.0e+4}",
            r"material\.c10_pa \+ material\.c01_pa is -10000\.0, expected a positive",
        ),
        ("material: {prony_shares: [0.1]}", r"prony_shares has 1 entries and .*times_s has 0"),
        (
            "material: {prony_shares: [0.6, 0.5], prony_times_s: [1, 2]}",
            r"material\.prony_shares is \[0\.6, 0\.5\], expected a sum below 1",
        ),
        (
            "material: {law: yeoh, c10_pa: 3.0e+4, bulk_modulus_pa: 1.0e+6}\n"
            "solver: {method: explicit}",
            "solver.method 'explicit' takes the law neo_hookean, not 'yeoh'",
        ),
        (
            "camera: {quaternion_xyzw: [0, 0, 0, 0.5]}",
            r"camera\.quaternion_xyzw is .*of length 0\.5, expected 1 within 0\.001",
        ),
        (
            "camera: {principal_point_px: [319.5, 2000]}",
            r"camera\.principal_point_px is \[319\.5, 2000\.0\], expected at most",
        ),
        ("camera: {position_m: [0, 0, 0.02]}", r"camera\.position_m is .* in front of the skin"),
        (
            "camera: {position_m: [0.02, 0, -0.005]}",
            r"camera\.position_m is .* in front of the skin",
        ),
        (
            "camera: {position_m: [0, 0, -0.15]}",
            r"camera\.position_m is \[0\.0, 0\.0, -0\.15\], 0\.15 m from the gel, expected at most",
        ),
        (
            "camera: {idle_image: ''}\npattern: {blotch_m: 2.0e-5}",
            r"pattern\.blotch_m is 2\.0e-05, expected at least 0\.000132 m to be drawn",
        ),
    ],
)
def test_fields_that_contradict_each_other_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sensor_of(text)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("solver: {grid_spacing_m: 0.001}", "the grid"),
        ("gel: {outer_radius_m: 0.2, core_radius_m: 0.19}", "the grid"),
        (
            "gel: {shape: flat_pad, pad_size_m: [0.2, 0.2, 0.02], skin_spacing_m: 5.0e-5}\n"
            "solver: {grid_spacing_m: 0.01, refined: false}",
            "the skin",
        ),
    ],
)
def test_a_sensor_that_no_machine_holds_is_refused_before_it_is_made(text: str, part: str) -> None:
    message = refusal(text)
    assert "GB of memory, expected at most 16 GB" in message
    assert message.endswith(f"most of it is for {part}")


@pytest.mark.parametrize(
    ("gel", "spacing_m"),
    [
        (GelSpecification(), 4.8e-3),
        (GelSpecification(core_radius_m=0.0, skin_spacing_m=1e-3), 3e-3),
        (GelSpecification(core_radius_m=0.012), 2e-3),
        (GelSpecification(shape="flat_pad", pad_size_m=(0.021, 0.017, 0.005)), 1.3e-3),
    ],
)
def test_markers_and_nodes_are_known_beforehand(gel: GelSpecification, spacing_m: float) -> None:
    sensor = SensorSpecification(gel=gel, solver=SolverSpecification(grid_spacing_m=spacing_m))
    size, skin = size_of(sensor), skin_of(gel)
    made = discretize(body_of(gel), skin.rest_position_m, spacing_m)
    assert size.skin_marker_count == pytest.approx(skin.vertex_count, rel=0.12)
    assert size.grid_node_count == pytest.approx(made.node_count, rel=0.12)


def test_memory_grows_with_all_that_takes_it() -> None:
    own = SensorSpecification()
    larger = [
        replace(own, solver=SolverSpecification(grid_spacing_m=2.0e-3)),
        replace(own, gel=replace(own.gel, skin_spacing_m=0.25e-3)),
        replace(own, camera=replace(own.camera, width=1280, height=960)),
    ]
    memory = size_of(own).memory_bytes
    # Measured: 1.57 GB.
    assert 1.0e9 < memory < 2.1e9 < LARGEST_MEMORY_BYTES
    assert all(size_of(sensor).memory_bytes > memory for sensor in larger)
    explicit = replace(own, solver=SolverSpecification(method="explicit"))
    unrefined = replace(own, solver=SolverSpecification(refined=False))
    assert size_of(explicit).memory_bytes < size_of(unrefined).memory_bytes < memory


def test_numbers_of_numpy_are_taken_as_what_they_are(tmp_path: Path) -> None:
    camera = CameraSpecification(
        width=np.int64(320),  # type: ignore[arg-type]
        principal_point_px=np.array([159.5, 119.5]).tolist(),
        half_height_angle_deg=np.float64(80.0),
    )
    assert type(camera.width) is int
    assert camera.principal_point_px == (159.5, 119.5)
    assert type(camera.half_height_angle_deg) is float
    write_sensor(tmp_path / "own.yaml", SensorSpecification(camera=camera), "")
    assert load_sensor(tmp_path / "own.yaml").camera == camera
    with pytest.raises(ValueError, match=r"camera\.width is 320\.0, expected a whole number"):
        CameraSpecification(width=np.float64(320.0))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_written_sensor_has_what_differs_and_loads_as_the_same(tmp_path: Path, name: str) -> None:
    sensor = load_sensor(name)
    path = tmp_path / f"{name}.yaml"
    write_sensor(path, sensor, "a comment")
    document = yaml.safe_load(path.read_text())
    assert load_sensor(path) == sensor
    assert ("noise" in document) == (sensor.noise != NoiseSpecification())
    assert ("lighting" in document) == (sensor.lighting != LightingSpecification())
    noisy = replace(sensor, noise=NoiseSpecification(2.0, seed=5))
    write_sensor(path, noisy, "a comment")
    assert yaml.safe_load(path.read_text())["noise"] == {"deviation_levels": 2.0, "seed": 5}
    assert load_sensor(path) == noisy


def test_an_image_beside_the_file_is_found_wherever_the_folder_is(tmp_path: Path) -> None:
    (folder := tmp_path / "made").mkdir()
    shutil.copy(parameter_path("images/densetact2_idle.png"), folder / "idle.png")
    sensor = load_sensor("densetact2")
    own = replace(sensor, camera=replace(sensor.camera, idle_image=str(folder / "idle.png")))
    write_sensor(folder / "own.yaml", own, "")
    assert load_sensor(folder / "own.yaml") == own
    moved = folder.rename(tmp_path / "moved")
    assert load_sensor(moved / "own.yaml").camera.idle_image == str(moved / "idle.png")


@pytest.mark.parametrize("kind", [SensorSpecification, *SECTIONS.values()])
def test_every_field_says_what_it_is_and_holds_its_default(kind: type) -> None:
    known = quantities_of(kind)
    sections = set(SECTIONS) if kind is SensorSpecification else set()
    assert set(known) == {field.name for field in dataclasses.fields(kind)} - sections
    assert kind() == kind(**{name: default for name, (default, _) in known.items()})
    for name, (default, entry) in known.items():
        assert meanings_of(kind)[name].endswith("."), name
        assert name.endswith("_m") == (entry.unit == "m"), name
        assert name.endswith("_pa") == (entry.unit == "Pa"), name
        assert entry.has_range != isinstance(default, bool | str), name


def test_a_number_without_a_range_cannot_be_a_field() -> None:
    with pytest.raises(TypeError, match="both ends of a range"):
        quantity(1.0, low=0.0)
    with pytest.raises(TypeError, match="no field can have the default None"):
        quantity(None)


def test_the_page_of_the_fields_is_up_to_date() -> None:
    page = (ROOT / "docs" / "api" / "sensor_fields.md").read_text(encoding="utf-8")
    assert page == field_page(), (
        "run: python -m dotsim_ros.specification --markdown docs/api/sensor_fields.md"
    )
    for kind in SECTIONS.values():
        for name in quantities_of(kind):
            assert f"| `{name}` |" in page

    sensor = sensor_of(page.split("```yaml\n")[1].split("```")[0])
    assert (sensor.gel.shape, sensor.camera.idle_image) == ("flat_pad", "")


def test_the_page_is_printed_or_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["specification"])
    main()
    assert capsys.readouterr().out == field_page()
    monkeypatch.setattr(sys, "argv", ["specification", "--markdown", str(tmp_path / "page.md")])
    main()
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == field_page()
