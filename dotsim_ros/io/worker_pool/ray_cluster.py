# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The way to a Ray cluster, or to Ray on this machine alone; says why where there is none."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ANSWER_S = 5.0
"""An address at which nobody answers so long is not there."""
SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # Ray warns of changes of its own otherwise.
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    # A head that answers and lets nobody in would be tried twenty times, for minutes.
    "RAY_NUM_REDIS_GET_RETRIES": "2",
    # Ray tells of each dead worker in long lines on stdout, where results are printed.
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".*",
}
ON_THIS_MACHINE = {
    # Whatever the platform: so that nobody else in the network can give it work.
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
}


def connected_ray(address: str, count: int) -> Any:
    """Return the module `ray`, connected; the connection stays until the process ends.

    A process that is connected already stays where it is: "auto" and "local" are there, too.

    Args:
        address: as in `RayWorkers`.
        count: CPUs of Ray on this machine alone.

    Raises:
        ValueError: Ray is not installed.
        ConnectionError: no cluster there, or not one that this process can be part of, or the
            process is connected to another.
    """
    alone = ON_THIS_MACHINE if address == "local" else {}
    for name, value in (SETTINGS | alone).items():
        os.environ.setdefault(name, value)
    with _kept_signals():
        try:
            import ray
        except ImportError as error:
            raise ValueError(
                f"Ray is not installed ({error}), expected it where a Ray address is given: "
                "pip install 'dotsim_ros[scale]', or leave the address out to work on this machine"
            ) from error
        if ray.is_initialized():
            here = ray.get_runtime_context().gcs_address
            if address not in ("auto", "local", here):
                raise ConnectionError(
                    f"this process is connected to Ray at {here} already, expected to be to "
                    f"{address}: name the same, or call ray.shutdown() before"
                )
            return ray
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
        if address == "local":
            ray.init("local", num_cpus=count, include_dashboard=False, **quiet)
            return ray
        if address != "auto":
            _check_answers(address)
        try:
            ray.init(address, **quiet)
        except (RuntimeError, ValueError, OSError, ray.exceptions.RayError) as error:
            raise ConnectionError(_reason(address, error)) from error
    return ray


def _check_answers(address: str) -> None:
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise ConnectionError(
            f"nobody answers at {address} ({error}); {_HEAD}, and that this machine may reach it"
        ) from error


_HEAD = (
    "expected the head of a running Ray cluster: start one with `ray start --head --port=6379`, "
    "and see that the address is the one that it prints"
)


def _reason(address: str, error: BaseException) -> str:
    text = " ".join(str(error).split())
    if "Version mismatch" in text:
        return (
            f"the cluster at {address} has another Ray or Python than this process: {text}; "
            "expected the same on all machines: install the same, and start Ray again"
        )
    if "raylet" in text.lower() or "node_ip_address" in text:
        return (
            f"this machine is no part of the cluster at {address} ({text}); expected the command "
            f"on a machine of the cluster: make it one with `ray start --address={address}`"
        )
    return (
        f"no connection to Ray at {address} ({text}); {_HEAD}; where the cluster was started with "
        "a token, set RAY_AUTH_MODE=token here as well, and have its ~/.ray/auth_token"
    )


@contextmanager
def _kept_signals() -> Iterator[None]:
    """Give SIGTERM back to who had it: Ray takes it when it is loaded and when it connects."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
