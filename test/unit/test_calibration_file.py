# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Files of a camera's calibration, as ROS keeps them."""

import numpy as np
import pytest
import yaml

pytest.importorskip("sensor_msgs", reason="needs ROS 2")

import msg_adapters
from dotsim_ros.nodes.tactile_sim.camera_calibration import (
    path_of_url,
    read_calibration,
    write_calibration,
)
from msg_adapters import CameraCalibration

# As the calibrator of image_pipeline writes one.
WRITTEN = """image_width: 640
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [515.2, 0.0, 322.1, 0.0, 514.9, 238.4, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.11, -0.25, 0.001, -0.002, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [520.0, 0.0, 321.0, 0.0, 0.0, 519.0, 238.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""


def test_a_written_calibration_is_read_and_written_back(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(WRITTEN)
    found = read_calibration(path)
    assert (found.width, found.height, found.distortion_model) == (640, 480, "plumb_bob")
    assert found.projection[1].tolist() == [0.0, 519.0, 238.0, 0.0]
    write_calibration(tmp_path / "again.yaml", found, name="narrow_stereo")
    assert yaml.safe_load((tmp_path / "again.yaml").read_text()) == yaml.safe_load(WRITTEN)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("image_width: 640", "image_width: wide"), "image_width is 'wide', expected"),
        (("515.2, 0.0, 322.1,", ""), "camera_matrix needs 9 numbers"),
        (("515.2", "0.0"), "no positive focal lengths"),
        (("data: [0.11, -0.25, 0.001, -0.002, 0.0]", "data: [a]"), "distortion_coefficients is"),
        (("0.11", ".nan"), "distortion_coefficients is"),
        ((WRITTEN, "- 1"), "expected a calibration"),
    ],
)
def test_what_is_no_calibration_is_refused_with_the_reason(change, reason, tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(WRITTEN.replace(*change))
    with pytest.raises(ValueError, match=reason):
        read_calibration(path)


def test_urls_name_files(tmp_path):
    assert path_of_url(f"file://{tmp_path}/my%20camera.yaml") == tmp_path / "my camera.yaml"
    for wrong in ("camera.yaml", "http://host/camera.yaml", "file://", "package://", "flash:///"):
        with pytest.raises(ValueError, match=r"expected file:///PATH\.yaml"):
            path_of_url(wrong)
    with pytest.raises(ValueError, match="no package 'no_such_package' is installed"):
        path_of_url("package://no_such_package/camera.yaml")


def test_a_message_of_any_model_is_a_calibration_and_back():
    calibration = CameraCalibration(
        640,
        480,
        "rational_polynomial",
        np.arange(8.0),
        np.diag([500.0, 510.0, 1.0]),
        np.eye(3),
        np.eye(3, 4),
    )
    message = msg_adapters.encode_calibration(calibration, stamp_ns=5, frame_id="camera")
    again = msg_adapters.decode_camera_info(message)
    assert again.distortion.tolist() == calibration.distortion.tolist()
    assert np.array_equal(again.camera_matrix, calibration.camera_matrix)
    assert again.distortion_model == "rational_polynomial"
