# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Times a policy: the whole answer to an image, and its network by ONNX Runtime and by torch.

    python benchmarks/policy_inference.py --json policy_inference.json

Torch runs the network that the weights were made from, in single precision and in bfloat16, with
random weights, which cost the same.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dotsim_ros.files import write_json
from dotsim_ros.optics.network.carded_weights import GRAPH
from dotsim_ros.optics.network.session import open_session
from dotsim_ros.provenance import provenance
from dotsim_ros.tasks.policy.images import CHANNEL_COUNT
from dotsim_ros.tasks.policy.network import load_policy

THREADS = (1, 2)


def timed(run: Callable[[], Any], count: int) -> dict[str, float]:
    """Return the spread of a call's wall-clock time, after a few that do not count."""
    samples = []
    for number in range(count + 5):
        start = time.perf_counter()
        run()
        if number >= 5:
            samples.append(time.perf_counter() - start)
    quantiles = 1e3 * np.percentile(samples, [5, 50, 95])
    return {
        name: round(float(value), 2)
        for name, value in zip(("p5_ms", "p50_ms", "p95_ms"), quantiles, strict=True)
    }


def by_torch(path_count: int, side_px: int, count: int) -> dict[str, dict[str, float]]:
    """Return the times of the network by torch."""
    import torch

    from dotsim_ros.tasks.policy.resnet import PolicyResNet, without_normalisation

    network = without_normalisation(PolicyResNet(path_count).eval())
    network = network.to(memory_format=torch.channels_last)
    crop = torch.rand(1, CHANNEL_COUNT, side_px, side_px)
    crop = crop.to(memory_format=torch.channels_last)
    result = {}
    for threads in THREADS:
        torch.set_num_threads(threads)
        for name, narrow in (("single precision", False), ("bfloat16", True)):

            def run(narrow: bool = narrow) -> None:
                with (
                    torch.inference_mode(),
                    torch.autocast("cpu", dtype=torch.bfloat16, enabled=narrow),
                ):
                    network(crop)

            result[f"torch, {name}, {threads} threads"] = timed(run, count)
    return result


def measure(folder: Path, count: int) -> dict[str, Any]:
    """Return all times."""
    policy = load_policy(folder)
    height, width = policy.image_shape
    random = np.random.default_rng(0)
    image = random.integers(0, 255, (height, width, 3), dtype=np.uint8)
    idle = random.integers(0, 255, (height, width, 3), dtype=np.uint8)
    card = policy.card
    given = random.random((1, CHANNEL_COUNT, card.side_px, card.side_px), dtype=np.float32)
    rows: dict[str, dict[str, float]] = {}
    for threads in THREADS:
        whole = load_policy(folder, thread_count=threads)

        def answer(policy: Any = whole) -> None:
            policy(image, idle)

        rows[f"whole answer, {threads} threads"] = timed(answer, count)
    rows["distance from the usual images"] = timed(
        lambda: policy.image_distance(image, idle), count
    )
    for threads in THREADS:
        session = open_session(folder / GRAPH, threads, "policy")

        def run(session: Any = session) -> None:
            session.run(None, {"picture": given})

        rows[f"ONNX Runtime, {threads} threads"] = timed(run, count)
    rows.update(by_torch(len(card.paths), card.side_px, count))
    return {"side_px": card.side_px, "times": rows, "provenance": provenance()}


def main() -> None:
    """Print the table, and write it as JSON where asked."""
    parser = argparse.ArgumentParser(
        description="Time a policy's answer to an image.",
        epilog="example: python benchmarks/policy_inference.py --count 300 --json times.json",
    )
    add = parser.add_argument
    add("--policy", type=Path, default=Path("params/policies/densetact2_sphere"), metavar="DIR")
    add("--count", type=int, default=200, help="answers to time (200)")
    add("--json", type=Path, metavar="FILE", help="file to write the figures to")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    result = measure(arguments.policy, arguments.count)
    print(f"{'':<40}{'p5':>9}{'p50':>9}{'p95':>9}  ms")
    for name, row in result["times"].items():
        print(f"{name:<40}" + "".join(f"{value:9.2f}" for value in row.values()))
    if arguments.json:
        write_json(arguments.json, result)


if __name__ == "__main__":
    main()
