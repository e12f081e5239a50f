"""Materials and the sensor's specification: what they accept, refuse and say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.gel.implicit.relaxation import Relaxation
from dotsim_ros.gel.material import (
    MooneyRivlin,
    NeoHookean,
    PronySeries,
    Yeoh,
    bulk_modulus_pa,
    shear_modulus_pa,
    small_strain_moduli_pa,
)
from dotsim_ros.specification import (
    ContactSpecification,
    SensorSpecification,
    load_sensor,
)

NAN = float("nan")


def test_neo_hookean_has_the_moduli_of_its_parameters() -> None:
    law = NeoHookean(3.0e5, 0.48)
    c10, c01, c20, c30, bulk = law.coefficients_pa()
    assert 2.0 * c10 == pytest.approx(shear_modulus_pa(3.0e5, 0.48))
    assert bulk == pytest.approx(bulk_modulus_pa(3.0e5, 0.48))
    assert (c01, c20, c30) == (0.0, 0.0, 0.0)
    assert small_strain_moduli_pa(law) == pytest.approx((3.0e5, bulk))


@pytest.mark.parametrize(
    ("law", "coefficients"),
    [
        (MooneyRivlin(3e4, 1e4, 1e6), [3e4, 1e4, 0.0, 0.0, 1e6]),
        (Yeoh(3e4, -1e3, 2e2, 1e6), [3e4, 0.0, -1e3, 2e2, 1e6]),
    ],
)
def test_coefficients(law: MooneyRivlin | Yeoh, coefficients: list[float]) -> None:
    assert law.coefficients_pa().tolist() == coefficients
    youngs, bulk = small_strain_moduli_pa(law)
    shear = 2.0 * (coefficients[0] + coefficients[1])
    assert youngs == pytest.approx(9.0 * bulk * shear / (3.0 * bulk + shear))


@pytest.mark.parametrize("youngs", [0.0, -1.0, NAN])
def test_bad_modulus_is_refused(youngs: float) -> None:
    with pytest.raises(ValueError, match="youngs_modulus_pa"):
        NeoHookean(youngs, 0.4)


@pytest.mark.parametrize("ratio", [-0.1, 0.5, 0.49995, NAN])
def test_bad_poisson_ratio_is_refused(ratio: float) -> None:
    with pytest.raises(ValueError, match="poisson_ratio"):
        NeoHookean(1e5, ratio)


def test_bad_constants_are_refused() -> None:
    for values in ((-2e4, 1e4, 1e6), (1e4, 1e4, 0.0), (NAN, 1e4, 1e6)):
        with pytest.raises(ValueError, match="c10_pa"):
            MooneyRivlin(*values)
    for constants in ((0.0, 0.0, 0.0, 1e6), (1e4, 0.0, 0.0, -1.0)):
        with pytest.raises(ValueError, match="c10_pa"):
            Yeoh(*constants)


@pytest.mark.parametrize(
    ("shares", "times"),
    [((0.2,), ()), ((0.5, 0.5), (1.0, 2.0)), ((-0.1,), (1.0,)), ((0.2,), (0.0,)), ((0.2,), (NAN,))],
)
def test_bad_prony_series_is_refused(shares: tuple[float, ...], times: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="Prony"):
        PronySeries(shares, times)


def test_without_a_series_nothing_is_remembered() -> None:
    relaxation = Relaxation(PronySeries())
    fast, history = relaxation.step_terms(0.1, 3)
    relaxation.finish_step(0.1, np.ones((3, 3, 3)))
    assert fast == 1.0
    assert np.all(history == 0.0)
    assert np.all(relaxation.step_terms(0.1, 3)[1] == 0.0)


def test_shipped_sensor_loads_by_name_and_by_path() -> None:
    sensor = load_sensor("densetact2")
    assert sensor.name == "densetact2"
    assert sensor.gel.outer_radius_m == 0.01575
    assert sensor.gel.core_radius_m == 0.006
    path = Path(__file__).parents[2] / "params" / "sensors" / "densetact2.yaml"
    assert load_sensor(path) == sensor
    assert isinstance(sensor, SensorSpecification)


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
        ("gel: {radius: 1}", r"section 'gel' has unknown entries \['radius'\]; known are"),
        ("jelly: {}", r"unknown sections \['jelly'\]"),
        ("gel: 3", "section 'gel' is no mapping"),
        ("- 1\n- 2", "holds no mapping"),
        ("gel: {shape: [", "is not valid YAML"),
        ("gel: {shape: cube}", "gel.shape is 'cube', expected one of"),
        ("gel: {core_radius_m: 0.02}", "core_radius_m"),
        ("gel: {skin_spacing_m: 0}", "skin_spacing_m"),
        ("gel: {skin_spacing_m: wide}", "gel.skin_spacing_m is 'wide'"),
        ("gel: {skin_spacing_m: .nan}", "skin_spacing_m"),
        ("material: {law: rubber}", "material.law is 'rubber'"),
        ("material: {density_kg_m3: -1}", "density_kg_m3"),
        ("material: {prony_shares: 0.3}", "material.prony_shares is 0.3"),
        ("contact: {friction_coefficient: 9}", "friction_coefficient is 9"),
        ("contact: {stiffness: 0}", "contact.stiffness"),
        ("solver: {method: magic}", "solver.method is 'magic'"),
        ("solver: {dynamic: 1}", "solver.dynamic is 1: expected true or false"),
        ("solver: {iterations: 0}", "solver.iterations"),
        ("camera: {distortion: [0, 0]}", "2 coefficients, expected 4"),
        ("camera: {width: many}", "camera.width is 'many'"),
    ],
)
def test_mistakes_in_a_file_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "sensor.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_sensor(path)
    assert "sensor.yaml" in str(caught.value)


@pytest.mark.parametrize("source", ["no_such_sensor", "/nowhere/sensor.yaml"])
def test_missing_sensor_is_named(source: str) -> None:
    with pytest.raises(FileNotFoundError, match="sensor"):
        load_sensor(source)
