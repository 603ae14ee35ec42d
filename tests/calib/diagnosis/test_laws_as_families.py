"""A law is a family: machines that follow another formula than ours keep the name."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from calib.diagnosis.engine.frame_inner_products_and_reduced_least_squares import Normal, solve_nonnegative
from rig.recording.recording_folder import load_recording
from tests.calib.diagnose_recording import diagnosis_of
from tests.truth import case as cases
from tests.truth import draw, memories, record

CONFIGURATIONS = 150
REACH = 1.5e-3 * (np.arange(8) + 0.5) / 8  # m, of sliders of which the short ones carry most
WEIGHTS = 0.095 / np.arange(1, 9) / (1 / np.arange(1, 9)).sum()
AXIS = np.eye(6)[2]
ALL_AXES = np.array([0.9, 1.1, 1.0, 0.7, 0.8, 0.7])


def diagnosed(folder, effect, law, seed, only=None):
    """Diagnosis of a hexapod of the independent truth that follows a law; seed : of the machine and its plan"""
    case = draw(seed, effect, "strong", "shuffled", "hexapod", count=CONFIGURATIONS)
    case = replace(case, laws=(law(case),), sigma=(2e-6, 2e-5))
    case = replace(case, seen=cases._seen(case, np.random.default_rng(seed)))
    return diagnosis_of(load_recording(record(case, folder / "rec")), only=only)


def sites(found):
    return sorted((effect.name, effect.place) for effect in found.effects)


def short_sliders(case):
    return memories.Sliders(AXIS, REACH, WEIGHTS, np.zeros(6))


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_loops_of_another_shape_are_hysteresis(tmp_path, seed):
    found = diagnosed(tmp_path, "hysteresis", short_sliders, seed)
    assert sites(found) == [("hysteresis", "strut 3")] and not found.left


@pytest.mark.slow
@pytest.mark.parametrize("axes", [AXIS, ALL_AXES], ids=["one strut", "all struts"])
@pytest.mark.parametrize("share", [0.55, 0.9, 1.0])
def test_bristles_that_bend_and_slip_are_hysteresis(tmp_path, share, axes):
    def bristles(case):
        return memories.Bristles(axes, np.array([4e-3]), np.array([1.5e-2]), share, np.zeros(6))

    found = diagnosed(tmp_path, "hysteresis", bristles, 1)
    wanted = [("hysteresis", f"strut {i + 1}") for i in np.flatnonzero(axes)]
    assert set(wanted) <= set(sites(found))


@pytest.mark.slow
@pytest.mark.parametrize("effect, variant", [("creep", 0), ("creep", 1), ("warm_up", 0), ("thermal_expansion", 1)])
def test_several_times_and_late_heat_keep_the_name(tmp_path, effect, variant):
    case = draw(2, effect, "strong", "shuffled", "hexapod", count=CONFIGURATIONS, variant=variant)
    case = replace(case, laws=(replace(case.laws[0], axes=AXIS),))
    case = replace(case, seen=cases._seen(case, np.random.default_rng(2)))
    found = diagnosis_of(load_recording(record(case, tmp_path / "rec")))
    assert (effect, "strut 3") in sites(found) and not found.left


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_profile_with_kinks_is_a_transmission_error(tmp_path, seed):
    case = draw(1, "transmission_error", "strong", "shuffled", "hexapod", count=CONFIGURATIONS, variant=1)
    case = replace(case, laws=(replace(case.laws[0], axes=AXIS),))
    case = replace(case, seen=cases._seen(case, np.random.default_rng(seed)))
    found = diagnosis_of(load_recording(record(case, tmp_path / "rec")))
    assert sites(found) == [("transmission_error", "strut 3")]


def test_nothing_below_zero_and_the_best_of_that():
    rng = np.random.default_rng(3)
    A, y = rng.normal(size=(5, 40, 4)), rng.normal(size=(5, 40))
    G, b = np.swapaxes(A, 1, 2) @ A, np.einsum("knq,kn->kq", A, y)
    solved = solve_nonnegative(Normal(b, G, np.einsum("kqq->kq", G).copy()))
    for rows, right, x, rank, gain in zip(A, y, solved.coefficients, solved.rank, solved.delta_chi2):
        own = lsq_linear(rows, right, (0, np.inf), tol=1e-14)
        assert (x >= 0).all() and rank == np.count_nonzero(x)
        np.testing.assert_allclose(x, own.x, atol=1e-6)
        np.testing.assert_allclose(gain, right @ right - 2 * own.cost, rtol=1e-6)
