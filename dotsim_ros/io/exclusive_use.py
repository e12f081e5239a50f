# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Objects whose calls change them, for one thread at a time."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar, cast


class ExclusiveUse:
    """Refuses what two threads would mix.

    A call is refused while one of another thread runs. Threads that take turns, with a lock of
    their own, are not. Threads that were once found to collide hold no such lock, and one may come
    between two calls of the other: from then on only the thread that began again last goes on.

    Args:
        name: of the object, for the message.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._lock = threading.RLock()
        self._owner: int | None = None
        self._has_collided = False

    @contextmanager
    def call(self, *, begins: bool) -> Iterator[None]:
        """Run a call in the block.

        Args:
            begins: whether nothing of what was done before matters to it, as in a reset.

        Raises:
            RuntimeError: another thread uses the object.
        """
        if not self._lock.acquire(blocking=False):
            self._has_collided = True
            raise self._refusal("is in a call of another thread")
        try:
            caller = threading.get_ident()
            if begins or self._owner is None:
                self._owner = caller
            elif self._has_collided and caller != self._owner:
                raise self._refusal("was reset by another thread")
            yield
        finally:
            self._lock.release()

    def _refusal(self, why: str) -> RuntimeError:
        return RuntimeError(
            f"this {self._name} {why}: what two threads do with it would mix, and its forces would "
            "be wrong; make one for each thread, or hold a lock of your own from a reset to the "
            "last call that belongs to it"
        )


Method = TypeVar("Method", bound=Callable[..., Any])


def exclusive(*, begins: bool = False) -> Callable[[Method], Method]:
    """Return a decorator for methods that one thread at a time may call, all of an object together:
    those of its `exclusive_use`.

    Args:
        begins: as `ExclusiveUse.call`.
    """

    def decorate(method: Method) -> Method:
        @functools.wraps(method)
        def called(self: Any, *given: Any, **named: Any) -> Any:
            with self.exclusive_use.call(begins=begins):
                return method(self, *given, **named)

        return cast(Method, called)

    return decorate
