# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The card of a folder of demonstrations: of what plan, which sensor and which ball they are.

Names do not tell sensors apart: a user's file may have that of a shipped one, or may have changed
since. So the card holds what the contact's geometry needs, and a key of all that the sensor and
the ball are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from dotsim_ros.control.policy.paths import DomeContact
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.io.cache import content_key
from dotsim_ros.io.documents import is_number, read_json, value_text
from dotsim_ros.io.files import given_path, write_json
from dotsim_ros.optics.idle import description_of
from dotsim_ros.specification import SensorSpecification

CARD = "demonstrations.json"
PLAN, CONTACT, CONTENT = "plan", "contact", "content"
"""Entries of the card: the plan, the fields of `DomeContact`, and `content_of` sensor and ball."""


def content_of(sensor: SensorSpecification, indenter: Indenter) -> str:
    """Return a key of all that decides what a sensor shows of an indenter; where its image lies
    does not count.

    Raises:
        FileNotFoundError: the sensor names an image that is not there.
    """
    described = asdict(sensor)
    image = described["camera"].pop("idle_image")
    # Looks have lights and coats of their own, which no network completes.
    described["camera"].pop("residual")
    files = [given_path(image), description_of(sensor)] if image else []
    return content_key((), described, indenter, [file.read_bytes() for file in files if file])


def keep_card(folder: Path, card: Mapping[str, Any]) -> None:
    """Write the card of a folder, or see that the one that is there is of the same demonstrations.

    Raises:
        ValueError: it is of another plan, sensor or indenter, or none that `read_card` takes.
    """
    if not (folder / CARD).is_file():
        write_json(folder / CARD, card)
        return
    known = read_card(folder)
    if known[PLAN] != card[PLAN]:
        raise ValueError(
            f"{folder} holds demonstrations of another plan; choose another folder, or remove it "
            "to make them again"
        )
    if known[CONTENT] != card[CONTENT]:
        raise ValueError(
            f"{folder} holds demonstrations of another sensor or indenter than the present "
            f"{value_text(card[PLAN]['sensor'])} and {value_text(card[PLAN]['indenter'])}, whose "
            "names are the same; give another folder with --out, or remove it to make them again"
        )


def read_card(folder: Path) -> dict[str, Any]:
    """Return the card of a folder of demonstrations.

    Raises:
        ValueError: it holds none, or one of a version that did not note sensor and indenter.
    """
    try:
        card = read_json(folder / CARD)
        if not isinstance(card, dict) or PLAN not in card:
            raise ValueError("no plan in it")
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{folder} holds no demonstrations ({error}); make some with dotsim_ros demonstrate "
            f"--out {folder}"
        ) from error
    for entry in (CONTACT, CONTENT):
        if entry not in card:
            raise ValueError(
                f"{folder / CARD} has no {entry}: it is of an earlier version, which did not note "
                "the sensor and the ball, so that neither can be told; make the demonstrations "
                "again in another folder with dotsim_ros demonstrate"
            )
    return card


def contact_in(folder: Path) -> DomeContact:
    """Return how ball and dome of a folder's demonstrations touched.

    Raises:
        ValueError: as `read_card`, or its contact is none.
    """
    given = read_card(folder)[CONTACT]
    names = [field.name for field in fields(DomeContact)]
    if (
        not isinstance(given, dict)
        or sorted(given) != sorted(names)
        or not all(is_number(value) and value > 0.0 for value in given.values())
    ):
        raise ValueError(
            f"{folder / CARD}: {CONTACT} is {value_text(given)}, expected {' and '.join(names)} in "
            "metres; make the demonstrations again with dotsim_ros demonstrate"
        )
    return DomeContact(**given)
