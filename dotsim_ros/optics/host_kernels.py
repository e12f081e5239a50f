"""The camera's kernels that run over pixels, for a CPU: those of `kernels`, some twice as fast.

Warp makes a CPU's code one pixel and one number at a time. These hand the inner loops to the
compiler's vector types instead: eight pixels of a row at once, or the three parts of a colour or a
direction. Numbers are added and multiplied in the same order, so the results are the same to the
last bit; the tests hold both against each other. The types are those of Clang, which Warp compiles
for a CPU with: any CPU has them, whatever the width of its registers.

`fill_view` and `carry_idle` take what their namesakes in `kernels` take.
"""

# Kernels are Warp's language, whose types are none of a type checker's.
# mypy: ignore-errors

import warp as wp

from dotsim_ros.optics.kernels import NO_TRIANGLE, Lens

wp.set_module_options({"enable_backward": False})

LANES = 8
"""Pixels that the rasteriser tests at once; an image must have as many."""

_NO_TRIANGLE = wp.constant(NO_TRIANGLE)
_CRACK_TOLERANCE = wp.constant(1.0e-5)

_NEAREST_IN_BOX = """
    typedef float lanes __attribute__((vector_size(32), aligned(4), may_alias));
    typedef int flags __attribute__((vector_size(32), aligned(4), may_alias));
    typedef float pairs __attribute__((vector_size(64), aligned(4), may_alias));
    typedef int pair_flags __attribute__((vector_size(64), aligned(4), may_alias));
    const flags number = {0, 1, 2, 3, 4, 5, 6, 7};
    const int width = triangle_seen.shape[1];
    const int count = triangle_seen.shape[0] * width;
    for (int row = y_first; row <= y_last; ++row) {
        const int end = row * width + x_last + 1;
        for (int first = row * width + x_first; first < end; first += 8) {
            // The last lanes of the image start earlier, and leave out what lies before.
            const int start = first < count - 8 ? first : count - 8;
            const flags place = start + number;
            const float* direction = ray.data + start;
            const lanes x = *(const lanes*)direction;
            const lanes y = *(const lanes*)(direction + count);
            const lanes z = *(const lanes*)(direction + 2 * count);
            // The weights sum to the inverse of the distance along the ray.
            const lanes total = normal_all[0] * x + normal_all[1] * y + normal_all[2] * z;
            const lanes weight_b = normal_b[0] * x + normal_b[1] * y + normal_b[2] * z;
            const lanes weight_c = normal_c[0] * x + normal_c[1] * y + normal_c[2] * z;
            const lanes least = -crack_tolerance * total;
            const flags inside = (place >= first) & (place < end) & (total > 0.0f)
                & (weight_b >= least) & (weight_c >= least)
                & (total - weight_b - weight_c >= least);
            const lanes distance = 1.0f / total;
            flags& seen = *(flags*)(triangle_seen.data + start);
            lanes& nearest = *(lanes*)(depth.data + start);
            const flags closer = inside & ((seen == no_triangle) | (distance < nearest));
            seen = closer ? face : seen;
            nearest = closer ? distance : nearest;
            const lanes b = weight_b * distance;
            const lanes c = weight_c * distance;
            pairs& weight = *(pairs*)(barycentric.data + start);
            const pairs both = __builtin_shufflevector(
                b, c, 0, 8, 1, 9, 2, 10, 3, 11, 4, 12, 5, 13, 6, 14, 7, 15);
            const pair_flags written = __builtin_shufflevector(
                closer, closer, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7);
            weight = written ? both : weight;
        }
    }
"""


@wp.func_native(_NEAREST_IN_BOX)
def nearest_in_box(
    face: int,
    x_first: int,
    x_last: int,
    y_first: int,
    y_last: int,
    normal_all: wp.vec3,
    normal_b: wp.vec3,
    normal_c: wp.vec3,
    crack_tolerance: float,
    no_triangle: int,
    ray: wp.array3d(dtype=wp.float32),
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    depth: wp.array2d(dtype=wp.float32),
):
    """Note a triangle where it is nearer than what the box's rays have met so far."""
    ...


@wp.kernel
def rasterize(
    position: wp.array(dtype=wp.vec3),
    pixel: wp.array(dtype=wp.vec2),
    triangles: wp.array2d(dtype=wp.int32),
    ray: wp.array3d(dtype=wp.float32),
    lens: Lens,
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    depth: wp.array2d(dtype=wp.float32),
):
    """Nearest triangle along every ray; one thread at a time (a CPU), since pixels are shared.

    The box around the projected corners only chooses the pixels; each is tested with its own ray,
    so the fisheye's curved edges cost no accuracy. The rays are (3, H, W): their parts lie apart.
    """
    face = wp.tid()
    i0 = triangles[face, 0]
    i1 = triangles[face, 1]
    i2 = triangles[face, 2]
    p0 = pixel[i0]
    p1 = pixel[i1]
    p2 = pixel[i2]
    left = wp.min(wp.min(p0[0], p1[0]), p2[0])
    right = wp.max(wp.max(p0[0], p1[0]), p2[0])
    top = wp.min(wp.min(p0[1], p1[1]), p2[1])
    bottom = wp.max(wp.max(p0[1], p1[1]), p2[1])
    # An edge of length s images as a curve of curvature below 0.65 / focal, which bulges out of
    # the box of its ends by at most a curvature's eighth of s^2; s^2 is at most 2 extent^2.
    extent = wp.max(right - left, bottom - top)
    margin = 0.2 * extent * extent / lens.focal_px + 0.01
    x_first = wp.max(int(wp.ceil(left - margin)), 0)
    x_last = wp.min(int(wp.floor(right + margin)), triangle_seen.shape[1] - 1)
    y_first = wp.max(int(wp.ceil(top - margin)), 0)
    y_last = wp.min(int(wp.floor(bottom + margin)), triangle_seen.shape[0] - 1)
    if x_first > x_last or y_first > y_last:
        return

    a = position[i0]
    b = position[i1]
    c = position[i2]
    # Differences first: cross products of nearly equal vectors would lose the digits of depth.
    ab = b - a
    face_normal = wp.cross(ab, c - a)
    plane = wp.dot(a, face_normal)
    if plane == 0.0:
        return
    inverse = 1.0 / plane
    normal_b = wp.cross(c, a - c) * inverse
    normal_c = wp.cross(a, ab) * inverse
    normal_all = face_normal * inverse
    nearest_in_box(
        face,
        x_first,
        x_last,
        y_first,
        y_last,
        normal_all,
        normal_b,
        normal_c,
        _CRACK_TOLERANCE,
        _NO_TRIANGLE,
        ray,
        triangle_seen,
        barycentric,
        depth,
    )
