# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Demonstrations: an expert moves a sensor against a ball; the sensor's images and its commands.

An episode is one motion on one gel, seen by several looks. Half of the episodes
follow a path by the expert with errors injected, so that the labels show the way back (Laskey et
al., "DART: noise injection for robust imitation learning", CoRL 2017). The others wander between
places near the paths at any speed: without them the drag of the skin would show which way the
expert went, and a policy would only learn to continue in that direction.

Where a plan names a policy, that policy drives the episodes on paths, through an arm with delays,
and the expert only labels what it should have done (Ross et al., "A reduction of imitation learning
and structured prediction to no-regret online learning", AISTATS 2011).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dotsim_ros.control.policy.images import PolicyView, fingerprint
from dotsim_ros.control.policy.looks import Look, LookRanges
from dotsim_ros.control.policy.network import load_policy
from dotsim_ros.control.policy.paths import DomeContact, Expert, ReferencePath, reference_path
from dotsim_ros.control.policy.rollout import follow
from dotsim_ros.geometry.indenter import Indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray, ImageArray
from dotsim_ros.io.cache import content_key
from dotsim_ros.io.documents import is_number, read_arrays, read_json, value_text
from dotsim_ros.io.files import given_path, whole_file, write_json
from dotsim_ros.io.provenance import provenance
from dotsim_ros.io.worker_pool.pool import Crew, open_pool
from dotsim_ros.optics.idle import description_of
from dotsim_ros.sensor import GelFailureError, TactileSensor
from dotsim_ros.specification import SensorSpecification

WANDER = "wander"
RATE_HZ = 25.0
LARGEST_TILT_RAD = 0.47
DEPTHS_M = (-0.2e-3, 2.5e-3)
"""Where the expert's errors may take the ball."""
STORED_SIDE_PX = 128
"""Finer than a network sees, so that one set of demonstrations serves networks of several sizes."""
FRICTION_FACTORS = (1.0, 0.6, 1.4)
"""Number of gels, which episodes use in turn. Young's modulus does not vary: the shape of a gel
that a rigid body presses slowly does not depend on it."""
CARD = "demonstrations.json"
PLAN, CONTACT, CONTENT = "plan", "contact", "content"
"""Entries of the card: the plan, the fields of `DomeContact`, and `content_of` sensor and ball.
Names do not tell sensors apart: a user's file may have that of a shipped one."""


@dataclass(frozen=True)
class Plan:
    """What to demonstrate: motions, each seen in `frame_count` images by each of several looks.

    `wander_share` of the motions follow no path. `policy` is the folder of the policy that drives
    in the expert's place, empty for none.
    """

    sensor: str
    paths: tuple[str, ...]
    episode_count: int = 24
    frame_count: int = 250
    look_count: int = 2
    wander_share: float = 0.5
    seed: int = 0
    policy: str = ""
    looks: LookRanges = field(default_factory=LookRanges)

    def __post_init__(self) -> None:
        if not self.paths:
            raise ValueError("no path is named, expected at least one")
        if self.episode_count < 1 or self.frame_count < 10 or self.look_count < 1:
            raise ValueError(
                f"{self.episode_count} episodes of {self.frame_count} frames and {self.look_count} "
                "looks: expected at least 1, 10 and 1"
            )
        if not 0.0 <= self.wander_share <= 1.0:
            raise ValueError(f"wander_share is {self.wander_share}, expected 0 to 1")


@dataclass(frozen=True)
class Episode:
    """What was seen of one motion.

    Attributes:
        crop: (L, F, side, side, 3) uint8 middles of the images of each look.
        idle: (L, side, side, 3) uint8 the same without contact.
        fingerprint: (L, F, 96) of the whole images.
        position_m: (F, 3) places of the indenter in the sensor's frame.
        command: (F, P, 6) the expert's command for each path.
        paths: (P,) their names.
    """

    crop: NDArray[np.uint8]
    idle: NDArray[np.uint8]
    fingerprint: NDArray[np.float32]
    position_m: FloatArray
    command: FloatArray
    paths: tuple[str, ...]


def within_bounds(position_m: FloatArray, contact: DomeContact) -> FloatArray:
    """Return the place (3,) where the ball may be that is nearest to a place (3,)."""
    tilt, depth = contact.tilt_and_depth(position_m)
    angle = float(np.linalg.norm(tilt))
    tilt = tilt * min(1.0, LARGEST_TILT_RAD / max(angle, 1e-9))
    return contact.position_m(tilt, np.clip(depth, *DEPTHS_M))


def perturbed(
    path: ReferencePath, contact: DomeContact, frame_count: int, random: np.random.Generator
) -> FloatArray:
    """Return places (F, 3) of an expert on a path, with smooth errors of its velocity and pushes
    of up to a millimetre."""
    expert, dt_s = Expert(path), 1.0 / RATE_HZ
    here = path.position_m[random.integers(len(path.position_m))]
    here = here + 0.7e-3 * random.standard_normal(3)
    error, push, push_left = np.zeros(3), np.zeros(3), 0
    places = np.empty((frame_count, 3))
    for frame in range(frame_count):
        here = within_bounds(here, contact)
        places[frame] = here
        # An Ornstein-Uhlenbeck process: 0.3 s long, 1.5 mm/s.
        error = error + dt_s / 0.3 * -error
        error = error + 1.5e-3 * np.sqrt(2.0 * dt_s / 0.3) * random.standard_normal(3)
        if push_left == 0 and random.uniform() < dt_s / 2.0:
            push, push_left = random.standard_normal(3), 5
            push *= random.uniform(2e-3, 6e-3) / np.linalg.norm(push)
        velocity = expert.relative_velocity_m_s(here) + error + (push if push_left else 0.0)
        push_left = max(0, push_left - 1)
        here = here + dt_s * velocity
    return places


def wandering(
    paths: Sequence[ReferencePath],
    contact: DomeContact,
    frame_count: int,
    random: np.random.Generator,
) -> FloatArray:
    """Return places (F, 3) of a motion from one place near a path to another, straight in tilt and
    depth, at any speed up to 9 mm/s."""
    dt_s = 1.0 / RATE_HZ

    def draw() -> tuple[FloatArray, FloatArray]:
        if random.uniform() < 0.5:
            path = paths[int(random.integers(len(paths)))]
            place = path.position_m[int(random.integers(len(path.position_m)))]
            place = within_bounds(place + 0.6e-3 * random.standard_normal(3), contact)
            return contact.tilt_and_depth(place)
        angle = random.uniform(0.0, 2.0 * np.pi)
        tilt = (
            LARGEST_TILT_RAD * np.sqrt(random.uniform()) * np.array([np.cos(angle), np.sin(angle)])
        )
        return tilt, np.asarray(random.uniform(0.3e-3, DEPTHS_M[1]))

    places: list[FloatArray] = []
    start = draw()
    while len(places) < frame_count:
        # Near ends are drawn more often than far ones: short ways cover the depths better.
        end = min(
            (draw() for _ in range(3)), key=lambda end: float(np.linalg.norm(end[0] - start[0]))
        )
        way = np.linalg.norm(contact.position_m(*end) - contact.position_m(*start))
        steps = max(2, int(way / (random.uniform(2e-3, 9e-3) * dt_s)))
        share = np.linspace(0.0, 1.0, steps, endpoint=False)
        tilt = start[0] + share[:, None] * (end[0] - start[0])
        depth = start[1] + share * (end[1] - start[1])
        places.extend(contact.position_m(tilt, depth))
        start = end
    return np.array(places[:frame_count])


def motion_of(plan: Plan, number: int, contact: DomeContact) -> tuple[str, FloatArray]:
    """Return the kind of an episode, WANDER or the name of a path, and its places (F, 3)."""
    random = np.random.default_rng([plan.seed, number, 1])
    paths = [reference_path(name, contact) for name in plan.paths]
    wanders = int((number + 1) * plan.wander_share) > int(number * plan.wander_share)
    if wanders:
        return WANDER, wandering(paths, contact, plan.frame_count, random)
    path = paths[(number - int(number * plan.wander_share)) % len(paths)]
    return path.name, perturbed(path, contact, plan.frame_count, random)


def contact_of(sensor: SensorSpecification, indenter: Indenter) -> DomeContact:
    """Return how an indenter touches a sensor.

    Raises:
        ValueError: the sensor is no dome, or the indenter no ball.
    """
    if sensor.gel.shape != "dome":
        raise ValueError(
            f"the sensor {sensor.name!r} has the shape {sensor.gel.shape}; paths are for a dome"
        )
    if indenter.kind.name != "SPHERE":
        raise ValueError(
            f"the indenter {indenter.name!r} is a {indenter.kind.name.lower()}; paths are for a "
            "ball, such as sphere_4mm"
        )
    return DomeContact(sensor.gel.outer_radius_m, indenter.parameters[0])


def approach(position_m: FloatArray, contact: DomeContact) -> FloatArray:
    """Return places (A, 3) from just above the skin to a place, 0.15 mm apart."""
    tilt, depth = contact.tilt_and_depth(position_m)
    steps = max(2, int((float(depth) + 0.3e-3) / 0.15e-3))
    depths = np.linspace(-0.3e-3, float(depth), steps, endpoint=False)
    return contact.position_m(np.broadcast_to(tilt, (steps, 2)), depths)


def labels(paths: Sequence[str], contact: DomeContact, position_m: FloatArray) -> FloatArray:
    """Return the expert's commands (F, P, 6) at places (F, 3), for each path."""
    experts = [Expert(reference_path(name, contact)) for name in paths]
    return np.stack([expert.command(position_m) for expert in experts], axis=1)


def view_of(sensor: SensorSpecification) -> PolicyView:
    """Return what is kept of a sensor's images."""
    return PolicyView((sensor.camera.height, sensor.camera.width), side_px=STORED_SIDE_PX)


class Demonstrator:
    """Makes the episodes of a plan; errors as of `contact_of`."""

    def __init__(self, sensor: SensorSpecification, indenter: Indenter, plan: Plan) -> None:
        self._sensor, self._indenter, self.plan = sensor, indenter, plan
        self.contact = contact_of(sensor, indenter)
        self.view = view_of(sensor)
        self._gels: dict[float, TactileSensor] = {}

    def _gel(self, number: int) -> TactileSensor:
        factor = FRICTION_FACTORS[number % len(FRICTION_FACTORS)]
        if factor not in self._gels:
            friction = factor * self._sensor.contact.friction_coefficient
            varied = replace(
                self._sensor,
                contact=replace(self._sensor.contact, friction_coefficient=friction),
            )
            self._gels[factor] = TactileSensor(varied, indenter=self._indenter)
        return self._gels[factor]

    def episode(self, number: int) -> Episode:
        """Return an episode; it ends early where the gel could not be solved.

        Raises:
            GelFailureError: it could not be solved for a single frame.
            ValueError: the plan's policy does not follow the episode's path.
        """
        random = np.random.default_rng([self.plan.seed, number, 2])
        gel = self._gel(number)
        looks = [
            Look(self._sensor, gel.skin, self.plan.looks, random)
            for _ in range(self.plan.look_count)
        ]
        kind, places = motion_of(self.plan, number, self.contact)
        gel.reset()
        for place in approach(places[0], self.contact):
            gel.press(Pose(place), 1.0 / RATE_HZ)
        crops: list[list[ImageArray]] = [[] for _ in looks]
        fingerprints: list[list[NDArray[np.float32]]] = [[] for _ in looks]
        seen_m: list[FloatArray] = []

        def press(pose: Pose) -> ImageArray:
            """Press the gel, keep what each look sees of it, and return the first one's image."""
            skin = gel.press(pose, 1.0 / RATE_HZ).skin_position_m
            images = [look.image(skin) for look in looks]
            for row, (look, image) in enumerate(zip(looks, images, strict=True)):
                crops[row].append(self.view.crop(image))
                fingerprints[row].append(fingerprint(image, look.idle))
            seen_m.append(pose.position_m)
            return images[0]

        if self.plan.policy and kind != WANDER:
            policy = load_policy(Path(self.plan.policy), kind)
            start, count = Pose(places[0]), len(places)
            follow(policy, press, looks[0].idle, start, frame_count=count, rate_hz=RATE_HZ)
        else:
            with suppress(GelFailureError):
                for place in places:
                    press(Pose(place))
        if not seen_m:
            raise GelFailureError(f"the gel could not be solved for the start of episode {number}")
        position = np.reshape(seen_m, (-1, 3))
        return Episode(
            np.array(crops, dtype=np.uint8),
            np.array([self.view.crop(look.idle) for look in looks]),
            np.array(fingerprints, dtype=np.float32),
            position,
            labels(self.plan.paths, self.contact, position),
            self.plan.paths,
        )


def episode_file(folder: Path, number: int) -> Path:
    """Return the file of an episode."""
    return folder / f"episode_{number:04d}.npz"


def write_episode(path: Path, episode: Episode) -> None:
    """Write an episode, whole or not at all."""
    arrays: dict[str, Any] = asdict(episode)
    with whole_file(path) as part:
        np.savez(part, **arrays)


def read_episode(path: Path) -> Episode:
    """Read an episode.

    Raises:
        ValueError: the file holds none.
    """
    try:
        arrays: dict[str, Any] = dict(read_arrays(path))
        arrays["paths"] = tuple(str(name) for name in arrays["paths"])
        return Episode(**arrays)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} holds no demonstration ({error}); remove it and make it again with dotsim_ros "
            "demonstrate"
        ) from error


def content_of(sensor: SensorSpecification, indenter: Indenter) -> str:
    """Return a key of all that decides what a sensor shows of an indenter: the place of its image
    does not.

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


def demonstrate(
    sensor: SensorSpecification,
    indenter: Indenter,
    plan: Plan,
    folder: Path,
    *,
    progress: Callable[[int, int], None],
    workers: Crew = 1,
) -> int:
    """Make the episodes of a plan that a folder does not hold yet; return how many frames of all
    looks there are.

    It starts processes, so a script calls it below `if __name__ == "__main__":`.

    Args:
        progress: called with the number of episodes done, and of all.
        workers: how many processes, or workers of Ray, each of which makes an episode.

    Raises:
        ValueError: as `contact_of`, or the folder holds demonstrations of another plan, sensor or
            indenter, as `keep_card` tells.
    """
    contact = contact_of(sensor, indenter)
    described = {**json.loads(json.dumps(asdict(plan))), "indenter": indenter.name}
    keep_card(
        folder,
        {
            PLAN: described,
            CONTACT: asdict(contact),
            CONTENT: content_of(sensor, indenter),
            "rate_hz": RATE_HZ,
            "view": asdict(view_of(sensor)),
            "friction_factors": list(FRICTION_FACTORS),
            "origin": provenance(),
        },
    )
    numbers = range(plan.episode_count)
    missing = [number for number in numbers if not episode_file(folder, number).is_file()]
    done = plan.episode_count - len(missing)
    if done:
        progress(done, plan.episode_count)
    reads = (Path(plan.policy),) if plan.policy else ()
    with open_pool(workers, _begin, sensor, indenter, plan, reads=reads) as pool:
        making = {pool.submit(_make, number): number for number in missing}
        for made in as_completed(making):
            # The future would hold the images of its episode until the end.
            write_episode(episode_file(folder, making.pop(made)), made.result())
            done += 1
            progress(done, plan.episode_count)
    return sum(
        int(np.prod(read_episode(episode_file(folder, number)).crop.shape[:2]))
        for number in numbers
    )


_demonstrator: Demonstrator | None = None


def _begin(sensor: SensorSpecification, indenter: Indenter, plan: Plan) -> None:
    global _demonstrator
    _demonstrator = Demonstrator(sensor, indenter, plan)


def _make(number: int) -> Episode:
    assert _demonstrator is not None
    return _demonstrator.episode(number)
