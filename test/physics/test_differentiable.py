# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of a trajectory by torch, against central finite differences of `press` itself."""

from dataclasses import replace

import numpy as np
import pytest

from dotsim_ros.gel.make import skin_of
from dotsim_ros.geometry.indenter import load_indenter
from dotsim_ros.geometry.pose import Pose
from dotsim_ros.sensor import TactileSensor
from dotsim_ros.specification import load_sensor

pytest.importorskip("torch")

import torch

from dotsim_ros.differentiable import Touch, press, press_each, see

PAD = load_sensor("flat_pad")
SENSOR = replace(PAD, solver=replace(PAD.solver, refined=False))
TOP_M = PAD.gel.pad_size_m[2]
PATH = [
    Pose(np.array([x, 0.1e-3, TOP_M + z]))
    for x, z in ((0.0, 0.2e-3), (0.0, -0.3e-3), (0.1e-3, -0.6e-3), (0.5e-3, -0.6e-3))
]


def loss_of(touch: Touch) -> torch.Tensor:
    """Return a loss in which every output has a part, that of the slide the largest."""
    weight = torch.linspace(1.0, 2.0, 3, dtype=torch.float64)
    skin = touch.skin_position_m[-1] - torch.as_tensor([0.0, 0.0, TOP_M])
    return 1e6 * (skin**2 * weight).sum() + (touch.force_n * weight).sum() + touch.torque_nm.sum()


def solved(path: list[Pose] = PATH, **values: float) -> float:
    return float(loss_of(press(SENSOR, load_indenter("sphere_4mm"), path, **values)))


@pytest.fixture(scope="module")
def gradient() -> dict[str, torch.Tensor]:
    own = PAD.material
    given = {
        name: torch.tensor(value, dtype=torch.float64, requires_grad=True)
        for name, value in (
            ("youngs_modulus_pa", own.youngs_modulus_pa),
            ("poisson_ratio", own.poisson_ratio),
            ("friction", PAD.contact.friction_coefficient),
            ("contact_stiffness", PAD.contact.stiffness),
        )
    }
    offset = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    twist = torch.zeros(len(PATH), 6, dtype=torch.float64, requires_grad=True)
    touch = press(
        SENSOR, load_indenter("sphere_4mm"), PATH, pose_twist=twist, pose_offset=offset, **given
    )
    loss_of(touch).backward()
    return {**given, "twist": twist, "offset": offset}


@pytest.mark.parametrize(
    ("name", "relative_step"),
    [
        ("youngs_modulus_pa", 1e-4),
        ("poisson_ratio", 1e-5),
        ("friction", 1e-4),
        ("contact_stiffness", 1e-4),
    ],
)
def test_derivatives_by_values_are_those_of_differences(gradient, name, relative_step):
    value = gradient[name].item()
    step = relative_step * value
    expected = (solved(**{name: value + step}) - solved(**{name: value - step})) / (2.0 * step)
    assert float(gradient[name].grad) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("frame", "axis"), [(3, 0), (3, 2), (2, 1)])
def test_derivatives_by_a_pose_are_those_of_differences(gradient, frame, axis):
    step = 1e-7
    found = []
    for sign in (1.0, -1.0):
        path = list(PATH)
        moved = path[frame].position_m + sign * step * np.eye(3)[axis]
        path[frame] = replace(path[frame], position_m=moved)
        found.append(solved(path))
    expected = (found[0] - found[1]) / (2.0 * step)
    assert float(gradient["twist"].grad[frame, axis]) == pytest.approx(expected, rel=1e-3)


def test_the_derivative_by_an_offset_is_that_of_all_poses_moved_along_the_indenters_axes(gradient):
    found = [
        solved([replace(p, position_m=p.position_m + s * np.eye(3)[2]) for p in PATH])
        for s in (1e-7, -1e-7)
    ]
    expected = (found[0] - found[1]) / 2e-7
    assert float(gradient["offset"].grad[2]) == pytest.approx(expected, rel=1e-3)


def test_gels_that_share_their_values_have_the_derivatives_of_each_alone():
    shapes = [load_indenter("sphere_4mm"), load_indenter("box_edge")]
    paths = [PATH, [*PATH[:3], PATH[1]]]

    def given(*before: int) -> tuple[torch.Tensor, torch.Tensor]:
        friction = torch.tensor(0.5, dtype=torch.float64, requires_grad=True)
        twist = torch.zeros(*before, 4, 6, dtype=torch.float64, requires_grad=True)
        return friction, twist

    friction, twist = given(2)
    touch = press_each(SENSOR, shapes, paths, pose_twist=twist, friction=friction)
    sum(loss_of(Touch(*each)) for each in zip(*touch, strict=True)).backward()
    by_friction = 0.0
    for b in (0, 1):
        own_friction, own_twist = given()
        own = press(SENSOR, shapes[b], paths[b], pose_twist=own_twist, friction=own_friction)
        loss_of(own).backward()
        by_friction += own_friction.grad
        torch.testing.assert_close(twist.grad[b], own_twist.grad, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(friction.grad, by_friction, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize(
    ("name", "spacing_m", "shares"),
    [("densetact2", 3.6e-3, (1.0, 1.1)), ("flat_pad", 2.0e-3, (0.97, 0.95))],
)
def test_the_derivative_by_thickness_is_that_of_differences_for_each_gel(name, spacing_m, shares):
    sensor = load_sensor(name)
    solver = replace(sensor.solver, grid_spacing_m=spacing_m, refined=False)
    sensor, step_m = replace(sensor, solver=solver), 1e-7
    top_m = float(skin_of(sensor.gel).rest_position_m[:, 2].max())
    paths = [[Pose(np.array([0.0, 0.0, top_m + z])) for z in (1e-4, -x)] for x in (4e-4, 6e-4)]
    balls = [load_indenter("sphere_4mm")] * 2
    own_m = sensor.gel.thickness_m * torch.tensor(shares, dtype=torch.float64)
    value = own_m.requires_grad_()
    force_n = press_each(sensor, balls, paths, thickness_m=value).force_n[:, -1, 2]
    force_n.sum().backward()
    alone = [
        float(press(sensor, balls[1], paths[1], thickness_m=value[1].item() + s).force_n[-1, 2])
        for s in (step_m, -step_m)
    ]
    assert force_n[1].item() == pytest.approx(0.5 * sum(alone), rel=1e-6)
    expected = (alone[0] - alone[1]) / (2.0 * step_m)
    assert float(value.grad[1]) == pytest.approx(expected, rel=1e-3)
    assert float(value.grad[0]) != float(value.grad[1])
    with pytest.raises(ValueError, match="1 indenters for 2 gels"):
        press_each(sensor, balls[:1], paths)


def test_what_has_no_derivative_is_refused():
    sphere = load_indenter("sphere_4mm")
    with pytest.raises(TypeError, match="no parameter 'stiffness', expected some of youngs"):
        press(SENSOR, sphere, PATH, stiffness=torch.tensor(1.0))
    with pytest.raises(ValueError, match=r"shape \(2, 6\), expected zeros of shape \(4, 6\)"):
        press(SENSOR, sphere, PATH, pose_twist=torch.zeros(2, 6))


MARKED = load_sensor("gelsight_mini_markers")
COARSE = replace(MARKED, solver=replace(MARKED.solver, refined=False))
SEEN_TOP_M = MARKED.gel.pad_size_m[2]
SEEN_PATH = [
    Pose(np.array([x, 0.1e-3, SEEN_TOP_M + z]))
    for x, z in ((0.0, 0.2e-3), (0.0, -0.4e-3), (0.4e-3, -0.5e-3))
]
IMAGE = (48, 36)


def test_what_is_seen_is_what_the_sensor_sees():
    sensor = TactileSensor.load(COARSE, indenter="sphere_4mm")
    frame = [sensor.step(pose) for pose in SEEN_PATH][-1]
    motion = sensor.marker_motion(frame.skin_position_m)
    sight = see(COARSE, torch.as_tensor(frame.skin_position_m))
    # The frame has single precision.
    np.testing.assert_allclose(sight.depth_m.numpy(), frame.depth_m, atol=2e-8)
    np.testing.assert_allclose(sight.marker_px.numpy(), motion.position_px, atol=1e-6)


DOME = load_sensor("densetact2")
MARKED_DOME = replace(
    DOME,
    markers=replace(MARKED.markers, columns=5, rows=5),
    solver=replace(DOME.solver, grid_spacing_m=3.6e-3, refined=False),
)


@pytest.mark.parametrize(
    ("sensor", "indenter"),
    [(COARSE, "sphere_4mm"), (COARSE, "box_edge"), (MARKED_DOME, "sphere_4mm")],
)
def test_derivatives_of_depth_and_markers_are_those_of_differences(sensor, indenter):
    top_m = float(skin_of(sensor.gel).apex_m[2])
    # Of the last pose along x, and of values; the shape does not depend on Young's modulus.
    step = torch.tensor([1e-7, 1e-6, 1e-5, 1e-6], dtype=torch.float64)

    def seen(given: torch.Tensor) -> torch.Tensor:
        x_m, poisson, friction, thickness = given
        path = [Pose(pose.position_m + np.array([0.0, 0.0, top_m - TOP_M])) for pose in PATH]
        path[3] = Pose(path[3].position_m + x_m.item() * np.eye(3)[0])
        twist = torch.zeros(4, 6, dtype=torch.float64)
        twist[3, 0] = x_m - x_m.detach()
        touch = press(
            sensor,
            load_indenter(indenter),
            path,
            pose_twist=twist,
            poisson_ratio=sensor.material.poisson_ratio * (1.0 + poisson),
            friction=sensor.contact.friction_coefficient * (1.0 + friction),
            thickness_m=sensor.gel.thickness_m * (0.97 + thickness),
        )
        sight = see(sensor, touch.skin_position_m, image_size=(32, 24))
        depth_mm = 1e3 * (sight.depth_m[1:] - sight.depth_m[:1]).flatten(1)
        motion_px = sight.marker_px[1:] - sight.marker_px[:1]
        by_pixel, by_axis = torch.linspace(1.0, 2.0, depth_mm.shape[1]), torch.tensor([1.0, 2.0])
        return torch.stack([(depth_mm * by_pixel).nansum(), (motion_px**2 * by_axis).nansum()])

    given = torch.zeros(4, dtype=torch.float64, requires_grad=True)
    found = [torch.autograd.grad(one, given, retain_graph=True)[0] for one in seen(given)]
    # All at once, since derivatives by each value have tests of their own.
    expected = 0.5 * (seen(step) - seen(-step))
    for by_given, difference in zip(found, expected, strict=True):
        assert float(by_given @ step) == pytest.approx(float(difference), rel=1e-3, abs=0.0)


def test_a_marker_without_an_image_leaves_the_derivatives_of_the_others():
    near = replace(MARKED.camera, position_m=(0.0, 0.0, 3.3e-3), distortion=(0.0,) * 4)
    sensor = replace(MARKED, camera=near)
    skin_m = torch.tensor(skin_of(MARKED.gel).rest_position_m, requires_grad=True)
    marker_px = see(sensor, skin_m, image_size=(32, 24)).marker_px
    assert 0 < int(marker_px.isnan().any(dim=1).sum()) < len(marker_px)
    marker_px.nansum().backward()
    assert bool(skin_m.grad.isfinite().all())
