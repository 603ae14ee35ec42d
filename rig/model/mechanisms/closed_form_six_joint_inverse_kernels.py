"""Kernels of closed-form inverses of six-joint arms.

Compiled: spherical wrist, or three parallel axes.

All branches: two shoulders, two elbows, two wrists. Points and axes are those at zero, in the global frame. Each joint
is read from a point or a direction that the joints behind it cannot move, and then turned back before the next is read.
Vectors are tuples of three numbers, so that nothing is allocated. Where two readings of a joint fall together, the
small quantity between them is taken from factors and differences that keep its digits. Source: patent CN111488654A,
claims 1-5 (there for parallel axes 2, 3, 4; the spherical wrist is read by the same steps).
"""

from math import atan2, sqrt

import numpy as np

from rig.array_and_json_types import Floats, Integers
from rig.compute.numba_compilation_and_kernel_cache_folder import njit

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
    """Sum a + k b of a vector and a scaled vector."""
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
def angle_cosine_and_sine_about_axis(a: Vector, b: Vector, u: Vector) -> tuple[float, float, float, float]:
    """Angle from a to b about the axis u, its cosine and sine, and the product of their lengths across u."""
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
    """Both angles x of the equation a cos x + b sin x = c.

    From r - c and r + c.
    less and more come in the form that keeps their digits where they are small; a negative one is the caller's to
    refuse.

    Returns (first, second, sine)
    """
    h = sqrt(max(r_minus_c, 0.0) * max(r_plus_c, 0.0))
    c = 0.5 * (r_plus_c - r_minus_c)
    middle, half = atan2(b, a), atan2(h, c)
    return wrap_angle(middle + half), wrap_angle(middle - half), h


@njit(cache=True, error_model="numpy")
def first_joint_angles_for_axis_2_offset(
    point: Vector, o: Vector, u1: Vector, u2: Vector, level: float
) -> tuple[float, float, float, float, float]:
    """Both angles of joint 1 that bring a point to a level, its offset along axis 2.

    With spread and distances.
    """
    w = add_scaled(point, o, -1.0)
    flat = add_scaled(u2, u1, -dot(u1, u2))
    a, b = dot(flat, w), -dot(flat, cross(u1, w))
    c = level - dot(u1, u2) * dot(u1, w)
    r = sqrt(a * a + b * b)
    first, second, h = cosine_equation_angles(a, b, r - c, r + c)
    return first, second, h, abs(c) - r, r


@njit(cache=True, error_model="numpy")
def elbow_points_and_distances(
    o: Vector, u: Vector, upper_arm: float, forearm: float, point: Vector
) -> tuple[Vector, Vector, float, float, float, float]:
    """Both elbow points, `upper_arm` from axis (o, u) and `forearm` from a point, and distances.

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
def vector_from_axis_components(v: Vector, ex: Vector, ey: Vector, ez: Vector) -> Vector:
    """Vector of components v along the axes ex, ey, ez."""
    return add_scaled(add_scaled(add_scaled((0.0, 0.0, 0.0), ex, v[0]), ey, v[1]), ez, v[2])


Found = tuple[Floats, Integers, Integers, Floats]  # solutions, their flags, reasons, gaps


@njit(cache=True, error_model="numpy")
def _across(a: Vector, u: Vector) -> Vector:
    """The part of a across the unit vector u."""
    return add_scaled(a, u, -dot(a, u))


@njit(cache=True, error_model="numpy")
def _set(t: float) -> tuple[float, float, float, float]:
    """An angle that is chosen, as `angle` returns one that is read."""
    return t, np.cos(t), np.sin(t), 1.0


@njit(cache=True, error_model="numpy")
def _hand(hands: Floats, m: int, key: Vector) -> tuple[Vector, Vector, Vector, Vector]:
    """(key point, hand's x, y, z) where the hand's points number m are; key : from A, at zero."""
    A = matrix_row(hands[m], 0)
    ez, ey = add_scaled(matrix_row(hands[m], 1), A, -1.0), add_scaled(matrix_row(hands[m], 2), A, -1.0)
    ex = cross(ey, ez)
    return add_scaled(vector_from_axis_components(key, ex, ey, ez), A, 1.0), ex, ey, ez


@njit(cache=True, error_model="numpy")
def _bend(axis: Vector, u5: Vector, u6: Vector) -> tuple[float, float, float, float]:
    """What joint 5 is read from: cos and sine parts of axis . turned(u6), and how far r + product and r - product are
    from 1.
    """
    a, b = dot(_across(axis, u5), _across(u6, u5)), dot(axis, cross(u5, u6))
    r, tilt = np.sqrt(a * a + b * b), dot(axis, u5) * dot(u6, u5)
    return a, b, r + tilt - 1, r - tilt - 1


@njit(cache=True, error_model="numpy")
def _wrist(axis: Vector, v: Vector, bend: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """Joint 5 from where axis 6 points, v, against another axis: (first, second, sine between, miss)."""
    apart, together = add_scaled(v, axis, -1.0), add_scaled(v, axis, 1.0)
    less, more = 0.5 * dot(apart, apart) + bend[2], 0.5 * dot(together, together) + bend[3]
    first, second, h = cosine_equation_angles(bend[0], bend[1], less, more)
    return first, second, h, -min(less, more)


@njit(cache=True, error_model="numpy")
def spherical_wrist_inverse(
    wanted_hand_points: Floats,
    axis_points: Floats,
    axes: Floats,
    hand_points_at_zero: Floats,
    wrist_crossing: Floats,
    free_joint_values: Floats,
) -> Found:
    """Inverse of arms with a spherical wrist (axes 4, 5, 6 cross in `wrist_crossing`).

    Axes 2 and 3 parallel.
    wanted_hand_points : (m, 3, 3) points A, B, C wanted, AB and AC of length 1, hand_points_at_zero : (3, 3) the same
        at zero; key : (3,) at zero
    free_joint_values : (6,) rad, taken where a joint is free
    Returns q (m, 8, 6) rad, flags (m, 8), -1 for a branch that is not there, reason (m,) and gap (m,) m or rad
    """
    q, flags = np.full((len(wanted_hand_points), 8, 6), np.nan), np.full((len(wanted_hand_points), 8), -1)
    reason, gap = np.zeros(len(wanted_hand_points), np.int64), np.zeros(len(wanted_hand_points))
    o1, o2, o3 = matrix_row(axis_points, 0), matrix_row(axis_points, 1), matrix_row(axis_points, 2)
    u1, u2, u3, u4, u5, u6 = (
        matrix_row(axes, 0),
        matrix_row(axes, 1),
        matrix_row(axes, 2),
        matrix_row(axes, 3),
        matrix_row(axes, 4),
        matrix_row(axes, 5),
    )
    k0 = (wrist_crossing[0], wrist_crossing[1], wrist_crossing[2])
    arm, fore = _across(add_scaled(o3, o2, -1.0), u2), _across(add_scaled(k0, o3, -1.0), u2)
    upper, lower, level = np.sqrt(dot(arm, arm)), np.sqrt(dot(fore, fore)), dot(u2, add_scaled(k0, o1, -1.0))
    reach, mark, bend = add_scaled(k0, matrix_row(hand_points_at_zero, 0), -1.0), cross(u6, u5), _bend(u4, u5, u6)
    for m in range(len(wanted_hand_points)):
        W, ex, ey, ez = _hand(wanted_hand_points, m, reach)
        first, second, h1, miss, span1 = first_joint_angles_for_axis_2_offset(W, o1, u1, u2, level)
        if miss > SLACK:
            reason[m], gap[m] = OFF_AXIS, miss
            continue
        worst, why = np.inf, TOO_FAR
        for n1 in range(2):
            t1 = free_joint_values[0] if span1 < FREE else (first if n1 == 0 else second)
            c, s = np.cos(t1), -np.sin(t1)
            W1, x1, y1, z1 = (
                rotate_point(W, o1, u1, c, s),
                rotate_vector(ex, u1, c, s),
                rotate_vector(ey, u1, c, s),
                rotate_vector(ez, u1, c, s),
            )
            e1, e2, h2, far, close, span = elbow_points_and_distances(o2, u2, upper, lower, W1)
            if max(far, close) > SLACK:
                if max(far, close) < worst:
                    worst, why = max(far, close), TOO_FAR if far > close else TOO_NEAR
                continue
            for n2 in range(2):
                t2, c, s, _ = (
                    _set(free_joint_values[1])
                    if span < FREE
                    else angle_cosine_and_sine_about_axis(arm, e1 if n2 == 0 else e2, u2)
                )
                t3, d, e, _ = angle_cosine_and_sine_about_axis(
                    fore, add_scaled(rotate_point(W1, o2, u2, c, -s), o3, -1.0), u3
                )
                s, e = -s, -e
                x, y, z = (
                    rotate_vector(rotate_vector(x1, u2, c, s), u3, d, e),
                    rotate_vector(rotate_vector(y1, u2, c, s), u3, d, e),
                    rotate_vector(rotate_vector(z1, u2, c, s), u3, d, e),
                )
                v, w = vector_from_axis_components(u6, x, y, z), vector_from_axis_components(mark, x, y, z)
                first5, second5, h5, miss = _wrist(u4, v, bend)
                if miss > SLACK:
                    if worst == np.inf:
                        worst, why = miss, TURNED_AWAY
                    continue
                for n5 in range(2):
                    t5 = first5 if n5 == 0 else second5
                    c, s = np.cos(t5), np.sin(t5)
                    t4, d, e, size = angle_cosine_and_sine_about_axis(rotate_vector(u6, u5, c, s), v, u4)
                    if size < FREE**2:
                        t4, d, e, _ = _set(free_joint_values[3])
                    t6 = angle_cosine_and_sine_about_axis(
                        mark, rotate_vector(rotate_vector(w, u4, d, -e), u5, c, -s), u6
                    )[0]
                    b = 4 * n1 + 2 * n2 + n5
                    q[m, b, 0], q[m, b, 1], q[m, b, 2], q[m, b, 3], q[m, b, 4], q[m, b, 5] = t1, t2, t3, t4, t5, t6
                    flags[m, b] = SHOULDER * (h1 < SINGULAR) + ELBOW * (h2 < SINGULAR) + WRIST * (h5 < SINGULAR)
        if (flags[m] < 0).all():
            reason[m], gap[m] = why, worst
    return q, flags, reason, gap


@njit(cache=True, error_model="numpy")
def _within(turn: float, point: Vector, last: Vector, u: Vector, upper: float, fore: float) -> float:
    """The turn itself where it leaves point - turned(last) within the elbow's reach, else one that brings it there if
    any does.
    """
    flat, span = _across(point, u), _across(last, u)
    a, b = np.sqrt(dot(flat, flat)), np.sqrt(dot(span, span))
    least, most = max(abs(upper - fore), abs(a - b)), min(upper + fore, a + b)
    d = add_scaled(flat, rotate_vector(span, u, np.cos(turn), np.sin(turn)), -1.0)
    reach = np.sqrt(dot(d, d))
    if a * b < FREE or least > most or abs(upper - fore) <= reach <= upper + fore:
        return turn
    middle = 0.5 * (least + most)
    return angle_cosine_and_sine_about_axis(span, flat, u)[0] + np.arccos(
        min(max((a * a + b * b - middle * middle) / (2 * a * b), -1.0), 1.0)
    )


@njit(cache=True, error_model="numpy")
def parallel_axes_inverse(
    wanted_hand_points: Floats,
    axis_points: Floats,
    axes: Floats,
    hand_points_at_zero: Floats,
    wrist_crossing: Floats,
    free_joint_values: Floats,
) -> Found:
    """Inverse of arms with parallel axes 2, 3, 4.

    Axes 5 and 6 cross in `wrist_crossing`: q (m, 8, 6), flags, reasons.
    """
    q, flags = np.full((len(wanted_hand_points), 8, 6), np.nan), np.full((len(wanted_hand_points), 8), -1)
    reason, gap = np.zeros(len(wanted_hand_points), np.int64), np.zeros(len(wanted_hand_points))
    o1, o2, o3, o4 = (
        matrix_row(axis_points, 0),
        matrix_row(axis_points, 1),
        matrix_row(axis_points, 2),
        matrix_row(axis_points, 3),
    )
    u1, u2, u3, u4, u5, u6 = (
        matrix_row(axes, 0),
        matrix_row(axes, 1),
        matrix_row(axes, 2),
        matrix_row(axes, 3),
        matrix_row(axes, 4),
        matrix_row(axes, 5),
    )
    k0 = (wrist_crossing[0], wrist_crossing[1], wrist_crossing[2])
    arm, fore, last = (
        _across(add_scaled(o3, o2, -1.0), u2),
        _across(add_scaled(o4, o3, -1.0), u2),
        add_scaled(k0, o4, -1.0),
    )
    upper, lower, level = np.sqrt(dot(arm, arm)), np.sqrt(dot(fore, fore)), dot(u2, add_scaled(k0, o1, -1.0))
    reach, mark, bend = add_scaled(k0, matrix_row(hand_points_at_zero, 0), -1.0), cross(u6, u5), _bend(u2, u5, u6)
    sign3, sign4 = dot(u3, u2), dot(u4, u2)
    for m in range(len(wanted_hand_points)):
        P, ex, ey, ez = _hand(wanted_hand_points, m, reach)
        first, second, h1, miss, span1 = first_joint_angles_for_axis_2_offset(P, o1, u1, u2, level)
        if miss > SLACK:
            reason[m], gap[m] = OFF_AXIS, miss
            continue
        worst, why = np.inf, TOO_FAR
        for n1 in range(2):
            t1 = free_joint_values[0] if span1 < FREE else (first if n1 == 0 else second)
            c, s = np.cos(t1), -np.sin(t1)
            P1, x, y, z = (
                rotate_point(P, o1, u1, c, s),
                rotate_vector(ex, u1, c, s),
                rotate_vector(ey, u1, c, s),
                rotate_vector(ez, u1, c, s),
            )
            v, w = vector_from_axis_components(u6, x, y, z), vector_from_axis_components(mark, x, y, z)
            first5, second5, h5, miss = _wrist(u2, v, bend)
            if miss > SLACK:
                if worst == np.inf:
                    worst, why = miss, TURNED_AWAY
                continue
            for n5 in range(2):
                t5 = first5 if n5 == 0 else second5
                c, s = np.cos(t5), np.sin(t5)
                turn, d, e, size = angle_cosine_and_sine_about_axis(rotate_vector(u6, u5, c, s), v, u2)
                if (
                    size < FREE**2
                ):  # axis 6 along 2: one motion of all four leaves the hand still, so take a place of it that can be
                    turn = angle_cosine_and_sine_about_axis(
                        rotate_vector(
                            rotate_vector(mark, u6, np.cos(free_joint_values[5]), np.sin(free_joint_values[5])),
                            u5,
                            c,
                            s,
                        ),
                        w,
                        u2,
                    )[0]
                    turn, d, e, _ = _set(_within(turn, add_scaled(P1, o2, -1.0), last, u2, upper, lower))
                t6 = angle_cosine_and_sine_about_axis(mark, rotate_vector(rotate_vector(w, u2, d, -e), u5, c, -s), u6)[
                    0
                ]
                D = add_scaled(P1, rotate_vector(last, u2, d, e), -1.0)
                e1, e2, h2, far, close, span = elbow_points_and_distances(o2, u2, upper, lower, D)
                if max(far, close) > SLACK:
                    if max(far, close) < worst:
                        worst, why = max(far, close), TOO_FAR if far > close else TOO_NEAR
                    continue
                for n2 in range(2):
                    t2, f, g, _ = (
                        _set(free_joint_values[1])
                        if span < FREE
                        else angle_cosine_and_sine_about_axis(arm, e1 if n2 == 0 else e2, u2)
                    )
                    t3 = angle_cosine_and_sine_about_axis(
                        fore, add_scaled(rotate_point(D, o2, u2, f, -g), o3, -1.0), u3
                    )[0]
                    t4 = wrap_angle(wrap_angle(sign4 * (turn - t2 - sign3 * t3)))
                    b = 4 * n1 + 2 * n2 + n5
                    q[m, b, 0], q[m, b, 1], q[m, b, 2], q[m, b, 3], q[m, b, 4], q[m, b, 5] = t1, t2, t3, t4, t5, t6
                    flags[m, b] = SHOULDER * (h1 < SINGULAR) + ELBOW * (h2 < SINGULAR) + WRIST * (h5 < SINGULAR)
        if (flags[m] < 0).all():
            reason[m], gap[m] = why, worst
    return q, flags, reason, gap
