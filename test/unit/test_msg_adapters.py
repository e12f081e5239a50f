# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Messages to arrays and back: exact both ways, and malformed messages refused."""

import copy
import importlib.util
import subprocess
import sys
from array import array

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import msg_adapters as adapters
from dotsim_ros.data.bag import BAG_TYPES, TYPESTORE
from msg_adapters.image import CAMERA_LAYOUTS

HAS_ROS = importlib.util.find_spec("rclpy") is not None
WORLDS = [
    pytest.param(BAG_TYPES, id="bag"),
    pytest.param(
        adapters.ROS, id="ros", marks=pytest.mark.skipif(not HAS_ROS, reason="needs ROS 2")
    ),
]
BARE = {"stamp_ns": 0, "frame_id": "", "types": BAG_TYPES}
every_world = pytest.mark.parametrize("types", WORLDS)
quick = settings(max_examples=15, deadline=None)

stamps = st.integers(0, 2**31 * 10**9 - 1)
finite = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(finite, finite, finite)
sizes = st.integers(1, 9)
names = st.text(st.characters(codec="ascii", categories=["L", "N"]), max_size=8)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


def unit(quaternion):
    return np.array(quaternion) / np.linalg.norm(quaternion)


def pixels(encoding):
    dtype, tail = {
        "rgb8": (np.uint8, (3,)),
        "bgr8": (np.uint8, (3,)),
        "mono8": (np.uint8, ()),
        "32FC1": (np.float32, ()),
    }[encoding]
    shapes = st.tuples(sizes, sizes).map(lambda size: (*size, *tail))
    return shapes.flatmap(lambda shape: arrays.arrays(dtype, shape))


images = st.sampled_from(["rgb8", "bgr8", "mono8", "32FC1"]).flatmap(
    lambda encoding: st.tuples(st.just(encoding), pixels(encoding))
)


def over_the_wire(message):
    """Return a bag's message after it has been serialised and read again."""
    name = message.__msgtype__
    return TYPESTORE.deserialize_cdr(TYPESTORE.serialize_cdr(message, name), name)


@every_world
@quick
@given(stamps)
def test_stamps_are_exact(types, stamp_ns):
    assert adapters.decode_stamp(adapters.encode_stamp(stamp_ns, types=types)) == stamp_ns


def test_a_stamp_that_is_no_time_is_refused_both_ways():
    for stamp_ns in (-1, 2**31 * 10**9):
        with pytest.raises(ValueError, match="outside"):
            adapters.encode_stamp(stamp_ns, types=BAG_TYPES)
    stamp = BAG_TYPES.make("builtin_interfaces/msg/Time", sec=1, nanosec=10**9)
    with pytest.raises(ValueError, match="no valid time"):
        adapters.decode_stamp(stamp)


@every_world
@quick
@given(images, stamps, names)
def test_image_is_exact(types, image, stamp_ns, frame_id):
    encoding, values = image
    message = adapters.encode_image(
        values, encoding=encoding, stamp_ns=stamp_ns, frame_id=frame_id, types=types
    )
    if types is BAG_TYPES:
        message = over_the_wire(message)
    decoded = adapters.decode_image(message)
    assert decoded.dtype == values.dtype
    assert decoded.tobytes() == values.tobytes()
    assert (message.header.frame_id, adapters.message_stamp_ns(message)) == (frame_id, stamp_ns)


@every_world
@quick
@given(pixels("rgb8"), st.integers(0, 7))
def test_padded_rows_are_read(types, values, padding):
    height, width, _ = values.shape
    message = adapters.encode_image(values, encoding="rgb8", stamp_ns=0, frame_id="", types=types)
    message.step = 3 * width + padding
    rows = np.full((height, message.step), 255, np.uint8)
    rows[:, : 3 * width] = values.reshape(height, -1)
    message.data = types.octets(rows)
    assert np.array_equal(adapters.decode_image(message), values)


def test_big_endian_depth_is_read():
    depth = np.array([[1.5, np.nan], [-2.25, 0.0]], np.float32)
    message = adapters.encode_image(depth, encoding="32FC1", **BARE)
    message.is_bigendian = 1
    message.data = BAG_TYPES.octets(depth.astype(">f4"))
    assert np.array_equal(adapters.decode_image(message), depth, equal_nan=True)


def test_decoded_image_shares_the_memory_of_the_message():
    data = array("B", range(12))
    message = BAG_TYPES.make(
        "sensor_msgs/msg/Image",
        header=adapters.encode_header(0, "", types=BAG_TYPES),
        height=2,
        width=2,
        encoding="rgb8",
        is_bigendian=0,
        step=6,
        data=data,
    )
    decoded = adapters.decode_image(message)
    data[0] = 99
    assert decoded[0, 0, 0] == 99


@quick
@given(pixels("rgb8"))
def test_colours_keep_their_places(values):
    reverse = adapters.encode_image(values[..., ::-1], encoding="bgr8", **BARE)
    assert np.array_equal(adapters.decode_rgb(reverse), values)
    grey = adapters.encode_image(np.ascontiguousarray(values[..., 0]), encoding="mono8", **BARE)
    assert np.array_equal(adapters.decode_rgb(grey), np.repeat(values[..., :1], 3, axis=2))


HUES = np.array([[[200, 30, 40], [30, 180, 60]], [[20, 50, 220], [90, 90, 90]]])
"""A quarter of an image each: mostly red, green, blue, and grey."""


def yuv(rgb):
    """Return luma and the two chroma differences by BT.601, limited range (ITU-R BT.601-7)."""
    red, green, blue = np.moveaxis(rgb / 255.0, -1, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    planes = 16 + 219 * luma, 128 + 112 * (blue - luma) / 0.886, 128 + 112 * (red - luma) / 0.701
    return [np.round(plane).astype(np.uint8) for plane in planes]


def encoded(rgb, encoding):
    """Return what a camera sends of an (H, W, 3) image: rows of numbers."""
    height, width = rgb.shape[:2]
    luma, *chroma = yuv(rgb)
    if encoding in ("nv12", "nv21"):
        pair = np.stack(
            [plane[::2, ::2] for plane in chroma[:: 1 if encoding == "nv12" else -1]], -1
        )
        return np.concatenate([luma, pair.reshape(height // 2, width)])
    if encoding.startswith(("yuv", "uyvy", "yuyv")):
        pair = np.stack([plane[:, ::2] for plane in chroma], -1).reshape(height, width)
        parts = (luma, pair) if encoding in ("yuv422_yuy2", "yuyv") else (pair, luma)
        return np.stack(parts, -1).reshape(height, -1)
    if encoding.startswith("bayer"):
        mosaic = np.empty((height, width), np.uint8)
        for index, colour in enumerate(encoding[6:10]):
            row, column = divmod(index, 2)
            mosaic[row::2, column::2] = rgb[row::2, column::2, "rgb".index(colour)]
        rows = mosaic
    elif encoding.startswith("mono"):
        rows = rgb[..., 0]
    else:
        planes = {"r": rgb[..., 0], "g": rgb[..., 1], "b": rgb[..., 2]}
        planes["a"] = np.full((height, width), 7)
        rows = np.stack([planes[letter] for letter in encoding.rstrip("0123456789")], -1)
    # 257 times the level: the same brightness in 16 bits.
    rows = rows.astype(np.uint16) * 257 if encoding.endswith("16") else rows.astype(np.uint8)
    return np.ascontiguousarray(rows).reshape(height, -1)


@pytest.mark.parametrize(("padding", "is_bigendian"), [(0, 0), (6, 1)])
@pytest.mark.parametrize("encoding", sorted(CAMERA_LAYOUTS))
def test_colours_of_a_camera_are_right(encoding, padding, is_bigendian):
    rgb = HUES.repeat(8, axis=0).repeat(12, axis=1)
    rows = encoded(rgb, encoding)
    if rows.dtype == np.uint16:
        rows = rows.astype(">u2" if is_bigendian else "<u2").view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=99)
    message = adapters.encode_image(np.zeros((16, 24), np.uint8), encoding="mono8", **BARE)
    message.encoding, message.is_bigendian = encoding, is_bigendian
    message.step, message.data = rows.shape[1], rows.reshape(-1)
    found = adapters.decode_rgb(message)
    assert found.shape == (16, 24, 3)
    # Away from the edges between colours, which a camera's encoding blurs.
    middle = found[4::8, 6::12].astype(int)
    expected = HUES[..., :1].repeat(3, axis=2) if encoding.startswith("mono") else HUES
    largest = 3 if encoding in ("nv12", "nv21") or CAMERA_LAYOUTS[encoding][1] == 2 else 0
    assert np.abs(middle - expected).max() <= largest


@pytest.mark.parametrize(
    ("encoding", "reason"),
    [
        ("nv12", "needs even sides, the image has 24 x 15 pixels"),
        ("bgra8", "too short"),
        ("h264", "not supported; expected one of rgb8, .*bayer_rggb8"),
        ("8UC1", "holds depth"),
    ],
)
def test_an_image_that_is_no_picture_is_refused(encoding, reason):
    message = adapters.encode_image(np.zeros((15, 24), np.uint8), encoding="mono8", **BARE)
    message.encoding = encoding
    with pytest.raises(ValueError, match=reason):
        adapters.decode_rgb(message)


@pytest.mark.parametrize(
    ("values", "encoding"),
    [
        (np.zeros((2, 2), np.uint8), "rgb8"),
        (np.zeros((2, 2, 4), np.uint8), "rgb8"),
        (np.zeros((2, 2, 3), np.float32), "rgb8"),
        (np.zeros((2, 2), np.float64), "32FC1"),
        (np.zeros((0, 2), np.uint8), "mono8"),
        (np.zeros((2, 2, 3), np.uint8), "rgba8"),
    ],
)
def test_pixels_that_do_not_fit_are_refused(values, encoding):
    with pytest.raises(ValueError, match=encoding):
        adapters.encode_image(values, encoding=encoding, **BARE)


@every_world
@quick
@given(st.sampled_from(["rgb8", "mono8"]).flatmap(pixels), stamps)
def test_png_is_exact(types, values, stamp_ns):
    message = adapters.encode_compressed_image(
        values, compression="png", stamp_ns=stamp_ns, frame_id="camera", types=types
    )
    assert np.array_equal(adapters.decode_compressed_image(message), values)
    assert bytes(message.data[:4]) == b"\x89PNG"


def test_jpeg_is_close():
    across, down = np.meshgrid(np.arange(64), np.arange(48))
    values = np.stack([4 * across, 5 * down, 128 + 0 * across], axis=-1).astype(np.uint8)
    message = adapters.encode_compressed_image(values, compression="jpeg", **BARE)
    decoded = adapters.decode_compressed_image(message)
    assert np.abs(decoded.astype(float) - values).mean() < 3.0
    assert message.format == "rgb8; jpeg compressed bgr8"


@every_world
@quick
@given(
    st.tuples(st.integers(1, 5000), st.integers(1, 5000)),
    st.tuples(st.floats(1e-3, 1e6), st.floats(1e-3, 1e6)),
    st.tuples(finite, finite),
    st.tuples(finite, finite, finite, finite),
)
def test_camera_info_is_exact(types, size, focal, centre, distortion):
    message = adapters.encode_camera_info(
        width=size[0],
        height=size[1],
        focal_px=focal,
        principal_point_px=centre,
        distortion=distortion,
        stamp_ns=7,
        frame_id="camera",
        types=types,
    )
    decoded = adapters.decode_camera_info(message)
    assert (decoded.width, decoded.height) == size
    assert tuple(decoded.focal_px) == focal
    assert tuple(decoded.principal_point_px) == centre
    assert tuple(decoded.distortion) == distortion
    assert message.distortion_model == "equidistant"
    assert len(message.d) == 4
    projection = np.array(message.p).reshape(3, 4)
    assert np.array_equal(projection[:, :3], np.array(message.k).reshape(3, 3))
    assert not projection[:, 3].any()


LENS = {
    **{"width": 4, "height": 3, "focal_px": 1.0},
    **{"principal_point_px": (2.0, 1.5), "distortion": (0.0, 0.0, 0.0, 0.0)},
}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"distortion_model": "rational_polynomial"}, "'rational_polynomial' is not supported"),
        ({"distortion_model": "plumb_bob"}, "distortion needs 5 numbers"),
        ({"focal_px": (1.0, 0.0)}, "no positive focal lengths"),
        ({"height": 0}, "4 x 0 pixels is empty"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(change, reason):
    with pytest.raises(ValueError, match=reason):
        adapters.encode_camera_info(**{**LENS, **change}, **BARE)


BLACK = np.zeros((2, 2, 3), np.uint8)
MESSAGES = {
    "image": adapters.encode_image(BLACK, encoding="rgb8", **BARE),
    "compressed_image": adapters.encode_compressed_image(BLACK, compression="png", **BARE),
    "camera_info": adapters.encode_camera_info(**LENS, **BARE),
}


@pytest.mark.parametrize(
    ("kind", "change", "reason"),
    [
        ("image", {"encoding": ""}, "must set the encoding"),
        ("image", {"encoding": "yuv422"}, "not supported"),
        ("image", {"step": 5}, "too short"),
        ("image", {"height": 3}, "expected step"),
        ("image", {"width": 0}, "empty"),
        ("image", {"data": np.zeros(11, np.uint8)}, "holds 11 bytes"),
        ("compressed_image", {"data": b""}, "cannot be read"),
        ("compressed_image", {"data": b"\x89PNG\r\n"}, "cannot be read"),
        ("compressed_image", {"data": b"no image at all"}, "cannot be read"),
        ("camera_info", {"d": np.zeros(15)}, "15 coefficients, expected at most 14"),
        ("camera_info", {"k": np.zeros(9)}, "uncalibrated"),
        ("camera_info", {"k": np.full(9, np.nan)}, "not finite"),
        ("camera_info", {"width": 0}, "empty"),
    ],
)
def test_a_malformed_message_is_refused(kind, change, reason):
    message = copy.copy(MESSAGES[kind])
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(ValueError, match=reason):
        getattr(adapters, f"decode_{kind}")(message)


def points(count):
    single = st.floats(allow_nan=False, allow_infinity=False, width=32)
    return arrays.arrays(np.float32, (count, 3), elements=single)


@every_world
@quick
@given(st.integers(0, 20).flatmap(lambda count: st.tuples(*[points(count)] * 3)), st.booleans())
def test_cloud_is_exact(types, groups, has_extras):
    position, normal, displacement = groups
    pixel, pixel_displacement = normal[:, 1:], displacement[:, :2]
    message = adapters.encode_cloud(
        position,
        normal=normal if has_extras else None,
        displacement_m=displacement if has_extras else None,
        pixel=pixel if has_extras else None,
        pixel_displacement=pixel_displacement if has_extras else None,
        stamp_ns=3,
        frame_id="base",
        types=types,
    )
    cloud = adapters.decode_cloud(message)
    assert np.array_equal(cloud.position, position)
    if has_extras:
        assert np.array_equal(cloud.normal, normal)
        assert np.array_equal(cloud.displacement, displacement)
        assert np.array_equal(cloud.pixel, pixel)
        assert np.array_equal(cloud.pixel_displacement, pixel_displacement)
        assert [field.name for field in message.fields][3:5] == ["normal_x", "normal_y"]
    else:
        assert cloud.normal is None
        assert cloud.displacement is None
        assert cloud.pixel is None
    assert message.is_dense


def test_decoded_cloud_is_a_view():
    message = adapters.encode_cloud(np.zeros((4, 3)), normal=np.ones((4, 3)), **BARE)
    assert np.shares_memory(adapters.decode_cloud(message).position, message.data)


FIELD_KINDS = {np.dtype(np.float32): 7, np.dtype(np.float64): 8}


@quick
@given(
    st.permutations(["x", "y", "z", "intensity"]),
    st.lists(st.integers(0, 5), min_size=4, max_size=4),
    st.sampled_from(sorted(FIELD_KINDS, key=str)),
    st.booleans(),
    st.tuples(st.integers(1, 4), st.integers(1, 4)),
    st.integers(0, 9),
    st.randoms(use_true_random=False),
)
def test_cloud_of_any_layout_is_read(order, gaps, dtype, is_big, size, row_padding, random):
    offsets, offset = [], 0
    for gap in gaps:
        offsets.append(offset + gap)
        offset += gap + dtype.itemsize
    kind = dtype.newbyteorder(">" if is_big else "<")
    layout = np.dtype(
        {"names": order, "formats": [kind] * 4, "offsets": offsets, "itemsize": offset + 3}
    )
    height, width = size
    table = np.zeros(height * width, layout)
    for name in order:
        table[name] = [random.uniform(-1, 1) for _ in range(height * width)]
    row_step = width * layout.itemsize + row_padding
    rows = np.zeros((height, row_step), np.uint8)
    rows[:, : width * layout.itemsize] = table.view(np.uint8).reshape(height, -1)
    fields = [
        BAG_TYPES.make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=start,
            datatype=FIELD_KINDS[dtype],
            count=1,
        )
        for name, start in zip(order, offsets, strict=True)
    ]
    message = BAG_TYPES.make(
        "sensor_msgs/msg/PointCloud2",
        header=adapters.encode_header(0, "", types=BAG_TYPES),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=is_big,
        point_step=layout.itemsize,
        row_step=row_step,
        data=rows.reshape(-1),
        is_dense=True,
    )
    decoded = adapters.decode_cloud(over_the_wire(message))
    expected = np.stack([table[name] for name in "xyz"], axis=1)
    assert np.array_equal(decoded.position, expected)
    assert np.array_equal(adapters.decode_cloud_fields(message)["intensity"], table["intensity"])


@pytest.mark.parametrize(
    ("field", "change", "reason"),
    [
        (0, {"name": "y"}, "twice"),
        (0, {"datatype": 9}, "unknown type 9"),
        (2, {"offset": 10}, "ends at byte 14"),
        (None, {"data": np.zeros(23, np.uint8)}, "holds 23 bytes"),
        (None, {"row_step": 3}, "too short"),
        (0, {"name": "a"}, "expected x, y and z"),
        (None, {"data": np.full(24, 255, np.uint8)}, "is_dense"),
    ],
)
def test_malformed_cloud_is_refused(field, change, reason):
    message = adapters.encode_cloud(np.ones((2, 3)), **BARE)
    for name, value in change.items():
        setattr(message if field is None else message.fields[field], name, value)
    with pytest.raises(ValueError, match=reason):
        adapters.decode_cloud(message)


def test_cloud_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="normal_x"):
        adapters.encode_cloud(np.ones((2, 3)), normal=np.ones((3, 3)), **BARE)


@every_world
@quick
@given(vectors, quaternions, stamps)
def test_pose_is_exact(types, position, quaternion, stamp_ns):
    rotation = unit(quaternion)
    message = adapters.encode_pose_stamped(
        position, rotation, stamp_ns=stamp_ns, frame_id="base", types=types
    )
    decoded = adapters.decode_pose_stamped(message)
    assert tuple(decoded[0]) == position
    assert np.array_equal(decoded[1], rotation)
    assert adapters.message_stamp_ns(message) == stamp_ns


@every_world
@quick
@given(vectors, vectors)
def test_twist_and_wrench_are_exact(types, first, second):
    stamped = {"stamp_ns": 1, "frame_id": "base", "types": types}
    for decoded in (
        adapters.decode_twist(adapters.encode_twist(first, second, types=types)),
        adapters.decode_twist_stamped(adapters.encode_twist_stamped(first, second, **stamped)),
        adapters.decode_wrench_stamped(adapters.encode_wrench_stamped(first, second, **stamped)),
    ):
        assert (tuple(decoded[0]), tuple(decoded[1])) == (first, second)


@pytest.mark.parametrize("bad", [float("nan"), -float("inf")])
def test_numbers_that_are_not_finite_are_refused_both_ways(bad):
    zero = (0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="position holds a number that is not finite"):
        adapters.encode_pose_stamped((0.0, bad, 0.0), (0.0, 0.0, 0.0, 1.0), **BARE)
    with pytest.raises(ValueError, match="force"):
        adapters.encode_wrench_stamped((bad, 0.0, 0.0), zero, **BARE)
    pose = adapters.encode_pose_stamped(zero, (0.0, 0.0, 0.0, 1.0), **BARE)
    pose.pose.position.z = bad
    with pytest.raises(ValueError, match="position"):
        adapters.decode_pose_stamped(pose)
    wrench = adapters.encode_wrench_stamped(zero, zero, **BARE)
    wrench.wrench.torque.y = bad
    with pytest.raises(ValueError, match="torque"):
        adapters.decode_wrench_stamped(wrench)
    twist = adapters.encode_twist_stamped(zero, zero, **BARE)
    twist.twist.linear.x = bad
    with pytest.raises(ValueError, match="linear velocity"):
        adapters.decode_twist_stamped(twist)


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.01), (1, 1, 1, 1)])
def test_quaternion_not_of_unit_length_is_refused_both_ways(quaternion):
    with pytest.raises(ValueError, match="expected 1 within"):
        adapters.encode_pose_stamped((0, 0, 0), quaternion, **BARE)
    pose = adapters.encode_pose_stamped((0, 0, 0), (0, 0, 0, 1), **BARE)
    for name, value in zip("xyzw", quaternion, strict=True):
        setattr(pose.pose.orientation, name, float(value))
    with pytest.raises(ValueError, match="expected 1 within"):
        adapters.decode_pose_stamped(pose)


statuses = st.builds(
    adapters.Status,
    name=names,
    level=st.sampled_from(adapters.Level),
    message=names,
    hardware_id=names,
    values=st.dictionaries(names, names, max_size=4),
)


@every_world
@quick
@given(st.lists(statuses, max_size=4), stamps)
def test_diagnostics_are_exact(types, given_statuses, stamp_ns):
    message = adapters.encode_diagnostics(given_statuses, stamp_ns=stamp_ns, types=types)
    assert adapters.decode_diagnostics(message) == given_statuses
    assert adapters.message_stamp_ns(message) == stamp_ns


def test_unknown_diagnostic_level_is_refused():
    message = adapters.encode_diagnostics(
        [adapters.Status("camera", adapters.Level.OK)], stamp_ns=0, types=BAG_TYPES
    )
    message.status[0].level = 7
    with pytest.raises(ValueError, match="unknown level 7"):
        adapters.decode_diagnostics(message)


def test_message_class_names_what_is_missing():
    with pytest.raises(ImportError, match="nowhere_msgs"):
        adapters.message_class("nowhere_msgs/msg/Nothing")
    with pytest.raises(ValueError, match="PACKAGE/msg/TYPE"):
        adapters.message_class("Image")


def test_importing_needs_no_ros_and_no_opencv():
    code = (
        "import sys, msg_adapters; "
        "print(sorted({'rclpy', 'cv2', 'sensor_msgs', 'rosbags'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
