# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The kernels of many gels with blocks of any size, and for a GPU that need not be there."""

from collections.abc import Iterator

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from dotsim_ros.gel.batched import compliance_kernels, contact_newton, kernels  # noqa: E402
from dotsim_ros.gel.batched.contact import Contact, Markers, solve_contact  # noqa: E402
from dotsim_ros.gel.distance_field import indenter_field  # noqa: E402
from dotsim_ros.geometry.indenter import sphere  # noqa: E402
from dotsim_ros.io.arrays import FloatArray  # noqa: E402
from dotsim_ros.io.warp_runtime import wp  # noqa: E402

RADIUS_M, SIDE, SPACING_M, MODULUS_PA, FRICTION = 4e-3, 7, 0.5e-3, 8e4, 0.4
DEPTH_M, SLIDE_M = (0.05e-3, 0.3e-3, -1e-3), 0.1e-3
"""Of balls in the markers' plane; the last one touches none. The markers slid by SLIDE_M."""
STIFFNESS_PA_M, ONSET_M, SMOOTHING_M = 8e9, 5e-6, 5e-6


@pytest.fixture(params=[1, 32])
def lanes(request: pytest.FixtureRequest) -> Iterator[int]:
    """Let blocks of a CPU have so many lanes."""
    before = wp.config.enable_cpu_blocks
    wp.config.enable_cpu_blocks = request.param > 1
    yield request.param
    wp.config.enable_cpu_blocks = before


def half_space() -> tuple[FloatArray, FloatArray]:
    """Return markers (K, 3) on a half space, the middle ones first, and its compliance."""
    x, y = np.meshgrid(*[SPACING_M * (np.arange(SIDE) - SIDE // 2)] * 2)
    marker = np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    marker = marker[np.argsort(np.linalg.norm(marker, axis=1), kind="stable")]
    apart = np.linalg.norm(marker[:, None] - marker, axis=2)
    normal = 1.0 / (np.pi * MODULUS_PA * np.hypot(apart, 0.4 * SPACING_M))
    return marker, np.kron(normal, np.diag([0.8, 0.8, 1.0]))


def solved(marker: FloatArray, compliance: FloatArray) -> Contact:
    count, k = len(DEPTH_M), len(marker)
    law = kernels.ContactLaw()
    law.stiffness = law.tangential_stiffness = STIFFNESS_PA_M
    law.friction, law.onset, law.smoothing = FRICTION, ONSET_M, SMOOTHING_M
    field = indenter_field(sphere(RADIUS_M), scalar=wp.float32, device="cpu")
    base = torch.as_tensor(marker, dtype=torch.float32).expand(count, -1, -1).contiguous()
    origin = torch.tensor([[0.0, 0.0, -depth] for depth in DEPTH_M])
    start = base - origin[:, None] + torch.tensor([SLIDE_M, 0.0, 0.0])
    markers = Markers(
        torch.arange(k).expand(count, -1),
        torch.full((count, k), SPACING_M**2),
        start,
        torch.zeros_like(start),
        torch.arange(count, dtype=torch.int32),
        torch.arange(count, dtype=torch.int32),
        torch.eye(3).repeat(count, 1, 1),
        origin,
        wp.array([field] * count, dtype=kernels.IndenterField, device="cpu"),
        wp.array([law] * count, dtype=kernels.ContactLaw, device="cpu"),
    )
    given = torch.as_tensor(compliance, dtype=torch.float32).expand(count, -1, -1).contiguous()
    return solve_contact(
        markers,
        given,
        base_m=base,
        force_n=torch.zeros_like(base),
        guess_m=base,
        newton_steps=24,
        tolerance_m=1e-9,
    )


def answered_n(position_m: FloatArray, depth_m: float, start_m: FloatArray) -> FloatArray:
    """Return the forces (K, 3) of Coulomb's law on markers (K, 3) under a ball."""
    from_centre = position_m - np.array([0.0, 0.0, RADIUS_M - depth_m])
    length = np.linalg.norm(from_centre, axis=1, keepdims=True)
    normal, depth = from_centre / length, ONSET_M - (length - RADIUS_M)
    early = depth.clip(min=0.0) ** 2 / (2.0 * SMOOTHING_M)
    pressure_pa = STIFFNESS_PA_M * np.where(depth < SMOOTHING_M, early, depth - 0.5 * SMOOTHING_M)
    slip = position_m - start_m
    slip -= np.sum(slip * normal, axis=1, keepdims=True) * normal
    limit = FRICTION * pressure_pa / STIFFNESS_PA_M
    slip *= np.minimum(1.0, limit / np.linalg.norm(slip, axis=1, keepdims=True).clip(min=1e-15))
    force: FloatArray = SPACING_M**2 * (pressure_pa * normal - STIFFNESS_PA_M * slip)
    return force


def test_contact_is_solved_with_blocks_of_any_size(lanes, monkeypatch):
    monkeypatch.setattr(kernels, "BLOCK", lanes)
    marker, compliance = half_space()
    found = solved(marker, compliance)
    for b, depth_m in enumerate(DEPTH_M):
        force = found.force_n[b].numpy().astype(float)
        position = marker + (compliance @ force.ravel()).reshape(-1, 3)
        np.testing.assert_allclose(found.position_m[b], position, atol=2e-9)
        right = answered_n(position, depth_m, marker + np.array([SLIDE_M, 0.0, 0.0]))
        np.testing.assert_allclose(force, right, atol=3e-3 * np.abs(right).max())
    newtons = found.force_n.norm(dim=2).amax(dim=1)
    assert newtons[1] > newtons[0] > 0.0
    assert newtons[2] == 0.0


@pytest.mark.skipif(not wp.get_cuda_supported_archs(), reason="Warp has no compiler for a GPU")
@pytest.mark.parametrize(
    ("module", "names"),
    [
        (contact_newton, ["solve"]),
        (kernels, ["mix", "add_elastic_forces"]),
        (compliance_kernels, ["weigh"]),
    ],
)
def test_the_kernels_of_a_batch_build_for_a_gpu(tmp_path, module, names):
    [built] = wp.compile_aot_module(module, arch=90, use_ptx=True, module_dir=tmp_path)
    text = built.read_text(encoding="ascii")
    assert all(f".entry {name}_" in text for name in names)
