"""Compiled kernels for joint angles of six-joint arms: vectors, rotations, shoulder and elbow solutions.

Forward, the hand's three points A, B, C turn about the axes where these stand at zero, the last joint first. Inverse,
each joint is read from a point or a direction that the joints behind it cannot move, and then turned back before the
next is read. Vectors are tuples of three numbers, so that nothing is allocated. Where two readings of a joint fall
together, the small quantity between them is taken from factors and differences that keep its digits. Source: patent
CN111488654A, claims 1-5.
"""

from math import atan2, sqrt

import numpy as np

from rig.array_and_json_types import Floats
from rig.compute.numba_kernels_and_lazy_exports import njit

SLACK = 1e-10  # m or rad; by so much a pose may lie beyond the edge of the reach before it counts as unreachable
SINGULAR = 1e-6  # sine (or share of a length) below which a joint's two readings count as one
FREE = 1e-13  # sine below which a joint's angle cannot be read at all
SHOULDER, ELBOW, WRIST = 1, 2, 4
REACHED, OFF_AXIS, TOO_FAR, TOO_NEAR, TURNED_AWAY = 0, 1, 2, 3, 4

Vector = tuple[float, float, float]


@njit(cache=True, error_model="numpy")
def matrix_row(m: Floats, i: int) -> Vector:
    """Row i of a matrix (n, 3)."""
    return m[i, 0], m[i, 1], m[i, 2]


@njit(cache=True, error_model="numpy")
def dot(a: Vector, b: Vector) -> float:
    """Dot product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy")
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product of two vectors (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, error_model="numpy")
def add_scaled(a: Vector, b: Vector, k: float) -> Vector:
    """a with b added, scaled: a + k b."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@njit(cache=True, error_model="numpy")
def rotate_vector(v: Vector, u: Vector, c: float, s: float) -> Vector:
    """Vector v rotated about the unit vector u by the angle of cosine c and sine s, right-handed."""
    w, k = cross(u, v), dot(u, v) * (1 - c)
    return c * v[0] + s * w[0] + k * u[0], c * v[1] + s * w[1] + k * u[1], c * v[2] + s * w[2] + k * u[2]


@njit(cache=True, error_model="numpy")
def rotate_point(p: Vector, o: Vector, u: Vector, c: float, s: float) -> Vector:
    """Point p rotated about the axis through o along u by the angle of cosine c and sine s."""
    return add_scaled(rotate_vector(add_scaled(p, o, -1.0), u, c, s), o, 1.0)


@njit(cache=True, error_model="numpy")
def angle_about_axis(a: Vector, b: Vector, u: Vector) -> tuple[float, float, float, float]:
    """Angle from a to b about the axis u, with its cosine, sine and the product of their lengths across u."""
    a, b = add_scaled(a, u, -dot(a, u)), add_scaled(b, u, -dot(b, u))
    s, c = dot(u, cross(a, b)), dot(a, b)
    size = sqrt(s * s + c * c)
    if size == 0.0:
        return 0.0, 1.0, 0.0, 0.0
    return atan2(s, c), c / size, s / size, size


@njit(cache=True, error_model="numpy")
def wrap_angle(t: float) -> float:
    """Angle within a turn of zero wrapped to -pi .. pi."""
    return t - 2 * np.pi if t > np.pi else (t + 2 * np.pi if t < -np.pi else t)


@njit(cache=True, error_model="numpy")
def cosine_equation_angles(a: float, b: float, r_minus_c: float, r_plus_c: float) -> tuple[float, float, float]:
    """Both angles of the equation a cos x + b sin x = c, from r - c and r + c: (first, second, sine).

    less and more come in the form that keeps their digits where they are small; a negative one is the caller's to
    refuse.
    """
    h = sqrt(max(r_minus_c, 0.0) * max(r_plus_c, 0.0))
    c = 0.5 * (r_plus_c - r_minus_c)
    middle, half = atan2(b, a), atan2(h, c)
    return wrap_angle(middle + half), wrap_angle(middle - half), h


@njit(cache=True, error_model="numpy")
def both_first_joint_angles_for_point_level(
    point: Vector, o: Vector, u1: Vector, u2: Vector, level: float
) -> tuple[float, float, float, float, float]:
    """Both shoulder angles (joint 1) that bring the point to `level` along axis 2, with spread and distances."""
    w = add_scaled(point, o, -1.0)
    flat = add_scaled(u2, u1, -dot(u1, u2))
    a, b = dot(flat, w), -dot(flat, cross(u1, w))
    c = level - dot(u1, u2) * dot(u1, w)
    r = sqrt(a * a + b * b)
    first, second, h = cosine_equation_angles(a, b, r - c, r + c)
    return first, second, h, abs(c) - r, r


@njit(cache=True, error_model="numpy")
def both_elbow_points(
    o: Vector, u: Vector, upper_arm: float, forearm: float, point: Vector
) -> tuple[Vector, Vector, float, float, float, float]:
    """Both elbow points at distance `upper_arm` from axis (o, u) and `forearm` from a point, with distances in m.
    (first, second, height, by how much the point is too far, too near, its distance), all in m.
    """
    d = add_scaled(point, o, -1.0)
    d = add_scaled(d, u, -dot(d, u))
    far = sqrt(dot(d, d))
    if far < FREE:
        return d, d, 0.0, 0.0, abs(upper_arm - forearm), far
    high = (forearm - far + upper_arm) * (forearm + far - upper_arm)
    low = (far + upper_arm - forearm) * (far + upper_arm + forearm)
    x = (upper_arm * upper_arm - forearm * forearm + far * far) / (2 * far)
    h = sqrt(max(high, 0.0) * max(low, 0.0)) / (2 * far)
    e = d[0] / far, d[1] / far, d[2] / far
    side = cross(u, e)
    along = add_scaled((0.0, 0.0, 0.0), e, x)
    return (
        add_scaled(along, side, h),
        add_scaled(along, side, -h),
        h,
        far - upper_arm - forearm,
        abs(upper_arm - forearm) - far,
        far,
    )


@njit(cache=True, error_model="numpy")
def forward_hand_points(q: Floats, points: Floats, axes: Floats, hand: Floats) -> Floats:
    """Hand points A, B, C (m, 3, 3) of joint angles q (m, 6), by forward rotation from zero."""
    out = np.empty((len(q), 3, 3))
    for m in range(len(q)):
        a, b, c = matrix_row(hand, 0), matrix_row(hand, 1), matrix_row(hand, 2)
        for i in range(5, -1, -1):
            o, u, co, si = matrix_row(points, i), matrix_row(axes, i), np.cos(q[m, i]), np.sin(q[m, i])
            a, b, c = rotate_point(a, o, u, co, si), rotate_point(b, o, u, co, si), rotate_point(c, o, u, co, si)
        for k in range(3):
            out[m, 0, k], out[m, 1, k], out[m, 2, k] = a[k], b[k], c[k]
    return out


@njit(cache=True, error_model="numpy")
def vector_from_axes(v: Vector, ex: Vector, ey: Vector, ez: Vector) -> Vector:
    """Vector with components v along the axes ex, ey, ez of the hand."""
    return add_scaled(add_scaled(add_scaled((0.0, 0.0, 0.0), ex, v[0]), ey, v[1]), ez, v[2])
