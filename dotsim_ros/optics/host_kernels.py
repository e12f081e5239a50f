# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera's kernels that run over pixels, for a CPU: those of `kernels`, some twice as fast.

Warp makes a CPU's code one pixel and one number at a time. These hand the inner loops to the
compiler's vector types instead: eight points or pixels of a row at once, or the three parts of a
colour or a direction. Numbers are added and multiplied in the same order, so the results are the
same to the last bit; the tests hold both against each other. The types are those of Clang, which
Warp compiles for a CPU with: any CPU has them, whatever the width of its registers. Threads share a
frame by bands of rows (`bands`), so a kernel writes to the rows that it is given alone.

What has a namesake in `kernels` takes what that takes.
"""

# Kernels are Warp's language, whose types are none of a type checker's.
# mypy: ignore-errors

from dotsim_ros.io.warp_runtime import wp
from dotsim_ros.optics.kernels import (
    CRACK_TOLERANCE,
    NO_TRIANGLE,
    ImagePixels,
    Led,
    Lens,
    NormalPixels,
    inverse_corners,
    pixels_around,
)

wp.set_module_options({"enable_backward": False})

LANES = wp.constant(8)
"""Points that are lit, and pixels that the rasteriser tests at once; a band of rows must have as
many."""

_NO_TRIANGLE = wp.constant(NO_TRIANGLE)


def launch_dim(rows: int, _width: int) -> tuple[int, int]:
    """Return the threads of a kernel that runs over the pixels of rows: one a row."""
    return rows, 1


def point_dim(count: int) -> int:
    """Return the threads of `irradiate`."""
    return -(-count // LANES)


_NEAREST_IN_BOX = """
    typedef float lanes __attribute__((vector_size(32), aligned(4), may_alias));
    typedef int flags __attribute__((vector_size(32), aligned(4), may_alias));
    typedef float pairs __attribute__((vector_size(64), aligned(4), may_alias));
    typedef int pair_flags __attribute__((vector_size(64), aligned(4), may_alias));
    const int width = triangle_seen.shape[1];
    const int count = triangle_seen.shape[0] * width;
    // What lies beyond may be another thread's.
    const int last_start = row_end * width - 8;
    // Copies stay in registers: what is written cannot change them.
    const auto all = inverse.data[0];
    const auto to_b = inverse.data[1];
    const auto to_c = inverse.data[2];
    const auto corners = box;
    const float* const rays = ray.data;
    int* const triangles_seen = triangle_seen.data;
    float* const depths = depth.data;
    auto* const weights = barycentric.data;
    for (int row = corners[2]; row <= corners[3]; ++row) {
        const int end = row * width + corners[1] + 1;
        for (int first = row * width + corners[0]; first < end; first += 8) {
            // The last lanes of the band start earlier. No ray beyond the box meets the triangle.
            const int start = first < last_start ? first : last_start;
            const float* direction = rays + start;
            const lanes x = *(const lanes*)direction;
            const lanes y = *(const lanes*)(direction + count);
            const lanes z = *(const lanes*)(direction + 2 * count);
            // The weights sum to the inverse of the distance along the ray.
            const lanes total = all[0] * x + all[1] * y + all[2] * z;
            const lanes weight_b = to_b[0] * x + to_b[1] * y + to_b[2] * z;
            const lanes weight_c = to_c[0] * x + to_c[1] * y + to_c[2] * z;
            const lanes least = -crack_tolerance * total;
            const flags inside = (total > 0.0f) & (weight_b >= least)
                & (weight_c >= least) & (total - weight_b - weight_c >= least);
            const lanes distance = 1.0f / total;
            flags& seen = *(flags*)(triangles_seen + start);
            lanes& nearest = *(lanes*)(depths + start);
            pairs& weight = *(pairs*)(weights + start);
            // All are read before one is written: else Clang makes masked stores of it, which are
            // slow on some CPUs (Agner Fog, "Instruction tables": VMASKMOVPS of AMD's).
            const flags seen_before = seen;
            const lanes nearest_before = nearest;
            const pairs weight_before = weight;
            // Of two at one distance the first of the mesh, in whatever order they come.
            const flags closer = inside & ((seen_before == no_triangle)
                | (distance < nearest_before)
                | ((distance == nearest_before) & (face < seen_before)));
            const lanes b = weight_b * distance;
            const lanes c = weight_c * distance;
            const pairs both = __builtin_shufflevector(
                b, c, 0, 8, 1, 9, 2, 10, 3, 11, 4, 12, 5, 13, 6, 14, 7, 15);
            const pair_flags written = __builtin_shufflevector(
                closer, closer, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7);
            seen = closer ? face : seen_before;
            nearest = closer ? distance : nearest_before;
            weight = written ? both : weight_before;
        }
    }
"""


@wp.func_native(_NEAREST_IN_BOX)
def nearest_in_box(
    face: int,
    box: wp.vec4i,
    row_end: int,
    inverse: wp.mat33,
    crack_tolerance: float,
    no_triangle: int,
    ray: wp.array3d(dtype=wp.float32),
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    depth: wp.array2d(dtype=wp.float32),
):
    """Note a triangle where it is nearer than what the rays of a box (first and last column, first
    and last row) have met so far; the rows of `inverse` are those of `kernels.inverse_corners`.

    The lanes beyond the box get back what they held, up to the end of the row before `row_end`.
    """
    ...


@wp.kernel
def rasterize(
    position: wp.array(dtype=wp.vec3),
    pixel: wp.array(dtype=wp.vec2),
    triangles: wp.array2d(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    ray: wp.array3d(dtype=wp.float32),
    lens: Lens,
    row_first: int,
    row_end: int,
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    depth: wp.array2d(dtype=wp.float32),
):
    """Nearest triangle along every ray of a band of rows; one thread at a time has a band (a CPU),
    since its triangles share pixels. A band has at least `LANES` pixels.

    The box around the projected corners only chooses the pixels; each is tested with its own ray,
    so a lens's curved edges cost no accuracy. The rays are (3, H, W): their parts lie apart. The
    order of the triangles decides how long it takes alone.
    """
    face = order[wp.tid()]
    i0 = triangles[face, 0]
    i1 = triangles[face, 1]
    i2 = triangles[face, 2]
    x_first, x_last, y_first, y_last = pixels_around(
        pixel[i0], pixel[i1], pixel[i2], lens, triangle_seen.shape[1], row_first, row_end
    )
    if x_first > x_last or y_first > y_last:
        return

    normal_all, normal_b, normal_c = inverse_corners(position[i0], position[i1], position[i2])
    nearest_in_box(
        face,
        wp.vec4i(x_first, x_last, y_first, y_last),
        row_end,
        wp.matrix_from_rows(normal_all, normal_b, normal_c),
        CRACK_TOLERANCE,
        _NO_TRIANGLE,
        ray,
        triangle_seen,
        barycentric,
        depth,
    )


_NORMAL_ROW = """
    // A copy stays in registers: what is written cannot change it.
    const auto view = given;
    typedef float four __attribute__((vector_size(16)));
    const auto load = [](const wp::vec_t<3, float>& v) -> four {
        return four{v[0], v[1], v[2], 0.0f};
    };
    const auto store = [](const four& v, wp::vec_t<3, float>& out) {
        out = wp::vec_t<3, float>(v[0], v[1], v[2]);
    };
    const four nothing = four{} + __builtin_nanf("");
    int loaded = no_triangle;
    four outward[3] = {};
    const int end = (row + 1) * view.triangle_seen.shape[1];
    for (int at = end - view.triangle_seen.shape[1]; at < end; ++at) {
        const int face = view.triangle_seen.data[at];
        if (face == no_triangle) {
            store(nothing, view.normal.data[at]);
            continue;
        }
        if (face != loaded) {
            loaded = face;
            for (int i = 0; i < 3; ++i)
                outward[i] = load(view.vertex_normal.data[view.triangles.data[3 * face + i]]);
            for (int i = 1; i < 3; ++i) outward[i] -= outward[0];
        }
        const float b = view.barycentric.data[at][0];
        const float c = view.barycentric.data[at][1];
        const four towards = outward[0] + b * outward[1] + c * outward[2];
        const four square = towards * towards;
        const four along = towards * load(view.ray.data[at]);
        const float length = __builtin_sqrtf(square[0] + square[1] + square[2]);
        const bool away = along[0] + along[1] + along[2] > 0.0f;
        store(towards / (away ? -length : length), view.normal.data[at]);
    }
"""


@wp.func_native(_NORMAL_ROW)
def normal_row(row: int, no_triangle: int, given: NormalPixels):
    """Fill the normals of a row."""
    ...


@wp.kernel
def fill_normals(view: NormalPixels, row_first: int):
    """`kernels.fill_normals`, the three parts of a vector at once."""
    row, _ = wp.tid()
    normal_row(row_first + row, _NO_TRIANGLE, view)


_WARP_ROW = """
    const auto pixels = given;
    typedef float four __attribute__((vector_size(16), aligned(4), may_alias));
    typedef float eight __attribute__((vector_size(32), aligned(4), may_alias));
    typedef int levels __attribute__((vector_size(16)));
    const auto both = [](const four& a, const four& b) -> eight {
        return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
    };
    const auto first = [](const eight& v) -> four {
        return __builtin_shufflevector(v, v, 0, 1, 2, 3);
    };
    const auto second = [](const eight& v) -> four {
        return __builtin_shufflevector(v, v, 4, 5, 6, 7);
    };
    // The right one of two neighbouring samples, by a load that stays within them.
    const auto next = [](const float* sample) -> four {
        const four last = *(const four*)(sample + 2);
        return __builtin_shufflevector(last, last, 1, 2, 3, 0);
    };
    const int fine_width = pixels.fine_flat.shape[1];
    const int fine_height = pixels.fine_flat.shape[0];
    const four last_place = {(float)(fine_width - 1), (float)(fine_height - 1)};
    const levels last_cell = {fine_width - 2, fine_height - 2};
    const float* const samples = (const float*)pixels.fine_flat.data;
    const four dark = {};
    const four full = dark + 255.0f;
    const eight* const changes = (const eight*)pixels.change.data;
    const int width = pixels.triangle_seen.shape[1];
    for (int x = 0; x < width; ++x) {
        const int at = y * width + x;
        const int face = pixels.triangle_seen.data[at];
        unsigned char* colour = pixels.image.data + 3 * at;
        if (face == no_triangle || pixels.lit.data[at] == 0) {
            for (int k = 0; k < 3; ++k) colour[k] = pixels.idle.data[3 * at + k];
            continue;
        }
        const float b = pixels.barycentric.data[at][0];
        const float c = pixels.barycentric.data[at][1];
        const eight* change = changes + 3 * face;
        const eight mixed = change[0] + b * change[1] + c * change[2];
        four place = 2.0f * (four{(float)x, (float)y} + second(mixed));
        place = place > dark ? place : dark;
        place = place < last_place ? place : last_place;
        // The last sample is reached as the far end of the last cell.
        levels cell = __builtin_convertvector(place, levels);
        cell = cell < last_cell ? cell : last_cell;
        const four share = place - __builtin_convertvector(cell, four);
        const float right = share[0];
        const float down = share[1];
        const float* upper = samples + 3 * (cell[1] * fine_width + cell[0]);
        const float* lower = upper + 3 * fine_width;
        const eight rows = (1.0f - right) * both(*(const four*)upper, *(const four*)lower)
            + right * both(next(upper), next(lower));
        four level = ((1.0f - down) * first(rows) + down * second(rows)) * first(mixed);
        level = level * pixels.vignetting.data[at];
        level = level > dark ? level : dark;
        level = level < full ? level : full;
        const levels whole = __builtin_convertvector(level + 0.5f, levels);
        for (int k = 0; k < 3; ++k) colour[k] = (unsigned char)whole[k];
    }
"""


@wp.func_native(_WARP_ROW)
def warp_row(y: int, no_triangle: int, given: ImagePixels):
    """Colour the pixels of a row."""
    ...


@wp.kernel
def warp_idle(pixels: ImagePixels, row_first: int):
    """`kernels.warp_idle`, the three colours and both coordinates at once."""
    row, _ = wp.tid()
    warp_row(row_first + row, _NO_TRIANGLE, pixels)


_LIGHT = """
    typedef float lanes __attribute__((vector_size(32)));
    const int count = position.shape[0];
    lanes place[3], out[3], total[3] = {};
    for (int k = 0; k < 8; ++k) {
        // The last lanes repeat the last point.
        const int at = first + k < count ? first + k : count - 1;
        for (int i = 0; i < 3; ++i) {
            place[i][k] = position.data[at][i];
            out[i][k] = outward.data[at][i];
        }
    }
    const auto dot = [](const lanes* a, const lanes* b) -> lanes {
        return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    };
    const lanes distance = __builtin_elementwise_sqrt(dot(place, place));
    lanes sight[3];
    for (int i = 0; i < 3; ++i) sight[i] = distance > 0.0f ? place[i] / distance : lanes{};
    const lanes towards = dot(out, sight);
    const float widest = 1.0f - 9.0f / exponent;
    const float least = widest > 0.0f ? widest : 0.0f;
    for (int led = 0; led < leds.shape[0]; ++led) {
        lanes away[3];
        for (int i = 0; i < 3; ++i) away[i] = place[i] - leds.data[led].position[i];
        const lanes nearness = 1.0f / __builtin_elementwise_sqrt(dot(away, away));
        const lanes incidence = dot(out, away) * nearness;
        lanes share = incidence > 0.0f ? incidence : 0.0f;
        if (gloss > 0.0f) {
            const lanes along = incidence + towards;
            const lanes length_square = 2.0f + 2.0f * dot(away, sight) * nearness;
            const auto mirrors = (along > 0.0f)
                & (along * along > least * least * length_square);
            for (int k = 0; k < 8; ++k) {
                if (!mirrors[k]) continue;
                const float cosine = wp::min(along[k] / wp::sqrt(length_square[k]), 1.0f);
                share[k] += gloss * wp::exp(exponent * (cosine - 1.0f));
            }
        }
        const lanes sent = share * nearness * nearness;
        for (int i = 0; i < 3; ++i) total[i] += leds.data[led].intensity[i] * sent;
    }
    for (int k = 0; k < 8 && first + k < count; ++k)
        for (int i = 0; i < 3; ++i) irradiance.data[first + k][i] = total[i][k];
"""


@wp.func_native(_LIGHT)
def light_sent(
    first: int,
    position: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    leds: wp.array(dtype=Led),
    gloss: float,
    exponent: float,
    irradiance: wp.array(dtype=wp.vec3),
):
    """Fill in the light that points from one on send."""
    ...


@wp.kernel
def irradiate(
    position: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    leds: wp.array(dtype=Led),
    gloss: float,
    gloss_exponent: float,
    irradiance: wp.array(dtype=wp.vec3),
):
    """`kernels.irradiate`, eight points at once."""
    light_sent(LANES * wp.tid(), position, outward, leds, gloss, gloss_exponent, irradiance)
