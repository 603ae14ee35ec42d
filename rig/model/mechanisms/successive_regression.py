"""Successive regression, compiled: everything is a point or a space vector of one global frame, and joints are undone
in turn.

Forward, the hand's three points A, B, C turn about the axes where these stand at zero, the last joint first. Inverse,
each joint is read from a point or a direction that the joints behind it cannot move, and then turned back before the
next is read.
Vectors are tuples of three numbers, so that nothing is allocated. Where two readings of a joint fall together, the
small quantity between them is taken from factors and differences that keep its digits. Source: patent CN111488654A,
claims 1-5.
"""

from math import atan2, sqrt

import numpy as np

from rig.compute.numba_kernels import njit

SLACK = 1e-10  # m or rad; by so much a pose may lie beyond the edge of the reach before it counts as unreachable
SINGULAR = 1e-6  # sine (or share of a length) below which a joint's two readings count as one
FREE = 1e-13  # sine below which a joint's angle cannot be read at all
SHOULDER, ELBOW, WRIST = 1, 2, 4
REACHED, OFF_AXIS, TOO_FAR, TOO_NEAR, TURNED_AWAY = 0, 1, 2, 3, 4

Vector = tuple[float, float, float]


@njit(cache=True, error_model="numpy")
def row(m: np.ndarray, i: int) -> Vector:
    """Row i of a matrix (n, 3)."""
    return m[i, 0], m[i, 1], m[i, 2]


@njit(cache=True, error_model="numpy")
def dot(a: Vector, b: Vector) -> float:
    """Scalar product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy")
def cross(a: Vector, b: Vector) -> Vector:
    """Vector product of two vectors (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, error_model="numpy")
def add(a: Vector, b: Vector, k: float) -> Vector:
    """a + k b."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@njit(cache=True, error_model="numpy")
def about(v: Vector, u: Vector, c: float, s: float) -> Vector:
    """Vector v turned about the unit vector u by the angle of cosine c and sine s, right-handed."""
    w, k = cross(u, v), dot(u, v) * (1 - c)
    return c * v[0] + s * w[0] + k * u[0], c * v[1] + s * w[1] + k * u[1], c * v[2] + s * w[2] + k * u[2]


@njit(cache=True, error_model="numpy")
def around(p: Vector, o: Vector, u: Vector, c: float, s: float) -> Vector:
    """Point p turned about the axis through o along u."""
    return add(about(add(p, o, -1.0), u, c, s), o, 1.0)


@njit(cache=True, error_model="numpy")
def angle(a: Vector, b: Vector, u: Vector) -> tuple[float, float, float, float]:
    """(angle from a to b about u, its cosine, its sine, product of their lengths across u); 0 where one lies along
    u.
    """
    a, b = add(a, u, -dot(a, u)), add(b, u, -dot(b, u))
    s, c = dot(u, cross(a, b)), dot(a, b)
    size = sqrt(s * s + c * c)
    if size == 0.0:
        return 0.0, 1.0, 0.0, 0.0
    return atan2(s, c), c / size, s / size, size


@njit(cache=True, error_model="numpy")
def wrapped(t: float) -> float:
    """An angle within a turn of zero, brought to -pi .. pi."""
    return t - 2 * np.pi if t > np.pi else (t + 2 * np.pi if t < -np.pi else t)


@njit(cache=True, error_model="numpy")
def readings(a: float, b: float, less: float, more: float) -> tuple[float, float, float]:
    """The two angles of a cos x + b sin x = c, with r = hypot(a, b), less = r - c, more = r + c: (first, second, sine
    between).

    less and more come in the form that keeps their digits where they are small; a negative one is the caller's to
    refuse.
    """
    h = sqrt(max(less, 0.0) * max(more, 0.0))
    c = 0.5 * (more - less)
    middle, half = atan2(b, a), atan2(h, c)
    return wrapped(middle + half), wrapped(middle - half), h


@njit(cache=True, error_model="numpy")
def shoulder(
    point: Vector, o: Vector, u1: Vector, u2: Vector, level: float
) -> tuple[float, float, float, float, float]:
    """Joint 1, by which the point, turned back about axis 1, lies at `level` along axis 2: (first, second, half their
    spread in m, by how much the point is too near the axis, its distance, both in m)."""
    w = add(point, o, -1.0)
    flat = add(u2, u1, -dot(u1, u2))
    a, b = dot(flat, w), -dot(flat, cross(u1, w))
    c = level - dot(u1, u2) * dot(u1, w)
    r = sqrt(a * a + b * b)
    first, second, h = readings(a, b, r - c, r + c)
    return first, second, h, abs(c) - r, r


@njit(cache=True, error_model="numpy")
def elbows(
    o: Vector, u: Vector, upper: float, fore: float, point: Vector
) -> tuple[Vector, Vector, float, float, float, float]:
    """Two elbow points, from o, at distance `upper` from the axis (o, u) and `fore` from a point, all seen along u:
    (first, second, height, by how much the point is too far, too near, its distance), all in m."""
    d = add(point, o, -1.0)
    d = add(d, u, -dot(d, u))
    far = sqrt(dot(d, d))
    if far < FREE:
        return d, d, 0.0, 0.0, abs(upper - fore), far
    high = (fore - far + upper) * (fore + far - upper)
    low = (far + upper - fore) * (far + upper + fore)
    x = (upper * upper - fore * fore + far * far) / (2 * far)
    h = sqrt(max(high, 0.0) * max(low, 0.0)) / (2 * far)
    e = d[0] / far, d[1] / far, d[2] / far
    side = cross(u, e)
    along = add((0.0, 0.0, 0.0), e, x)
    return add(along, side, h), add(along, side, -h), h, far - upper - fore, abs(upper - fore) - far, far


@njit(cache=True, error_model="numpy")
def forward(q: np.ndarray, points: np.ndarray, axes: np.ndarray, hand: np.ndarray) -> np.ndarray:
    """(m, 3, 3) hand points A, B, C (rows) of joint angles q (m, 6); points, axes (6, 3) and hand (3, 3) at zero."""
    out = np.empty((len(q), 3, 3))
    for m in range(len(q)):
        a, b, c = row(hand, 0), row(hand, 1), row(hand, 2)
        for i in range(5, -1, -1):
            o, u, co, si = row(points, i), row(axes, i), np.cos(q[m, i]), np.sin(q[m, i])
            a, b, c = around(a, o, u, co, si), around(b, o, u, co, si), around(c, o, u, co, si)
        for k in range(3):
            out[m, 0, k], out[m, 1, k], out[m, 2, k] = a[k], b[k], c[k]
    return out


@njit(cache=True, error_model="numpy")
def seen(v: Vector, ex: Vector, ey: Vector, ez: Vector) -> Vector:
    """A vector of the hand at zero, where the hand's x, y, z now point along ex, ey, ez."""
    return add(add(add((0.0, 0.0, 0.0), ex, v[0]), ey, v[1]), ez, v[2])
