# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The command line and its `view`: real files of a real bag, read back."""

import os
import resource
import shutil
import struct
import subprocess
import sys

import cv2
import imageio.v2 as imageio
import numpy as np
import pytest

import msg_adapters
from dotsim_ros.cli.main import main, verbs
from dotsim_ros.data.bag import BAG_TYPES, BagFile, BagReader
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.view.sheet import strongest_stamps
from dotsim_ros.view.skin_map import SkinMap
from dotsim_ros.view.timeline import BagMoment, Forces, ViewTopics, find_topics, open_timeline
from dotsim_ros.view.video import paced

PERIOD_NS = 40_000_000
COUNT = 8


def view(bag, out, *options):
    return main(["view", str(bag), "--out", str(out), *options])


SHEET_ALONE = ("--format", "none")


def bag_of(path, *messages):
    with BagFile(path) as file:
        for index, (topic, message) in enumerate(messages):
            file.write(topic, 10**9 + index, message)
    return path


HEAD = {"stamp_ns": 10**9, "frame_id": "base", "types": BAG_TYPES}


def pixels(height, width):
    return msg_adapters.encode_image(
        np.zeros((height, width, 3), np.uint8), encoding="rgb8", **HEAD
    )


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A press in the layout that the sensor publishes; the image brightens with the force."""
    path = tmp_path_factory.mktemp("bags") / "press"
    rest = dome_skin(0.01575, 0.002).rest_position_m
    near = np.exp(-(((rest - rest[rest[:, 2].argmax()]) / 0.004) ** 2).sum(axis=1))
    with BagFile(path) as file:
        for index in range(COUNT):
            stamp_ns = 10**9 + index * PERIOD_NS
            strength = index / (COUNT - 1)
            header = {"stamp_ns": stamp_ns, "frame_id": "base", "types": BAG_TYPES}
            image = np.full((48, 64, 3), 60 + int(120 * strength), np.uint8)
            depth = np.full((48, 64), 0.012 - 0.002 * strength, np.float32)
            depth[:4] = np.nan
            displacement = -0.003 * strength * near[:, None] * np.array([0.0, 0.0, 1.0])
            messages = {
                "/image_raw": msg_adapters.encode_image(image, encoding="rgb8", **header),
                "/depth/image": msg_adapters.encode_image(depth, encoding="32FC1", **header),
                "/points": msg_adapters.encode_cloud(
                    rest + displacement, displacement_m=displacement, **header
                ),
                "/wrench": msg_adapters.encode_wrench_stamped(
                    (0.0, 0.0, 5.0 * strength), (0.0, 0.0, 0.0), **header
                ),
                "/indenter/state": msg_adapters.encode_pose_stamped(
                    (0.0, 0.0, 0.016 - 0.003 * strength), (0.0, 0.0, 0.0, 1.0), **header
                ),
            }
            for topic, message in messages.items():
                file.write(topic, stamp_ns, message)
    return path


def test_view_writes_video_gif_and_sheet(bag, tmp_path, capsys):
    # At half the speed.
    assert view(bag, tmp_path, "--format", "both", "--speed", "0.5") == 0
    printed = capsys.readouterr().out.split()
    made = sorted(os.path.basename(path) for path in printed)
    assert made == sorted(os.listdir(tmp_path)) == ["press.gif", "press.mp4", "press.png"]
    frames = list(imageio.get_reader(tmp_path / "press.mp4").iter_data())
    assert len(frames) == 2 * COUNT - 1
    assert frames[0].shape == (720, 1280, 3)
    # The image of the bag lies at the left of the frame and brightens.
    places = [frame[200, 150].astype(float).mean() for frame in frames[::2]]
    assert np.allclose(places, 60 + 120 * np.arange(COUNT) / (COUNT - 1), atol=6)
    sheet = cv2.imread(str(tmp_path / "press.png"))
    assert sheet.shape[0] > 600
    assert sheet.shape[1] > 1200
    assert len(imageio.mimread(tmp_path / "press.gif")) >= 2


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["{tmp}/nothing"], "no bag"),
        (["{tmp}"], "no ROS 2 bag"),
        (["{bag}", "--image", "/depth/image", "--depth", "/image_raw"], "expected 32FC1"),
        (["{bag}", "--image", "/image_raw", "--depth", "/image_raw"], "two things"),
        (["{bag}", "--rest", "{tmp}/rest.npz"], "rest.npz"),
    ],
)
def test_bad_input_is_told_and_leaves_nothing(bag, tmp_path, capsys, arguments, reason):
    out = tmp_path / "out"
    filled = [part.format(bag=bag, tmp=tmp_path) for part in arguments]
    assert view(filled[0], out, *filled[1:]) == 1
    assert reason in capsys.readouterr().err
    assert not out.exists() or not os.listdir(out)


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("--fps", "1e9", "from 0.1 to 240"),
        ("--fps", "nan", "from 0.1 to 240"),
        ("--speed", "1e-9", "from 0.001 to 1000"),
        ("--columns", "0", "from 1 to 24"),
        ("--columns", "9" * 5000, "from 1 to 24"),
    ],
)
@pytest.mark.fault("view", "")
def test_numbers_out_of_range_are_refused(bag, option, value, expected, capsys, answered):
    with pytest.raises(SystemExit) as stopped:
        main(["view", str(bag), option, value])
    assert stopped.value.code == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert expected in line
    if len(value) < 10:
        answered(line, what=f"{option} {value}")


@pytest.mark.fault("view", "a video of more than 100,000 frames")
def test_endless_video_is_refused_before_anything_is_drawn(tmp_path, capsys, answered):
    message = pixels(48, 64)
    path = tmp_path / "long"
    with BagFile(path) as file:
        for stamp_s in (1, 1_700_000_000):
            message.header.stamp.sec = stamp_s
            file.write("/image_raw", 1, message)
    assert view(path, tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert "would have 1.7e+10 frames" in error
    assert not (tmp_path / "out").exists()
    answered(error)
    assert view(path, tmp_path / "out", *SHEET_ALONE) == 0


def test_dots_are_part_of_a_name(noisy_bag, tmp_path):
    shutil.copytree(noisy_bag, tmp_path / "press_0.5mm")
    # Its file alone has the name of the bag, too.
    for path in (tmp_path / "press_0.5mm", tmp_path / "press_0.5mm" / "press.mcap"):
        assert view(path, tmp_path / "out", *SHEET_ALONE, "--columns", "1") == 0
    assert sorted(os.listdir(tmp_path / "out")) == ["press.png", "press_0.5mm.png"]


@pytest.fixture(scope="module")
def noisy_bag(tmp_path_factory):
    """A bag whose video is larger than its contact sheet."""
    random, messages = np.random.default_rng(0), []
    for index in range(5):
        noise = random.integers(0, 256, (60, 80, 3), dtype=np.uint8)
        head = HEAD | {"stamp_ns": 10**9 + index * PERIOD_NS}
        messages.append(("/image_raw", msg_adapters.encode_image(noise, encoding="rgb8", **head)))
    return bag_of(tmp_path_factory.mktemp("bags") / "press", *messages)


@pytest.mark.fault("view", "")
def test_full_disk_leaves_the_files_before(noisy_bag, tmp_path, answered):
    out, name = tmp_path / "out", "press.mp4"
    assert view(noisy_bag, out, "--columns", "1") == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    # The sheet fits, the video does not.
    length = len(before["press.png"]) + 2_000
    assert len(before[name]) > length, {name: len(made) for name, made in before.items()}
    code = (
        "import sys, dotsim_ros.io.files; dotsim_ros.io.files.PROBE_BYTES = 1; "
        "from dotsim_ros.cli.main import main; sys.exit(main())"
    )
    # -B: bytecode that is cut off would be read by whoever comes next.
    done = subprocess.run(
        [
            sys.executable,
            "-B",
            "-c",
            code,
            "view",
            str(noisy_bag),
            "--out",
            str(out),
            "--columns",
            "1",
        ],
        capture_output=True,
        text=True,
        # No file may grow beyond a length, which shows only half-way.
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (length, length)),
    )
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "File too large" in done.stderr or "ffmpeg: ended by SIGXFSZ" in done.stderr
    assert {path.name for path in out.iterdir()} == set(before)
    assert (out / name).read_bytes() == before[name]
    assert str(out / name) in done.stderr
    answered(done.stderr, what=f"the disk is full when {name} is written")


@pytest.mark.skipif(os.geteuid() != 0, reason="needs the right to mount a small disk")
def test_ffmpeg_says_why_it_failed(noisy_bag, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("dotsim_ros.io.files.PROBE_BYTES", 1)
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=240k", "tmpfs", str(disk)]
    if subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("no disk can be mounted here")
    try:
        (disk / "press.mp4").write_bytes(b"good video" * 1000)
        assert view(noisy_bag, disk, "--columns", "1") == 1
        error = capsys.readouterr().err
        assert (disk / "press.mp4").read_bytes() == b"good video" * 1000
    finally:
        subprocess.run(["umount", str(disk)], check=True)
    assert f"{disk / 'press.mp4'} could not be written: ffmpeg: " in error
    assert "No space left on device" in error
    assert len(error.splitlines()) == 1


@pytest.mark.fault("view", "a recording that was cut short")
def test_recording_that_was_cut_short_is_shown_up_to_its_end(bag, tmp_path, capsys, answered):
    short = tmp_path / "short.partial"
    shutil.copytree(bag, short)
    (short / "metadata.yaml").unlink()
    os.truncate(short / "press.mcap", (short / "press.mcap").stat().st_size - 100)
    assert view(short, tmp_path / "out", *SHEET_ALONE) == 0
    said = capsys.readouterr()
    assert "was not finished or is cut off" in said.err
    assert "record --repair" in said.err
    assert os.listdir(tmp_path / "out") == ["short.partial.png"]
    answered(said.err)


def cloud(**fields):
    message = msg_adapters.encode_cloud(np.random.default_rng(0).random((9, 3)), **HEAD)
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def wide_field():
    message = cloud()
    message.fields[0].count = 4_000_000_000
    return message


def force(newtons):
    message = msg_adapters.encode_wrench_stamped((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), **HEAD)
    message.wrench.force.x = newtons
    return message


MALFORMED = {
    "an image of 1 x 3000 pixels": (
        [("/image_raw", pixels(3000, 1))],
        "press: an image of 1 x 3000 pixels cannot be shown",
    ),
    "a cloud that claims 4e9 points": (
        [("/points", cloud(width=4_000_000_000))],
        "press, /points, message of 1.000 s: cloud row_step of 108 bytes is too short",
    ),
    "a cloud with a field of 4e9 numbers": (
        [("/points", wide_field())],
        "press, /points, message of 1.000 s: cloud field 'x' ends at byte 16000000000",
    ),
    "a skin of points that are not finite": (
        [("/points", msg_adapters.encode_cloud(np.full((9, 3), np.nan), **HEAD))],
        "press: the skin at rest holds a point that is not finite",
    ),
    "a force of 1e308 N": (
        [("/image_raw", pixels(48, 64)), ("/wrench", force(1e308))],
        "press, /wrench, message of 1.000 s: a force of 1e+308 N, expected at most 1e+06 N",
    ),
}


@pytest.mark.parametrize("what", MALFORMED)
@pytest.mark.fault("view", "")
def test_malformed_message_is_named(tmp_path, what, capsys, answered):
    messages, reason = MALFORMED[what]
    bag = bag_of(tmp_path / "press", *messages)
    assert view(bag, tmp_path / "out") == 1
    error = capsys.readouterr().err
    assert reason in error
    assert len(error.splitlines()) == 1
    answered(error, what=what)


@pytest.mark.fault("view", "messages whose stamp is no time")
def test_messages_without_a_time_are_left_out_and_counted(bag, tmp_path, capsys, answered):
    path = tmp_path / "press"
    with BagReader(bag) as reader, BagFile(path) as file:
        for number, item in enumerate(reader.messages(*reader.topics())):
            file.add_topic(item.topic, item.message_type)
            serialized = item.serialized
            if number % 12 == 11:
                serialized = serialized[:4] + struct.pack("<iI", -1, 0) + serialized[12:]
            file.write_serialized(item.topic, item.log_time_ns, serialized)
    assert view(path, tmp_path / "out", *SHEET_ALONE) == 0
    error = capsys.readouterr().err
    assert "3 messages are not shown: their stamp is no time" in error
    answered(error)


@pytest.mark.parametrize("verb", verbs())
def test_every_verb_has_help_with_an_example(verb, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([verb, "--help"])
    assert stopped.value.code == 0
    assert f"dotsim_ros {verb}" in capsys.readouterr().out.partition("example")[2]


def test_overview_lists_verbs_without_importing_them(capsys):
    code = (
        "import sys\n"
        "from dotsim_ros.cli.main import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit:\n"
        "    print(sorted({'warp', 'torch', 'rclpy', 'matplotlib', 'numpy'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "view" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"


def test_topics_are_found_by_their_ends():
    image, compressed = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
    there = {
        "/left/image_raw": image,
        "/left/depth/image": image,
        "/left/image_raw/compressed": compressed,
        "/indenter/wrench": "geometry_msgs/msg/WrenchStamped",
        "/tactile/skin": "sensor_msgs/msg/PointCloud2",
    }
    assert find_topics(there) == ViewTopics(
        "/left/image_raw", "/left/depth/image", "/tactile/skin", "/indenter/wrench"
    )
    with pytest.raises(ValueError, match="nothing to look at"):
        find_topics({"/clock": "rosgraph_msgs/msg/Clock"})


def test_moments_hold_all_of_one_stamp(bag):
    with open_timeline(bag) as timeline:
        moments = list(timeline.moments())
    assert timeline.topics == ViewTopics(
        "/image_raw", "/depth/image", "/points", "/wrench", "/indenter/state"
    )
    assert [moment.stamp_ns for moment in moments] == [
        10**9 + index * PERIOD_NS for index in range(COUNT)
    ]
    for index, moment in enumerate(moments):
        assert moment.image[0, 0, 0] == 60 + int(120 * index / (COUNT - 1))
        assert moment.depth_m[10, 10] == np.float32(0.012 - 0.002 * index / (COUNT - 1))


def test_video_shows_the_moment_that_is_current():
    moments = [BagMoment(stamp) for stamp in (0, 10, 30)]
    shown = [moment.stamp_ns for moment in paced(moments, fps=1e8, speed=1.0)]
    assert shown == [0, 10, 10, 30]


def test_sheet_takes_the_strongest_of_each_part():
    stamps = np.arange(8, dtype=np.int64)
    strength = np.array([0, 3, 1, 0, 0, 2, 5, 1.0])
    forces = Forces(stamps, strength[:, None] * np.array([0.0, 0.0, -1.0]))
    assert strongest_stamps(stamps, forces, count=2) == [1, 6]
    assert strongest_stamps(stamps, None, count=2) == [2, 6]


def test_skin_map_puts_each_side_in_its_place():
    rest = dome_skin(0.01575, 0.001).rest_position_m
    skin_map = SkinMap(rest, size_px=101)
    across, down = (skin_map.raster(rest[:, axis]) for axis in (0, 1))
    assert across[50, 90] > 0.008
    assert across[50, 10] < -0.008
    assert abs(across[50, 50]) < 1e-3
    assert np.isnan(across[0, 0])
    assert down[90, 50] > 0.008


@pytest.mark.fault("view", "a number of columns that is two lines of text")
def test_a_wrong_command_line_ends_in_one_line(capsys, answered):
    with pytest.raises(SystemExit) as ended:
        main(["view", "bag", "--columns=a\nb"])
    assert ended.value.code == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("dotsim_ros view: error: Invalid value for --columns: ")
    answered(last)


def test_rerun_reads_what_was_written(bag, tmp_path, capsys):
    pytest.importorskip("rerun", reason="needs the extra rerun: pip install '.[rerun]'")
    reading = pytest.importorskip("rerun.chunk", reason="an older rerun cannot read its files")
    out = tmp_path / "press.rrd"
    assert main(["view", str(bag), "--rerun", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    reader = reading.RrdReader(out)
    assert len(reader.blueprints()) == 1
    shown = {
        chunk.entity_path: chunk.to_record_batch()
        for chunk in reader.store().stream().to_chunks()
        if not chunk.is_static
    }
    assert set(shown) == {
        *("/camera/image", "/camera/depth", "/base/skin", "/base/indenter"),
        *("/wrench/force_n", "/wrench/torque_nm"),
    }
    stamps_ns = 10**9 + np.arange(COUNT) * PERIOD_NS
    for columns in shown.values():
        assert (columns["stamp"].to_numpy().astype(int) == stamps_ns).all()
    assert np.allclose(shown["/wrench/force_n"]["Scalars:scalars"].to_pylist()[-1], [0.0, 0.0, 5.0])
    assert np.allclose(
        shown["/base/indenter"]["Transform3D:translation"].to_pylist()[-1], [0.0, 0.0, 0.013]
    )
    png = np.array(shown["/camera/image"]["EncodedImage:blob"].to_pylist()[-1], np.uint8).ravel()
    assert (cv2.imdecode(png, cv2.IMREAD_COLOR) == 180).all()
    # Nothing has moved at first, and at the end the apex most.
    colours = [np.array(each) for each in shown["/base/skin"]["Mesh3D:vertex_colors"].to_pylist()]
    assert len(np.unique(colours[0])) == 1
    apex = np.array(shown["/base/skin"]["Mesh3D:vertex_positions"].to_pylist()[0])[:, 2].argmax()
    brightness = [sum(int(colour).to_bytes(4)[:3]) for colour in colours[-1]]
    assert brightness[apex] == max(brightness) > 2 * min(brightness)


@pytest.mark.fault("view", "")
def test_a_recording_for_rerun_that_cannot_be_written_is_told(
    bag, tmp_path, capsys, monkeypatch, answered
):
    assert main(["view", str(bag), "--rerun", str(tmp_path / "press.mp4")]) == 1
    answered(capsys.readouterr().err, what="--rerun names no .rrd file")
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["view", str(bag), "--rerun", str(tmp_path / "press.rrd")]) == 1
    answered(capsys.readouterr().err, what="--rerun without rerun")
    assert os.listdir(tmp_path) == []
