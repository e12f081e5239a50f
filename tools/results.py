# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Make the tables of docs/results, for a release; a run that was interrupted is resumed.

    python tools/results.py --list
    python tools/results.py [--data ../shared] [NAME ...]

A table is made from a clean commit, and only if its record does not name that commit yet. Sealed
records, of data that can be judged once only, are not in the list.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from dotsim_ros.provenance import commit_of

ROOT = Path(__file__).resolve().parents[1]
RESULTS = "docs/results"


@dataclass(frozen=True)
class Table:
    """A record below docs/results, and how it is made.

    Attributes:
        minutes: that it took, roughly, on two slow cores.
        command: writes the record, as it is given with `--json`.
        before: commands that make what it needs, in `out`.
    """

    minutes: int
    command: str
    before: tuple[str, ...] = ()


def benchmark(minutes: int, command: str) -> Table:
    """Return the table of a script of benchmarks/."""
    return Table(minutes, f"python benchmarks/{command}")


def evaluation(minutes: int, command: str, *before: str) -> Table:
    """Return the table of a subject of `dotsim_ros evaluate`."""
    return Table(minutes, f"dotsim_ros evaluate {command} --out out/results", before)


SENSOR_A = "--data {data}/measured/sensor_a"
FINDER = "--sensor data/hidden_17/sensor_a.yaml --discrepancy data/hidden_17/discrepancy.npz"
KNOWN_NOISE = "--noise-skin-discretisation-m 0.3e-3 --joint-steps 0"
APART = (
    f"dotsim_ros calibrate-camera {SENSOR_A} --sensor densetact2 --leave-out 1_sphere "
    "3_lying_cylinder --out out/apart/apart.yaml"
)
FIRST = f"dotsim_ros calibrate {SENSOR_A} --workers 1 --run out/run_first --out out/first.yaml"
TABLES = {
    "accuracy": benchmark(30, "accuracy.py --figure docs/images/gel_error_cost.png"),
    "calibration_sensor_a": Table(
        15, f"dotsim_ros calibrate {SENSOR_A} --workers 1 --run out/run_first --out out/again.yaml"
    ),
    "calibration_sensor_a_28": Table(
        20,
        f"dotsim_ros calibrate {SENSOR_A} --sensor out/first.yaml --fit E nu friction c20 "
        f"{KNOWN_NOISE} --solves 5 --hold-out 0 --workers 1 --run out/run_28 "
        "--out docs/results/sensor_a_28.yaml",
        (FIRST,),
    ),
    "calibration_sensor_a_stiffening": Table(
        15,
        f"dotsim_ros calibrate {SENSOR_A} --sensor out/first.yaml --fit E nu friction c20 "
        f"{KNOWN_NOISE} --solves 5 --workers 1 --run out/run_19 --out out/sensor_a.yaml",
        (FIRST,),
    ),
    "calibration_sensor_a_thickness": Table(
        15,
        f"dotsim_ros calibrate {SENSOR_A} --trajectories 1_sphere_3 1_sphere_slide_1 2_cone_1 "
        "3_lying_cylinder_0 4_torus_1 6_round_punch_0 --hold-out 0 --workers 1 --sensor sensor_a "
        f"--fit E nu friction c20 thickness {KNOWN_NOISE} --solves 6 --out out/thickness.yaml",
    ),
    "camera_sensor_a": Table(
        5, f"dotsim_ros calibrate-camera {SENSOR_A} --sensor sensor_a --out out/camera.yaml"
    ),
    "classification": evaluation(
        60,
        f"classification {SENSOR_A} --sensor out/apart/apart.yaml --network-epochs 20 "
        "--network-width 64 --workers 1 --models ours bound tacto difftactile paper "
        "--gelsight {data}/real/gelsight",
        APART,
    ),
    "closed_loop": benchmark(5, "closed_loop.py --minutes 4"),
    "coupling": benchmark(5, "coupling.py"),
    "coverage_units": benchmark(25, "coverage_units.py --sets data/hidden_17 --workers 1"),
    "device_check": benchmark(8, "device_check.py --device cuda:0 --timed 20"),
    "drop_in": benchmark(6, "drop_in.py --seconds 60"),
    "environments": benchmark(5, "environments.py"),
    "find_gap": benchmark(
        30,
        "find_gap.py --measured data/hidden_23/set_00 data/hidden_23/set_03 data/hidden_23/set_10 "
        f"data/hidden_23/set_12 {FINDER}",
    ),
    "gap": evaluation(31, f"gap {SENSOR_A} --sensor sensor_a --nulls 200 --repeats 2 --seed 5"),
    "gap_images": benchmark(
        10, f"gap_images.py {SENSOR_A} --run out/gap_images --noise params/gap/optical_noise.npz"
    ),
    "gap_nulls": benchmark(30, f"gap_nulls.py {SENSOR_A} --sensor sensor_a --count 12 --workers 1"),
    "gap_open": benchmark(30, "gap_open.py --data {data}/measured --sensor sensor_a"),
    "gap_physics_new_again/gap_physics": evaluation(
        45, f"gap --sets data/hidden_23 {FINDER} --half opened --run out/search_23 --workers 1"
    ),
    "gap_physics_rule_9/gap_physics": evaluation(
        45, f"gap --sets data/hidden_17 {FINDER} --half opened --run out/search_17 --workers 1"
    ),
    "gap_rendered": benchmark(35, f"gap_rendered.py {SENSOR_A} --run out/gap_rendered --seed 2"),
    "gelsight": evaluation(
        10, "gelsight --data {data}/real/gelsight --models idle taxim taxim_cap fots ours"
    ),
    "gelsight_taxim": evaluation(
        10, "gelsight_taxim --data {data}/real/gelsight_taxim --models idle taxim fots ours"
    ),
    "geometry": evaluation(45, f"geometry {SENSOR_A} --sensor sensor_a --splits held_out", FIRST),
    "geometry_later": evaluation(
        40,
        "geometry_later --data {data}/measured/sensor_a_later --fit-data {data}/measured/sensor_a "
        "--sensor docs/results/sensor_a_28.yaml",
    ),
    "live": benchmark(2, "live.py --seconds 15"),
    "loop_faults": benchmark(20, "loop_faults.py --faults 100"),
    "optics": evaluation(
        40,
        f"optics {SENSOR_A} --sensor out/apart/apart.yaml --splits easy hard --models idle "
        "idle_refined tacto tacto_refined tacto_warped taxim taxim_warped difftactile "
        "difftactile_warped carried ours",
        APART,
    ),
    "optics_network": benchmark(5, "optics_network.py --sensor sensor_a --published 3"),
    "profiles": benchmark(10, "profiles.py"),
    "real_cylinders": evaluation(15, "real_cylinders --data {data}/real/ecoflex_compression"),
    "real_force": evaluation(5, "real_force --data {data}/real/gelsight_mini_force"),
    "real_pair": evaluation(5, "real_pair --data {data}/real/densetact"),
    "realtime": benchmark(8, "realtime.py --seconds 60"),
    "realtime_learned": benchmark(
        4, "realtime.py --sensor sensor_a --seconds 30 --case-frames 40 --skip-cold-start"
    ),
    "reference": benchmark(45, "reference.py --out out/reference"),
    "residual_size": benchmark(
        15,
        f"residual_size.py {SENSOR_A} --indenters 1_sphere 3_lying_cylinder --widths 64 160 240",
    ),
    "rl": evaluation(35, "rl --seeds 5 --episodes 100 --workers 1"),
    "runtime": evaluation(
        15, f"runtime {SENSOR_A} --sensor sensor_a --presses 1_sphere_0 2_cone_3"
    ),
    "scale_out": benchmark(10, "scale_out.py --presses 32"),
    "sensors": benchmark(5, "sensors.py"),
    "simulated_loop": benchmark(70, "simulated_loop.py --faults 100"),
    "soak": benchmark(31, "soak.py --minutes 30"),
    "trajectory": evaluation(40, "trajectory --trials 10"),
    "trajectory_realtime": evaluation(
        25, "trajectory --trials 10 --clock realtime --settings simulated transferred"
    ),
    "tumour": evaluation(40, "tumour --presses 30 --judged 6"),
}


def record_of(name: str) -> Path:
    """Return the file of a table."""
    return ROOT / RESULTS / f"{name}.json"


def is_made(name: str, commit: str) -> bool:
    """Return whether the record of a table names a commit, or is sealed and stays as it is."""
    if not record_of(name).is_file():
        return False
    record = json.loads(record_of(name).read_text(encoding="utf-8"))
    source = record.get("provenance") or record.get("origin") or record
    return record.get("sealed", False) or source.get("commit") == commit


def make(name: str, data: Path) -> bool:
    """Run the commands of a table; return whether all of them ended well."""
    table = TABLES[name]
    for command in (*table.before, f"{table.command} --json {RESULTS}/{name}.json"):
        line = command.replace("{data}", str(data))
        print(f"$ {line}", flush=True)
        if subprocess.run(shlex.split(line), cwd=ROOT).returncode:
            return False
    return True


def main(arguments: list[str] | None = None) -> int:
    """Make the named tables; return how many could not be made, 2 for a wrong call."""
    parser = argparse.ArgumentParser(description="Make the tables of docs/results.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="tables (all)")
    parser.add_argument("--data", type=Path, default=Path("../shared"), help="measured and real")
    parser.add_argument("--list", action="store_true", help="only list the tables")
    given = parser.parse_args(arguments)
    names = given.names or list(TABLES)
    if unknown := sorted(set(names) - set(TABLES)):
        parser.error(f"no table {', '.join(unknown)}; --list shows those that there are")
    commit = commit_of(ROOT)
    waiting = [name for name in names if not is_made(name, commit)]
    for name in names:
        state = "" if name in waiting else "made at this commit"
        print(f"{name:36} {TABLES[name].minutes:4d} min  {state}".rstrip())
    total = sum(TABLES[name].minutes for name in waiting)
    print(f"{len(waiting)} to make, about {total} minutes", flush=True)
    if given.list:
        return 0
    if commit.endswith("-dirty"):
        parser.error("a record names a clean commit: commit or stash the changes first")
    failed = []
    for number, name in enumerate(waiting, start=1):
        print(f"{name}: {number} of {len(waiting)}, about {TABLES[name].minutes} minutes")
        begun = time.monotonic()
        failed += [] if make(name, given.data) else [name]
        print(f"{name}: {(time.monotonic() - begun) / 60.0:.1f} minutes", flush=True)
    print(f"{len(waiting) - len(failed)} made, {len(names) - len(waiting)} were there")
    if failed:
        print(f"failed: {', '.join(failed)}; the same command tries these again")
    return len(failed)


if __name__ == "__main__":
    sys.exit(main())
