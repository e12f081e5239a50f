# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Check that each result names clean commits of this history, and that no sealed one has changed.

check_records.py [CHECKOUT]. A sealed result is of data that can be judged once only.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(sys.argv[1] if len(sys.argv) > 1 else ".").resolve()


def git(*arguments: str) -> subprocess.CompletedProcess[bytes]:
    """Run git in the checkout."""
    return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True)


faults = []
for file in sorted((ROOT / "docs/results").rglob("*.json")):
    path, text = file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8")
    for commit in sorted(set(re.findall(r'"commit": "([^"]*)"', text)) or {"none"}):
        is_ancestor = git("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0
        if not re.fullmatch("[0-9a-f]{7,40}", commit) or not is_ancestor:
            faults.append(f"{path}: commit {commit} is not a clean one of this (whole?) history")
    record = json.loads(text)
    if isinstance(record, dict) and record.get("sealed"):
        by_age = ("log", "--reverse", "--format=%h", "-S", '"sealed": true', "--", path)
        first = git(*by_age).stdout.decode().partition("\n")[0]
        if first and git("show", f"{first}:{path}").stdout != file.read_bytes():
            faults.append(f"{path}: sealed at {first}, then changed: write another file")
print(*faults, f"{len(faults)} faults in the records of docs/results", sep="\n")
sys.exit(bool(faults))
