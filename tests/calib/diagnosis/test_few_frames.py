"""Few frames tell: what they say of a camera's six motions, of both sides of a moment, of a curve; nothing is made of
noise by that.
"""

import numpy as np
import pytest
from scipy.special import chdtri

from calib.diagnosis.engine.candidate_scores_and_their_significance import Score, score_raised_to_likelihood_ratio
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import PLATFORM, Candidate
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import (
    cross_validation_folds_of_frames,
    residual_dispersion,
    scan_p_value,
)
from calib.diagnosis.engine.forward_and_backward_term_selection import _hidden
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    FrameProducts,
    normal_equations_by_common_weights,
    solve_normal_equations,
)
from calib.diagnosis.engine.linear_residual_model import Block, Column, LinearModel
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import (
    frames_before_and_after_sudden_changes,
)
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.effects.catalogue.camera_bump import CameraBump
from rig.effects.catalogue.missed_steps import MissedSteps
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded

FRAMES, ROWS, DRAWS = 30, 14, 500  # of a camera, numbers that each shows, worlds with nothing in them
KNOCK = "motion=3e-5/-4e-5/-1e-5/5e-5/-7e-5/0"


@pytest.mark.parametrize("frames, together", [(30, 5), (16, 5), (23, 6), (31, 8)])
def test_frames_taken_together_are_sums_over_them(frames, together):
    """The dispersion of groups of frames, the last one shorter, is that of as many longer frames."""
    rng = np.random.default_rng(frames)
    looks = rng.normal(size=(frames, ROWS, 3))
    y = (
        rng.normal(size=(frames, ROWS))
        + np.repeat(rng.normal(size=(-(-frames // together), ROWS)), together, axis=0)[:frames]
    )

    def dispersion(edges, correlated):
        F = len(edges) - 1
        parts = [slice(a, b) for a, b in zip(edges, edges[1:])]
        model = LinearModel(
            (Block("corners", "px", y.ravel(), ROWS * np.asarray(edges)),),
            Column((np.zeros((y.size, 0)),)),
            None,
            y.size,
        )
        beta = np.array([np.einsum("fma,fm->a", looks[part], y[part]) for part in parts])
        gamma = np.array([np.einsum("fma,fmb->ab", looks[part], looks[part]) for part in parts])
        products = FrameProducts(beta, gamma, np.zeros((F, 3, 0)))
        weights = np.broadcast_to(np.eye(3), (F, 3, 3))
        coefficients = np.linalg.solve(gamma.sum(axis=0), beta.sum(axis=0))
        return residual_dispersion(model, products, weights, coefficients, correlated)

    grouped = dispersion(np.arange(frames + 1), together)
    summed = dispersion([*range(0, frames, together), frames], 1)
    assert grouped == pytest.approx(summed, rel=1e-9)


def chance(after, y, looks):
    """p-value of a camera's step before the last frames `after`. y : (F, m) whitened residuals; looks : (F, m, 6)
    derivatives
    """
    F, m = y.shape
    block = Block("corners", "px", y.ravel(), m * np.arange(F + 1))
    model = LinearModel((block,), Column((np.zeros((F * m, 0)),)), None, F * m)
    products = FrameProducts(np.einsum("fma,fm->fa", looks, y), np.swapaxes(looks, 1, 2) @ looks, np.zeros((F, 6, 0)))
    w = (np.arange(F) >= F - after).astype(float)
    solved = solve_normal_equations(normal_equations_by_common_weights(products, w[None]))
    found = residual_dispersion(model, products, w[:, None, None] * np.eye(6), solved.coefficients[0])
    return scan_p_value(solved.delta_chi2 / found.ratio, 6, found.freedom)


@pytest.mark.parametrize(
    "after, scatter", [(6, 1.0), (3, 3.0)], ids=["six, as stated", "three, noise three times what is stated"]
)
def test_a_step_before_few_frames_is_as_likely_by_chance_as_it_says(after, scatter):
    rng = np.random.default_rng(after)
    looks = rng.normal(size=(FRAMES, ROWS, 6))
    p = np.array([chance(after, scatter * rng.normal(size=(FRAMES, ROWS)), looks) for _ in range(DRAWS)])
    for level in (0.1, 0.01):
        assert (p < level).mean() < level + 3 * np.sqrt(level / DRAWS)
    step = rng.normal(size=(FRAMES, ROWS)) + looks @ np.full(6, 3.0) * (np.arange(FRAMES) >= FRAMES - after)[:, None]
    assert chance(after, step, looks) < 1e-6


@pytest.mark.parametrize(
    "after, uneven", [(10, 1.0), (20, 2.0)], ids=["some frames sharper", "a few frames show nearly all"]
)
def test_frames_that_see_unevenly_make_nothing_less_likely_by_chance(after, uneven):
    """The greater of two degrees of freedom, and a dispersion as of frames alike, made one chance in a hundred of every
    tenth world.
    """
    rng = np.random.default_rng(after)
    p = np.array(
        [
            chance(
                after,
                3.0 * rng.normal(size=(FRAMES, ROWS)),
                rng.normal(size=(FRAMES, ROWS, 6)) * np.exp(uneven * rng.normal(size=(FRAMES, 1, 1))),
            )
            for _ in range(DRAWS)
        ]
    )
    for level in (0.1, 0.01):
        assert (p < level).mean() < level + 3 * np.sqrt(level / DRAWS)


@pytest.mark.parametrize("count, frames", [(1, 10), (4, 30), (6, 60)])
def test_a_likelihood_ratio_with_scatter_free_is_as_likely_by_chance_as_it_says(count, frames):
    """Of numbers that mean nothing: Bartlett's factor brings the ratio down to chi-square, or below."""
    rng = np.random.default_rng(count)
    noise, S = 3.0 * rng.normal(size=(4000, frames)), np.linalg.qr(rng.normal(size=(frames, count)))[0]
    whole, explained = (noise**2).sum(axis=1), ((noise @ S) ** 2).sum(axis=1)
    ratio = frames * np.log(whole / (whole - explained))
    base = Score(
        Candidate(name="x", place="y", grid=[{}]), {}, np.zeros(count), -np.inf, 1.0, count, 1.0, 1.0, np.zeros(1)
    )
    delta = np.array([score_raised_to_likelihood_ratio(base, r, frames).delta_chi2 for r in ratio])
    for level in (0.1, 0.01):
        assert (delta > chdtri(count, level)).mean() < level + 3 * np.sqrt(level / len(delta))
        assert count == 1 or (ratio > chdtri(count, level)).mean() > 1.1 * level, "without the factor it says too much"


def test_what_comes_before_a_moment_is_never_held_out_whole():
    for first in range(2, 40):
        late = np.arange(44) >= first
        fold = cross_validation_folds_of_frames(44, True, [late, ~late])
        assert all(len(np.unique(fold[side])) > 1 for side in (late, ~late) if side.sum() > 1), first
    np.testing.assert_array_equal(
        cross_validation_folds_of_frames(44, True, [np.arange(44) >= 20, np.arange(44) < 20]),
        cross_validation_folds_of_frames(44, True),
    )


def test_sides_are_held_out_of_what_is_seen_and_not_of_what_axes_do():
    """In one stretch an axis may do so for where it stands: a coupling without a name was called lost steps."""
    t = np.arange(10.0)
    late, early = frames_before_and_after_sudden_changes(
        [CameraBump("camera cam1", time=3.0), MissedSteps("strut 2", jump=1e-4, time=3.0)], t
    )
    np.testing.assert_array_equal(late, ~early)
    assert late.sum() == 7


@pytest.mark.slow
@pytest.mark.parametrize("time", [24, 130], ids=["after few frames", "before few frames"])
def test_a_knock_that_few_frames_see_is_named(tmp_path, design, time):
    found = diagnosis_of(
        recorded(tmp_path, design, [f"camera_bump:cam1:{KNOCK},time={time}"], route="sobol:30", noise=0.01),
        only=["camera_bump", "camera_drift", "focal_drift"],
    )
    assert [(e.name, e.place) for e in found.effects] == [("camera_bump", "camera cam1")] and not found.left


@pytest.mark.slow
def test_a_curve_of_many_numbers_is_named_in_few_frames(tmp_path, design):
    found = diagnosis_of(
        recorded(
            tmp_path,
            design,
            ["transmission_error:strut2:profile=1e-5/0/5e-6/2e-5/4e-6/-4e-6/-3e-5/-1e-5/2e-5/-1e-5"],
            route="sobol:20,ladder:1",
            noise=0.01,
        ),
        only=["transmission_error", "hysteresis", "cyclic_error", "backlash"],
    )
    assert [(e.name, e.place) for e in found.effects] == [("transmission_error", "strut 2")] and not found.left


class Scanned:
    """A Problem whose scan saw a curve and a line; what their fits are worth is given. ratios : {name: likelihood
    ratio}
    """

    policy = PLATFORM
    candidates = tuple(Candidate(name=name, place="strut 2", grid=[{}]) for name in ("curve", "line"))

    def __init__(self, ratios):
        self.ratios, self.tried = ratios, []

    def linear(self, model):
        return model

    def add_term(self, fit, score):
        self.tried.append(score.candidate.name)
        return score.candidate.name

    def likelihood_ratio(self, fit, other):
        return self.ratios[other]


@pytest.mark.parametrize("worth, message", [(200.0, ["curve"]), (60.0, [])])
def test_what_its_own_scatter_caps_is_fitted_however_many_numbers_it_has(worth, message):
    """Forty frames explain forty and no more where their scatter is free: too little for five numbers among ten
    thousand corners.
    """
    model = LinearModel(
        (Block("closures", "m", np.zeros(40), np.arange(41)),), Column((np.zeros((40, 0)),)), None, 10_000
    )
    scores = [
        Score(c, {}, np.ones(q), delta, p, q, 1.0, 1.0, np.array([delta]))
        for c, q, delta, p in zip(Scanned.candidates, (5, 1), (38.0, 26.0), (1e-5, 1e-3))
    ]
    assert scores[0].raw_delta_bic(model.size) < PLATFORM.delta_bic
    problem = Scanned({"curve": worth, "line": 12.0})
    assert [s.candidate.name for s in _hidden(problem, "nothing", model, scores)] == message and problem.tried == [
        "curve",
        "line",
    ]


@pytest.mark.slow
def test_a_strong_effect_in_few_frames_is_not_hidden_by_its_own_scatter(tmp_path, design):
    """A scan takes what nobody admitted yet for the strut's scatter: a backlash ten times the noise would stay
    unknown.
    """
    rec = recorded(tmp_path, design, ["backlash:strut2:gap=100e-6"], route="sobol:16,ladder:1", seed=22)
    (finding,) = diagnosis_report(
        diagnosis_of(rec, only=["backlash", "hysteresis", "joint_clearance", "transmission_error", "cyclic_error"])
    ).findings
    assert (finding.effect, finding.place) == ("backlash", "strut 2")
    assert finding.parameters["gap"].value == pytest.approx(1e-4, abs=1e-5)
