"""The emulator's axes: together, within their limits, halted on the way, and told as straight lines."""

import numpy as np

from rig.driving.emulators.emulated_axis_motion_and_controller_faults import FINE, MovingAxes

SPEED, ACCELERATION = np.array([0.01, 0.02, 0.03]), np.array([0.1, 0.05, 0.2])


def axes():
    return MovingAxes(5.0, np.zeros(3), SPEED, ACCELERATION)


def moved(one, until, step=1e-4):
    t = np.arange(5.0, until + step, step)
    p = one.lengths_at(t)
    v = np.diff(p, axis=0) / step
    return t, p, v, np.diff(v, axis=0) / step


def test_axes_start_and_arrive_together_within_every_limit():
    one = axes()
    target = np.array([0.01, -0.03, 0.001])
    end = one.go(6.0, target)
    t, p, v, a = moved(one, end + 0.1)
    np.testing.assert_allclose(p[t <= 6.0], 0, atol=1e-12)
    np.testing.assert_allclose(p[t >= end], np.broadcast_to(target, p[t >= end].shape), atol=1e-12)
    np.testing.assert_allclose(p / target, np.broadcast_to((p / target)[:, :1], p.shape), atol=1e-9)
    assert (np.abs(v).max(axis=0) <= SPEED * (1 + 1e-6)).all() and (np.abs(a).max(axis=0) <= ACCELERATION * 1.001).all()
    assert np.isclose(np.abs(v).max(axis=0), SPEED, rtol=1e-3).any()  # one of them is the reason


def test_a_move_takes_as_long_as_asked():
    one = axes()
    assert one.go(6.0, np.array([0.001, 0.001, 0.001]), 3.0) > 9.0


def test_a_halt_brakes_on_the_way_and_forgets_what_was_queued():
    one = axes()
    one.go(6.0, np.array([0.05, 0.05, 0.05]))
    one.go(6.0, np.zeros(3))
    end = one.halt(7.0)
    t, p, v, a = moved(one, end + 1.0)
    assert 7.0 < end < 7.5 and (np.abs(a).max(axis=0) <= ACCELERATION * 1.001).all()
    assert (p[-1] > one.at(7.0)).all() and (p[-1] < 0.05).all()
    np.testing.assert_allclose(p[t > end], np.broadcast_to(p[-1], p[t > end].shape), atol=1e-12)
    assert one.halt(end + 1) == end + 1


def test_the_past_told_in_straight_lines():
    one = axes()
    end = one.go(6.0, np.array([0.01, -0.03, 0.001]))
    one.go(end + 1, np.zeros(3))
    t, p = one.knots()
    at = np.arange(5.0, one.until, 1e-3)
    lines = np.stack([np.interp(at, t, column) for column in p.T], axis=1)
    assert np.abs(lines - one.lengths_at(at)).max() <= FINE * (1 + 1e-6)
    later, _ = one.knots(end)
    assert later[0] >= end and len(later) < len(t)
