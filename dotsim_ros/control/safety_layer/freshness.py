# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How old the newest message of a stream is, and whether its stamps run like a clock.

Three clocks take part: the steady one of this machine, which nobody sets, by which arrivals are
timed; the one that stamped the message; and this machine's time, which stamps are compared with. A
message that comes late is old, for whatever reason, and the next one may be in time again. A stamp
that runs back or lies in the future, or a time that departs from the steady clock, is no delay: a
clock was set, or two senders share a topic.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from threading import Lock

import numpy as np

NANOSECONDS_PER_SECOND = 1_000_000_000

DISORDER_S = 0.02
"""Two messages may change places, and a sender that relates two clocks be off by some microseconds:
a stamp so little before the newest holds no new data, but is no jump."""


class HeardMessage(Enum):
    """What a message is to its stream."""

    NEW = "new"
    NOTHING_NEW = "nothing new"
    JUMPED = "jumped"


@dataclass(frozen=True)
class StreamReading:
    """The state of a stream at one moment.

    Attributes:
        age_s: since the newest message came; infinite before the first.
        delay_s: from the newest message's stamp to its arrival; negative where it is stamped in the
            future.
    """

    age_s: float = np.inf
    delay_s: float = 0.0


class StreamWatch:
    """Watches one stream; one thread may receive while others read.

    Args:
        jump_s: how far in the future a stamp may lie, and how far the machine's time may leave the
            steady clock from one message to the next.

    Attributes:
        count: messages that were new.
        repeated: messages without new data: with the stamp of the newest, or just before it.
    """

    def __init__(self, name: str, *, jump_s: float) -> None:
        self.name = name
        self._jump_s = jump_s
        self._lock = Lock()
        self._stamp_ns: int | None = None
        self._clock_ns = 0
        self._arrival_s = -np.inf
        self._delay_s = 0.0
        self.count = 0
        self.repeated = 0

    def hear(self, stamp_ns: int, *, arrival_s: float, clock_ns: int) -> tuple[HeardMessage, str]:
        """Note a message; return what it is, and for a jump the reason in words.

        After a jump the stream continues from the new stamp.

        Args:
            arrival_s: when it came, on the steady clock.
            clock_ns: the same on the clock that stamps are compared with.
        """
        with self._lock:
            last_ns, passed_s = self._stamp_ns, arrival_s - self._arrival_s
            clock_step_s = (clock_ns - self._clock_ns) / NANOSECONDS_PER_SECOND
            back_s = 0.0 if last_ns is None else (last_ns - stamp_ns) / NANOSECONDS_PER_SECOND
            if last_ns is not None and 0.0 <= back_s <= DISORDER_S:
                self.repeated += 1
                return HeardMessage.NOTHING_NEW, ""
            delay_s = (clock_ns - stamp_ns) / NANOSECONDS_PER_SECOND
            self._stamp_ns, self._clock_ns, self._arrival_s = stamp_ns, clock_ns, arrival_s
            self._delay_s = delay_s
            self.count += 1
        if last_ns is None:
            return HeardMessage.NEW, ""
        if back_s > 0.0:
            return HeardMessage.JUMPED, f"{self.name}: the stamp runs back by {back_s:.3f} s"
        if delay_s < -self._jump_s:
            return (
                HeardMessage.JUMPED,
                f"{self.name}: the stamp lies {-delay_s:.3f} s in the future",
            )
        if abs(clock_step_s - passed_s) > self._jump_s:
            return HeardMessage.JUMPED, (
                f"the time of this machine moves on by {clock_step_s:.3f} s while "
                f"{passed_s:.3f} s pass"
            )
        return HeardMessage.NEW, ""

    def reading(self, now_s: float) -> StreamReading:
        """Return the state of the stream."""
        with self._lock:
            return StreamReading(now_s - self._arrival_s, self._delay_s)
