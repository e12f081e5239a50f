# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The idle image that belongs to a calibrated sensor's file, with its description next to it."""

from __future__ import annotations

import copy
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dotsim_ros.io.documents import read_yaml
from dotsim_ros.io.files import given_path, parameter_path, whole_file, write_text
from dotsim_ros.optics.idle import description_of, fine_path, stated_lights
from dotsim_ros.specification import SensorSpecification, read_comment


@dataclass(frozen=True)
class DescribedImage:
    """An idle image whose description comes before the lights of the sensor's file.

    Attributes:
        image: its file.
        comment: lines that begin the description.
        document: the description's sections.
        height_m: of the lights, over the base plane.
    """

    image: Path
    comment: tuple[str, ...]
    document: dict[str, Any]
    height_m: float

    def lowered(self, drop_m: float) -> dict[str, Any]:
        """Return the sections with the lights lower by a length, to the nanometre."""
        document = copy.deepcopy(self.document)
        lighting = document.get("lighting") or {}
        document["lighting"] = {**lighting, "height_m": round(self.height_m - drop_m, 9)}
        return document


def described_image(sensor: SensorSpecification) -> DescribedImage | None:
    """Return a sensor's idle image with its description; None where nothing describes it.

    Raises:
        FileNotFoundError: the sensor names an image that is not there.
        ValueError: the file next to the image describes none.
    """
    description = description_of(sensor)
    if description is None:
        return None
    lights, _ = stated_lights(sensor)
    return DescribedImage(
        given_path(sensor.camera.idle_image),
        tuple(read_comment(description)),
        read_yaml(description) or {},
        lights.height_m,
    )


def idle_image_of(out: Path, ending: str = ".png") -> tuple[Path, str]:
    """Return the file of the idle image of a sensor's file, and how the sensor names it.

    It lies next to the sensor's file, or below `params/images` for one in `params/sensors`.
    """
    out = out.resolve()
    file = f"{out.stem}_idle{ending}"
    parameters = parameter_path("sensors").resolve().parent
    if out.parent == parameters / "sensors":
        return parameters / "images" / file, f"images/{file}"
    return out.with_name(file), str(out.with_name(file))


def write_description(image: Path, sections: dict[str, Any], comment: str) -> None:
    """Write what describes an idle image next to it, whole or not at all; the comment says where it
    comes from."""
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    write_text(image.with_suffix(".yaml"), head + yaml.safe_dump(sections, sort_keys=False))


def write_lowered_copy(described: DescribedImage, drop_m: float, out: Path) -> str:
    """Copy an idle image to where that of a sensor's file, `out`, lies, with its lights lower;
    return how the sensor names the copy.

    What is copied stays as it is, for the sensor before: also one that is about to be replaced,
    since whatever interrupts that leaves a sensor that is lit as it was.

    Raises:
        OSError: it cannot be written.
    """
    suffix = described.image.suffix
    image, name = idle_image_of(out, suffix)
    if image == described.image.resolve():
        image, name = idle_image_of(out, f"_moved{suffix}")
    _copy(described.image, image)
    fine = fine_path(described.image)
    if fine.exists():
        _copy(fine, fine_path(image))
    else:
        # Samples that are left of another image would be refused next to this one.
        fine_path(image).unlink(missing_ok=True)
    way = "lower" if drop_m > 0.0 else "higher"
    remark = (
        f"The lights {1e3 * abs(drop_m):.3g} mm {way} than in {described.image.name}, with the "
        "face of the pad, by dotsim_ros calibrate"
    )
    write_description(image, described.lowered(drop_m), "\n".join([*described.comment, remark]))
    return name


def _copy(source: Path, target: Path) -> None:
    with whole_file(target) as part:
        shutil.copyfile(source, part)
