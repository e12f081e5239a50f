# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The compliance between markers, W C W': from its blocks between the nodes that they move with.
Each row of W has 27 weights."""

# Warp reads kernels by its own rules, which are none of a type checker's.
# mypy: ignore-errors

import torch

from dotsim_ros.gel.batched.kernels import ROUNDS_ONCE, meet
from dotsim_ros.io.warp_runtime import wp

wp.set_module_options({"enable_backward": False})

_SIZE = 9
"""Of a block, row by row."""
_TOGETHER = 8


def memory(count: int, rows: int, length: int, device: torch.device) -> torch.Tensor:
    """Return memory (count, rows, length or a few more, 9) for blocks, some of which a CPU takes at
    once. Rows of an odd number of those do not share a part of its cache."""
    padded = (-(-length // _TOGETHER) | 1) * _TOGETHER
    return torch.empty(count, rows, padded, _SIZE, device=device)


@wp.func_native("""
    const int n = block.shape[1];
    const int* __restrict__ first = place.data + 2 * node.data[(long long)b * node.shape[1] + i];
    const int* __restrict__ second = place.data + 2 * node.data[(long long)b * node.shape[1] + j];
    const float* __restrict__ signs = sign.data;
    float total[9] = {};
    for (int p = 0; p < 4; ++p) {
        const float* __restrict__ from =
            block.data + ((long long)p * n + 3 * first[0]) * n + 3 * second[0];
        for (int r = 0; r < 3; ++r)
            for (int s = 0; s < 3; ++s)
                total[3 * r + s] += signs[16 * r + 4 * p + first[1]]
                    * signs[16 * s + 4 * p + second[1]] * from[(long long)r * n + s];
    }
    const long long padded = between.shape[2], row = (long long)b * between.shape[1];
    float* there = between.data + 9 * ((row + i) * padded + j);
    float* back = between.data + 9 * ((row + j) * padded + i);
    for (int c = 0; c < 9; ++c) {
        there[c] = total[c];
        back[c] = total[3 * (c % 3) + c / 3];
    }
""")
def write_rest(
    b: int,
    i: int,
    j: int,
    node: wp.array2d(dtype=wp.int32),
    place: wp.array2d(dtype=wp.int32),
    sign: wp.array3d(dtype=wp.float32),
    block: wp.array3d(dtype=wp.float32),
    between: wp.array4d(dtype=wp.float32),
):
    """Write the compliance between two nodes, and between them in the other order."""
    ...


@wp.kernel
def gather_rest(
    node: wp.array2d(dtype=wp.int32),
    place: wp.array2d(dtype=wp.int32),
    sign: wp.array3d(dtype=wp.float32),
    block: wp.array3d(dtype=wp.float32),
    between: wp.array4d(dtype=wp.float32),
):
    """Write the compliance between nodes [b, i] and [b, j] from its blocks by parity; place holds
    each node's orbit and image, sign is [component, parity, image]."""
    b, i, j = wp.tid()
    if j <= i:
        write_rest(b, i, j, node, place, sign, block, between)


@wp.func_native("""
    const int* __restrict__ numbers = number.data + (long long)b * number.shape[1];
    float* row = between.data + 9LL * ((long long)b * between.shape[1] + i) * between.shape[2];
    for (int k = begin; k < end; ++k) {
        const int j = numbers[index.data[k]];
        if (j < 0) continue;
        const float* __restrict__ from = &block.data[k].data[0][0];
        for (int c = 0; c < 9; ++c) row[9 * j + c] = from[c];
    }
""")
def write_refinement(
    b: int,
    i: int,
    begin: int,
    end: int,
    number: wp.array2d(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    block: wp.array(dtype=wp.mat33),
    between: wp.array4d(dtype=wp.float32),
):
    """Write some blocks of a node's row to where the other nodes have numbers."""
    ...


@wp.kernel
def gather_refinement(
    node: wp.array2d(dtype=wp.int32),
    number: wp.array2d(dtype=wp.int32),
    indptr: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    block: wp.array(dtype=wp.mat33),
    between: wp.array4d(dtype=wp.float32),
):
    """Write what refinement adds to the compliance between nodes [b, i] of the finer grid, whose
    numbers the others lack (-1)."""
    b, i = wp.tid()
    n = node[b, i]
    write_refinement(b, i, indptr[n], indptr[n + 1], number, index, block, between)


@wp.func_native(
    ROUNDS_ONCE
    + """
    constexpr int lanes = WP_TILE_BLOCK_DIM;
    constexpr int nodes = lanes > 1 ? 1 : 8;
    const int count = column.shape[1];
    const long long width = 9 * between.shape[2], length = 9 * row.shape[2];
    const float* __restrict__ from = between.data + (long long)b * between.shape[1] * width;
    const int* __restrict__ columns = column.data + 27LL * b * count;
    const float* __restrict__ w = weight.data + 27LL * b * count;
    float* __restrict__ to = row.data + (b % row.shape[0]) * row.shape[1] * length;
    for (int first = lane * nodes; first < between.shape[2]; first += lanes * nodes)
        for (int m = 0; m < count; ++m) {
            float sum[9 * nodes] = {};
            for (int a = 27 * m; a < 27 * m + 27; ++a) {
                const float* __restrict__ part = from + columns[a] * width + 9 * first;
                for (int c = 0; c < 9 * nodes; ++c) sum[c] += w[a] * part[c];
            }
            for (int k = 0; k < nodes; ++k)
                for (int c = 0; c < 9; ++c) to[(first + k) * length + 9 * m + c] = sum[9 * k + c];
        }
"""
)
def weigh_rows(
    b: int,
    lane: int,
    column: wp.array3d(dtype=wp.int32),
    weight: wp.array3d(dtype=wp.float32),
    between: wp.array4d(dtype=wp.float32),
    row: wp.array4d(dtype=wp.float32),
):
    """Write W C, a lane's part."""
    ...


# It is symmetric: what is of markers m and l goes to both rows, unless the latter comes by itself.
@wp.func_native(
    ROUNDS_ONCE
    + """
    constexpr int lanes = WP_TILE_BLOCK_DIM;
    constexpr int markers = lanes > 1 ? 1 : 8;
    const int count = column.shape[1];
    const long long length = 9 * row.shape[2], size = 3 * count;
    const int* __restrict__ columns = column.data + 27LL * b * count;
    const float* __restrict__ w = weight.data + 27LL * b * count;
    const float* __restrict__ rows = row.data + (b % row.shape[0]) * row.shape[1] * length;
    float* __restrict__ to = result.data + b * size * size;
    for (int first = lane * markers; first < count; first += lanes * markers)
        for (int l = first; l < count; ++l) {
            float sum[9 * markers] = {};
            for (int a = 27 * l; a < 27 * l + 27; ++a) {
                const float* __restrict__ part = rows + columns[a] * length + 9 * first;
                for (int c = 0; c < 9 * markers; ++c) sum[c] += w[a] * part[c];
            }
            for (int k = 0; k < markers && first + k < count; ++k) {
                const int m = first + k;
                float* there = to + 3 * l * size + 3 * m;
                float* back = to + 3 * m * size + 3 * l;
                for (int i = 0; i < 3; ++i)
                    for (int j = 0; j < 3; ++j) {
                        const float c = sum[9 * k + 3 * i + j];
                        there[j * size + i] += c;
                        if (l >= first + markers) back[i * size + j] += c;
                    }
            }
        }
"""
)
def weigh_columns(
    b: int,
    lane: int,
    column: wp.array3d(dtype=wp.int32),
    weight: wp.array3d(dtype=wp.float32),
    row: wp.array4d(dtype=wp.float32),
    result: wp.array3d(dtype=wp.float32),
):
    """Add W C W' of W C, a lane's part."""
    ...


@wp.kernel
def weigh(
    column: wp.array3d(dtype=wp.int32),
    weight: wp.array3d(dtype=wp.float32),
    between: wp.array4d(dtype=wp.float32),
    row: wp.array4d(dtype=wp.float32),
    result: wp.array3d(dtype=wp.float32),
):
    """Add W C W' [b, 3 m + i, 3 l + j] of weights [b, m, a] on the nodes that are number
    [b, m, a] of those that C [b, node, node, component] is between. row is memory, of one gel where
    a block has one lane: these come one by one."""
    b, lane = wp.tid()
    weigh_rows(b, lane, column, weight, between, row)
    meet()
    weigh_columns(b, lane, column, weight, row, result)
