"""Configurations where two hypotheses come apart: what is chosen of many, and in whose images it shows."""

import numpy as np
import pytest

from calib.api.next_experiment import CHOSEN, available_experiment_plan_texts
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.experiment.experiment_questions_and_information import (
    Hypothesis,
    PerFrame,
    camera_information_shares,
    discriminating_configurations,
    most_informative_exposures,
)
from calib.experiment.platform_diagnosis_questions import (
    PlatformQuestion,
    predicted_outcomes_of_two_likeliest_hypotheses,
)
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.planning.recording_plan import build_plan
from tests.calib.recordings_with_effects import recorded


def frames(difference, left_open):
    """PerFrame of exposures of one row each. difference : (F,); left_open : (F, p)"""
    d, N = np.asarray(difference, float), np.asarray(left_open, float)
    return PerFrame(d**2, N * d[:, None], N[:, :, None] * N[:, None, :], {})


def total_information(found):
    """What all of a PerFrame's exposures tell together."""
    b = found.onto.sum(axis=0)
    return found.of.sum() - b @ np.linalg.solve(np.eye(len(b)) + found.open.sum(axis=0), b)


def test_what_is_left_open_counts_for_nothing_however_large():
    """Three exposures differ most, by what one open number explains in all of them; two smaller ones it does not."""
    open_ones = 100 * np.array([[1.0], [1.0], [1.0], [0.0], [0.0], [1e-3]])
    one = frames([3.0, 3.0, 3.0, 1.0, 1.5, 0.1], open_ones)
    assert most_informative_exposures([one], 2).tolist() == [4, 3]
    assert most_informative_exposures([frames([3.0, 3.0, 3.0, 1.0, 1.5, 0.1], np.zeros((6, 1)))], 3).tolist() == [
        0,
        1,
        2,
    ]


def test_the_best_pair_is_found_as_trying_all_finds_it():
    rng = np.random.default_rng(4)
    d, N = rng.normal(size=8), rng.normal(size=(8, 2))

    def distance(pair):
        X = N[list(pair)]
        return d[list(pair)] @ np.linalg.solve(np.eye(len(pair)) + X @ X.T, d[list(pair)])

    first, second = most_informative_exposures([frames(d, N)], 2).tolist()
    assert first == max(range(8), key=lambda i: distance((i,)))
    assert second == max((i for i in range(8) if i != first), key=lambda i: distance((first, i)))
    assert total_information(frames(d, N)) == pytest.approx(distance(range(8)))


def test_more_than_there_are_cannot_be_chosen():
    with pytest.raises(ValueError, match="3 exposures are to be chosen from 2"):
        most_informative_exposures([frames([1.0, 1.0], np.zeros((2, 1)))], 3)


def test_they_are_a_part_of_a_plan(design):
    assert all(f"apart:{count}" in available_experiment_plan_texts((), True) for count in CHOSEN)
    own = build_plan(design, "sobol:2", 3).commands.values[-2:]
    plan = build_plan(design, "apart:2,ladder:1", additional_parts={"apart:2": own})
    assert len(plan.t) == 2 + len(build_plan(design, "ladder:1").t)
    np.testing.assert_allclose(plan.commands.at(plan.t[:2]), own)


@pytest.mark.slow
def test_configurations_are_chosen_by_the_images_and_the_cameras_that_see_it_are_told(tmp_path, design):
    """Whether the edges of one camera's images have shifted or that camera's focal length goes with the temperature."""
    point = operating_point_source_and_measurement(
        recorded(tmp_path, design, ["edge_bias:camera cam1:bias=0.1"], route="sobol:20")
    )[0]
    fits = [
        refine_operating_point(point.with_effects([parse_effect(text)]), Sensitivities(point))
        for text in ("edge_bias:camera cam1:bias=0.1", "focal_drift:camera cam1:per_kelvin=1e-4")
    ]
    questions = [
        PlatformQuestion(tuple(Hypothesis(fit.point.effects[0].name, "camera cam1", 0.5, fit, 0) for fit in fits))
    ]
    own = discriminating_configurations(questions, design, 8, seed=3)
    plan = build_plan(design, "apart:8", additional_parts={"apart:8": own})
    seen = camera_information_shares(questions, plan)
    assert next(iter(seen)) == "cam1" and seen["cam1"] > 0.5 and sum(seen.values()) == pytest.approx(1)
    anywhere = [
        total_information(
            predicted_outcomes_of_two_likeliest_hypotheses(questions[0], build_plan(design, "sobol:8", seed))
        )
        for seed in range(3)
    ]
    assert total_information(predicted_outcomes_of_two_likeliest_hypotheses(questions[0], plan)) > 1.2 * max(anywhere)
