# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The code that a recorded command measures, in this tree and at earlier commits."""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
from collections import ChainMap
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import cast

from dotsim_ros.code_version import PACKAGES, FolderSources, digest_of, import_closure

VERB_MODULE = "dotsim_ros.cli.{verb}"
"""Where the command line finds a verb; the function `_SUBJECT` in it runs one of its subjects."""
STARTED = {
    "benchmarks/closed_loop.py": ("tactile_sim", "tactile_policy", "xarm_sim"),
    "benchmarks/drop_in.py": ("tactile_sim",),
    "benchmarks/environments.py": (
        "dotsim_ros.tasks.environments.ball",
        "dotsim_ros.tasks.environments.box_yaw",
    ),
    "benchmarks/find_gap.py": ("dotsim_ros.cli.find_gap",),
    "benchmarks/interrupts.py": (
        "indenter_player",
        "tactile_policy",
        "tactile_record",
        "tactile_sim",
        "xarm_adapter",
        "xarm_sim",
    ),
    "benchmarks/live.py": ("dotsim_ros.cli.live",),
    "benchmarks/loop_faults.py": ("tactile_sim", "tactile_policy", "xarm_sim"),
    "benchmarks/realtime.py": ("tactile_sim",),
    "benchmarks/simulated_loop.py": ("tactile_sim", "tactile_policy", "tactile_record", "xarm_sim"),
    "benchmarks/slow_machine.py": ("tactile_sim", "tactile_policy", "xarm_sim"),
    "benchmarks/soak.py": ("tactile_sim",),
    "evaluate trajectory": ("tactile_sim", "tactile_policy", "xarm_sim"),
}
"""What a script or a verb starts as processes, or Gymnasium loads, and no import shows: executables
and modules."""
MOVED: dict[str, str] = {}
"""Scripts that have got another path since results were made with them, and that path."""
WITH_SUBJECTS = ("evaluate",)
"""Verbs whose first argument says what they do."""
_ENTRY_POINTS = "setup.py"
_RECORD_KEEPERS = frozenset({"code_version", "provenance"})
"""Modules that write down where a figure comes from, and so decide none."""


class Checkout:
    """A working tree and the history that it stands on.

    Args:
        root: its top folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.now: Mapping[str, bytes] = FolderSources(root)
        self._blobs: dict[str, bytes] = {}
        self._trees: dict[str, Mapping[str, bytes]] = {}
        self._known: dict[str, bool] = {}
        self._digests: dict[tuple[object, str], str] = {}
        self._behind: dict[tuple[object, str], tuple[tuple[str, ...], Mapping[str, bytes]]] = {}

    def has_whole_history(self) -> bool:
        """Return whether every commit below the current one can be read."""
        try:
            return self._git("rev-parse", "--is-shallow-repository").strip() == b"false"
        except (OSError, subprocess.CalledProcessError):
            return False

    def is_known(self, commit: str) -> bool:
        """Return whether the current commit stands on another.

        Commits that lie about in one clone only do not count.
        """
        if commit not in self._known:
            try:
                self._git("merge-base", "--is-ancestor", commit, "HEAD")
                self._known[commit] = True
            except (OSError, subprocess.CalledProcessError):
                self._known[commit] = False
        return self._known[commit]

    def digest_behind(self, command: str, commit: str = "") -> str:
        """Return a digest of the code that a command runs, its processes included.

        Args:
            command: as provenance records it.
            commit: that is known; "" for the working tree, as it was when it was first asked.

        Raises:
            ValueError: the command is neither a script's nor a verb's.
            FileNotFoundError: the tree does not hold the code that it runs.
        """
        key = (parts_of(command), commit)
        if key not in self._digests:
            self._digests[key] = digest_of(*self._files_behind(command, commit))
        return self._digests[key]

    def _files_behind(
        self, command: str, commit: str
    ) -> tuple[tuple[str, ...], Mapping[str, bytes]]:
        key = (parts_of(command), commit)
        if key not in self._behind:
            self._behind[key] = files_behind(command, self.at(commit) if commit else self.now)
        return self._behind[key]

    def changed_since(self, command: str, commit: str) -> list[str]:
        """Return the files behind a command that are not what they were at a commit.

        A file counts where nothing behind the command held the same then, or holds the same now:
        one that only moved does not.

        Args:
            command: as provenance records it.
            commit: that is known.

        Raises:
            ValueError, FileNotFoundError: as `digest_behind`.
        """
        now, then = (
            {path: _digest_of_one(path, sources) for path in files}
            for files, sources in (self._files_behind(command, tree) for tree in ("", commit))
        )
        same = set(now.values()) & set(then.values())
        changed = [path for path, digest in now.items() if digest not in same]
        gone = [path for path, digest in then.items() if digest not in same and path not in now]
        return sorted([*changed, *gone])

    def at(self, commit: str) -> Mapping[str, bytes]:
        """Return the Python files at a commit that is known."""
        if commit not in self._trees:
            self._trees[commit] = self._read_tree(commit)
        return self._trees[commit]

    def _read_tree(self, commit: str) -> Mapping[str, bytes]:
        blobs = {}
        for line in filter(None, self._git("ls-tree", "-r", "-z", commit).decode().split("\0")):
            described, path = line.split("\t", 1)
            if path.endswith(".py"):
                blobs[path] = described.split()[2]
        missing = sorted(set(blobs.values()) - set(self._blobs))
        self._blobs |= zip(missing, self._read(missing), strict=True)
        return {path: self._blobs[blob] for path, blob in blobs.items()}

    def _read(self, blobs: Sequence[str]) -> list[bytes]:
        out = self._git("cat-file", "--batch", given="".join(f"{b}\n" for b in blobs).encode())
        read = []
        while out:
            head, _, rest = out.partition(b"\n")
            size = int(head.split()[2])
            read.append(rest[:size])
            out = rest[size + 1 :]
        return read

    def _git(self, *arguments: str, given: bytes = b"") -> bytes:
        command = ["git", "-C", str(self.root), *arguments]
        return subprocess.run(command, input=given, capture_output=True, check=True).stdout


_known_digests: dict[tuple[str, bytes], str] = {}


def _digest_of_one(path: str, sources: Mapping[str, bytes]) -> str:
    # Alone, a file's digest depends on nothing else: where its imports lead is left out.
    key = (path, sources[path])
    if key not in _known_digests:
        _known_digests[key] = digest_of([path], sources)
    return _known_digests[key]


def files_behind(
    command: str, sources: Mapping[str, bytes]
) -> tuple[tuple[str, ...], Mapping[str, bytes]]:
    """Return the files that decide what a command measures, and the tree to read them in.

    Of a verb with subjects the tree holds only what the subject's function uses.

    Args:
        command: as provenance records it.
        sources: Python files of a tree, by path.

    Raises:
        ValueError: the command is neither a script's nor a verb's.
        FileNotFoundError: the tree does not hold the code that it runs.
    """
    script, verb, subject = parts_of(command)
    if script is not None:
        root = script if script in sources else MOVED.get(script, script)
        name = root
    else:
        root = VERB_MODULE.format(verb=verb.replace("-", "_"))
        name = f"{verb} {subject}".strip()
    if subject:
        path = root.replace(".", "/") + ".py"
        if path not in sources:
            raise FileNotFoundError(f"there is no {path}")
        part = {path: _only(f"_{subject}", sources[path], path)}
        # Which asks for mappings that can be written to, and writes to the first alone.
        sources = ChainMap(part, cast(dict[str, bytes], sources))
    roots = [root, *_modules_of(STARTED.get(name, ()), sources)]
    closure = import_closure(roots, sources)
    kept = tuple(path for path in closure if PurePosixPath(path).stem not in _RECORD_KEEPERS)
    return kept, sources


def parts_of(command: str) -> tuple[str | None, str, str]:
    """Return a command's script, or its verb and its subject: all that decides its code.

    Raises:
        ValueError: the command is neither a script's nor a verb's.
    """
    words = shlex.split(command)
    if words[:1] == ["python"]:
        words = words[1:]
    program, *arguments = words or [""]
    is_command_line = PurePosixPath(program).parts[-2:] == ("cli", "main.py")
    if program == PACKAGES[0] or is_command_line:
        verb, *rest = arguments or [""]
        if re.fullmatch(r"[a-z][a-z-]*", verb):
            if verb not in WITH_SUBJECTS:
                return None, verb, ""
            if rest and re.fullmatch(r"[a-z][a-z_]*", rest[0]):
                return None, verb, rest[0]
    elif program.endswith(".py"):
        return program.removeprefix("./"), "", ""
    raise ValueError(
        f"the command {command!r} is neither `python SCRIPT.py ...` nor `dotsim_ros VERB ...`"
    )


def _only(function: str, source: bytes, path: str) -> bytes:
    """Return what of a module a function of it uses, itself included."""
    tree = ast.parse(source)
    defined: dict[str, ast.stmt] = {}
    for statement in tree.body:
        match statement:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                defined[name] = statement
            case ast.Assign([ast.Name(name)]) | ast.AnnAssign(ast.Name(name)):
                defined[name] = statement
    if function not in defined:
        raise FileNotFoundError(f"{path} has no function {function}")
    used: dict[str, ast.stmt] = {}
    waiting = [function]
    while waiting:
        name = waiting.pop()
        if name in defined and name not in used:
            used[name] = defined[name]
            names = [n for n in ast.walk(defined[name]) if isinstance(n, ast.Name)]
            # A variable of a function may have the name of another function.
            own = {n.id for n in names if isinstance(n.ctx, ast.Store)}
            waiting += [n.id for n in names if n.id not in own]
    kept = [
        statement
        for statement in tree.body
        if isinstance(statement, ast.Import | ast.ImportFrom) or statement in used.values()
    ]
    return ast.unparse(ast.Module(kept, [])).encode()


def _modules_of(started: Sequence[str], sources: Mapping[str, bytes]) -> list[str]:
    """Return the modules of what is started, of executables as the package installs them."""
    executables = [name for name in started if "." not in name]
    if not executables:
        return list(started)
    written = sources[_ENTRY_POINTS].decode() if _ENTRY_POINTS in sources else ""
    known = dict(re.findall(r'"(\w+) = ([\w.]+):\w+"', written))
    missing = sorted(set(executables) - set(known))
    if missing:
        raise FileNotFoundError(f"{_ENTRY_POINTS} installs no {', '.join(missing)}")
    return [known.get(name, name) for name in started]
