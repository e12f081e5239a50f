"""The command line and its `view`: real files of a real bag, read back."""

import importlib.util
import os
import subprocess
import sys

import cv2
import imageio.v2 as imageio
import numpy as np
import pytest

import msg_adapters
from dotsim_ros.cli.main import main, verbs
from dotsim_ros.geometry.skin_mesh import dome_skin
from dotsim_ros.measured.bag import BAG_TYPES, BagFile
from dotsim_ros.view.sheet import strongest_stamps
from dotsim_ros.view.skin_map import SkinMap
from dotsim_ros.view.timeline import BagMoment, Forces, ViewTopics, find_topics, iterate_moments
from dotsim_ros.view.video import paced

PERIOD_NS = 40_000_000
COUNT = 8


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
            }
            for topic, message in messages.items():
                file.write(topic, stamp_ns, message)
    return path


def test_view_writes_video_gif_and_sheet(bag, tmp_path, capsys):
    assert main(["view", str(bag), "--out", str(tmp_path), "--format", "both"]) == 0
    printed = capsys.readouterr().out.split()
    assert sorted(os.path.basename(path) for path in printed) == [
        "press.gif",
        "press.mp4",
        "press.png",
    ]
    assert sorted(os.listdir(tmp_path)) == ["press.gif", "press.mp4", "press.png"]
    frames = list(imageio.get_reader(tmp_path / "press.mp4").iter_data())
    assert len(frames) == COUNT
    assert frames[0].shape == (720, 1280, 3)
    # The image of the bag lies at the left of the frame and brightens.
    places = [frame[200, 150].astype(float).mean() for frame in frames]
    assert np.allclose(places, 60 + 120 * np.arange(COUNT) / (COUNT - 1), atol=6)
    sheet = cv2.imread(str(tmp_path / "press.png"))
    assert sheet.shape[0] > 600
    assert sheet.shape[1] > 1200
    assert len(imageio.mimread(tmp_path / "press.gif")) >= 2


def test_slower_video_has_more_frames(bag, tmp_path):
    assert main(["view", str(bag), "--out", str(tmp_path), "--speed", "0.5"]) == 0
    assert len(list(imageio.get_reader(tmp_path / "press.mp4").iter_data())) == 2 * COUNT - 1


def test_sheet_alone(bag, tmp_path):
    arguments = ["view", str(bag), "--out", str(tmp_path), "--format", "none", "--columns", "3"]
    assert main(arguments) == 0
    assert os.listdir(tmp_path) == ["press.png"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["{tmp}/nothing"], "no bag"),
        (["{tmp}"], "no ROS 2 bag"),
        (["{bag}", "--image", "/wrench"], "no topic /wrench of type"),
        (["{bag}", "--image", "/depth/image"], "holds depth"),
        (["{bag}", "--image", "/depth/image", "--depth", "/image_raw"], "expected 32FC1"),
        (["{bag}", "--image", "/image_raw", "--depth", "/image_raw"], "two things"),
        (["{bag}", "--rest", "{tmp}/rest.npz"], "rest.npz"),
    ],
)
def test_bad_input_is_told_and_leaves_nothing(bag, tmp_path, capsys, arguments, reason):
    out = tmp_path / "out"
    filled = [part.format(bag=bag, tmp=tmp_path) for part in arguments]
    assert main(["view", *filled, "--out", str(out)]) == 1
    assert reason in capsys.readouterr().err
    assert not out.exists() or not os.listdir(out)


@pytest.mark.parametrize("arguments", [[], ["dance"], ["view"], ["view", "a", "--fps", "-1"]])
def test_wrong_command_line_is_told(arguments, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "usage: dotsim_ros" in capsys.readouterr().err


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
    moments = list(
        iterate_moments(bag, ViewTopics("/image_raw", "/depth/image", "/points", "/wrench"))
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
    raster = SkinMap(rest, size_px=101).raster(rest[:, 0])
    assert raster[50, 90] > 0.008
    assert raster[50, 10] < -0.008
    assert abs(raster[50, 50]) < 1e-3
    assert np.isnan(raster[0, 0])
    down = SkinMap(rest, size_px=101).raster(rest[:, 1])
    assert down[90, 50] > 0.008


def test_plotting_needs_no_display():
    assert importlib.util.find_spec("matplotlib") is not None
    code = (
        "import dotsim_ros.view.bag, sys; "
        "print('matplotlib.pyplot' in sys.modules, 'tkinter' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]
