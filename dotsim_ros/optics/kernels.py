# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Warp kernels of the camera. All positions are in the optical frame, so rays start at the origin.

A pixel that sees no skin has the triangle NO_TRIANGLE.
"""

# Kernels are Warp's language, whose types are none of a type checker's.
# mypy: ignore-errors

from typing import Any

from dotsim_ros.io.warp_runtime import wp

wp.set_module_options({"enable_backward": False})

NO_TRIANGLE = -1

CRACK_TOLERANCE = wp.constant(1.0e-5)
"""Share of a triangle's size by which it is seen beyond its edges, so that rays miss no seam."""
_NO_TRIANGLE = wp.constant(NO_TRIANGLE)
_REACH = wp.constant(1.0)
_NAN = wp.constant(float("nan"))


def launch_dim(rows: int, width: int) -> tuple[int, int]:
    """Return the threads of a kernel that runs over the pixels of rows: one a pixel."""
    return rows, width


def point_dim(count: int) -> int:
    """Return the threads of `irradiate`: one a point."""
    return count


@wp.struct
class Lens:
    """A projection: pixels a radian at the axis along x and y, principal point, coefficients,
    widest angle imaged and its cotangent, whether it is a pinhole, and how strongly straight edges
    bend."""

    focal_x: float
    focal_y: float
    principal_x: float
    principal_y: float
    distortion: wp.vec4
    widest_angle: float
    least_cotangent: float
    pinhole: int
    edge_curvature: float


@wp.func
def projected(point: wp.vec3, lens: Lens):
    across = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    k = lens.distortion
    if lens.pinhole != 0:
        height = wp.max(wp.max(point[2], across * lens.least_cotangent), 1.0e-12)
        x = point[0] / height
        y = point[1] / height
        around = x * x + y * y
        radial = 1.0 + around * (k[0] + around * k[1])
        return wp.vec2(
            lens.principal_x
            + lens.focal_x * (x * radial + 2.0 * k[2] * x * y + k[3] * (around + 2.0 * x * x)),
            lens.principal_y
            + lens.focal_y * (y * radial + k[2] * (around + 2.0 * y * y) + 2.0 * k[3] * x * y),
        )
    angle = wp.min(wp.atan2(across, point[2]), lens.widest_angle)
    square = angle * angle
    growth = 1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))
    scale = angle * growth / wp.max(across, 1.0e-12)
    return wp.vec2(
        lens.principal_x + lens.focal_x * scale * point[0],
        lens.principal_y + lens.focal_y * scale * point[1],
    )


@wp.kernel
def project_vertices(position: wp.array(dtype=wp.vec3), lens: Lens, pixel: wp.array(dtype=wp.vec2)):
    """Image of every vertex."""
    v = wp.tid()
    pixel[v] = projected(position[v], lens)


@wp.func
def vertex_normal_of(
    v: int,
    position: wp.array(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    first_face: wp.array(dtype=wp.int32),
    faces_around: wp.array(dtype=wp.int32),
):
    total = wp.vec3(0.0, 0.0, 0.0)
    for entry in range(first_face[v], first_face[v + 1]):
        face = faces_around[entry]
        a = position[triangles[face, 0]]
        total += wp.cross(position[triangles[face, 1]] - a, position[triangles[face, 2]] - a)
    return wp.normalize(total)


@wp.kernel
def vertex_normals(
    position: wp.array(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    first_face: wp.array(dtype=wp.int32),
    faces_around: wp.array(dtype=wp.int32),
    normal: wp.array(dtype=wp.vec3),
):
    """Area-weighted unit normal of every vertex, on the side of the triangles' winding."""
    v = wp.tid()
    normal[v] = vertex_normal_of(v, position, triangles, first_face, faces_around)


@wp.func
def pixels_around(
    p0: wp.vec2, p1: wp.vec2, p2: wp.vec2, lens: Lens, width: int, row_first: int, row_end: int
):
    """First and last column and row that a triangle of these images may be seen in."""
    left = wp.min(wp.min(p0[0], p1[0]), p2[0])
    right = wp.max(wp.max(p0[0], p1[0]), p2[0])
    top = wp.min(wp.min(p0[1], p1[1]), p2[1])
    bottom = wp.max(wp.max(p0[1], p1[1]), p2[1])
    # An edge of length s images as a curve of curvature below edge_curvature / focal, which bulges
    # out of the box of its ends by at most a curvature's eighth of s^2; s^2 is at most 2 extent^2.
    # Where the focal lengths differ, that holds in angles.
    extent = wp.max(right - left, bottom - top)
    least = wp.min(lens.focal_x, lens.focal_y)
    bulge = wp.max(lens.focal_x, lens.focal_y) / (least * least)
    margin = 0.25 * lens.edge_curvature * extent * extent * bulge + 0.01
    x_first = wp.max(int(wp.ceil(left - margin)), 0)
    x_last = wp.min(int(wp.floor(right + margin)), width - 1)
    y_first = wp.max(int(wp.ceil(top - margin)), row_first)
    y_last = wp.min(int(wp.floor(bottom + margin)), row_end - 1)
    return x_first, x_last, y_first, y_last


@wp.func
def inverse_corners(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Vectors whose products with a ray are the inverse of the distance along it to a triangle's
    plane, and the second and third corner's weights times that; zero for a plane seen edge-on."""
    # Differences first: cross products of nearly equal vectors would lose the digits of depth.
    ab = b - a
    face_normal = wp.cross(ab, c - a)
    plane = wp.dot(a, face_normal)
    inverse = 0.0
    if plane != 0.0:
        inverse = 1.0 / plane
    return face_normal * inverse, wp.cross(c, a - c) * inverse, wp.cross(a, ab) * inverse


@wp.kernel
def cast_rays(
    mesh: wp.uint64,
    ray: wp.array2d(dtype=wp.vec3),
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    depth: wp.array2d(dtype=wp.float32),
):
    """Nearest triangle along every ray, by Warp's bounding-volume hierarchy."""
    y, x = wp.tid()
    direction = ray[y, x]
    triangle_seen[y, x] = _NO_TRIANGLE
    if wp.isnan(direction[2]):
        return
    query = wp.mesh_query_ray(mesh, wp.vec3(0.0, 0.0, 0.0), direction, _REACH)
    if query.result:
        triangle_seen[y, x] = query.face
        depth[y, x] = query.t
        # Warp's u and v belong to the first and second corner.
        barycentric[y, x] = wp.vec2(query.v, 1.0 - query.u - query.v)


@wp.func
def normal_towards_camera(
    outward: wp.vec3, second: wp.vec3, third: wp.vec3, weight: wp.vec2, ray: wp.vec3
):
    """Unit normal between those of a triangle's corners, by the weights of the latter two."""
    towards = outward + weight[0] * (second - outward) + weight[1] * (third - outward)
    length = wp.length(towards)
    if wp.dot(towards, ray) > 0.0:
        length = -length
    return towards / length


@wp.struct
class NormalPixels:
    """What `fill_normals` reads and writes: of each pixel the triangle seen and the weights of its
    second and third corner, ray and normal; of the skin its triangles and the vertices' normals."""

    triangle_seen: wp.array2d(dtype=wp.int32)
    barycentric: wp.array2d(dtype=wp.vec2)
    ray: wp.array2d(dtype=wp.vec3)
    normal: wp.array2d(dtype=wp.vec3)
    triangles: wp.array2d(dtype=wp.int32)
    vertex_normal: wp.array(dtype=wp.vec3)


@wp.kernel
def fill_normals(view: NormalPixels, row_first: int):
    """Normal towards the camera of a pixel, rows counted from one on; no numbers where no skin
    is."""
    row_number, x = wp.tid()
    y = row_first + row_number
    face = view.triangle_seen[y, x]
    if face == _NO_TRIANGLE:
        view.normal[y, x] = wp.vec3(_NAN, _NAN, _NAN)
        return
    view.normal[y, x] = normal_towards_camera(
        view.vertex_normal[view.triangles[face, 0]],
        view.vertex_normal[view.triangles[face, 1]],
        view.vertex_normal[view.triangles[face, 2]],
        view.barycentric[y, x],
        view.ray[y, x],
    )


@wp.kernel
def fill_material_points(
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    triangles: wp.array2d(dtype=wp.int32),
    rest_position: wp.array(dtype=wp.vec3),
    material_point: wp.array2d(dtype=wp.vec3),
):
    """Place at rest of what a pixel sees; no numbers where no skin is."""
    y, x = wp.tid()
    face = triangle_seen[y, x]
    if face == _NO_TRIANGLE:
        material_point[y, x] = wp.vec3(_NAN, _NAN, _NAN)
        return
    weight = barycentric[y, x]
    rest = rest_position[triangles[face, 0]]
    material_point[y, x] = (
        rest
        + weight[0] * (rest_position[triangles[face, 1]] - rest)
        + weight[1] * (rest_position[triangles[face, 2]] - rest)
    )


@wp.struct
class Led:
    """A point light: its place in the optical frame, and its intensity for red, green, blue."""

    position: wp.vec3
    intensity: wp.vec3


@wp.func
def light_sent(
    position: wp.vec3, outward: wp.vec3, leds: wp.array(dtype=Led), gloss: float, exponent: float
):
    """Light that the inner side of a point sends to the camera: the cosine of incidence, and a lobe
    of the angle between normal and half-way direction, over squared distance, summed."""
    total = wp.vec3(0.0, 0.0, 0.0)
    sight = wp.normalize(position)
    towards = wp.dot(outward, sight)
    # Most points mirror no LED: a lobe below a ten thousandth is not worth its power.
    least = wp.max(1.0 - 9.0 / exponent, 0.0)
    for i in range(leds.shape[0]):
        led = leds[i]
        away = position - led.position
        square = wp.dot(away, away)
        nearness = 1.0 / wp.sqrt(square)
        incidence = wp.dot(outward, away) * nearness
        share = wp.max(incidence, 0.0)
        if gloss > 0.0:
            # The half-way direction is the sum of two unit vectors, over its length.
            along = incidence + towards
            length_square = 2.0 + 2.0 * wp.dot(away, sight) * nearness
            if along > 0.0 and along * along > least * least * length_square:
                cosine = wp.min(along / wp.sqrt(length_square), 1.0)
                share += gloss * wp.exp(exponent * (cosine - 1.0))
        total += led.intensity * (share * nearness * nearness)
    return total


@wp.func
def brightness_over_rest(irradiance: wp.vec3, rest: wp.vec3, ambient: wp.vec3, exponent: float):
    """Brightness of a point over that at rest; ambient light does not change."""
    ratio = wp.cw_div(irradiance + ambient, rest + ambient)
    return wp.vec3(
        wp.pow(ratio[0], exponent), wp.pow(ratio[1], exponent), wp.pow(ratio[2], exponent)
    )


@wp.kernel
def irradiate(
    position: wp.array(dtype=wp.vec3),
    outward: wp.array(dtype=wp.vec3),
    leds: wp.array(dtype=Led),
    gloss: float,
    gloss_exponent: float,
    irradiance: wp.array(dtype=wp.vec3),
):
    """Light that the inner side of every vertex sends to the camera."""
    v = wp.tid()
    irradiance[v] = light_sent(position[v], outward[v], leds, gloss, gloss_exponent)


@wp.kernel
def brightness_gain(
    irradiance: wp.array(dtype=wp.vec3),
    rest_irradiance: wp.array(dtype=wp.vec3),
    ambient: wp.vec3,
    exponent: float,
    gain: wp.array(dtype=wp.vec3),
):
    """Brightness of every vertex over that at rest."""
    v = wp.tid()
    gain[v] = brightness_over_rest(irradiance[v], rest_irradiance[v], ambient, exponent)


vec8 = wp.types.vector(length=8, dtype=wp.float32)


@wp.struct
class ImagePixels:
    """What `warp_idle` reads and writes: of each pixel the triangle seen and the weights of its
    second and third corner, whether it is lit, vignetting, idle colour and colour; of the skin its
    `triangle_changes`; and the idle frame to warp, of twice the resolution (2 H - 1, 2 W - 1)."""

    triangle_seen: wp.array2d(dtype=wp.int32)
    barycentric: wp.array2d(dtype=wp.vec2)
    lit: wp.array2d(dtype=wp.uint8)
    vignetting: wp.array2d(dtype=wp.float32)
    idle: wp.array3d(dtype=wp.uint8)
    image: wp.array3d(dtype=wp.uint8)
    change: wp.array2d(dtype=vec8)
    fine_flat: wp.array2d(dtype=wp.vec3)


@wp.func
def corner_change(rest_pixel: wp.vec2, pixel: wp.vec2, gain: wp.vec3):
    back = rest_pixel - pixel
    return vec8(gain[0], gain[1], gain[2], 0.0, back[0], back[1], 0.0, 0.0)


@wp.kernel
def triangle_changes(
    triangles: wp.array2d(dtype=wp.int32),
    rest_pixel: wp.array(dtype=wp.vec2),
    pixel: wp.array(dtype=wp.vec2),
    gain: wp.array(dtype=wp.vec3),
    change: wp.array2d(dtype=vec8),
):
    """What a pixel of each triangle interpolates: of the first corner the gain of brightness and,
    from the fifth number on, the way back to its pixel at rest; of the others what they have more.

    Pixels of a row see another triangle every few, and would wait for what its corners have.
    """
    face = wp.tid()
    i0 = triangles[face, 0]
    i1 = triangles[face, 1]
    i2 = triangles[face, 2]
    first = corner_change(rest_pixel[i0], pixel[i0], gain[i0])
    change[face, 0] = first
    change[face, 1] = corner_change(rest_pixel[i1], pixel[i1], gain[i1]) - first
    change[face, 2] = corner_change(rest_pixel[i2], pixel[i2], gain[i2]) - first


@wp.func
def between_corners(a: Any, b: Any, c: Any, weight: wp.vec2):
    return a + weight[0] * (b - a) + weight[1] * (c - a)


@wp.func
def warped_colour(pixels: ImagePixels, x: int, y: int, way: wp.vec2, brightness: wp.vec3):
    """Colour of a pixel whose material point lay a way from here, in grey levels from 0.5 on."""
    fine_x = wp.clamp(2.0 * (float(x) + way[0]), 0.0, float(pixels.fine_flat.shape[1] - 1))
    fine_y = wp.clamp(2.0 * (float(y) + way[1]), 0.0, float(pixels.fine_flat.shape[0] - 1))
    # The last sample is reached as the far end of the last cell.
    column = wp.min(int(fine_x), pixels.fine_flat.shape[1] - 2)
    row = wp.min(int(fine_y), pixels.fine_flat.shape[0] - 2)
    right = fine_x - float(column)
    down = fine_y - float(row)
    upper = (1.0 - right) * pixels.fine_flat[row, column] + right * pixels.fine_flat[
        row, column + 1
    ]
    lower = (1.0 - right) * pixels.fine_flat[row + 1, column] + right * pixels.fine_flat[
        row + 1, column + 1
    ]
    colour = wp.cw_mul((1.0 - down) * upper + down * lower, brightness) * pixels.vignetting[y, x]
    return wp.vec3(
        wp.clamp(colour[0], 0.0, 255.0) + 0.5,
        wp.clamp(colour[1], 0.0, 255.0) + 0.5,
        wp.clamp(colour[2], 0.0, 255.0) + 0.5,
    )


@wp.kernel
def warp_idle(pixels: ImagePixels, row_first: int):
    """Colour of a pixel, rows counted from one on: the idle frame where the material point lay,
    times its gain.

    The idle pixel is the pixel plus the interpolated way back of the triangle's corners, which is
    exactly zero at rest, and exact to first order in the size of a triangle elsewhere.
    """
    row_number, x = wp.tid()
    y = row_first + row_number
    face = pixels.triangle_seen[y, x]
    if face == _NO_TRIANGLE or pixels.lit[y, x] == wp.uint8(0):
        for channel in range(3):
            pixels.image[y, x, channel] = pixels.idle[y, x, channel]
        return
    weight = pixels.barycentric[y, x]
    mixed = (
        pixels.change[face, 0]
        + weight[0] * pixels.change[face, 1]
        + weight[1] * pixels.change[face, 2]
    )
    way = wp.vec2(mixed[4], mixed[5])
    brightness = wp.vec3(mixed[0], mixed[1], mixed[2])
    colour = warped_colour(pixels, x, y, way, brightness)
    for channel in range(3):
        pixels.image[y, x, channel] = wp.uint8(colour[channel])
