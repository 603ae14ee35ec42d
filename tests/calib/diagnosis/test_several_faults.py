"""Faults that come together: what several axes show beside what all have in common, and what stays when it is tried in
another's place. The recordings are of the independent truth.
"""

import numpy as np
import pytest
from scipy.optimize import nnls

from calib.api.diagnose import diagnose
from calib.diagnosis.engine.candidate_scores_and_their_significance import joint_fit_and_explained_sum_of_squares
from calib.diagnosis.engine.linear_residual_model import Projection
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.recording import recording_folder
from tests.bench.several_faults import drawn
from tests.truth import record


def projection(columns, residual):
    return Projection(np.zeros((0, columns.shape[1])), columns.T @ residual, columns.T @ columns)


def test_sizes_of_columns_are_those_of_least_squares_that_never_goes_below_zero():
    rng = np.random.default_rng(5)
    columns, residual = rng.normal(size=(40, 6)) @ rng.normal(size=(6, 6)), rng.normal(size=40)
    sizes, gain = joint_fit_and_explained_sum_of_squares(projection(columns, residual), np.zeros(6, bool))
    expected, left = nnls(columns, residual)
    assert np.allclose(sizes, expected, atol=1e-3 * expected.max())
    assert gain == pytest.approx(residual @ residual - left**2, rel=1e-4)


def test_what_may_have_either_sign_does_and_a_column_that_another_makes_needless_takes_nothing_from_the_sum():
    rng = np.random.default_rng(6)
    columns, sizes = rng.normal(size=(50, 3)), np.array([2.0, -1.0, 0.5])
    twice = np.column_stack([columns, columns[:, 0]])
    found, gain = joint_fit_and_explained_sum_of_squares(projection(twice, columns @ sizes), np.ones(4, bool))
    assert np.allclose(twice @ found, columns @ sizes) and gain == pytest.approx(((columns @ sizes) ** 2).sum())


def diagnosed(seed, faults, folder):
    """(Diagnosis, its findings, hidden faults) of a recording."""
    case, hidden = drawn(seed, faults)
    result = diagnose(recording_folder.load_recording(record(case, folder / "rec"))).found
    return result, tuple(diagnosis_report(result).findings), hidden


def require_named_or_stated(effects, hidden):
    for one in hidden:
        assert one.is_named(effects) or one.is_in_stated_set(effects), (str(one), [str(f) for f in effects])


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(65003, id="a clock that is late and drives that lag differently"),
        pytest.param(65017, id="drives that lag a little differently, and a strut that creeps"),
        pytest.param(51007, id="struts that creep with two times, and a clock that is late"),
        pytest.param(91007, id="a strut with backlash, and a clock that is late as a lag of all drives would be"),
    ],
)
def test_what_moves_with_the_speed_is_named_or_listed_among_what_it_cannot_be_told_from(seed, tmp_path):
    _, effects, hidden = diagnosed(seed, 2, tmp_path)
    require_named_or_stated(tuple(f for f in effects if f.effect != "unknown"), hidden)


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed, count",
    [
        pytest.param(67002, 2, id="springs of which one is three times stiffer, and a hysteresis"),
        pytest.param(67011, 2, id="struts that warm up differently and lose steps twice"),
        pytest.param(67014, 2, id="a hysteresis at every strut, and a clock that is late"),
        pytest.param(76000, 3, id="waves in every screw, screws that turn the platform, and one drive that lags"),
        pytest.param(95000, 2, id="a lag, which has no negative size, of all struts, of which two lag less"),
        pytest.param(95013, 2, id="profiles with kinks, whose own scatter hides how much finer ones explain"),
        pytest.param(95020, 2, id="clearances of few frames each, which convince together, and springs of all struts"),
        pytest.param(97017, 2, id="clearances that predict stretches held out together, and a wave of one strut"),
        pytest.param(99001, 2, id="two springs and lost steps of one strut, each scatter to the others"),
    ],
)
def test_several_faults_of_all_axes_leave_nothing_unknown(seed, count, tmp_path):
    result, effects, hidden = diagnosed(seed, count, tmp_path)
    assert not result.left
    require_named_or_stated(effects, hidden)


@pytest.mark.slow
def test_other_names_for_several_that_are_refuted_together_stand_where_they_explain_more(tmp_path):
    # struts that lag and settle, each differently: three settling errors were refuted, and what took their place at all
    # struts was given up for eight unknowns
    result, effects, hidden = diagnosed(92001, 3, tmp_path)
    assert not result.left
    assert [one.effect for one in hidden if one.is_named(effects)] == ["servo_lag", "axis_coupling"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(97024, id="a step that other steps at its place make needless is not admitted for ever"),
        pytest.param(97016, id="struts that lose steps and warm up, each hidden by what the other scatters"),
    ],
)
def test_steps_beside_what_all_struts_do_are_named(seed, tmp_path):
    _, effects, hidden = diagnosed(seed, 2, tmp_path)
    require_named_or_stated(effects, hidden)


@pytest.mark.slow
def test_a_profile_as_fine_as_the_data_show_leaves_nothing_unknown_beside_a_lag(tmp_path):
    result, effects, hidden = diagnosed(68004, 3, tmp_path)
    assert not result.left
    assert all(one.is_named(effects) for one in hidden if one.effect in ("servo_lag", "transmission_error"))


@pytest.mark.slow
def test_a_late_clock_that_one_struts_hysteresis_hides_at_first_is_one_finding_once_that_is_known(tmp_path):
    result, effects, hidden = diagnosed(71009, 2, tmp_path)
    assert not result.left and len(effects) == 2
    require_named_or_stated(effects, hidden)


@pytest.mark.slow
def test_springs_of_all_struts_that_are_not_alike_are_no_clearance_of_some(tmp_path):
    result, effects, hidden = diagnosed(99029, 2, tmp_path)
    assert not result.left
    assert not {"joint_clearance", "scale_error"} & {f.effect for f in effects}
    assert all(one.is_named(effects) for one in hidden)
