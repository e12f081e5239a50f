# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The camera's kernels with a leading axis of B skins; a z-buffer decides what a pixel sees.

An entry of the z-buffer has the distance along the ray in its upper half and the triangle in the
lower. Bits of positive floats are ordered as the floats are, so that the least entry is the nearest
triangle, and of two at one distance the first: in whatever order threads write.
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
    between_corners,
    brightness_over_rest,
    inverse_corners,
    light_sent,
    normal_towards_camera,
    pixels_around,
    projected,
    vertex_normal_of,
    warped_colour,
)

wp.set_module_options({"enable_backward": False})

EMPTY = 2**63 - 1
"""Entry of the z-buffer where no skin is seen."""

_EMPTY = wp.constant(wp.int64(EMPTY))
_NO_TRIANGLE = wp.constant(NO_TRIANGLE)
_NAN = wp.constant(float("nan"))


@wp.func
def in_optical_frame(point: wp.vec3, origin: wp.vec3d, rotation: wp.mat33d):
    offset = wp.vec3d(wp.float64(point[0]), wp.float64(point[1]), wp.float64(point[2])) - origin
    place = wp.transpose(rotation) * offset
    return wp.vec3(wp.float32(place[0]), wp.float32(place[1]), wp.float32(place[2]))


@wp.kernel
def place_vertices(
    skin: wp.array2d(dtype=wp.vec3),
    origin: wp.vec3d,
    rotation: wp.mat33d,
    lens: Lens,
    position: wp.array2d(dtype=wp.vec3),
    pixel: wp.array2d(dtype=wp.vec2),
):
    """Vertices in the optical frame, and their images."""
    b, v = wp.tid()
    point = in_optical_frame(skin[b, v], origin, rotation)
    position[b, v] = point
    pixel[b, v] = projected(point, lens)


@wp.kernel
def vertex_normals(
    position: wp.array2d(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    first_face: wp.array(dtype=wp.int32),
    faces_around: wp.array(dtype=wp.int32),
    normal: wp.array2d(dtype=wp.vec3),
):
    """As `kernels.vertex_normals`."""
    b, v = wp.tid()
    normal[b, v] = vertex_normal_of(v, position[b], triangles, first_face, faces_around)


@wp.kernel
def rasterize(
    position: wp.array2d(dtype=wp.vec3),
    pixel: wp.array2d(dtype=wp.vec2),
    triangles: wp.array2d(dtype=wp.int32),
    ray: wp.array2d(dtype=wp.vec3),
    lens: Lens,
    nearest: wp.array3d(dtype=wp.int64),
):
    """Nearest triangle along every ray, as `host_kernels.rasterize`."""
    b, face = wp.tid()
    i0 = triangles[face, 0]
    i1 = triangles[face, 1]
    i2 = triangles[face, 2]
    x_first, x_last, y_first, y_last = pixels_around(
        pixel[b, i0], pixel[b, i1], pixel[b, i2], lens, ray.shape[1], 0, ray.shape[0]
    )
    if x_first > x_last or y_first > y_last:
        return
    normal_all, normal_b, normal_c = inverse_corners(
        position[b, i0], position[b, i1], position[b, i2]
    )
    for y in range(y_first, y_last + 1):
        for x in range(x_first, x_last + 1):
            direction = ray[y, x]
            total = wp.dot(normal_all, direction)
            weight_b = wp.dot(normal_b, direction)
            weight_c = wp.dot(normal_c, direction)
            least = -CRACK_TOLERANCE * total
            # Written so that a number that is not one sees nothing.
            if (
                total > 0.0
                and weight_b >= least
                and weight_c >= least
                and total - weight_b - weight_c >= least
            ):
                bits = wp.int64(wp.cast(1.0 / total, wp.int32))
                entry = (bits << wp.int64(32)) | wp.int64(face)
                if entry < nearest[b, y, x]:
                    wp.atomic_min(nearest, b, y, x, entry)


@wp.func
def corner_weights(a: wp.vec3, b: wp.vec3, c: wp.vec3, direction: wp.vec3, distance: float):
    """Weights of a triangle's second and third corner at a distance along a ray."""
    _normal_all, normal_b, normal_c = inverse_corners(a, b, c)
    return distance * wp.vec2(wp.dot(normal_b, direction), wp.dot(normal_c, direction))


@wp.kernel
def fill_view(
    nearest: wp.array3d(dtype=wp.int64),
    ray: wp.array2d(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    position: wp.array2d(dtype=wp.vec3),
    vertex_normal: wp.array2d(dtype=wp.vec3),
    depth: wp.array3d(dtype=wp.float32),
    normal: wp.array3d(dtype=wp.vec3),
    triangle: wp.array3d(dtype=wp.int32),
):
    """What the z-buffer found, and the normal towards the camera; no numbers where no skin is."""
    b, y, x = wp.tid()
    entry = nearest[b, y, x]
    if entry == _EMPTY:
        depth[b, y, x] = _NAN
        normal[b, y, x] = wp.vec3(_NAN, _NAN, _NAN)
        triangle[b, y, x] = _NO_TRIANGLE
        return
    face = wp.int32(entry & wp.int64(0x7FFFFFFF))
    distance = wp.cast(wp.int32(entry >> wp.int64(32)), wp.float32)
    i0 = triangles[face, 0]
    i1 = triangles[face, 1]
    i2 = triangles[face, 2]
    direction = ray[y, x]
    weight = corner_weights(position[b, i0], position[b, i1], position[b, i2], direction, distance)
    depth[b, y, x] = distance
    normal[b, y, x] = normal_towards_camera(
        vertex_normal[b, i0], vertex_normal[b, i1], vertex_normal[b, i2], weight, direction
    )
    triangle[b, y, x] = face


@wp.kernel
def project_markers(
    skin: wp.array2d(dtype=wp.vec3),
    corner: wp.array2d(dtype=wp.int32),
    weight: wp.array(dtype=wp.vec3),
    origin: wp.vec3d,
    rotation: wp.mat33d,
    lens: Lens,
    pixel: wp.array2d(dtype=wp.vec2),
):
    """Images of the markers printed on triangles; no numbers where the camera has none."""
    b, m = wp.tid()
    point = in_optical_frame(
        weight[m][0] * skin[b, corner[m, 0]]
        + weight[m][1] * skin[b, corner[m, 1]]
        + weight[m][2] * skin[b, corner[m, 2]],
        origin,
        rotation,
    )
    across = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    if wp.atan2(across, point[2]) <= lens.widest_angle:
        pixel[b, m] = projected(point, lens)
    else:
        pixel[b, m] = wp.vec2(_NAN, _NAN)


@wp.kernel
def brightness_gain(
    position: wp.array2d(dtype=wp.vec3),
    outward: wp.array2d(dtype=wp.vec3),
    leds: wp.array(dtype=Led),
    gloss: float,
    gloss_exponent: float,
    rest_irradiance: wp.array(dtype=wp.vec3),
    ambient: wp.vec3,
    exponent: float,
    gain: wp.array2d(dtype=wp.vec3),
):
    """As `kernels.irradiate` and `kernels.brightness_gain`."""
    b, v = wp.tid()
    light = light_sent(position[b, v], outward[b, v], leds, gloss, gloss_exponent)
    gain[b, v] = brightness_over_rest(light, rest_irradiance[v], ambient, exponent)


@wp.kernel
def warp_idle(
    shared: ImagePixels,
    triangles: wp.array2d(dtype=wp.int32),
    rest_pixel: wp.array(dtype=wp.vec2),
    triangle: wp.array3d(dtype=wp.int32),
    depth: wp.array3d(dtype=wp.float32),
    ray: wp.array2d(dtype=wp.vec3),
    position: wp.array2d(dtype=wp.vec3),
    pixel: wp.array2d(dtype=wp.vec2),
    gain: wp.array2d(dtype=wp.vec3),
    image: wp.array4d(dtype=wp.uint8),
):
    """As `kernels.warp_idle`, of which `shared` holds what all skins have in common."""
    b, y, x = wp.tid()
    face = triangle[b, y, x]
    if face == _NO_TRIANGLE or shared.lit[y, x] == wp.uint8(0):
        for channel in range(3):
            image[b, y, x, channel] = shared.idle[y, x, channel]
        return
    i0 = triangles[face, 0]
    i1 = triangles[face, 1]
    i2 = triangles[face, 2]
    weight = corner_weights(
        position[b, i0], position[b, i1], position[b, i2], ray[y, x], depth[b, y, x]
    )
    way = between_corners(
        rest_pixel[i0] - pixel[b, i0],
        rest_pixel[i1] - pixel[b, i1],
        rest_pixel[i2] - pixel[b, i2],
        weight,
    )
    brightness = between_corners(gain[b, i0], gain[b, i1], gain[b, i2], weight)
    colour = warped_colour(shared, x, y, way, brightness)
    for channel in range(3):
        image[b, y, x, channel] = wp.uint8(colour[channel])
