# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Faults injected into the running closed loop, and how long the arm continues to move.

`tactile_sim`, `tactile_policy` and `xarm_sim` run as processes; the faults take turns and come at
random moments while the arm moves:

- images cut: the sensor is disabled, so that no frames come;
- poses cut: the arm's feedback is dropped;
- sensor killed: SIGKILL; it is started again afterwards;
- wrong sensor: frames of another sensor take the place of this one's;
- clock jump: poses stamped a second ahead, or a second back, come on the arm's topic;
- policy overloaded: each inference takes 0.3 s of processor time from one moment on.

Counted is the time until the first command of zero that is followed by no other, by the times at
which the middleware sent the messages. It begins where a stream falls silent with its last message
(bound: 80 ms); where something wrong comes, with the first wrong message (80 ms); for the overload
with its onset, when the next image may be a frame away (80 ms and a frame: 120 ms). The second time
is until the arm stands, slower than 0.1 mm/s.
"""

from __future__ import annotations

import itertools
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any

import cv2
import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import Image
from std_srvs.srv import SetBool

import msg_adapters
from dotsim_ros.control.loop.judge import trial_start
from dotsim_ros.control.policy.network import read_policy
from dotsim_ros.control.policy.paths import PATHS, reference_path
from dotsim_ros.io.files import given_path
from dotsim_ros.nodes.common.transport import stay_local
from dotsim_ros.nodes.loop.closed_loop import SENSOR, ClosedLoop, LoopSetup, policy_name
from dotsim_ros.nodes.loop.observer import LOOP_TOPICS
from dotsim_ros.nodes.tactile_policy.files import policy_folder, read_image
from dotsim_ros.specification import load_sensor
from studies.run import FAILED, expect_known, expect_positive

BOUND_MS, FRAME_MS = 80.0, 40.0
WATCH_S = 0.6
STILL_M_S = 1e-4
JUMP_NS = 1_000_000_000
MOVING_COMMANDS = 5
BEGINNINGS = 5
LEASE_S = 60.0
"""A participant that was killed is forgotten after 20 s (Fast DDS's default lease)."""
PATIENCE_S = 10.0
TOUCHED_N = 0.05
SENSOR_PERIOD_S, ARM_PERIOD_S = 0.04, 0.01
TOPICS = {**LOOP_TOPICS, "indenter/pose": PoseStamped}

OVERLOADED_POLICY = """
import os, sys, time
import numpy as np
from dotsim_ros.nodes.tactile_policy import node as tactile_policy
from dotsim_ros.nodes.common.spin import run_node
from dotsim_ros.control.policy.network import load_policy

def load(folder, path):
    policy = load_policy(folder, path)
    kind = type(policy)

    class Overloaded(kind):
        def __call__(self, image, idle):
            begun = time.monotonic()
            # As a network that is too large would: work that lets the other threads run.
            work = np.ones((300, 300), dtype=np.float32)
            while os.path.exists({flag!r}) and time.monotonic() - begun < 0.3:
                work @ work
            return super().__call__(image, idle)

    policy.__class__ = Overloaded
    return policy

sys.setswitchinterval(tactile_policy.SWITCH_INTERVAL_S)
raise SystemExit(run_node(lambda: tactile_policy.TactilePolicy(load)))
"""


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes:
        inject: makes it; returns when it began (ns of the system's clock), or the topic that falls
            silent by it.
        mend: ends it.
        bound_ms: until the command must be zero.
    """

    inject: Callable[[], int | str]
    mend: Callable[[], None]
    bound_ms: float = BOUND_MS


class Intruder:
    """Somebody else who publishes on the loop's topics for a while.

    Args:
        loop: whose topics.
        period_s: between messages.
        messages: makes those of one moment, by topic.
    """

    def __init__(
        self,
        loop: ClosedLoop,
        period_s: float,
        kinds: Mapping[str, type],
        messages: Callable[[], Mapping[str, Any]],
    ) -> None:
        self._node = loop.observer.node
        self._publishers = {
            name: self._node.create_publisher(k, name, 5) for name, k in kinds.items()
        }
        self._period_s, self._messages = period_s, messages
        self._stop = Event()
        self._thread = Thread(target=self._run, daemon=True)
        loop.observer.wait(
            lambda: all(each.get_subscription_count() for each in self._publishers.values()),
            "a reader of the intruder's messages",
        )
        # What the reader knows of its publishers comes on its own way.
        time.sleep(0.2)
        self.begun_ns = 0

    def begin(self) -> int:
        """Publish from now on; return when the first message went out."""
        self._publish()
        self._thread.start()
        return self.begun_ns

    def _publish(self) -> None:
        messages = self._messages()
        self.begun_ns = self.begun_ns or time.time_ns()
        for name, message in messages.items():
            self._publishers[name].publish(message)

    def _run(self) -> None:
        while not self._stop.wait(self._period_s):
            self._publish()

    def end(self) -> None:
        """Leave."""
        self._stop.set()
        self._thread.join()
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)


class Bench:
    """The loop, and the faults that can be injected into it.

    Args:
        loop: the nodes.
        path: that is followed.
        flag: file whose presence overloads the policy.
        random: of the moments.
    """

    def __init__(
        self, loop: ClosedLoop, path: str, flag: Path, random: np.random.Generator
    ) -> None:
        self.loop, self._flag, self._random = loop, flag, random
        self._path = reference_path(path, loop.contact)
        self._intruder: Intruder | None = None
        self._killed: set[bytes] = set()
        self._starts = 0
        self._sides = itertools.cycle((1, -1))
        other = load_sensor("sensor_a").camera
        own = load_sensor(loop.setup.sensor).camera
        image = read_image(given_path(other.idle_image))
        self._wrong = np.asarray(cv2.resize(image, (own.width, own.height)), dtype=np.uint8)
        self.faults: dict[str, Fault] = {
            "images cut": Fault(self._cut_images, lambda: self._set_sensor(True)),
            "poses cut": Fault(self._cut_poses, lambda: loop.set_arm(fail_drop_feedback=False)),
            "sensor killed": Fault(self._kill_sensor, self._restart_sensor),
            "wrong sensor": Fault(self._wrong_sensor, self._right_sensor),
            "clock jump": Fault(self._jump, self._end_intruder),
            "policy overloaded": Fault(self._overload, self._relieve, BOUND_MS + FRAME_MS),
        }

    def begin(self) -> None:
        """Bring sensor and indenter together."""
        self.loop.rest()
        start_m = trial_start(self._path, self.loop.contact, seed=0, number=self._starts)
        self._starts += 1
        self.loop.touch(start_m)

    def move(self) -> None:
        """Wait until the arm moves; begin again where the contact was lost or the loop latched.

        Raises:
            OSError: it does not move, however often it is begun again.
        """
        self.loop.disable()
        is_touched = self._force_n() >= TOUCHED_N
        for _ in range(BEGINNINGS):
            if not is_touched:
                self.begin()
            is_touched = False
            self.loop.observer.forget()
            self.loop.enable()
            end_s = time.monotonic() + PATIENCE_S
            while time.monotonic() < end_s and self.loop.state()[0] != "latched":
                if self._moves():
                    time.sleep(self._random.uniform(0.1, 0.3))
                    if self._moves():
                        return
                time.sleep(0.02)
        raise OSError(f"the arm does not move: {', '.join(self.loop.state())}")

    def try_fault(self, name: str) -> dict[str, Any]:
        """Inject a fault, take the times, mend it, and return what happened."""
        fault = self.faults[name]
        self.move()
        before = self.loop.stops()
        began = fault.inject()
        time.sleep(WATCH_S)
        began_ns = began if isinstance(began, int) else self._last_sent_ns(began)
        zero_ns, still_ns = self._zero_ns(began_ns), self._still_ns(began_ns)
        self.loop.wait_diagnostics()
        reasons = [k for k, n in self.loop.stops().items() if n > before.get(k, 0)]
        self.loop.disable()
        fault.mend()
        zero_ms = None if zero_ns is None else round(1e-6 * (zero_ns - began_ns), 1)
        return {
            "fault": name,
            "zero_ms": zero_ms,
            "still_ms": None if still_ns is None else round(1e-6 * (still_ns - began_ns), 1),
            "bound_ms": fault.bound_ms,
            "in_time": zero_ms is not None and zero_ms <= fault.bound_ms,
            "reasons": reasons,
        }

    def _force_n(self) -> float:
        heard = self.loop.observer.heard("wrench", last=1)
        if not heard:
            return 0.0
        return float(np.linalg.norm(msg_adapters.decode_wrench_stamped(heard[0].message)[0]))

    def _moves(self) -> bool:
        heard = self.loop.observer.heard("cmd_vel", last=MOVING_COMMANDS)
        return len(heard) == MOVING_COMMANDS and all(_moves(each.message) for each in heard)

    def _last_sent_ns(self, topic: str) -> int:
        return self.loop.observer.heard(topic, last=1)[0].sent_ns

    def _zero_ns(self, began_ns: int) -> int | None:
        """Return when the first command of zero was sent after which all are zero."""
        first = None
        for heard in self.loop.observer.heard("cmd_vel"):
            if heard.sent_ns >= began_ns:
                if _moves(heard.message):
                    first = None
                elif first is None:
                    first = heard.sent_ns
        return first

    def _still_ns(self, began_ns: int) -> int | None:
        """Return the stamp from which on the arm stands, by the poses of the indenter."""
        heard = self.loop.observer.heard("indenter/pose")
        stamps_ns = np.array([msg_adapters.message_stamp_ns(each.message) for each in heard])
        places = np.array([msg_adapters.decode_pose_stamped(each.message)[0] for each in heard])
        later = stamps_ns >= began_ns
        stamps_ns, places = stamps_ns[later], places[later]
        speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(1e-9 * stamps_ns)
        moving = np.flatnonzero(speed > STILL_M_S)
        last = moving[-1] + 1 if len(moving) else 0
        return int(stamps_ns[last]) if last < len(stamps_ns) - 3 else None

    def _set_sensor(self, is_enabled: bool) -> None:
        self.loop.observer.call(SetBool, f"{SENSOR}/set_enabled", data=is_enabled)

    def _cut_images(self) -> str:
        self._set_sensor(False)
        return "wrench"

    def _cut_poses(self) -> str:
        self.loop.set_arm(fail_drop_feedback=True)
        return "ee_pose"

    def _restart_sensor(self) -> None:
        """Start the sensor again, and wait until the killed one is forgotten: the graph keeps it
        for the lease of its participant, and the policy refuses two senders."""
        self.loop.start_nodes(SENSOR)
        self.loop.observer.wait(
            # One sender that is the killed one is one too few: the new one is not in the graph yet.
            lambda: len(self._senders()) == 1 and not self._senders() & self._killed,
            "the killed sensor to leave the graph",
            timeout_s=LEASE_S,
        )

    def _senders(self) -> set[bytes]:
        """Return who publishes forces."""
        found = self.loop.observer.node.get_publishers_info_by_topic("/wrench")
        return {bytes(info.endpoint_gid) for info in found}

    def _kill_sensor(self) -> str:
        self._killed = self._senders()
        self.loop.process(SENSOR).signal(signal.SIGKILL)
        return "wrench"

    def _wrong_sensor(self) -> int:
        def messages() -> dict[str, Any]:
            now_ns = time.time_ns()
            return {
                "image_raw": msg_adapters.encode_image(
                    self._wrong,
                    encoding="rgb8",
                    stamp_ns=now_ns,
                    frame_id="densetact_optical_frame",
                ),
                "wrench": msg_adapters.encode_wrench_stamped(
                    (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), stamp_ns=now_ns, frame_id="densetact_base"
                ),
            }

        kinds = {"image_raw": Image, "wrench": WrenchStamped}
        self._intruder = Intruder(self.loop, SENSOR_PERIOD_S, kinds, messages)
        began_ns = self._intruder.begin()
        self._set_sensor(False)
        return began_ns

    def _right_sensor(self) -> None:
        self._end_intruder()
        self._set_sensor(True)

    def _jump(self) -> int:
        side = next(self._sides)

        def messages() -> dict[str, Any]:
            message = self.loop.observer.heard("ee_pose", last=1)[0].message
            message.header.stamp = msg_adapters.encode_stamp(time.time_ns() + side * JUMP_NS)
            return {"ee_pose": message}

        self._intruder = Intruder(self.loop, ARM_PERIOD_S, {"ee_pose": PoseStamped}, messages)
        return self._intruder.begin()

    def _end_intruder(self) -> None:
        if self._intruder is not None:
            self._intruder.end()
            self._intruder = None

    def _overload(self) -> int:
        self._flag.touch()
        return time.time_ns()

    def _relieve(self) -> None:
        self._flag.unlink(missing_ok=True)


def _moves(message: Any) -> bool:
    return bool(np.any(np.concatenate(msg_adapters.decode_twist_stamped(message))))


def inject_all(
    policy: Path, path: str, count: int, sensor: str, seed: int
) -> tuple[list[dict[str, Any]], float]:
    """Inject faults in turn and return what happened at each, and the minutes that it took."""
    random = np.random.default_rng(seed)
    rows: list[dict[str, Any]] = []
    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        flag = Path(folder) / "overload"
        setup = LoopSetup(
            policy_name(policy),
            sensor=sensor,
            policy_code=OVERLOADED_POLICY.replace("{flag!r}", repr(str(flag))),
        )
        with ClosedLoop(setup, topics=TOPICS) as loop:
            loop.start(path)
            bench = Bench(loop, path, flag, random)
            bench.begin()
            for name in itertools.islice(itertools.cycle(bench.faults), count):
                row = bench.try_fault(name)
                rows.append(row)
                print(
                    f"{len(rows)}: {name}: zero after {row['zero_ms']} ms, still after "
                    f"{row['still_ms']} ms, {', '.join(row['reasons']) or 'no reason'}",
                    file=sys.stderr,
                    flush=True,
                )
    return rows, (time.monotonic() - begun_s) / 60.0


def summarize(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of each kind of fault."""
    found: dict[str, Any] = {}
    for name in dict.fromkeys(row["fault"] for row in rows):
        chosen = [row for row in rows if row["fault"] == name]
        zero = [row["zero_ms"] for row in chosen if row["zero_ms"] is not None]
        still = [row["still_ms"] for row in chosen if row["still_ms"] is not None]
        reasons = Counter(reason for row in chosen for reason in row["reasons"])
        found[name] = {
            "faults": len(chosen),
            "stopped": len(zero),
            "in_time": sum(row["in_time"] for row in chosen),
            "bound_ms": chosen[0]["bound_ms"],
            "zero_p50_ms": float(np.median(zero)) if zero else None,
            "zero_max_ms": max(zero, default=None),
            "still_p50_ms": float(np.median(still)) if still else None,
            "still_max_ms": max(still, default=None),
            "reasons": dict(reasons),
        }
    return found


def loop_faults(
    *,
    faults: int = 100,
    policy: str = "densetact2_sphere",
    path: str = "figure_eight",
    seed: int = 0,
) -> dict[str, Any]:
    """Faults injected into the running closed loop, and how long the arm continues to move.

    Args:
        faults: how many.
        policy: folder or name.
        path: that it follows.
        seed: of the moments.
    """
    expect_positive(faults=faults)
    expect_known("path", [path], PATHS)
    stay_local()
    folder = policy_folder(policy)
    card, _ = read_policy(folder)
    rows, minutes = inject_all(folder, path, faults, card.sensor, seed)
    late = [row for row in rows if not row["in_time"]]
    return {
        "count": len(rows),
        "stopped": sum(row["zero_ms"] is not None for row in rows),
        "in_time": len(rows) - len(late),
        "minutes": round(minutes, 2),
        "faults": summarize(rows),
        "rows": rows,
        "policy": card.name,
        "seed": seed,
        FAILED: [f"{row['fault']}: commands zero after {row['zero_ms']} ms" for row in late],
    }
