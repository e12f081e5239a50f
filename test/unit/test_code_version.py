# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Import closures and digests of code, on small made-up packages and on this one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dotsim_ros.code_version import FolderSources, digest_of, import_closure, version_of

ROOT = Path(__file__).resolve().parents[2]


def tree(modules: dict[str, str]) -> dict[str, bytes]:
    """Return sources of a package; "a/b" is dotsim_ros/a/b.py."""
    return {f"dotsim_ros/{name}.py": source.encode() for name, source in modules.items()} | {
        "dotsim_ros/__init__.py": b'_HOMES = {"Gel": "dotsim_ros.gel", "Eye": ".eye"}\n'
    }


def closure(root: str, modules: dict[str, str]) -> set[str]:
    return {
        path.removeprefix("dotsim_ros/").removesuffix(".py")
        for path in import_closure([root], tree(modules))
    }


def digest(sources: dict[str, bytes]) -> str:
    return digest_of(sources, sources)


def test_a_closure_follows_imports_of_every_form():
    found = closure(
        "dotsim_ros.a",
        {
            "a": "import numpy\nimport dotsim_ros.b\nfrom dotsim_ros import c\nfrom .d import D",
            "b": "def late():\n    from dotsim_ros.e import E",
            "c": "",
            "d": "class D: pass",
            "e": "from dotsim_ros.a import late",
            "f": "import dotsim_ros.a",
        },
    )
    assert found == {"a", "b", "c", "d", "e"}


def test_imports_for_type_checkers_are_left_out_and_their_alternative_is_not():
    source = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import dotsim_ros.b"
    assert closure("dotsim_ros.a", {"a": source, "b": "", "c": ""}) == {"a"}
    either = f"{source}\nelse:\n    import dotsim_ros.c"
    assert closure("dotsim_ros.a", {"a": either, "b": "", "c": ""}) == {"a", "c"}


def test_a_name_from_the_front_door_leads_to_the_module_of_its_table():
    for source in (
        "from dotsim_ros import Gel",
        "import dotsim_ros\ndotsim_ros.Gel()",
        "import dotsim_ros as d\nprint(d.__version__, d.Gel)",
    ):
        assert closure("dotsim_ros.a", {"a": source, "gel": "", "eye": ""}) == {"a", "gel"}
    assert closure("dotsim_ros.a", {"a": "from dotsim_ros import Eye", "gel": "", "eye": ""}) == {
        "a",
        "eye",
    }
    with pytest.raises(FileNotFoundError, match="takes Nose from dotsim_ros"):
        closure("dotsim_ros.a", {"a": "from dotsim_ros import Nose"})


def test_modules_that_are_imported_by_name_are_found():
    shelf = {"shelf/__init__": "", "shelf/one": "", "shelf/two": "", "other": ""}
    all_of_it = {"a", "shelf/__init__", "shelf/one", "shelf/two"}
    written_out = "import importlib\nimportlib.import_module('dotsim_ros.shelf.one')"
    assert closure("dotsim_ros.a", {"a": written_out, **shelf}) == all_of_it - {"shelf/two"}
    started = "from importlib import import_module\nimport_module(f'dotsim_ros.shelf.{name}')"
    assert closure("dotsim_ros.a", {"a": started, **shelf}) == all_of_it
    listed = (
        "import importlib\nfrom dotsim_ros import shelf as s\n"
        "importlib.import_module(f'{s.__name__}.{name}')"
    )
    assert closure("dotsim_ros.a", {"a": listed, **shelf}) == all_of_it


def test_a_script_may_import_one_beside_it():
    sources = tree({"a": "import b"}) | {
        "benchmarks/run.py": b"import shared, numpy\nimport dotsim_ros.a",
        "benchmarks/shared.py": b"",
        "dotsim_ros/b.py": b"",
    }
    assert import_closure(["benchmarks/run.py"], sources) == (
        "benchmarks/run.py",
        "benchmarks/shared.py",
        "dotsim_ros/a.py",
    )


def test_what_is_not_there_is_refused_with_its_name():
    with pytest.raises(FileNotFoundError, match=r"dotsim_ros/a\.py imports dotsim_ros\.gone"):
        closure("dotsim_ros.a", {"a": "import dotsim_ros.gone"})
    with pytest.raises(FileNotFoundError, match=r"dotsim_ros\.gone is asked for"):
        closure("dotsim_ros.gone", {})
    with pytest.raises(FileNotFoundError, match=r"no script gone\.py"):
        closure("gone.py", {})
    with pytest.raises(FileNotFoundError, match=r"a\.py is not there.*with its \.py files"):
        digest_of(["dotsim_ros/a.py"], {})
    with pytest.raises(ValueError, match=r"dotsim_ros/a\.py cannot be read as Python"):
        closure("dotsim_ros.a", {"a": "def ("})


CODE = '''"""A module."""

import math
from dotsim_ros.b import B

__all__ = ["area"]
FACTOR = 2.0


def area(radius_m: float) -> float:
    """Return an area."""
    # Of a disc.
    return FACTOR * math.pi * radius_m**2
'''


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("A module.", "Another text."),
        ('    """Return an area."""\n', ""),
        ("    # Of a disc.\n", ""),
        ("FACTOR * math.pi", "(FACTOR\n        * math.pi)"),
        ('["area"]', '["area", "FACTOR"]'),
        ("import math\nfrom dotsim_ros.b import B", "from dotsim_ros.b import B\nimport math"),
        ("\nFACTOR", "\nif TYPE_CHECKING:\n    from dotsim_ros.c import C\n\nFACTOR"),
    ],
)
def test_a_digest_ignores_what_does_nothing(old, new):
    before = tree({"a": CODE, "b": "B = 1", "c": "C = 1"})
    assert old in CODE
    assert digest(before) == digest(tree({"a": CODE.replace(old, new), "b": "B = 1", "c": "C = 1"}))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2.0", "3.0"),
        ("2.0", "2"),
        ("FACTOR * math.pi", "math.pi * FACTOR"),
        ("**2", "**3"),
        ("def area", "def space"),
        ("radius_m: float", "radius_m: float = 1.0"),
        ("    return", "    if radius_m:\n        return"),
        ("from dotsim_ros.b import B", "from dotsim_ros.c import B"),
        ("from dotsim_ros.b import B", "from dotsim_ros.b import C as B"),
        ("import math", "import cmath as math"),
    ],
)
def test_a_digest_sees_what_does_something(old, new):
    before = tree({"a": CODE, "b": "B = C = 1", "c": "B = 2"})
    assert old in CODE
    assert digest(before) != digest(
        tree({"a": CODE.replace(old, new), "b": "B = C = 1", "c": "B = 2"})
    )


def test_a_module_that_moves_changes_nothing():
    before = tree({"a": CODE + "\nfrom .e import E", "b": "B = 1", "e": "E = 1"})
    moved = CODE.replace("dotsim_ros.b", "dotsim_ros.inner.deep.c") + "\nfrom ..f import E"
    after = {"inner/z": moved, "inner/deep/c": "B = 1", "inner/__init__": '"""In."""', "f": "E = 1"}
    assert digest(before) == digest(tree(after))


def test_this_package_is_followed_to_all_that_it_loads():
    code = (
        "import sys, dotsim_ros.sensor\n"
        "print(*[m.__file__ for n, m in sys.modules.items() if n.split('.')[0] == 'dotsim_ros'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {Path(file).relative_to(ROOT).as_posix() for file in done.stdout.split()}
    found = import_closure(["dotsim_ros.sensor"])
    assert len(loaded) > 20
    assert loaded - {"dotsim_ros/__init__.py"} <= set(found)
    assert version_of("dotsim_ros.sensor") == digest_of(found, FolderSources(ROOT))
