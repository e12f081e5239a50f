# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Bags on the disk: others read what is written, and damage is reported."""

import random
import resource
import shutil
import struct
import subprocess
import sys
import zlib

import lz4.frame
import mcap.writer
import numpy as np
import pytest
from backports import zstd
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Schema, Statistics
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

import msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, TYPESTORE, BagFile, BagReader
from dotsim_ros.data.mcap import reader as reader_module
from dotsim_ros.data.mcap.reader import Tolerance
from dotsim_ros.data.mcap.records import HEAD, MAGIC, pack
from dotsim_ros.data.trajectory import decode_colour, read_trajectory

WRENCH = "geometry_msgs/msg/WrenchStamped"
IMAGE = "sensor_msgs/msg/Image"
COUNT = 24


def wrench(number, stamp_ns=None):
    return msg_adapters.encode_wrench_stamped(
        (float(number), 0.0, 0.0),
        (0.0, 0.0, 0.0),
        stamp_ns=10**9 + number * 40_000_000 if stamp_ns is None else stamp_ns,
        frame_id="base",
        types=BAG_TYPES,
    )


def image(number):
    pixels = np.random.default_rng(number).integers(0, 256, (60, 80, 3), dtype=np.uint8)
    stamp_ns = 10**9 + number * 40_000_000
    return msg_adapters.encode_image(
        pixels, encoding="rgb8", stamp_ns=stamp_ns, frame_id="camera", types=BAG_TYPES
    )


def write_bag(path, count=COUNT, every=6):
    """Write a bag of several chunks."""
    with BagFile(path) as bag:
        for number in range(count):
            stamp_ns = 10**9 + number * 40_000_000
            bag.write("/image_raw", stamp_ns, image(number))
            bag.write("/wrench", stamp_ns, wrench(number))
            if number % every == every - 1:
                bag.flush()
    return path


def content(path, tolerance=Tolerance.WHOLE):
    with BagReader(path, tolerance) as bag:
        return [
            (item.topic, item.message_type, item.log_time_ns, item.serialized)
            for item in bag.messages(*bag.topics())
        ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp("bags") / "whole")


@pytest.fixture
def copy(whole, tmp_path):
    """A bag to spoil, and its mcap file."""
    bag = tmp_path / "bag"
    shutil.copytree(whole, bag)
    return bag, bag / "whole.mcap"


def read_or_refused(path, tolerance=Tolerance.WHOLE):
    """Return the content of a bag, or None and the one line that refuses it."""
    try:
        return content(path, tolerance), ""
    except ValueError as error:
        text = str(error)
    assert "\n" not in text
    assert str(path) in text
    return None, text


def refusal(path):
    """Return the one line that refuses a bag."""
    found, text = read_or_refused(path)
    assert found is None, "the bag is read"
    return text


def test_others_read_what_is_written(whole):
    expected = content(whole)
    assert len(expected) == 2 * COUNT
    with AnyReader([whole]) as bag:
        assert bag.message_count == 2 * COUNT
        found = [(c.topic, c.msgtype, time_ns, bytes(data)) for c, time_ns, data in bag.messages()]
        messages = [bag.deserialize(data, c.msgtype) for c, _, data in bag.messages()]
    assert found == expected
    assert messages[0].width == 80
    with (whole / "whole.mcap").open("rb") as file:
        indexed = make_reader(file, validate_crcs=True)
        found = [
            (channel.topic, schema.name, message.log_time, message.data)
            for schema, channel, message in indexed.iter_messages()
        ]
        statistics = indexed.get_summary().statistics
    assert found == expected
    assert (statistics.message_count, statistics.chunk_count) == (2 * COUNT, 4)
    with (whole / "whole.mcap").open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True, emit_chunks=True).records)
    chunks = [each for each in records if type(each).__name__ == "Chunk"]
    assert [each.uncompressed_crc for each in chunks] == [zlib.crc32(each.data) for each in chunks]
    (end,) = [each for each in records if type(each).__name__ == "DataEnd"]
    assert end.data_section_crc != 0


@pytest.mark.parametrize("mode", ["none", "sqlite3", "file", "message", "storage"])
def test_other_storages_are_read(tmp_path, mode):
    """As rosbags writes them, without checksums, and as data sets of earlier versions are."""
    path = tmp_path / "bag"
    plugin = StoragePlugin.SQLITE3 if mode == "sqlite3" else StoragePlugin.MCAP
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode not in ("none", "sqlite3"):
        writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/wrench", WRENCH, typestore=TYPESTORE)
        for number in range(5):
            data = TYPESTORE.serialize_cdr(wrench(number), WRENCH)
            writer.write(connection, 10**9 + number, data)
    assert [each[2] for each in content(path)] == [10**9 + number for number in range(5)]
    if mode == "none":
        # Its file alone, too.
        assert content(path / "bag.mcap") == content(path)


@pytest.mark.parametrize(
    "options",
    [
        {"compression": mcap.writer.CompressionType.LZ4},
        {"compression": mcap.writer.CompressionType.ZSTD, "enable_crcs": False},
        {"use_chunking": False},
        {"index_types": mcap.writer.IndexType.NONE, "use_statistics": False},
        {"repeat_channels": False, "repeat_schemas": False},
    ],
    ids=["lz4", "zstd", "no chunks", "no index", "no definitions in the index"],
)
def test_every_way_of_writing_mcap_is_read(tmp_path, options):
    # Out of order, and chunks that overlap.
    times = [10**9 + (number * 37) % 200 for number in range(200)]
    path = written_by_mcap(tmp_path / "bag.mcap", times, chunk_size=4000, **options)[0]
    assert [time_ns for _, _, time_ns, _ in content(path)] == sorted(times)


def written_by_mcap(path, times, **options):
    """Return a file that PyPI's mcap wrote, and where its last message begins."""
    with path.open("wb") as file:
        writer = mcap.writer.Writer(file, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(WRENCH, "ros2msg", b"# as in ROS")
        channel = writer.register_channel("/wrench", "cdr", schema)
        for time_ns in times:
            place = file.tell()
            writer.add_message(channel, log_time=time_ns, data=bytes(50), publish_time=time_ns)
        writer.finish()
    return path, place


def test_file_without_chunks_is_read_up_to_where_it_is_cut(tmp_path):
    path, place = written_by_mcap(tmp_path / "bag.mcap", range(3), use_chunking=False)
    octets = path.read_bytes()
    # Within the head of the last record, and within its content.
    for length in (5, 30):
        path.write_bytes(octets[: place + length])
        assert [time_ns for _, _, time_ns, _ in content(path, Tolerance.UNFINISHED)] == [0, 1]


def test_order_does_not_depend_on_what_fits_into_memory(whole, tmp_path, monkeypatch):
    path = tmp_path / "bag"
    with BagFile(path) as bag:
        for number in range(60):
            # Every chunk reaches from the beginning to the end.
            bag.write("/wrench", 10**9 + (number * 17) % 60, wrench(number))
            if number % 10 == 9:
                bag.flush()
    expected = content(path)
    monkeypatch.setattr(reader_module, "KEPT_BYTES", 1)
    assert content(path) == expected
    assert [time_ns for _, _, time_ns, _ in expected] == [10**9 + number for number in range(60)]


def flipped(octets, place):
    spoilt = bytearray(octets)
    spoilt[place // 8] ^= 1 << place % 8
    return spoilt


@pytest.mark.fault("bags and data sets", "a flipped bit in an image of a bag")
def test_no_flipped_bit_passes_unseen(copy, whole, answered):
    bag, file = copy
    expected, octets = content(whole), file.read_bytes()
    draw = random.Random(16)
    answers = set()
    for _ in range(60):
        place = draw.randrange(8 * len(octets))
        file.write_bytes(flipped(octets, place))
        found, text = read_or_refused(bag)
        assert found in (None, expected), f"bit {place} changed the content unseen"
        answers.add(text)
    (answer,) = [text for text in answers if "log times 1.000 s to 1.200 s" in text]
    assert "its checksum does not match" in answer
    assert "record --repair" in answer
    answered(answer)


@pytest.mark.parametrize("region", ["head", "end", "metadata.yaml"])
def test_no_flipped_bit_of_what_holds_a_bag_together_passes_unseen(copy, whole, region):
    bag, file = copy
    target = bag / "metadata.yaml" if region == "metadata.yaml" else file
    expected, octets = content(whole), target.read_bytes()
    length = 8 * len(octets)
    places = {"head": range(0, 8 * 150, 13), "end": range(length - 8 * 1200, length, 97)}
    for place in places.get(region, range(0, length, 89)):
        target.write_bytes(flipped(octets, place))
        found, _ = read_or_refused(bag)
        assert found in (None, expected), f"bit {place} changed the content unseen"


def test_time_in_the_head_of_a_chunk_is_compared_with_the_index(copy):
    bag, file = copy
    octets = file.read_bytes()
    file.write_bytes(flipped(octets, 8 * (45 + HEAD.size)))
    assert "its head differs from the index" in refusal(bag)


@pytest.mark.fault("bags and data sets", "a bag's file cut short")
def test_cut_file_is_refused_and_read_up_to_its_end_when_asked(copy, whole, answered):
    bag, file = copy
    expected, octets = content(whole), file.read_bytes()
    for length in (*range(0, 64, 7), *range(64, len(octets), len(octets) // 23), len(octets) - 1):
        file.write_bytes(octets[:length])
        answer = refusal(bag)
        found, _ = read_or_refused(bag, Tolerance.DAMAGED)
        if length < len(MAGIC):
            assert found is None
            continue
        assert found == expected[: len(found)]
        # Chunks of twelve messages; all that are whole are there.
        assert len(found) >= 12 * (length * 4 // len(octets) - 1)
    assert "was not finished or is cut off" in answer
    answered(answer)


def chunk_of(size, packed, compression=""):
    """Return a chunk that says that it unpacks to `size`."""
    return pack(
        Chunk(
            compression=compression,
            data=packed,
            message_end_time=1,
            message_start_time=0,
            uncompressed_crc=0,
            uncompressed_size=size,
        )
    )


def with_chunk(octets, chunk):
    """Return a file that holds that chunk alone, and no index."""
    return octets[:45] + chunk + octets[-37:-28] + struct.pack("<QQI", 0, 0, 0) + MAGIC


def with_index(octets, chunk_length):
    """Return a file of nothing but an index, of one chunk at byte 8."""
    index = b"".join(
        map(
            pack,
            [
                Schema(1, b"", "ros2msg", WRENCH),
                Channel(1, "/wrench", "cdr", {}, 1),
                Statistics(0, 1, {1: 1}, 1, 1, 1, 0, 0, 1),
                ChunkIndex(chunk_length, 8, "", 0, 1, 0, {1: 0}, 0, 0),
            ],
        )
    )
    return octets[:45] + index + pack(Footer(45, 0, 0)) + MAGIC


HOSTILE = {
    "a file of no bytes": lambda octets: b"",
    "random bytes behind the magic of mcap": lambda octets: (
        MAGIC + random.Random(3).randbytes(50_000)
    ),
    "a record of 2^62 bytes": lambda octets: (
        octets[:45] + HEAD.pack(Opcode.CHUNK, 2**62) + octets[54:]
    ),
    "a header of 2^40 bytes": lambda octets: MAGIC + HEAD.pack(Opcode.HEADER, 2**40) + octets[17:],
    "a chunk that unpacks to 2^62 bytes": lambda octets: with_chunk(octets, chunk_of(2**62, b"")),
    "a chunk of 20 kB that unpacks to 600 MB, not to 1 kB": lambda octets: with_chunk(
        octets, chunk_of(1000, zstd.compress(bytes(600_000_000)), "zstd")
    ),
    "a chunk packed by an unknown method": lambda octets: with_chunk(
        octets, chunk_of(3, b"abc", "rar")
    ),
    "half a packed chunk": lambda octets: with_chunk(
        octets, chunk_of(10**5, lz4.frame.compress(octets[: 10**5])[:999], "lz4")
    ),
    "an index of a chunk of 3 bytes": lambda octets: with_index(octets, 3),
    "an index that lies beyond the file": lambda octets: (
        octets[:-28] + struct.pack("<QQI", 2**50, 0, 0) + MAGIC
    ),
    "a file whose first 100 kB are missing behind its header": lambda octets: (
        octets[:45] + octets[100_000:]
    ),
}


@pytest.mark.parametrize("fault", HOSTILE)
@pytest.mark.fault("bags and data sets", "")
def test_hostile_file_is_refused_in_one_line(copy, fault, answered):
    bag, file = copy
    octets = file.read_bytes()
    assert octets[45] == Opcode.CHUNK
    file.write_bytes(HOSTILE[fault](octets))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    answered(refusal(bag), what=fault)
    read_or_refused(bag, Tolerance.DAMAGED)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 600_000


def broken_metadata(change):
    def write(bag):
        path = bag / "metadata.yaml"
        path.write_text(change(path.read_text()))

    return write


FOLDERS = {
    "a bag without its metadata.yaml": lambda bag: (bag / "metadata.yaml").unlink(),
    "a metadata.yaml cut short": broken_metadata(lambda text: text[:333]),
    "a metadata.yaml of something else": broken_metadata(lambda text: "bag: whole.mcap\n"),
    "a metadata.yaml that names a file that is not there": broken_metadata(
        lambda text: text.replace("whole.mcap", "other.mcap")
    ),
    "a metadata.yaml that names no file": broken_metadata(
        lambda text: text.replace("- whole.mcap", "- 3")
    ),
    "a metadata.yaml of an unknown storage": broken_metadata(
        lambda text: text.replace("storage_identifier: mcap", "storage_identifier: tape")
    ),
    "a bag without its mcap file": lambda bag: (bag / "whole.mcap").unlink(),
}


@pytest.mark.parametrize("fault", FOLDERS)
@pytest.mark.fault("bags and data sets", "")
def test_folder_in_disorder_is_refused_in_one_line(copy, fault, answered):
    bag, _ = copy
    FOLDERS[fault](bag)
    answered(refusal(bag), what=fault)


def test_pipe_in_place_of_a_bag_does_not_hang(tmp_path):
    subprocess.run(["mkfifo", str(tmp_path / "bag.mcap")], check=True)
    assert "is no file" in refusal(tmp_path / "bag.mcap")


def test_bag_of_several_files_is_read_in_order(tmp_path):
    """As ros2 bag record --max-bag-size leaves it."""
    bag = write_bag(tmp_path / "bag", count=4)
    second = tmp_path / "second"
    with BagFile(second) as file:
        for number in range(4, 8):
            file.write("/wrench", 10**9 + number * 40_000_000, wrench(number))
    shutil.copy(second / "second.mcap", bag / "bag_1.mcap")
    path = bag / "metadata.yaml"
    path.write_text(path.read_text().replace("- bag.mcap", "- bag.mcap\n  - bag_1.mcap"))
    with BagReader(bag) as reader:
        found = [item.message().wrench.force.x for item in reader.messages("/wrench")]
    assert found == list(range(8))


@pytest.mark.fault("messages", "a message shorter than its type")
def test_short_message_is_named(tmp_path, answered):
    data = bytes(TYPESTORE.serialize_cdr(wrench(0), WRENCH))
    with BagFile(tmp_path / "bag") as bag:
        bag.add_topic("/indenter/wrench", WRENCH)
        for length in range(0, len(data), 7):
            bag.write_serialized("/indenter/wrench", length, data[:length])
    with BagReader(tmp_path / "bag") as bag:
        for item in bag.messages("/indenter/wrench"):
            with pytest.raises(ValueError, match="is no whole geometry_msgs"):
                item.message()
    with pytest.raises(ValueError, match="is no whole geometry_msgs") as refused:
        read_trajectory(tmp_path / "bag")
    answered(refused.value)


CLAIMS = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30, 3 * 2**30))
import numpy as np, msg_adapters
from dotsim_ros.data.bag import BAG_TYPES, TYPESTORE, BagMessage
from dotsim_ros.data.trajectory import decode_colour
def told(decode, kind, message):
    data = bytes(TYPESTORE.serialize_cdr(message, kind))
    try:
        decode(BagMessage("/topic", kind, 0, data).message())
    except ValueError as error:
        print(" ".join(str(error).split()))
head = dict(stamp_ns=1, frame_id="a", types=BAG_TYPES)
cloud = msg_adapters.encode_cloud(np.zeros((4, 3)), **head)
cloud.width = cloud.row_step = 4_000_000_000
told(msg_adapters.decode_cloud, "sensor_msgs/msg/PointCloud2", cloud)
image = msg_adapters.encode_image(np.zeros((4, 4, 3), np.uint8), encoding="rgb8", **head)
image.width = image.height = 65535
image.step = 3 * 65535
told(decode_colour, "sensor_msgs/msg/Image", image)
for compression in ("png", "jpeg"):
    pixels = np.zeros((64, 64, 3), np.uint8)
    small = msg_adapters.encode_compressed_image(pixels, compression=compression, **head)
    data = bytes(small.data)
    for side in (30_000, 65_535):
        if compression == "png":
            start, size = 16, side.to_bytes(4, "big")
        else:
            start, size = data.index(b"\\xff\\xc0") + 5, side.to_bytes(2, "big")
        octets = data[:start] + 2 * size + data[start + 2 * len(size):]
        small.data = np.frombuffer(octets, np.uint8)
        told(decode_colour, "sensor_msgs/msg/CompressedImage", small)
small.data = np.frombuffer(b"GIF89a" + bytes(100), np.uint8)
told(decode_colour, "sensor_msgs/msg/CompressedImage", small)
# A sequence that claims more than the message holds.
data = bytearray(TYPESTORE.serialize_cdr(image, "sensor_msgs/msg/Image"))
place = data.index((48).to_bytes(4, "little"), 40)
data[place:place + 4] = (4_000_000_000).to_bytes(4, "little")
try:
    BagMessage("/topic", "sensor_msgs/msg/Image", 0, bytes(data)).message()
except ValueError as error:
    print(" ".join(str(error).split()))
"""


def test_claims_of_messages_cost_no_memory():
    done = subprocess.run([sys.executable, "-c", CLAIMS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = done.stdout.splitlines()
    assert len(told) == 8, told
    assert "cloud row_step of 4000000000 bytes is too short for 4000000000 points" in told[0]
    assert "image holds 48 bytes, expected step * height" in told[1]
    for words, side in zip(told[2:6], (30_000, 65_535, 30_000, 65_535), strict=True):
        assert f"{side} x {side} pixels, expected at most" in words
    assert "expected a whole PNG or JPEG file" in told[6]
    assert "is no whole sensor_msgs/msg/Image" in told[7]


@pytest.mark.fault("messages", "a JPEG file that is cut off")
def test_compressed_image_that_is_cut_off_is_refused(answered):
    """Of such a JPEG OpenCV makes an image that is grey where nothing came."""
    pixels = np.random.default_rng(0).integers(0, 256, (90, 90, 3), dtype=np.uint8)
    for compression in ("png", "jpeg"):
        message = msg_adapters.encode_compressed_image(
            pixels, compression=compression, stamp_ns=1, frame_id="", types=BAG_TYPES
        )
        octets = bytes(message.data)
        message.data = np.frombuffer(octets + bytes(100), np.uint8)
        assert decode_colour(message).shape == pixels.shape
        for length in (len(octets) // 4, len(octets) // 2, len(octets) - 20):
            message.data = np.frombuffer(octets[:length], np.uint8)
            with pytest.raises(ValueError, match="expected a whole PNG or JPEG file") as refused:
                decode_colour(message)
    answered(refused.value)
