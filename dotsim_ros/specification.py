"""What a sensor is, as data: read from a YAML file, checked, and frozen."""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml

from dotsim_ros.files import parameter_path, whole_file

SHAPES = ("dome", "flat_pad")
METHODS = ("implicit", "explicit")
LAWS = ("neo_hookean", "mooney_rivlin", "yeoh")


def _positive(section: str, **values: float) -> None:
    for name, value in values.items():
        if not value > 0.0:
            raise ValueError(f"{section}.{name} is {value}, expected a positive number")


@dataclass(frozen=True)
class GelSpecification:
    """Rest shape of the gel.

    Attributes:
        shape: "dome" or "flat_pad".
        skin_spacing_m: largest distance between neighbouring skin markers.
        outer_radius_m, core_radius_m: of a dome.
        pad_size_m: lengths along x, y and the thickness along z of a flat pad.
    """

    shape: str = "dome"
    skin_spacing_m: float = 0.5e-3
    outer_radius_m: float = 0.01575
    core_radius_m: float = 0.006
    pad_size_m: tuple[float, float, float] = (0.02, 0.025, 0.004)

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ValueError(f"gel.shape is {self.shape!r}, expected one of {SHAPES}")
        _positive("gel", skin_spacing_m=self.skin_spacing_m, outer_radius_m=self.outer_radius_m)
        if not 0.0 <= self.core_radius_m < self.outer_radius_m:
            raise ValueError(
                f"gel.core_radius_m is {self.core_radius_m}, expected 0 or more and less than "
                f"outer_radius_m ({self.outer_radius_m})"
            )


@dataclass(frozen=True)
class MaterialSpecification:
    """The gel's law: `neo_hookean` takes E and nu; the others take their constants and K.

    Attributes:
        prony_shares, prony_times_s: relaxation of the shape-changing stress, empty for none.
    """

    law: str = "neo_hookean"
    youngs_modulus_pa: float = 3.0e5
    poisson_ratio: float = 0.48
    c10_pa: float = 0.0
    c01_pa: float = 0.0
    c20_pa: float = 0.0
    c30_pa: float = 0.0
    bulk_modulus_pa: float = 0.0
    prony_shares: tuple[float, ...] = ()
    prony_times_s: tuple[float, ...] = ()
    density_kg_m3: float = 1070.0

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise ValueError(f"material.law is {self.law!r}, expected one of {LAWS}")
        _positive("material", density_kg_m3=self.density_kg_m3)


@dataclass(frozen=True)
class ContactSpecification:
    """Contact of the skin with the indenter.

    Attributes:
        friction_coefficient: mu of Coulomb's law.
        stiffness: of the contact, in units of Young's modulus over 1.2 mm; the skin's penetration
            is the pressure divided by it.
        tangential_ratio: tangential over normal stiffness while sticking.
    """

    friction_coefficient: float = 0.4
    stiffness: float = 60.0
    tangential_ratio: float = 0.5

    def __post_init__(self) -> None:
        if not 0.0 <= self.friction_coefficient <= 5.0:
            raise ValueError(
                f"contact.friction_coefficient is {self.friction_coefficient}, expected 0 to 5"
            )
        _positive("contact", stiffness=self.stiffness, tangential_ratio=self.tangential_ratio)


@dataclass(frozen=True)
class SolverSpecification:
    """Resolution and effort of the gel's solver.

    Attributes:
        method: "implicit" (equilibrium in every frame) or "explicit" (the paper's scheme).
        grid_spacing_m: spacing h of the grid.
        refined: contact acts on the skin of a grid of half the spacing (to first order).
        tolerance_m: Newton's method ends when an iteration moves no marker farther.
        iterations: most Newton iterations of a substep.
        friction_passes: how many pressures limit friction in a substep, one after the other; the
            first is extrapolated from the last substep.
        dynamic: backward Euler with inertia instead of quasi-static steps.
    """

    method: str = "implicit"
    grid_spacing_m: float = 2.4e-3
    refined: bool = True
    tolerance_m: float = 10.0e-6
    iterations: int = 15
    friction_passes: int = 5
    dynamic: bool = False

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ValueError(f"solver.method is {self.method!r}, expected one of {METHODS}")
        _positive(
            "solver",
            grid_spacing_m=self.grid_spacing_m,
            tolerance_m=self.tolerance_m,
            iterations=self.iterations,
            friction_passes=self.friction_passes,
        )


@dataclass(frozen=True)
class CameraSpecification:
    """The camera: an equidistant fisheye in the optical frame of REP 103.

    Attributes:
        position_m, quaternion_xyzw: pose of the optical frame in the base frame.
        half_height_angle_deg: angle from the axis that is seen at half the image's height.
        principal_point_px: (cx, cy).
        distortion: k1 to k4 of the equidistant model.
        idle_image: file of the image without contact, below `params/` or absolute.
        residual: folder of the network that completes the image, below `params/` or absolute;
            empty for none.
    """

    width: int = 640
    height: int = 480
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0025)
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    half_height_angle_deg: float = 86.0
    principal_point_px: tuple[float, float] = (319.5, 239.5)
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    idle_image: str = "images/densetact2_idle.png"
    residual: str = ""

    def __post_init__(self) -> None:
        _positive(
            "camera",
            width=self.width,
            height=self.height,
            half_height_angle_deg=self.half_height_angle_deg,
        )
        if len(self.distortion) != 4:
            raise ValueError(
                f"camera.distortion has {len(self.distortion)} coefficients, expected 4"
            )


@dataclass(frozen=True)
class SensorSpecification:
    """A whole sensor."""

    name: str = "densetact2"
    gel: GelSpecification = field(default_factory=GelSpecification)
    material: MaterialSpecification = field(default_factory=MaterialSpecification)
    contact: ContactSpecification = field(default_factory=ContactSpecification)
    solver: SolverSpecification = field(default_factory=SolverSpecification)
    camera: CameraSpecification = field(default_factory=CameraSpecification)


Section = TypeVar("Section")


def _section(kind: type[Section], name: str, values: Any, source: str) -> Section:
    if not isinstance(values, dict):
        raise ValueError(f"{source}: section {name!r} is no mapping of names to values")
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(values) - set(fields))
    if unknown:
        raise ValueError(
            f"{source}: section {name!r} has unknown entries {unknown}; known are {sorted(fields)}"
        )
    converted: dict[str, Any] = {}
    for key, value in values.items():
        default = fields[key].default
        try:
            if isinstance(default, tuple):
                converted[key] = tuple(float(v) for v in value)
            elif isinstance(default, bool):
                if not isinstance(value, bool):
                    raise ValueError("expected true or false")
                converted[key] = value
            elif isinstance(default, int):
                converted[key] = int(value)
            elif isinstance(default, float):
                converted[key] = float(value)
            else:
                converted[key] = str(value)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{source}: {name}.{key} is {value!r}: {error}") from error
    try:
        return kind(**converted)
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error


def sensor_path(source: str | Path) -> Path:
    """Return the file of a sensor, given itself or by the sensor's name."""
    path = Path(source)
    return path if path.suffix in (".yaml", ".yml") else parameter_path(f"sensors/{source}.yaml")


def load_sensor(source: str | Path) -> SensorSpecification:
    """Read a sensor from a YAML file, or by name from `params/sensors/`.

    Raises:
        FileNotFoundError: no such file or name.
        ValueError: an entry is unknown, of the wrong type or out of range; the message names it.
    """
    path = sensor_path(source)
    try:
        document = yaml.safe_load(path.read_text())
    except yaml.YAMLError as error:
        raise ValueError(f"{path} is not valid YAML: {error}") from error
    return sensor_from(document, str(path), name=path.stem)


def given_sensor(sensor: str | Path | SensorSpecification) -> SensorSpecification:
    """Return a specification as it is, or the one that `load_sensor` reads."""
    return sensor if isinstance(sensor, SensorSpecification) else load_sensor(sensor)


def sensor_from(document: Any, source: str, *, name: str = "") -> SensorSpecification:
    """Return the sensor of a mapping of sections as a sensor's YAML file holds them.

    Args:
        document: the mapping.
        source: where it comes from, for messages.
        name: of a sensor whose mapping gives none.

    Raises:
        ValueError: it is no mapping, or an entry is unknown, of the wrong type or out of range;
            the message names it.
    """
    if not isinstance(document, dict):
        raise ValueError(f"{source} holds no mapping; see params/sensors/densetact2.yaml")
    kinds: dict[str, type[Any]] = {
        "gel": GelSpecification,
        "material": MaterialSpecification,
        "contact": ContactSpecification,
        "solver": SolverSpecification,
        "camera": CameraSpecification,
    }
    unknown = sorted(set(document) - set(kinds) - {"name"})
    if unknown:
        raise ValueError(f"{source}: unknown sections {unknown}; known are {sorted(kinds)}")
    sections = {
        section: _section(kind, section, document.get(section) or {}, source)
        for section, kind in kinds.items()
    }
    return SensorSpecification(name=str(document.get("name", name)), **sections)


def write_sensor(path: Path, specification: SensorSpecification, comment: str) -> None:
    """Write a sensor's file, whole or not at all, and check that it loads as the same sensor.

    Args:
        path: of the file, ending in .yaml.
        specification: the sensor.
        comment: lines that say where its constants come from.

    Raises:
        ValueError: the suffix is another, or the file does not give the sensor back.
    """
    if path.suffix not in (".yaml", ".yml"):
        raise ValueError(f"{path}: a sensor's file must end in .yaml")
    document: dict[str, Any] = {"name": specification.name}
    for section in ("gel", "material", "contact", "solver", "camera"):
        document[section] = _plain(dataclasses.asdict(getattr(specification, section)))
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    with whole_file(path) as part:
        part.write_text(head + yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        if load_sensor(part) != specification:
            raise ValueError(f"{path} does not give the sensor back that was written")


def read_comment(path: Path) -> list[str]:
    """Return the lines of the comment that begins a sensor's file, without their marks."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head = itertools.takewhile(lambda line: line.startswith("#"), lines)
    return [line.removeprefix("#").removeprefix(" ") for line in head]


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: list(value) if isinstance(value, tuple) else value for name, value in values.items()
    }
