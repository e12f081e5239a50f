# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""YAML, JSON and arrays: whatever a file holds, an answer in one line, soon, in little memory."""

from __future__ import annotations

import io
import pickle
import resource
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dotsim_ros.data.data_set import read_data_set
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.io.documents import (
    ArrayForm,
    parse_json,
    parse_yaml,
    read_arrays,
    read_json,
    read_table,
    read_yaml,
)
from dotsim_ros.specification import load_sensor

Answered = Callable[..., None]

# Nine levels of nine aliases each: a few hundred bytes that stand for some 400 million entries.
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)

YAML_FAULTS = {
    "aliases nested nine levels deep": (BOMB, "more than 200000 entries"),
    "an alias within what it stands for": ("gel: &g {shape: *g}", "within what it stands for"),
    "3,000 nested brackets": ("gel: " + 3000 * "[" + 3000 * "]", "nested deeper than 50"),
    "brackets that are not closed": ("gel: {shape: dome", "expected ',' or '}'"),
    "a name given twice": ("gel: {shape: dome}\ngel: {}", "line 2, column 1: 'gel' is given twice"),
    "numbers and texts for names": ("gel: {1: 2, shape: dome}", "'1' is no text and so no name"),
    "a list for a name": ("? [gel, solver]\n: 1", "is no text and so no name"),
    "a date that does not exist": ("name: 2026-99-99", "month must be in 1..12"),
    "a tag of Python's": ("name: !!python/object/apply:os.system [true]", "could not determine"),
    "a truth value that is none": ("name: !!bool perhaps", "holds a value that YAML cannot read"),
    "a whole number of 10,000 digits": ("name: " + 10_000 * "9", "Exceeds the limit"),
    "a control character": ("name: \x07", "special characters are not allowed"),
}


@pytest.mark.fault("sensor and YAML files", "")
@pytest.mark.parametrize("what", YAML_FAULTS)
def test_yaml_is_refused_in_one_line_with_its_place(what, tmp_path, answered):
    text, expected = YAML_FAULTS[what]
    path = tmp_path / "sensor.yaml"
    path.write_text(text, encoding="utf-8")
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun_s = time.process_time()
    with pytest.raises(ValueError, match=r"sensor\.yaml") as refused:
        load_sensor(path)
    # Not a figure of speed: without bounds this takes minutes and gigabytes, or never ends.
    assert time.process_time() - begun_s < 20.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 500_000
    words = str(refused.value)
    assert expected in words
    assert "\n" not in words
    assert len(words) < 400 + len(str(path))
    answered(words, what=what)


@pytest.mark.fault("sensor and YAML files", "a file that is not in UTF-8")
def test_text_in_another_encoding(tmp_path, answered):
    path = tmp_path / "sensor.yaml"
    path.write_bytes("name: Fühler".encode("latin-1"))
    for read in (load_sensor, load_indenter, read_yaml, read_json):
        with pytest.raises(ValueError, match=r"no text in UTF-8 \(byte 7 is 0xfc\)") as refused:
            read(path)
    answered(refused.value)


@pytest.mark.fault("sensor and YAML files", "a file of 2 MB")
def test_large_file(tmp_path, answered):
    path = tmp_path / "sensor.yaml"
    path.write_text("# " + 2_000_000 * "x")
    with pytest.raises(ValueError, match="larger than the 1000000 bytes") as refused:
        load_sensor(path)
    answered(refused.value)


@pytest.mark.fault("sensor and YAML files", "a folder in place of a file")
def test_folder(tmp_path, answered):
    path = tmp_path / "sensor.yaml"
    path.mkdir()
    with pytest.raises(ValueError, match="is a folder, expected a file") as refused:
        load_sensor(path)
    answered(refused.value)


def test_yaml_is_read_as_version_1_2_reads_numbers():
    expected = {"a": 3e5, "b": 1.5e-3, "c": -4, "d": 3e5, "e": 3e5}
    assert parse_yaml("{a: 3e5, b: 1.5E-3, c: -4, d: 30.E+4, e: +.3e6}", "here") == expected


def test_aliases_and_merges_within_bounds_are_read():
    text = "base: &base {a: 1}\nboth: [*base, *base]\nmore: {<<: *base, b: 2}\n"
    assert parse_yaml(text, "here") == {
        "base": {"a": 1},
        "both": [{"a": 1}, {"a": 1}],
        "more": {"a": 1, "b": 2},
    }


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (100_000 * "[", "nested too deeply"),
        ('{"a": 1, "a": 2}', "'a' is given twice"),
        ('{"a": ', "Expecting value"),
        ("", "Expecting value"),
        ("9" * 10_000, "Exceeds the limit"),
    ],
)
def test_json_is_refused_in_one_line(text, expected):
    with pytest.raises(ValueError, match=f"^card.json is no valid JSON: .*{expected}"):
        parse_json(text, "card.json")


# -- arrays --

SKIN = {
    "rest_position_m": np.zeros((4, 3)),
    "triangles": np.zeros((2, 3), dtype=np.int32),
    "on_base": np.zeros(4, dtype=bool),
}


def _tetrahedron() -> dict[str, np.ndarray]:
    corner = 5e-3 * np.array([[1.0, 0, 0], [0, 1, 0], [-1, -1, 0], [0, 0, 1]])
    faces = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]], dtype=np.int32)
    return {"rest_position_m": corner, "triangles": faces, "on_base": corner[:, 2] == 0.0}


def _promising(shape: str) -> bytes:
    """Return an .npy member whose header promises an array of another shape."""
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.zeros(4))
    content = stream.getvalue()
    begin = content.index(b"'shape': ")
    end = content.index(b", }", begin)
    header = content[:begin] + f"'shape': {shape}".encode() + content[end:]
    excess = len(header) - len(content)
    return header.replace(b" " * excess + b"\n", b"\n", 1)


def _archive(path: Path, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)


def _cut(path: Path) -> None:
    np.savez(path, **_tetrahedron())
    path.write_bytes(path.read_bytes()[:-40])


def _flipped(path: Path) -> None:
    np.savez(path, **_tetrahedron())
    content = bytearray(path.read_bytes())
    content[content.index(b"\x93NUMPY") + 160] ^= 1
    path.write_bytes(bytes(content))


def _objects(path: Path) -> None:
    np.savez(path, **{**_tetrahedron(), "triangles": np.array([{"a": 1}], dtype=object)})


def _with(**changed: np.ndarray) -> Callable[[Path], None]:
    return lambda path: np.savez(path, **{**_tetrahedron(), **changed})


def _without(name: str) -> Callable[[Path], None]:
    return lambda path: np.savez(
        path, **{key: value for key, value in _tetrahedron().items() if key != name}
    )


def _huge(path: Path) -> None:
    _archive(path, dict.fromkeys(SKIN, _promising("(10000000000000, 3)")))


ARRAY_FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a skin_mesh.npz cut short": (_cut, "is broken or no .npz file"),
    "a flipped bit in skin_mesh.npz": (_flipped, "is broken or no .npz file"),
    "an empty skin_mesh.npz": (lambda path: path.write_bytes(b""), "is broken or no .npz file"),
    "a pickle named skin_mesh.npz": (
        lambda path: path.write_bytes(pickle.dumps(SKIN)),
        "is broken or no .npz file",
    ),
    "Python objects in skin_mesh.npz": (_objects, "holds Python objects, expected numbers"),
    "a skin_mesh.npz that promises 240 TB": (_huge, "is broken: an array of shape"),
    "a skin_mesh.npz without triangles": (_without("triangles"), "has no array triangles"),
    "a skin with a vertex that is not a number": (
        _with(rest_position_m=np.full((4, 3), np.nan)),
        "holds a number that is not finite",
    ),
    "a skin of vertices with two coordinates": (
        _with(rest_position_m=np.zeros((4, 2))),
        "expected numbers of shape (any, 3)",
    ),
    "a skin in millimetres": (
        _with(rest_position_m=1e3 * _tetrahedron()["rest_position_m"]),
        "if these are millimetres, multiply by 0.001",
    ),
    "a skin whose triangles name vertices that are not there": (
        _with(triangles=np.array([[0, 1, 9]])),
        "triangles name vertices 0 to 9",
    ),
    "a skin whose base is marked for other vertices": (
        _with(on_base=np.zeros(7, dtype=bool)),
        "on_base says of 7 vertices",
    ),
}


@pytest.mark.fault("bags and data sets", "")
@pytest.mark.parametrize("what", ARRAY_FAULTS)
def test_arrays_are_refused_in_one_line(what, tmp_path, answered):
    make, expected = ARRAY_FAULTS[what]
    (tmp_path / "press").mkdir()
    (tmp_path / "dataset.yaml").write_text("trajectories: [{bag: press}]")
    make(tmp_path / "skin_mesh.npz")
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=r"skin_mesh\.npz") as refused:
        read_data_set(tmp_path).skin_mesh()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 500_000
    words = str(refused.value)
    assert expected in words
    assert "pickle" not in words
    assert "\n" not in words
    answered(words, what=what)


@pytest.mark.fault("bags and data sets", "a dataset.yaml that names one bag twice")
def test_bag_named_twice(tmp_path, answered):
    (tmp_path / "press").mkdir()
    (tmp_path / "dataset.yaml").write_text("trajectories: [{bag: press}, {bag: press}]")
    with pytest.raises(ValueError, match="two trajectories have the name 'press'") as refused:
        read_data_set(tmp_path)
    answered(refused.value)


def test_whole_arrays_are_read(tmp_path):
    path = tmp_path / "skin.npz"
    given = {**_tetrahedron(), "name": np.array("dome"), "none": np.zeros((0, 3))}
    for save in (np.savez, np.savez_compressed):
        save(path, **given)
        read = read_arrays(path)
        assert read.keys() == given.keys()
        assert all(np.array_equal(read[name], given[name]) for name in given)
    only = read_arrays(path, {"name": ArrayForm((), "text")})
    assert set(only) == {"name"}


TABLE_FAULTS = {
    "a table with a name that is there twice": (
        "x,y, x\n1,2,3\n",
        "line 1, column 3: the name 'x'",
    ),
    "a table of tabs": ("x\ty\n1\t2\n", "line 1: tabs divide the names, expected commas"),
    "a table with a number that is not finite": (
        "x,y\n1,nan\n",
        "line 2, column y: 'nan' is not a",
    ),
    "a table with a unit in a cell": ("x,y\n1,2 mm\n", "line 2, column y: '2 mm' is not a number"),
    "a table with quotes that do not end": ('x,y\n1,"2\n3,4\n', "line 3: no valid CSV"),
}


@pytest.mark.fault("bags and data sets", "")
@pytest.mark.parametrize("what", TABLE_FAULTS)
def test_tables_are_refused_with_their_line(what, tmp_path, answered):
    text, expected = TABLE_FAULTS[what]
    (tmp_path / "table.csv").write_text(text)
    with pytest.raises(ValueError, match=r"table\.csv") as refused:
        read_table(tmp_path / "table.csv").numbers("y")
    assert expected in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    answered(refused.value, what=what)


def test_whole_tables_are_read(tmp_path):
    # As Excel writes it, with an index column without a name.
    (tmp_path / "table.csv").write_bytes(
        b'\xef\xbb\xbf,x_mm, note\r\n0, 1e3 ,"a, b"\r\n\r\n1,-.5,\r\n'
    )
    table = read_table(tmp_path / "table.csv")
    assert table.columns == ("", "x_mm", "note")
    assert table.numbers("x_mm").tolist() == [1000.0, -0.5]
    assert table.texts("note") == ["a, b", ""]
    assert table.lines == (2, 4)
    with pytest.raises(ValueError, match="no column y among , x_mm, note"):
        table.numbers("y")
