"""The chance that an experiment settles a question: against what is known in closed form, and what no outcome can
settle.
"""

import numpy as np
import pytest
from scipy.stats import norm

from calib.api.next_experiment import Experiment, available_experiment_plan_texts, rank_experiments
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import PLATFORM
from calib.experiment.experiment_questions_and_information import Prediction, experiment_information

HALF, NOTHING = np.array([0.5, 0.5]), np.zeros(2)


def apart(distance, r=5):
    """Prediction of two hypotheses whose means lie so many standard deviations apart."""
    means = np.zeros((2, r))
    means[1, 2] = distance
    return Prediction(means, np.tile(np.eye(r), (2, 1, 1)), np.zeros((2, 2)))


@pytest.mark.parametrize("d", [1.0, 2.0, 3.0, 5.0])
def test_the_chance_is_that_of_two_gaussians(d):
    settles = norm.sf((PLATFORM.alike - d**2) / (2 * d)) + norm.cdf((-PLATFORM.alike - d**2) / (2 * d))
    right = norm.sf((PLATFORM.alike - d**2) / (2 * d))
    found = experiment_information(HALF, apart(d), NOTHING)
    np.testing.assert_allclose([found.settles, found.right], [settles, right], atol=0.06)


def test_what_differs_in_nothing_tells_nothing_and_what_looks_the_same_stays_alike():
    nothing = experiment_information(HALF, apart(0.0), NOTHING)
    assert nothing.bits < 1e-9 and nothing.settles == 0
    far = apart(20.0)
    assert experiment_information(HALF, far, NOTHING).settles == pytest.approx(1) and experiment_information(
        HALF, far, NOTHING
    ).bits == pytest.approx(1.0)
    near, unequal = (
        apart(1.0),
        np.array([0.94, 0.06]),
    )  # what one costs more than the other settles nothing between two that do the same
    same = Prediction(near.means, near.covariances, np.ones((2, 2)))
    assert (
        experiment_information(unequal, same, NOTHING).settles
        < 0.05
        < experiment_information(unequal, near, NOTHING).settles
    )
    nearly_determined = np.array([0.0, 5.5])  # by the data so far: little more is needed
    assert experiment_information(unequal, same, nearly_determined).settles > 0.5


def test_what_costs_less_comes_first_among_those_that_settle():
    def one(text, minutes, bits, settles):
        return Experiment(text, 1, None, minutes, bits, settles)

    order = rank_experiments(
        [
            one("long", 60.0, 1.0, 1.0),
            one("short", 2.0, 0.9, 0.95),
            one("cheap", 0.5, 0.3, 0.1),
            one("dull", 1.0, 0.1, 0.0),
            one("telling", 1.0, 0.2, 0.0),
        ]
    )
    assert [e.text for e in order] == ["short", "cheap", "long", "telling", "dull"]


def test_nothing_is_loaded_and_nothing_waits_unless_the_owner_allows():
    assert not any(
        "payload" in text or "wait" in text or "dwell" in text for text in available_experiment_plan_texts((), False)
    )
    assert any("payload" in text for text in available_experiment_plan_texts(("payload",), False)) and any(
        "wait" in text for text in available_experiment_plan_texts(("wait",), False)
    )
    assert not any(
        text.startswith(("moving", "zigzag", "dwell", "payload"))
        for text in available_experiment_plan_texts(("wait", "payload"), True)
    )
