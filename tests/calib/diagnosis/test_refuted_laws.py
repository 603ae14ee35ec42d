"""A name whose law is not the law: a free curve of its own covariate says so, and then it is told without a name."""

import numpy as np
import pytest

from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import (
    LackOfFit,
    delta_chi2_and_rank_by_column_count,
)
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import Normal, solve_normal_equations
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.platform_problem import PlatformProblem
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation, unlisted_effects_and_corner_noise
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded
from tests.calib.rigs_with_unmodelled_physics import measured_by

# the wait parts the way travelled from time and temperatures
PLAN = "ladder:3,sobol:15,moving:15,wait:60,ladder:3,axes:8,moving:15"


@pytest.fixture(scope="module")
def seen(tmp_path_factory, rig_text):
    """A function: an effect -> Diagnosis of a rig that hides it, whose poses an instrument measures, which is
    quick.
    """
    text, folder = measured_by(rig_text), tmp_path_factory.mktemp("refuted")
    (folder / "rig.toml").write_text(text)
    design = design_from_rig_toml.load_design(folder / "rig.toml")

    def diagnosed(effect):
        rng, to = np.random.default_rng(5), folder / f"{effect.name}"
        recording_simulation.write_recording(
            recording_simulation.simulate_world(
                random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, (effect,)),
                plan.build_plan(design, PLAN, 5),
                rng,
            ),
            to,
            text,
            rng,
            0.04,
        )
        return diagnosis_of(recording_folder.load_recording(to))

    return diagnosed


@pytest.mark.slow
@pytest.mark.parametrize(
    "effect, depends, looked_at",
    [
        (
            unlisted_effects_and_corner_noise.SlippingClutch("strut 2", 1.5e-5),
            "way travelled",
            "own way",
        ),  # nearly a warm-up, by which struts would become shorter
        (
            unlisted_effects_and_corner_noise.Crosstalk("strut 6", 3, -6e-4, 0.05),
            "strut 3's position",
            "travel of strut 3",
        ),  # nearly a straight line
    ],
)
def test_a_curve_that_outdoes_a_law_leaves_no_name(seen, effect, depends, looked_at):
    found = seen(effect)
    assert found.effects == () and (found.left[0].place, found.left[0].depends_on) == (effect.site, (depends,))
    (suggested,) = found.suggestions
    assert suggested.place == effect.place and [q.name for q in suggested.written.quantities] == [looked_at]


@pytest.mark.slow
def test_a_law_that_holds_keeps_its_name(seen):
    (finding,) = seen(parse_effect("axis_coupling:strut 6:scale=-9e-4,other=3")).selection.findings
    assert (finding.score.candidate.name, finding.score.candidate.place) == ("axis_coupling", "strut 6")


@pytest.mark.slow
def test_a_focal_length_that_comes_and_goes_is_seen_beside_a_mount_that_stands(tmp_path, design):
    """A mount's six motions and a focal length are asked apart: seven times as many numbers hid what one of them
    does.
    """
    course = tuple(value for k in range(4) for value in (6.5e-6, (3 + k) / 700, 1.0 + k))
    problem = PlatformProblem(
        operating_point_source_and_measurement(
            recorded(tmp_path, design, [unlisted_effects_and_corner_noise.BreathingLens("camera cam1", course)])
        )[0],
        [],
    )
    left = problem.lack_of_fit(problem.residual(problem.start()))
    assert left and {(u.place, u.depends_on) for u in left} == {(Place("camera", "cam1"), ("time",))}


def test_first_functions_count_by_themselves():
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(200, 4)) * [1, 1e3, 1e-3, 1]
    columns[:, 3] = columns[:, 0] - 2 * columns[:, 2]  # which says nothing anew
    y = 3 * columns[:, 0] + rng.normal(size=200)
    G = columns.T @ columns
    found = delta_chi2_and_rank_by_column_count(Normal((columns.T @ y)[None], G[None], np.diag(G)[None]))
    for q, (delta, rank) in enumerate(found, 1):
        alone = solve_normal_equations(Normal((columns.T @ y)[None, :q], G[None, :q, :q], np.diag(G)[None, :q]))
        assert delta == pytest.approx(float(alone.delta_chi2[0])) and rank == alone.rank[0] == min(q, 3)
    whole = LackOfFit(Place("strut", "1"), 1e-6, "m", ("time",), 0.0, found[-1][0] / 2, 3, 2.0, found)
    assert whole.shortest(200) == (found[0][0], pytest.approx(np.log(200))) and whole.evidence(200) == pytest.approx(
        found[0][0] - np.log(200)
    )
    assert whole.delta_bic(200) == pytest.approx(found[-1][0] / 2 - 3 * np.log(200))
