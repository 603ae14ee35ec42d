"""Each law of a fault does what its formula says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.truth import FAULTS, draw, drive, rms
from tests.truth.days import Clocked, GrowingBase, GrownLinks, Warming
from tests.truth.draw_machines import nominal
from tests.truth.journey import Journey
from tests.truth.kinematics import Arm, Hinge
from tests.truth.laws import Law, stood
from tests.truth.loads import Springs
from tests.truth.memories import Bristles, Damped, LastStep, Logarithmic, Sliders, Stops, TwoPaces
from tests.truth.motion import Conditions, passed
from tests.truth.rigid import errors

DAY = Conditions((20.0, 6.0, 0.0, 1.0, 100.0), np.zeros(2), np.array([[0.0, 0.0]]))
HINGE = Hinge(np.array([[0.0, 0.0], [0.5, 0.0]]), np.zeros(2), np.array([[0.3, 0.5], [0.3, 0.5]]))
ONE, STILL = np.array([1.0, 0.0]), np.zeros(2)


def moved(law: Law, places: list[float], t: np.ndarray | None = None) -> np.ndarray:
    """What a law does to the first axis at places, reached one after the other, a second each."""
    t = np.arange(len(places), dtype=float) if t is None else t
    values = np.stack([places, np.full(len(places), 0.4)], axis=1)
    motion = passed(Journey(t, values, t), t, DAY, HINGE)
    return law.beyond(motion, HINGE.forward(values))[:, 0]


def test_play_is_two_sided_and_saturates():
    out = moved(Stops(ONE, 3e-5, 1e-5, STILL), [0.4, 0.41, 0.42, 0.42 - 2e-5, 0.41, 0.41 + 1e-5])
    assert np.allclose(out, [0, -3e-5, -3e-5, -1e-5, 1e-5, 0])


@pytest.mark.parametrize("share", [0.5, 0.7, 1.0])
def test_bristles_follow_their_equation(share):
    most, places = 1e-3, np.array([0.4, 0.4006, 0.3999, 0.402, 0.4013])
    z, seen = 0.0, [0.0]
    for step in np.diff(places):
        sign = np.sign(step)
        done = solve_ivp(
            lambda x, y: 1 - share * y / most - (1 - share) * np.abs(y) / most,
            (0, abs(step)),
            [z * sign],
            rtol=1e-10,
            atol=1e-13,
        )
        z = float(done.y[0, -1]) * sign
        seen.append(-z)
    assert np.allclose(
        moved(Bristles(ONE, np.array([most]), np.ones(1), share, STILL), places.tolist()), seen, atol=1e-9
    )


def test_sliders_hold_no_more_than_their_reach():
    law = Sliders(ONE, np.array([1e-4, 1e-3]), np.array([0.01, 0.02]), STILL)
    assert np.allclose(moved(law, [0.4, 0.45, 0.449]), [0, -(1e-6 + 2e-5), -(-1e-6 + 0.0)])


def test_what_comes_late_comes():
    t = np.array([0.0, 1.0, 1.001, 2.0, 10.0, 1e5])
    for law in (TwoPaces(ONE, 0.01, 1.0, 5.0, 0.4), Logarithmic(ONE, 0.01, 1.0, 1e4)):
        out = moved(law, [0.4, 0.4, 0.41, 0.41, 0.41, 0.41], t)
        assert (
            out[1] == 0
            and np.isclose(out[2], -1e-4, rtol=2e-3)
            and out[2] < out[3] < out[4] < -1e-6
            and abs(out[5]) < 1e-12
        )
    s = 10.0 - 1.0005
    assert np.isclose(
        moved(TwoPaces(ONE, 0.01, 1.0, 5.0, 0.4), [0.4, 0.4, 0.41, 0.41, 0.41, 0.41], t)[4],
        -1e-4 * (0.4 * np.exp(-s) + 0.6 * np.exp(-s / 5)),
        rtol=1e-6,
    )


def test_a_drive_of_the_second_order_settles_and_trails_a_ramp():
    t = np.array([0.0, 1.0, 3.0, 30.0])
    out = moved(Damped(ONE, 1.0, 10.0, 0.7), [0.4, 0.4, 0.42, 0.42], t)
    assert (
        np.isclose(out[2], -0.01 * 2 * 0.7 / 10.0, rtol=1e-4) and abs(out[3]) < 1e-12
    )  # speed times 2 damping / frequency


def test_the_last_step_is_that_of_the_whole_move():
    assert np.allclose(
        moved(LastStep(ONE, 1e-3, 0.0), [0.4, 0.4, 0.41, 0.42, 0.42, 0.39, 0.39]),
        [0, 0, -1e-5, -2e-5, -2e-5, 3e-5, 3e-5],
    )


def test_two_bodies_warm_one_through_the_other():
    law = Warming(ONE, 1e-5, 10.0, 30.0, 0.0)
    t = np.array([0.0, 5.0, 50.0])
    done = solve_ivp(
        lambda t, h: [(1 - h[0]) / 10, (h[0] - h[1]) / 30], (0, 50), [0, 0], t_eval=t, rtol=1e-9, atol=1e-12
    )
    assert np.allclose(moved(law, [0.4, 0.4, 0.4], t), 1e-5 * done.y[1], atol=1e-11)


def test_a_base_that_grows_is_a_larger_base():
    rng = np.random.default_rng(3)
    machine = nominal("hexapod", rng)
    path = Journey(
        np.array([0.0, 60.0]),
        np.tile(machine.ranges.mean(axis=1), (2, 1)) + rng.normal(0, 5e-3, (1, 6)),
        np.array([50.0]),
    )
    day = replace(DAY, warmer=np.zeros(6))
    grown = replace(machine, base=machine.base * (1 + 1e-4 * 3.0))  # 20 C and 6 K in 100 s: 3 K
    law = GrowingBase(np.ones(6), np.full(3, 1e-4))
    assert np.abs(errors(stood(machine, path, day, (law,)), grown.forward(path.values[:1]))).max() < 1e-11


def test_level_struts_share_the_weight_by_hand():
    machine = nominal("hexapod", np.random.default_rng(3))
    law = Springs(np.ones(6), 12.0, np.zeros(3), np.zeros(3), 1e7, np.inf)
    path = Journey(np.array([0.0, 1.0]), np.tile(machine.ranges.mean(axis=1), (2, 1)), np.array([1.0]))
    legs = machine.legs(machine.forward(path.values[:1]))[0]
    force = (
        12.0 * 9.80665 / 6 / (legs[:, 2] / np.linalg.norm(legs, axis=1))
    )  # by symmetry a sixth each, along the strut
    motion = passed(path, path.looked, Conditions((20, 0, 0, 1, 1), np.zeros(6), np.array([[0.0, 0.0]])), machine)
    assert np.allclose(law.beyond(motion, machine.forward(path.values[:1]))[0], -force / 1e7, rtol=1e-12)


def test_a_late_clock_sees_what_comes_later():
    t = np.array([0.0, 10.0])
    path = Journey(t, np.array([[0.4, 0.4], [0.45, 0.4]]), np.array([4.0]))
    assert (
        np.abs(
            errors(stood(HINGE, path, DAY, (Clocked(STILL, 0.5, 0.125),)), HINGE.forward(np.array([[0.425, 0.4]])))
        ).max()
        < 1e-12
    )


def test_links_grow_by_hand():
    arm = Arm(np.array([[0.0, 0.3, 0.5, 0.0]]), np.array([False]), np.zeros(1), np.array([[-1.0, 1.0]]), np.zeros(1))
    path = Journey(np.array([0.0, 60.0]), np.zeros((2, 1)), np.array([50.0]))  # at 23 C
    pose = stood(arm, path, DAY, (GrownLinks(np.ones(1), 1e-4),))[0]
    assert np.allclose(pose[:3, 3], [0.5 * 1.0003, 0, 0.3 * 1.0003], atol=1e-12)


@pytest.mark.parametrize("effect", FAULTS)
def test_strong_faults_show_and_none_do_not(effect):
    for variant in range(2 if effect not in ("time_offset", "clock_drift") else 1):
        case = draw(3, effect, "strong", "shuffled", count=20, variant=variant)
        sound = stood(case.machine, case.journey, case.day, ())
        real = stood(case.machine, case.journey, case.day, case.laws)
        assert 0.1 * case.size < rms(errors(real, sound))[0] < 30 * case.size
        assert (
            rms(
                errors(
                    stood(case.machine, case.journey, case.day, draw(3, effect, "none", "shuffled", count=20).laws),
                    sound,
                )
            )[0]
            == 0
        )


def test_homing_takes_lost_steps_away():
    case = draw(4, "missed_steps", "strong", "shuffled", count=14)
    values = case.journey.values[1::2][:3]
    assert rms(errors(drive(case, values), case.machine.forward(values)))[0] < 1e-12
    off = errors(
        stood(case.machine, case.journey, case.day, case.laws),
        case.machine.forward(case.journey.at(case.journey.looked)),
    )
    assert rms(off[:2])[0] < 1e-12 < 0.3 * case.size < rms(off[-2:])[0]
