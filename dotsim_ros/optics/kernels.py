"""Warp kernels of the camera. All positions are in the optical frame, so rays start at the origin.

A pixel that sees no skin has the triangle NO_TRIANGLE.
"""

# Kernels are Warp's language, whose types are none of a type checker's.
# mypy: ignore-errors

import warp as wp

wp.set_module_options({"enable_backward": False})

NO_TRIANGLE = -1

_NO_TRIANGLE = wp.constant(NO_TRIANGLE)
_CRACK_TOLERANCE = wp.constant(1.0e-5)
_REACH = wp.constant(1.0)
_NAN = wp.constant(float("nan"))


@wp.struct
class Lens:
    """The equidistant model: pixels a radian, principal point, k1..k4, widest angle imaged."""

    focal_px: float
    principal_x: float
    principal_y: float
    distortion: wp.vec4
    widest_angle: float


@wp.func
def projected(point: wp.vec3, lens: Lens):
    across = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    angle = wp.min(wp.atan2(across, point[2]), lens.widest_angle)
    square = angle * angle
    k = lens.distortion
    growth = 1.0 + square * (k[0] + square * (k[1] + square * (k[2] + square * k[3])))
    scale = lens.focal_px * angle * growth / wp.max(across, 1.0e-12)
    return wp.vec2(lens.principal_x + scale * point[0], lens.principal_y + scale * point[1])


@wp.kernel
def project_vertices(position: wp.array(dtype=wp.vec3), lens: Lens, pixel: wp.array(dtype=wp.vec2)):
    """Image of every vertex."""
    v = wp.tid()
    pixel[v] = projected(position[v], lens)


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
    total = wp.vec3(0.0, 0.0, 0.0)
    for entry in range(first_face[v], first_face[v + 1]):
        face = faces_around[entry]
        a = position[triangles[face, 0]]
        total += wp.cross(position[triangles[face, 1]] - a, position[triangles[face, 2]] - a)
    normal[v] = wp.normalize(total)


@wp.kernel
def rasterize(
    position: wp.array(dtype=wp.vec3),
    pixel: wp.array(dtype=wp.vec2),
    triangles: wp.array2d(dtype=wp.int32),
    ray: wp.array2d(dtype=wp.vec3),
    lens: Lens,
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    depth: wp.array2d(dtype=wp.float32),
):
    """Nearest triangle along every ray; one thread at a time (a CPU), since pixels are shared.

    The box around the projected corners only chooses the pixels; each is tested with its own ray,
    so the fisheye's curved edges cost no accuracy.
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
    x_last = wp.min(int(wp.floor(right + margin)), ray.shape[1] - 1)
    y_first = wp.max(int(wp.ceil(top - margin)), 0)
    y_last = wp.min(int(wp.floor(bottom + margin)), ray.shape[0] - 1)
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
    for y in range(y_first, y_last + 1):
        for x in range(x_first, x_last + 1):
            direction = ray[y, x]
            # The weights sum to the inverse of the distance along the ray.
            total = wp.dot(normal_all, direction)
            weight_b = wp.dot(normal_b, direction)
            weight_c = wp.dot(normal_c, direction)
            tolerance = -_CRACK_TOLERANCE * total
            if (
                total > 0.0
                and weight_b >= tolerance
                and weight_c >= tolerance
                and total - weight_b - weight_c >= tolerance
            ):
                distance = 1.0 / total
                if triangle_seen[y, x] == _NO_TRIANGLE or distance < depth[y, x]:
                    triangle_seen[y, x] = face
                    depth[y, x] = distance
                    barycentric[y, x] = wp.vec2(weight_b * distance, weight_c * distance)


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
    depth[y, x] = _NAN
    if wp.isnan(direction[2]):
        return
    query = wp.mesh_query_ray(mesh, wp.vec3(0.0, 0.0, 0.0), direction, _REACH)
    if query.result:
        triangle_seen[y, x] = query.face
        depth[y, x] = query.t
        # Warp's u and v belong to the first and second corner.
        barycentric[y, x] = wp.vec2(query.v, 1.0 - query.u - query.v)


@wp.kernel
def fill_view(
    triangle_seen: wp.array2d(dtype=wp.int32),
    barycentric: wp.array2d(dtype=wp.vec2),
    ray: wp.array2d(dtype=wp.vec3),
    triangles: wp.array2d(dtype=wp.int32),
    vertex_normal: wp.array(dtype=wp.vec3),
    rest_position: wp.array(dtype=wp.vec3),
    run: int,
    normal: wp.array2d(dtype=wp.vec3),
    material_point: wp.array2d(dtype=wp.vec3),
):
    """Normal towards the camera and material point of `run` pixels; NaN where there is no skin."""
    y, block = wp.tid()
    for x in range(block * run, wp.min(block * run + run, ray.shape[1])):
        face = triangle_seen[y, x]
        outward = wp.vec3(_NAN, _NAN, _NAN)
        rest = wp.vec3(_NAN, _NAN, _NAN)
        if face != _NO_TRIANGLE:
            weight = barycentric[y, x]
            b = weight[0]
            c = weight[1]
            a = 1.0 - b - c
            i0 = triangles[face, 0]
            i1 = triangles[face, 1]
            i2 = triangles[face, 2]
            rest = a * rest_position[i0] + b * rest_position[i1] + c * rest_position[i2]
            outward = wp.normalize(
                a * vertex_normal[i0] + b * vertex_normal[i1] + c * vertex_normal[i2]
            )
            if wp.dot(outward, ray[y, x]) > 0.0:
                outward = -outward
        normal[y, x] = outward
        material_point[y, x] = rest
