# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the pages show and order: one sensor or bag for all of them, and the newest order wins.

Threads: the subject shows moments from its own threads, the server hears orders on another one.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dotsim_ros.geometry.pose import Pose
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.documents import is_number, value_text
from dotsim_ros.io.files import expanded
from dotsim_ros.io.printable import one_line
from dotsim_ros.live.moments import Picture, Scene, SkinMoment
from dotsim_ros.live.payloads import (
    IndentationScale,
    Kind,
    history_payload,
    packed,
    picture_payload,
    scene_payload,
    skin_payload,
)
from dotsim_ros.live.playback import Playback, read_playback
from dotsim_ros.live.recorder import PressRecorder

HISTORY_COUNT = 2000
"""Forces that a page gets when it opens: some 80 s at 25 Hz."""
COUNT_EVERY_S = 0.5
"""Between two counts of the frames that are being recorded."""
BAG_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


class Subject(Protocol):
    """What the page presses: a sensor of this process, or a running node.

    Orders return at once; what comes of them is shown on the desk.
    """

    @property
    def title(self) -> str:
        """What it is, for the page; empty where the menu of sensors says it."""

    @property
    def sensors(self) -> Collection[str]:
        """Names to choose from; none where it cannot be chosen."""

    @property
    def indenters(self) -> Collection[str]:
        """Names to choose from."""

    @property
    def profiles(self) -> Mapping[str, str]:
        """Names to choose from, and what each of them is in one line."""

    def move(self, pose: Pose | None, number: int) -> None:
        """Bring the indenter to a pose in the base frame, or away, instead of whatever was ordered
        before."""

    def choose(self, what: str, name: str) -> None:
        """Press another `sensor` from now on, or with another `indenter`, from rest, or solve the
        gel in another `profile`."""

    def reset(self) -> None:
        """Take the indenter away and begin from rest."""


class LiveDesk:
    """What all pages show.

    Args:
        recordings: folder of the bags.
        publish: hears each payload that is to be shown, from any thread.
    """

    def __init__(self, recordings: Path, publish: Callable[[Kind, bytes], None]) -> None:
        self._recordings, self._publish = recordings, publish
        self._subject: Subject | None = None
        self._lock = threading.RLock()
        self._live: dict[Kind, bytes] = {}
        self._playback: Playback | None = None
        self._index = 0
        self._scene: Scene | None = None
        self._scale = IndentationScale()
        self._history: deque[tuple[float, float, float, float]] = deque(maxlen=HISTORY_COUNT)
        self._recorder: PressRecorder | None = None
        self._counted_s = 0.0
        self._state: dict[str, Any] = {
            "title": "",
            "sensors": [],
            "sensor": "",
            "indenters": [],
            "indenter": "",
            "profiles": {},
            "profile": "",
            "busy": "",
            "can_press": False,
            "notice": "",
            "notice_number": 0,
        }

    def attend(self, subject: Subject) -> None:
        """Let the pages press a subject."""
        self._subject = subject
        self.tell_state(
            title=subject.title,
            sensors=list(subject.sensors),
            indenters=list(subject.indenters),
            profiles=dict(subject.profiles),
        )

    def close(self) -> None:
        """Finish a bag that is being recorded."""
        with self._lock:
            if self._recorder is not None:
                self._finish_recording(self._recorder)

    # What the subject shows.

    def show_scene(self, scene: Scene) -> None:
        """Show a scene, and its moments from now on."""
        payload = scene_payload(scene)
        with self._lock:
            before, self._scene = self._scene, scene
            self._show_live("scene", payload)
            if before is not None and not np.array_equal(before.rest_m, scene.rest_m):
                # The forces were another sensor's.
                self._history.clear()
                if self._playback is None:
                    self._publish("history", self._shown()["history"])

    def show_skin(self, moment: SkinMoment) -> None:
        """Show the skin, and record it where a recording runs."""
        payload = skin_payload(moment)
        with self._lock:
            self._show_live("skin", payload)
            if moment.force_n is not None:
                stamp_s = 1e-9 * moment.stamp_ns
                if self._history and stamp_s < self._history[-1][0]:
                    # Time has begun again.
                    self._history.clear()
                self._history.append((stamp_s, *moment.force_n.tolist()))
            recorder = self._recorder
        if recorder is not None:
            self._record(recorder, partial(recorder.add_skin, moment))

    def show_picture(self, picture: Picture) -> None:
        """Show what the camera sees, and record it where a recording runs."""
        payload = picture_payload(picture, self._scale)
        with self._lock:
            self._show_live("picture", payload)
            recorder = self._recorder
        if recorder is not None:
            self._record(recorder, partial(recorder.add_picture, picture))

    def tell_state(self, **values: Any) -> None:
        """Show what has changed: `sensor`, `indenter`, `profile`, `profiles`, `busy` (what is
        awaited, in words), `can_press`."""
        with self._lock:
            if any(self._state[name] != value for name, value in values.items()):
                self._state.update(values)
                self._publish_state()

    def tell(self, words: object) -> None:
        """Show what went wrong."""
        with self._lock:
            self._state["notice"] = one_line(words)
            self._state["notice_number"] += 1
            self._publish_state()

    # What the pages see and order.

    def greeting(self) -> list[tuple[Kind, bytes]]:
        """Return what a page needs that has just opened."""
        with self._lock:
            shown = self._shown()
            order = ("scene", "state", "history", "skin", "picture")
            return [(kind, shown[kind]) for kind in order if kind in shown]

    def hear(self, text: str | bytes) -> None:
        """Do what a page orders; what is wrong with an order is shown.

        Args:
            text: a mapping in JSON; `do` names the order.
        """
        try:
            order = json.loads(text)
            name = order.get("do") if isinstance(order, dict) else None
            if not isinstance(name, str) or name not in self._orders:
                raise ValueError(
                    f"the order is {value_text(order)}, expected a mapping with 'do', one of "
                    f"{', '.join(self._orders)}"
                )
            self._orders[name](self, order)
        except (ValueError, OSError, RuntimeError) as error:
            self.tell(error)

    def _pose(self, order: Mapping[str, Any]) -> None:
        position = _numbers(order, "position_m", 3)
        quaternion = _numbers(order, "quaternion_xyzw", 4)
        self._go_live()
        self._pressed().move(Pose(position, quaternion), _number(order))

    def _away(self, order: Mapping[str, Any]) -> None:
        self._go_live()
        self._pressed().move(None, _number(order))

    def _reset(self, _order: Mapping[str, Any]) -> None:
        self._go_live()
        self._pressed().reset()

    def _choose(self, order: Mapping[str, Any]) -> None:
        self._go_live()
        subject, what, name = self._pressed(), str(order["do"]), order.get("name")
        if what != "profile" and self._recorder is not None:
            raise ValueError(f"a bag has one {what}: save the recording first")
        known: Collection[str] = getattr(subject, f"{what}s")
        if name not in known:
            raise ValueError(
                f"{what} is {value_text(name)}, expected one of {', '.join(known) or 'none'}"
            )
        subject.choose(what, str(name))

    def _record_order(self, order: Mapping[str, Any]) -> None:
        name = order.get("name")
        if not isinstance(name, str) or not BAG_NAME.fullmatch(name):
            raise ValueError(
                f"the bag's name is {value_text(name)}, expected at most 100 letters, digits, "
                "dots, dashes and underscores"
            )
        with self._lock:
            if self._recorder is not None:
                raise ValueError(f"{self._recorder.path.name} is being recorded; stop it first")
            if self._scene is None:
                raise ValueError("there is no skin yet to record; wait for the first frame")
            self._go_live()
            self._recorder = PressRecorder(
                self._recordings / name, self._scene.rest_m, self._state["indenter"]
            )
            self._publish_state()

    def _stop(self, _order: Mapping[str, Any]) -> None:
        with self._lock:
            if self._recorder is None:
                raise ValueError("nothing is being recorded")
            self._finish_recording(self._recorder)

    def _load(self, order: Mapping[str, Any]) -> None:
        given = order.get("path")
        if not isinstance(given, str) or not given or "\0" in given:
            raise ValueError(f"the bag is {value_text(given)}, expected a name or a path")
        # Relative to the recordings; an absolute path stays itself.
        path = self._recordings / expanded(given)
        # A bag takes seconds to read, and other pages go on meanwhile.
        threading.Thread(target=self._read, args=(path,), name="bag", daemon=True).start()

    def _scrub(self, order: Mapping[str, Any]) -> None:
        index = order.get("index")
        with self._lock:
            if self._playback is None:
                raise ValueError("no bag is shown; load one first")
            count = len(self._playback.stamp_ns)
            if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < count:
                raise ValueError(
                    f"the moment is {value_text(index)}, expected a whole number from 0 to "
                    f"{count - 1}"
                )
            self._index = index
            shown = self._shown()
            for kind in ("skin", "picture", "state"):
                if kind in shown:
                    self._publish(kind, shown[kind])

    def _live_order(self, _order: Mapping[str, Any]) -> None:
        self._go_live()

    _orders: Mapping[str, Callable[[LiveDesk, Mapping[str, Any]], None]] = {
        "pose": _pose,
        "away": _away,
        "reset": _reset,
        "sensor": _choose,
        "indenter": _choose,
        "profile": _choose,
        "record": _record_order,
        "stop": _stop,
        "load": _load,
        "scrub": _scrub,
        "live": _live_order,
    }

    def _pressed(self) -> Subject:
        if self._subject is None or not self._state["can_press"]:
            raise ValueError("the sensor is not ready yet: " + (self._state["busy"] or "wait"))
        return self._subject

    def _go_live(self) -> None:
        """Leave the bag, where one is shown."""
        with self._lock:
            if self._playback is None:
                return
            self._playback = None
            self._publish_all()

    def _read(self, path: Path) -> None:
        with self._lock:
            before = self._state["busy"]
        self.tell_state(busy=f"reading {path.name}")
        try:
            playback = read_playback(path)
        except (ValueError, OSError) as error:
            self.tell(error)
        else:
            with self._lock:
                self._playback, self._index = playback, 0
                self._publish_all()
        finally:
            self.tell_state(busy=before)

    def _record(self, recorder: PressRecorder, add: Callable[[], None]) -> None:
        try:
            add()
        except (ValueError, OSError) as error:
            with self._lock:
                self._recorder = None
            self.tell(f"{recorder.path.name} is recorded no further: {error}")
            return
        now_s = time.monotonic()
        with self._lock:
            if now_s - self._counted_s > COUNT_EVERY_S:
                self._counted_s = now_s
                self._publish_state()

    def _finish_recording(self, recorder: PressRecorder) -> None:
        self._recorder = None
        try:
            path = recorder.finish()
        except OSError as error:
            self.tell(f"{recorder.path.name} could not be finished: {error}")
            return
        if path is None:
            self.tell("nothing moved while it was recorded: no bag is left")
            return
        self.tell(f"saved {path}, {recorder.frame_count} frames")

    # Payloads; the lock is held.

    def _show_live(self, kind: Kind, payload: bytes) -> None:
        self._live[kind] = payload
        if self._playback is None:
            self._publish(kind, payload)

    def _publish_state(self) -> None:
        self._publish("state", self._state_payload())

    def _publish_all(self) -> None:
        shown = self._shown()
        for kind in ("scene", "history", "state", "skin", "picture"):
            if kind in shown:
                self._publish(kind, shown[kind])

    def _shown(self) -> dict[Kind, bytes]:
        """Return the payload of each kind that a page shows at the moment."""
        playback = self._playback
        if playback is None:
            past = np.array(self._history, dtype=np.float64).reshape(-1, 4)
            history = history_payload(past[:, 0], past[:, 1:])
            return {"state": self._state_payload(), "history": history, **self._live}
        there = {
            "state": self._state_payload(),
            "scene": playback.scene,
            "history": playback.history,
            "skin": playback.skins[self._index],
            "picture": playback.pictures[self._index],
        }
        return {kind: payload for kind, payload in there.items() if payload is not None}

    def _state_payload(self) -> bytes:
        playback, recorder = self._playback, self._recorder
        bag: dict[str, Any] | None = None
        if playback is not None:
            start_ns, end_ns = int(playback.stamp_ns[0]), int(playback.stamp_ns[-1])
            bag = {
                "name": playback.name,
                "count": len(playback.stamp_ns),
                "index": self._index,
                "time_s": 1e-9 * (int(playback.stamp_ns[self._index]) - start_ns),
                "duration_s": 1e-9 * (end_ns - start_ns),
            }
        recording = None
        if recorder is not None:
            recording = {"name": recorder.path.name, "frames": recorder.frame_count}
        state = {**self._state, "bag": bag, "recording": recording, "bags": self._bags()}
        return packed("state", state)

    def _bags(self) -> list[str]:
        """Return the names of the bags that were recorded, the newest first."""
        try:
            found = [path.parent for path in self._recordings.glob("*/metadata.yaml")]
            return [path.name for path in sorted(found, key=_changed_s, reverse=True)]
        except OSError:
            return []


def _changed_s(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def _numbers(order: Mapping[str, Any], name: str, count: int) -> FloatArray:
    """Return finite numbers of an order.

    Raises:
        ValueError: they are none.
    """
    given = order.get(name)
    is_valid = isinstance(given, list) and len(given) == count
    if not is_valid or not all(is_number(value) for value in given or ()):
        raise ValueError(f"{name} is {value_text(given)}, expected {count} finite numbers")
    return np.array(given, dtype=np.float64)


def _number(order: Mapping[str, Any]) -> int:
    given = order.get("number", 0)
    if not isinstance(given, int) or isinstance(given, bool) or not 0 <= given < 2**53:
        raise ValueError(f"number is {value_text(given)}, expected a whole number")
    return given
