"""One diagnosis of every machine: a core that every problem answers, capabilities that some have, nothing dropped in
silence.
"""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine import problem_interface as interface
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import ARM
from calib.diagnosis.engine.forward_and_backward_term_selection import select_terms
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.finding_parameter_optimisation_and_intervals import (
    _under,
    term_errors_by_temperature_logs,
)
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    NO_CORNERS,
    POSES_ALONE,
    joint_candidates_and_untested_effects,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import Term, fit_terms_to_poses
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    FEWEST,
    repeatability_of_pairs,
    row_pairs_with_same_command,
)
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    platform_candidates_and_untested_effects,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.platform_problem import PlatformProblem
from calib.diagnosis.recording_diagnosis import DiagnosisOptions, diagnose
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.effects.catalogue.effect_list import ALL
from rig.recording.recording_folder import Sensors
from tests.calib.diagnose_recording import page_text
from tests.calib.diagnosis.test_arm_diagnosis import recorded as arm_recorded
from tests.calib.recordings_with_effects import recorded

CAPABILITIES = (
    interface.AdmissionRules,
    interface.Tolerances,
    interface.SmoothCover,
    interface.AlternativeScreening,
    interface.AliasedNodes,
    interface.Companions,
    interface.TermRefinement,
    interface.TermSimplification,
)
CORE = [name for name, _ in inspect.getmembers(interface.Problem) if not name.startswith("_")]


class CoreAlone:
    """A problem of which nothing but the core is left."""

    def __init__(self, problem):
        for name in CORE:
            setattr(self, name, getattr(problem, name))


def of(kind):
    return {capability.__name__ for capability in CAPABILITIES if issubclass(kind, capability)}


def test_a_problem_has_the_capabilities_that_mean_something_for_it():
    assert of(PlatformProblem) == {"AdmissionRules", "Tolerances", "SmoothCover", "AlternativeScreening"}
    assert of(ArmProblem) == {"AdmissionRules", "AliasedNodes", "Companions", "TermRefinement", "TermSimplification"}
    assert all(hasattr(kind, name) or name in kind.__slots__ for kind in (PlatformProblem, ArmProblem) for name in CORE)


def test_the_core_is_all_that_a_search_takes(tmp_path, design):
    rec = recorded(tmp_path, design, ["backlash:strut2:gap=1.2e-4"], 11, "sobol:40,ladder:1", 0.03)
    point = operating_point_source_and_measurement(rec)[0]
    problem = PlatformProblem(
        point, platform_candidates_and_untested_effects(point, RequestedEffects(("backlash", "scale_error")))[0]
    )
    core = CoreAlone(problem)
    assert not any(isinstance(core, capability) for capability in CAPABILITIES)
    labels = []
    found = select_terms(core, lambda label, done, of: labels.append(label))
    assert labels[0] == "searching" and "so far backlash at strut 2, not yet confirmed; searching on" in labels
    assert [(f.score.candidate.name, f.score.candidate.place) for f in found.findings] == [("backlash", "strut 2")]
    core.policy = ARM
    with pytest.raises(ValueError, match="companions"):
        select_terms(core)


@pytest.mark.parametrize("cameras, reason", [(False, NO_CORNERS), (True, POSES_ALONE)])
def test_what_an_arm_cannot_be_asked_is_listed_with_why(design, cameras, reason):
    (arms, _), _ = arm_recorded(None, 60)
    own = replace(arms.context.design, cameras=design.cameras if cameras else ())
    arms = replace(arms, context=replace(arms.context, design=own))
    candidates, not_tested = joint_candidates_and_untested_effects(arms, RequestedEffects())
    unseen = {kind.name for kind in ALL if kind.discrete or kind.stage in ("targets", "view")}
    assert len(unseen) >= 11 and {s.effect for s in not_tested if s.reason == reason} == unseen
    assert {c.name for c in candidates} | {s.effect for s in not_tested} == {kind.name for kind in ALL}
    _, not_tested = joint_candidates_and_untested_effects(arms, RequestedEffects(("edge_bias",)))
    assert [(s.effect, s.reason) for s in not_tested] == [("edge_bias", reason)]


@pytest.mark.slow
def test_regions_and_repeats_are_of_every_machine(tmp_path, design):
    rec = recorded(tmp_path, design, ["backlash:strut2:gap=1.2e-4"], 11, "repeat:5,ladder:1,sobol:30", 0.03)
    found = diagnose(rec, DiagnosisOptions(only=("backlash",)))
    tree = diagnosis_report(found).tree()
    assert [row["place"] for row in tree["held_out_by_region"]] == [f"strut {i + 1}" for i in range(6)]
    gains = [row["findings"][0]["gain_sigma"] for row in tree["held_out_by_region"]]
    assert len(found.findings) == 1 and min(gains) > 2 and found.regions[0][0].unit == "m"
    assert tree["repeats"]["pairs"] >= FEWEST and 0 < tree["repeats"]["mean_m"] < 2e-4
    text = page_text(tmp_path / "page.html", rec, found)
    assert "Gain of each finding on held-out frames" in text and "repeatability of the same command" in text


def test_repeats_tell_noise_from_what_comes_again():
    rng = np.random.default_rng(0)
    commands = np.repeat(rng.uniform(size=(60, 3)), 2, axis=0)
    pairs = row_pairs_with_same_command(commands, ("m", "m", "rad"))
    assert pairs.tolist() == [[2 * i, 2 * i + 1] for i in range(60)]
    noise, repeated = 1e-5 * rng.normal(size=(120, 6)), np.repeat(3e-5 * rng.normal(size=(60, 3)), 2, axis=0)
    one, two = noise[::2], noise[1::2]
    alone = repeatability_of_pairs(pairs, (one, two), (one[:, :3], two[:, :3]))
    both = repeatability_of_pairs(pairs, (one, two), (one[:, :3] + repeated[::2], two[:, :3] + repeated[1::2]))
    assert alone.rms == pytest.approx(np.sqrt(3) * 1e-5, rel=0.1) and alone.rms == both.rms and alone.p_value > 1e-3
    assert both.recurring_share == pytest.approx(0.9, abs=0.05) and both.p_value < 1e-6
    assert repeatability_of_pairs(pairs[: FEWEST - 1], (one, two), (one, two)) is None


def test_thermometers_errors_leave_an_arms_sizes_open():
    (arms, _), _ = arm_recorded(None, 80)
    t = np.linspace(arms.t[0] - 1, arms.t[-1] + 1, 40)
    channel = "ambient_temperature_C"
    sensors = Sensors(t, {channel: 20 + 10 * np.sin(t / np.ptp(t) * 3)})
    warm = _under(arms, sensors)
    candidate, _ = [
        c
        for c in joint_candidates_and_untested_effects(warm, RequestedEffects(("thermal_expansion",)))[0]
        if c.place == "rig"
    ]
    term = Term.at(candidate, candidate.grid[0])
    size = 1e-5 * np.ones(term.weights.shape[2])
    shown = warm.directions(candidate.joint) @ (term.weights @ size)[..., None]
    warm = replace(warm, left=warm.left + shown[..., 0])
    fit = fit_terms_to_poses(warm, [term])
    error = 0.02 * np.cos(t / np.ptp(t) * 5)[:, None]
    off = term_errors_by_temperature_logs(fit, 0, {channel: error})
    other = _under(warm, Sensors(t, {channel: sensors.channels[channel] + error[:, 0]}))
    moved, _ = [
        c
        for c in joint_candidates_and_untested_effects(other, RequestedEffects(("thermal_expansion",)))[0]
        if c.place == "rig"
    ]
    change = (fit_terms_to_poses(other, [Term.at(moved, moved.grid[0])]).theta - fit.theta)[fit.slices[0]]
    assert off.shape == (len(size), 1) and np.abs(off).max() > 0
    np.testing.assert_allclose(np.abs(off[:, 0]), np.abs(change), rtol=0.1)
    assert term_errors_by_temperature_logs(fit, 0, {}).shape == (len(size), 0)
