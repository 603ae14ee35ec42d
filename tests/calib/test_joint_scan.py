"""The search at an arm's joints: its short cuts give what the long way gives, and what comes again is told from noise."""

import numpy as np
import pytest

from calib.diagnose import arm, joint_scan
from calib.diagnose.joint_families import families
from calib.diagnose.joint_select import findings, select
from calib.diagnose.joint_unknown import unknowns
from calib.diagnose.joints import fit
from calib.diagnose.repeats import repeats
from tests.calib import arm_worlds
from tests.rig.arms import UR10

GRAVITY = np.array([0, 0, -9.80665])
SIGMA = 2e-5  # m, per axis


def seen(deviation, count=200, seed=3, again=0):
    rng = np.random.default_rng(seed)
    samples = arm_worlds.tracked(arm_worlds.secret(UR10, rng), UR10, count, rng, deviation=deviation, again=again)
    return arm.arms_of(samples, UR10, arm_worlds.TRACKER, GRAVITY)[0]


def only(joint, function):
    """What a joint (index) does beyond its command, function(q), the others being true."""
    return lambda q: function(q)[:, None] * (np.arange(6) == joint)


@pytest.fixture(scope="module")
def searched():
    arms = seen(only(2, lambda q: 3e-4 * np.sin(7 * q[:, 2])), 150)
    asked, _ = families(arms)
    return fit(arms, (), np.arange(len(arms)) % 7 != 3), asked


@pytest.mark.parametrize("name", ["cyclic_error", "missed_steps"])
def test_short_cuts_give_every_shape_its_drop(searched, name):
    now, asked = searched
    family = next(f for f in asked if f.name == name and f.joint == 2)
    atom = joint_scan.atoms(now, 2)
    quick, long = joint_scan.drops_of(now, family, atom), joint_scan._each(now, family, atom, family.shapes)
    assert quick[0] == pytest.approx(long[0], abs=1e-6 * long[0].max())
    assert np.array(quick[1]) == pytest.approx(np.array(long[1]), abs=1e-9)


def test_a_term_struck_out_or_set_beside_is_the_fit_without_or_with_it(searched):
    now, asked = searched
    a, b = [joint_scan.term(s) for s in joint_scan.scan(now, asked, least=-np.inf)[:2]]
    both = now.beside([a, b])
    assert both.without([0, 1]).left == pytest.approx(now.left, abs=1e-12)
    assert both.without([0]).left == pytest.approx(now.beside([b]).left, abs=1e-12)
    assert both.cost() < now.beside([b]).cost() < now.cost()
    drop = now.cost() - now.beside([a]).cost()
    score = joint_scan.scan(now, [a.family], least=-np.inf)[0]
    assert score.drop * score.dispersion == pytest.approx(drop, rel=1e-6)


def test_sinusoid_is_found_with_its_order(searched):
    now, asked = searched
    arms = now.arms
    chosen = select(arms, asked)
    assert [(t.family.name, t.family.place) for t in chosen.terms] == [("cyclic_error", "joint 3")]
    assert chosen.terms[0].shape["order"] == pytest.approx(7, abs=0.1)
    assert np.hypot(*chosen.theta[chosen.slices[0]]) == pytest.approx(3e-4, rel=0.1)
    found = findings(chosen, asked)[0]
    assert found.after < 0.7 * found.before and found.gain > 2


def test_repeats_tell_noise_from_what_comes_again():
    quiet = repeats(fit(seen(None, again=60)))
    assert quiet.pairs == 60 and quiet.rms == pytest.approx(SIGMA * np.sqrt(3), rel=0.15) and quiet.p_value > 1e-3
    wavy = repeats(fit(seen(only(1, lambda q: 2e-4 * np.sin(9 * q[:, 1] + 5 * q[:, 3])), again=60)))
    assert wavy.rms == pytest.approx(SIGMA * np.sqrt(3), rel=0.15) and wavy.again > 0.8 and wavy.p_value < 1e-4
    assert repeats(fit(seen(None))) is None


def test_what_the_catalogue_lacks_is_unknown_at_its_joint():
    arms = seen(only(2, lambda q: 2e-4 * np.sin(q[:, 0])), again=60)
    chosen = select(arms, families(arms)[0])
    assert chosen.terms == ()
    left = unknowns(chosen, repeats(chosen))
    assert left[0].place == "joint 3" and left[0].depends_on == ("pose",)
    assert left[0].magnitude == pytest.approx(np.std(2e-4 * np.sin(arms.q[:, 0])), rel=0.3)
    assert left[-1].place == "rig" and left[-1].depends_on == ("configuration",)
