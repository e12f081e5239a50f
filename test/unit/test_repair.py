# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`dotsim_ros record --repair`: a bag of what can be read of another."""

import json
import os
import shutil

import pytest
from mcap.records import Channel, Schema
from rosbags.highlevel import AnyReader
from test_mcap import content, write_bag

from dotsim_ros.cli.main import main
from dotsim_ros.data.bag import BagFile
from dotsim_ros.data.repair import repaired_path


@pytest.fixture
def bag(tmp_path):
    return write_bag(tmp_path / "press_0.5mm")


def repair(path, capsys, *arguments):
    status = main(["record", "--repair", str(path), *map(str, arguments)])
    said = capsys.readouterr()
    assert "Traceback" not in said.err
    return status, said.out, said.err


def test_unfinished_recording_becomes_the_bag_that_it_was_to_be(tmp_path, bag, capsys):
    expected = content(bag)
    partial = tmp_path / "press_0.5mm.partial"
    os.rename(bag, partial)
    (partial / "metadata.yaml").unlink()
    file = partial / "press_0.5mm.mcap"
    # Cut within the third of four chunks; what was reserved for it is zeros.
    octets = file.read_bytes()
    file.write_bytes(octets[: 5 * len(octets) // 8] + bytes(100_000))
    before = file.read_bytes()
    status, out, err = repair(partial, capsys, "--json", tmp_path / "what.json")
    assert status == 0
    assert f"{bag}: 24 messages (/image_raw 12, /wrench 12)" in out
    assert "was not finished" in err
    assert "is damaged in the chunk at byte" in err
    assert content(bag) == expected[:24]
    assert file.read_bytes() == before
    with AnyReader([bag]) as independent:
        assert independent.message_count == 24
    what = json.loads((tmp_path / "what.json").read_text())
    assert what["messages"] == {"/image_raw": 12, "/wrench": 12}
    assert what["damage"]


@pytest.mark.fault("bags and data sets", "a bag with a damaged chunk, repaired")
def test_damaged_chunk_is_left_out_and_named(bag, capsys, answered):
    expected = content(bag)
    file = bag / "press_0.5mm.mcap"
    octets = bytearray(file.read_bytes())
    octets[len(octets) // 3] ^= 1
    file.write_bytes(octets)
    status, out, err = repair(bag, capsys)
    assert status == 0
    assert len(err.splitlines()) == 1
    assert "is damaged in the chunk at byte" in err
    assert "log times 1.240 s to 1.440 s" in err
    made = repaired_path(bag)
    assert made.name == "press_0.5mm_repaired"
    assert content(made) == expected[:12] + expected[24:]
    answered(f"{err} {out}")


def test_neither_index_nor_header_is_needed(bag, capsys):
    expected, file = content(bag), bag / "press_0.5mm.mcap"
    octets = file.read_bytes()
    spoilt = bytearray(octets)
    spoilt[-300] ^= 1
    for changed, words in (
        (bytes(spoilt), "the checksum of its index does not match"),
        (octets[:8] + bytes(20) + octets[28:], "has no header"),
    ):
        file.write_bytes(changed)
        out = bag.parent / words.split()[-1]
        status, _, err = repair(file, capsys, "--out", out)
        assert (status, len(err.splitlines())) == (0, 1)
        assert words in err
        assert content(out) == expected


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda bag: shutil.rmtree(bag), "no bag at"),
        (lambda bag: os.truncate(bag / "press_0.5mm.mcap", 3000), "no message can be read"),
        (lambda bag: (bag.parent / "press_0.5mm_repaired").mkdir(), "exists already"),
    ],
)
def test_what_cannot_be_repaired_is_told_in_one_line(bag, capsys, spoil, reason):
    spoil(bag)
    before = sorted(path.name for path in bag.parent.iterdir())
    status, out, err = repair(bag, capsys)
    assert (status, out) == (1, "")
    assert reason in err
    assert len(err.splitlines()) == 1
    assert sorted(path.name for path in bag.parent.iterdir()) == before


def test_own_types_keep_their_definition_in_a_copy_of_a_whole_bag(tmp_path, capsys):
    with BagFile(tmp_path / "bag") as bag:
        schema = Schema(0, b"float64 value", "ros2msg", "my_msgs/msg/Own")
        bag.add_channel(Channel(0, "/own", "cdr", {"topic_type_hash": "RIHS01_00"}, 0), schema)
        bag.write_serialized("/own", 5, b"\x00\x01\x00\x00" + bytes(8))
    status, out, err = repair(tmp_path / "bag", capsys)
    assert (status, err) == (0, "")
    assert "1 messages" in out
    made = tmp_path / "bag_repaired"
    assert content(made) == content(tmp_path / "bag")
    assert "RIHS01_00" in (made / "metadata.yaml").read_text()
    assert b"float64 value" in (made / "bag_repaired.mcap").read_bytes()


def test_names_of_repaired_bags(tmp_path):
    assert repaired_path(tmp_path / "a.b.partial") == tmp_path / "a.b"
    assert repaired_path(tmp_path / "a.b") == tmp_path / "a.b_repaired"
    (tmp_path / "c.d.mcap").touch()
    assert repaired_path(tmp_path / "c.d.mcap") == tmp_path / "c.d_repaired"


def test_bag_in_sqlite3_is_told_to_be_none_of_ours(tmp_path, capsys):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from test_mcap import TYPESTORE, WRENCH, wrench

    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/wrench", WRENCH, typestore=TYPESTORE)
        writer.write(connection, 1, TYPESTORE.serialize_cdr(wrench(0), WRENCH))
    status, _, err = repair(tmp_path / "bag", capsys)
    assert status == 1
    assert "only mcap bags are repaired" in err
