# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Many sensors on one device: is it right, how fast, how fast could it be?

The device first answers as the CPU does, for a few shapes that press and slide. Then batches of
growing size make the motions of batch.py: with images, the gel alone, and the gel with fixed
counts. One more frame of each is counted: operations, values that the host reads, and what torch
reads and writes. With what the device copies and multiplies in a second, that bounds the gels and
frames a second. Each row is printed as it is measured; those to come share the time that is left.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from dotsim_ros.gel.batched.gel import BatchedGel, Effort
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.io.arrays import FloatArray
from dotsim_ros.io.warp_runtime import known_device, wp
from dotsim_ros.specification import SensorSpecification
from dotsim_ros.tactile_array import TactileArray
from studies.run import FAILED
from studies.speed.batch import INDENTER, motion

SHAPES = ("sphere_4mm", "box_edge", "cone")
DEPTHS_M = (0.4e-3, 0.8e-3, 1.2e-3)
ASIDE_M = (0.3e-3, 0.6e-3)
MOST_SKIN_UM, MOST_FORCE_PERCENT = 10.0, 1.0
"""By which a device may differ from the CPU: sums in another order end an iteration elsewhere."""
IMAGE, LARGE_IMAGE = (64, 64), (640, 480)
FIXED = Effort(outer=3, newton=4, tolerance_m=0.0)
COPIED = 2**25
MULTIPLIED = 2048
LAUNCHED = 1000
FEWEST_FRAMES = 5
"""Of usual length that a case takes: the first one, from the air, is longer."""
READS = {"_local_scalar_dense", "nonzero", "masked_select", "equal", "_linalg_check_errors"}
"""Operations that wait for the device."""
WARP: Any = wp
"""Without types: what counts launches takes the place of some of its functions."""


class Counted(TorchDispatchMode):
    """Counts what torch and Warp do.

    Attributes:
        operations: launches of torch's operations and Warp's kernels.
        reads: of a value by the host, which waits for the device.
        bytes: that torch's operations read and write, of each the arguments and results once, by
            name of the operation.
        multiplications: additions and multiplications in products.
    """

    def __init__(self) -> None:
        super().__init__()
        self.operations = self.reads = self.multiplications = 0
        self.bytes: Counter[str] = Counter()

    def __enter__(self) -> Counted:
        self._of_warp = WARP.launch, WARP.Launch.launch
        WARP.launch, WARP.Launch.launch = map(self._noted, self._of_warp)
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        WARP.launch, WARP.Launch.launch = self._of_warp

    def _noted(self, launch: Callable[..., Any]) -> Callable[..., Any]:
        def noted(*arguments: Any, **named: Any) -> Any:
            self.operations += not named.get("record_cmd", False)
            return launch(*arguments, **named)

        return noted

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        name = func.overloadpacket.__name__
        self.reads += name in READS
        if func.is_view:
            return result
        self.operations += 1
        moved = [each for each in tree_leaves((args, kwargs, result)) if _is_dense(each)]
        self.bytes[name] += sum(each.numel() * each.element_size() for each in moved)
        if name in ("bmm", "mm", "addmm"):
            first, second = args[-2:]
            size = first.numel() if _is_dense(first) else first.values().numel()
            self.multiplications += 2 * size * second.shape[-1]
        return result


def _is_dense(value: Any) -> bool:
    return isinstance(value, torch.Tensor) and value.layout == torch.strided


def difference_rows(
    sensor: SensorSpecification, device: str, shapes: Sequence[str]
) -> list[dict[str, Any]]:
    """Return how far the device's answers are from the CPU's, by shape and motion."""
    indenters, count = [load_indenter(name) for name in shapes], len(shapes)
    arrays: list[Any] = [
        TactileArray(sensor, count, indenters, image_size=IMAGE, device=one)
        for one in ("cpu", device)
    ]
    gels: list[Any] = [
        BatchedGel(sensor, indenters, count, effort=FIXED, device=one) for one in ("cpu", device)
    ]
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    top_m = float(arrays[0].rest_position_m[:, 2].max())
    places = [("press", 0.0, depth) for depth in DEPTHS_M]
    places += [("slide", aside, DEPTHS_M[-1]) for aside in ASIDE_M]
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for what, aside, depth in places:
        position = np.tile([aside, 0.0, top_m - depth], (count, 1))
        for solved, both in ((what, arrays), (f"{what} with fixed counts", gels)):
            right, frame = (one.step(position, turn) for one in both)
            newtons = right.force_n.norm(dim=1).numpy()
            off = {
                "skin_um": 1e6 * _off(frame.skin_position_m, right.skin_position_m),
                "force_percent": 100.0 * _off(frame.force_n, right.force_n) / newtons,
            }
            if both is arrays:
                off["depth_um"] = 1e6 * _off(frame.depth_m[..., None], right.depth_m[..., None])
                off["marker_px"] = _off(frame.marker_px, right.marker_px)
            for b, shape in enumerate(shapes):
                row = rows.setdefault((solved, shape), {"motion": solved, "shape": shape})
                for name, values in off.items():
                    row[name] = max(row.get(name, 0.0), round(float(values[b]), 4))
    return list(rows.values())


def _off(found: torch.Tensor, right: torch.Tensor) -> FloatArray:
    """Return the longest difference of each sensor's vectors (B, ..., n); infinite where only one
    of them is no number."""
    both = [each.cpu().numpy().astype(float) for each in (found, right)]
    length = np.linalg.norm(both[0] - both[1], axis=-1)
    is_none = [np.isnan(each).any(axis=-1) for each in both]
    length = np.where(is_none[0] & is_none[1], 0.0, np.where(np.isnan(length), np.inf, length))
    whole: FloatArray = length.reshape(len(length), -1).max(axis=1, initial=0.0)
    return whole


def rates(device: str) -> dict[str, float]:
    """Return what a device copies and multiplies in a second, and the time of a small operation."""
    source = torch.zeros(COPIED, device=device)
    target = torch.empty_like(source)
    square = torch.zeros(MULTIPLIED, MULTIPLIED, device=device)
    little = torch.zeros(1, device=device)
    copy_s = _seconds(lambda: target.copy_(source), device, 5)
    product_s = _seconds(lambda: square @ square, device, 3)
    return {
        "gb_per_s": round(2e-9 * 4 * COPIED / copy_s, 1),
        "tflops": round(2e-12 * MULTIPLIED**3 / product_s, 3),
        "launch_us": round(1e6 * _seconds(lambda: little.add_(1.0), device, LAUNCHED), 2),
    }


def _seconds(work: Callable[[], Any], device: str, count: int) -> float:
    """Return the time of work that is repeated, once before the clock starts."""
    work()
    _wait(device)
    begun_s = time.perf_counter()
    for _ in range(count):
        work()
    _wait(device)
    return (time.perf_counter() - begun_s) / count


def _wait(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)


def _memory_gb(device: str) -> float:
    """Return the most that torch and Warp had of a device since the last call; on a CPU what this
    process has."""
    if device == "cpu":
        status = Path("/proc/self/status").read_text(encoding="ascii")
        return 1.024e-6 * float(status.partition("VmRSS:")[2].split()[0])
    most = torch.cuda.max_memory_allocated(device)
    if wp.is_mempool_enabled(device):
        most += wp.get_mempool_used_mem_high(device)
    torch.cuda.reset_peak_memory_stats(device)
    return 1e-9 * most


def measured(
    step: Callable[[FloatArray, FloatArray], Any],
    see: Callable[[], Any],
    count: int,
    radius_m: float,
    device: str,
    end_s: float,
) -> dict[str, Any]:
    """Return the time of a frame of so many gels, and what a frame does, counted.

    Args:
        step: one frame at poses (B, 3), (B, 4).
        see: what is done after each.
        count: B.
        radius_m: of the dome.
        device: which it runs on.
        end_s: time on the monotonic clock after which no frame begins.
    """
    paths = [motion(number, radius_m) for number in range(count)]
    poses = [
        (
            np.array([pose.position_m for pose in frame]),
            np.array([pose.quaternion_xyzw for pose in frame]),
        )
        for frame in zip(*paths, strict=True)
    ]

    def frame(number: int) -> None:
        step(*poses[number])
        see()
        _wait(device)

    # The first frame comes from the air in many short moves; it also compiles kernels.
    frame(0)
    spent_s: list[float] = []
    while not spent_s or (len(spent_s) < len(poses) - 2 and time.monotonic() < end_s):
        begun_s = time.perf_counter()
        frame(1 + len(spent_s))
        spent_s.append(time.perf_counter() - begun_s)
    with Counted() as counted:
        frame(1 + len(spent_s))
    total = sum(counted.bytes.values())
    frame_s = float(np.mean(spent_s))
    return {
        "gel_frames_per_second": round(count / frame_s, 1),
        "ms": round(1e3 * frame_s, 2),
        "frames": len(spent_s),
        "operations": counted.operations,
        "host_reads": counted.reads,
        "mb_per_gel": round(1e-6 * total / count, 1),
        "gflop_per_gel": round(1e-9 * counted.multiplications / count, 3),
        "mostly": {name: round(share / total, 2) for name, share in counted.bytes.most_common(4)},
    }


def bound(row: dict[str, Any], count: int, rate: dict[str, float]) -> float:
    """Return the most gels and frames a second that what was counted leaves."""
    frame_s = max(
        1e-3 * count * row["mb_per_gel"] / rate["gb_per_s"],
        1e-3 * count * row["gflop_per_gel"] / rate["tflops"],
        1e-6 * row["operations"] * rate["launch_us"],
    )
    return round(count / frame_s, 1)


def differing(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return what is wrong of the answers of a device."""
    return [
        f"{row['shape']}, {row['motion']}: skin {row['skin_um']:g} um and force "
        f"{row['force_percent']:g} % from the CPU's"
        for row in rows
        if not (row["skin_um"] <= MOST_SKIN_UM and row["force_percent"] <= MOST_FORCE_PERCENT)
    ]


def on_device(
    device: str,
    sensor: SensorSpecification,
    counts: Sequence[int],
    seconds: float,
    *,
    shapes: Sequence[str] = SHAPES,
) -> dict[str, Any]:
    """Return the figures of a device, printed as they come.

    Args:
        device: torch's name.
        sensor: of all gels, a dome.
        counts: of gels, B.
        seconds: for all; no frame begins after them.
        shapes: of indenters, that the device is compared with the CPU for.

    Raises:
        ValueError: no such device.
    """
    begun_s = time.monotonic()
    device = known_device(device)
    name = "cpu" if device == "cpu" else torch.cuda.get_device_name(device)
    compared = difference_rows(sensor, device, shapes)
    for answer in compared:
        print(*(f"{key} {value}" for key, value in answer.items()), sep=", ")
    rate = rates(device)
    print(*(f"{key} {value:g}" for key, value in rate.items()), sep=", ", flush=True)
    figures: dict[str, Any] = {"device": name, "rates": rate, "compared": compared}
    failed = differing(compared)
    ball, radius_m = load_indenter(INDENTER), sensor.gel.outer_radius_m

    def array(size: tuple[int, int], count: int) -> Any:
        return TactileArray(sensor, count, ball, image_size=size, device=device)

    kinds: dict[str, Callable[[int], Any]] = {
        "with_images": lambda count: array(IMAGE, count),
        "gel": lambda count: BatchedGel(sensor, ball, count, device=device),
        "gel_fixed": lambda count: BatchedGel(sensor, ball, count, effort=FIXED, device=device),
    }
    cases = [(kind, count) for count in counts for kind in kinds]
    kinds["large_image"] = lambda count: array(LARGE_IMAGE, count)
    cases.insert(len(kinds) - 1, ("large_image", 1))
    frame_s: dict[str, tuple[int, float]] = {}

    def row_of(kind: str, count: int, end_s: float) -> dict[str, Any]:
        made = kinds[kind](count)
        before, spent_s = frame_s.get(kind, (count, 0.0))
        left_s = begun_s + seconds - time.monotonic()
        if FEWEST_FRAMES * spent_s * count / before > left_s:
            return {"left_out": f"{left_s:.0f} s are left"}
        # Images of this size are those of a camera, with its light.
        see = made.image if kind == "large_image" else lambda: None
        row = measured(made.step, see, count, radius_m, device, end_s)
        frame_s[kind] = count, 1e-3 * row["ms"]
        return {**row, "bound": bound(row, count, rate)}

    for number, (kind, count) in enumerate(cases):
        now_s = time.monotonic()
        end_s = now_s + (begun_s + seconds - now_s) / (len(cases) - number)
        row: dict[str, Any]
        try:
            row = row_of(kind, count, end_s)
        except ValueError as error:
            row = {"refused": str(error)}
        except RuntimeError as error:
            row = {"failed": str(error).partition("\n")[0]}
            failed.append(f"{count} {kind}: {row['failed']}")
        row["memory_gb"] = round(_memory_gb(device), 3)
        print(count, kind, *(f"{key} {value}" for key, value in row.items()), sep=", ", flush=True)
        figures.setdefault(str(count), {})[kind] = row
    for rows in figures.values():
        if isinstance(rows, dict) and "gel_frames_per_second" in rows.get("gel", {}):
            rows["gel_frames_per_second"] = rows["gel"]["gel_frames_per_second"]
    print(f"{time.monotonic() - begun_s:.0f} s", flush=True)
    return {**figures, FAILED: failed}
