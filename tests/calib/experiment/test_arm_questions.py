"""Arms: what a plan's poses would be under each name is what the geometry and the machine say, and an investigation
ends with the right one.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.api.next_experiment import evaluate_experiment
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import joint_candidate
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import linearise_planned_poses
from calib.experiment.arm_diagnosis_questions_and_predicted_recording import open_questions_of_arm_diagnosis
from rig.cli.command_line import main
from rig.effects.catalogue.time_offset import TimeOffset
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.pose import pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.planning.layout import shipped_arms_and_layouts
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib.diagnose_recording import diagnosis_of
from tests.closed_loops import simulate_with_truth

FRICTION, PLAY = "hysteresis:joint 2:range=0.5,weight=0.001", "backlash:joint 2:gap=2e-4"


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """(Recording of a SCARA whose second joint sticks, its Diagnosis)."""
    at = tmp_path_factory.mktemp("scara")
    (at / "rig.toml").write_text(shipped_arms_and_layouts.shipped_arm_rig_toml("scara"))
    design, rng = design_from_rig_toml.load_design(at / "rig.toml"), np.random.default_rng(3)
    strokes = plan.axis_strokes(design)
    straight = plan.plan_of_configurations(
        configuration_generators.sobol_configurations(strokes, 60, seed=871346366),
        strokes.mean(axis=1),
        plan.planned_axis_speeds(design),
    )
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, (parse_effect(FRICTION),)),
        straight,
        rng,
    )
    recording_simulation.write_recording(done, at / "rec", shipped_arms_and_layouts.shipped_arm_rig_toml("scara"), rng)
    read = recording_folder.load_recording(at / "rec")
    return read, diagnosis_of(read)


@pytest.mark.slow
def test_a_plan_that_was_made_is_told_as_it_was_seen(found):
    """The first recording's own plan, told as one that is not there yet: the same freedoms and joints, and what effects
    move is the same.
    """
    read, d = found
    linearised = linearise_planned_poses(
        d.selection.fit.arms,
        d.selection.problem.geometry,
        read.commands,
        d.selection.fit.arms.t,
        d.selection.fit.arms.context.sensors,
    )
    np.testing.assert_allclose(linearised.q, d.selection.fit.arms.q)
    np.testing.assert_allclose(linearised.joints, d.selection.fit.arms.joints, atol=1e-12)
    np.testing.assert_allclose(linearised.freedoms, d.selection.fit.arms.freedoms, atol=1e-12)
    np.testing.assert_allclose(linearised.context.moved().lengths, d.selection.fit.arms.context.moved().lengths)


def test_places_of_earlier_recordings_move_no_planned_pose(found):
    """Base and tool of a second recording are fitted as freedoms of its own, which a plan's poses do not have."""
    read, d = found
    arms = d.selection.fit.arms
    placed = replace(arms, freedoms=np.concatenate([arms.freedoms, np.ones((*arms.left.shape, 12))], axis=2))
    planned = linearise_planned_poses(placed, d.selection.problem.geometry, read.commands, arms.t, None)
    assert planned.freedoms.shape == placed.freedoms.shape
    assert planned.freedoms[..., :-12].any() and not planned.freedoms[..., -12:].any()


def test_what_names_foretell_differs_as_the_machine_does(found):
    read, d = found
    (question,) = open_questions_of_arm_diagnosis(d)
    assert {h.title for h in question.hypotheses} == {
        "backlash at joint 2",
        "hysteresis at joint 2",
        "something in no catalogue",
    }
    assert sum(h.odds for h in question.hypotheses) == pytest.approx(1)
    route = plan.build_plan(read.design, "zigzag:16", 1)
    outcomes = question.predict_outcomes(route)
    each = question.predicted_outcomes_of_two_likeliest_hypotheses(route)
    first, other = (next(k for k, h in enumerate(question.named) if h is one) for one in question.likeliest)
    assert each.of.sum() == pytest.approx(np.sum((outcomes.means[other] - outcomes.means[first]) ** 2), rel=1e-6)

    design, sigma = (
        d.selection.fit.arms.context.design,
        np.sqrt(np.diag(d.selection.fit.arms.own[0]) + d.selection.fit.scatter**2),
    )
    effects = [
        h.fitted.fit.terms[h.number].candidate.effect(
            h.fitted.fit.terms[h.number].node, h.fitted.fit.theta[h.fitted.fit.slices[h.number]]
        )
        for h in (question.named[first], question.named[other])
    ]
    runs = [
        motion_simulation.simulate_machine_run(design, route.commands, route.t, (effect,), None).T_base_platform
        for effect in effects
    ]
    apart = float(np.sum((pose_difference(*runs) / sigma) ** 2))  # the geometry's own change is small beside it
    assert each.of.sum() == pytest.approx(apart, rel=0.3)


def test_a_clocks_offset_moves_an_arm_as_the_machine_has_it(found):
    """As one hypothesis of all joints: while it moved none, each joint got a lag of its own."""
    read, d = found
    route = plan.build_plan(read.design, "zigzag:16", 1)
    linearised = linearise_planned_poses(
        d.selection.fit.arms, d.selection.problem.geometry, route.commands, route.t, None
    )
    candidate = joint_candidate((TimeOffset.candidates("clock", linearised.context)[0],), linearised)
    assert candidate.joint is None and candidate.grid[0] == {}
    moved = 1e-3 * candidate.weights(candidate.grid[0])[..., 0]
    runs = [
        motion_simulation.simulate_machine_run(
            linearised.context.design, route.commands, route.t, effects, None
        ).T_base_platform
        for effects in ((), (TimeOffset("clock", 1e-3),))
    ]
    expected = pose_difference(*runs)
    assert np.abs(expected[:, :3]).max() > 1e-4
    np.testing.assert_allclose(moved, expected, atol=0.02 * np.abs(expected).max())


def test_what_turns_round_tells_play_from_friction_and_so_does_a_plan_of_balanced_approaches(found):
    """The recording went straight from one configuration to the next, in a Sobol sequence's own order, and left both
    names open.
    """
    read, d = found
    questions = open_questions_of_arm_diagnosis(d)
    turning, standing = (evaluate_experiment(questions, read.design, text, 1) for text in ("zigzag:16", "sobol:12"))
    assert min(turning.settles, standing.settles) > 0.9 and min(turning.bits, standing.bits) > 0.5


def test_what_of_arms_cannot_be_investigated_is_refused(tmp_path, capsys):
    text = shipped_arms_and_layouts.shipped_arm_rig_toml("puma560")
    (tmp_path / "rig.toml").write_text(text[: text.index("[instrument]")])
    assert main(["investigate", str(tmp_path / "rig.toml"), "--by-hand", "--out", str(tmp_path / "out")]) == 1
    assert "requires an [instrument] that measures its poses" in capsys.readouterr().err
    (tmp_path / "rig.toml").write_text(text)
    assert (
        main(["simulate", str(tmp_path / "rig.toml"), "--plan", "turn:P1,sobol:3", "--out", str(tmp_path / "rec")]) == 1
    )
    assert "there is no cube 'P1'; there are none" in capsys.readouterr().err
    assert not (tmp_path / "out").exists() and not (tmp_path / "rec" / "rig.toml").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "name"), [(FRICTION, "hysteresis"), (PLAY, "backlash")])
def test_play_is_told_from_friction_by_one_experiment(tmp_path, capsys, effect, name):
    rig, truth, out = tmp_path / "rig.toml", tmp_path / "truth.json", tmp_path / "out"
    rig.write_text(shipped_arms_and_layouts.shipped_arm_rig_toml("scara"))
    simulate_with_truth(tmp_path, "sobol:3", 3, "--effect", effect)
    assert (
        main(
            [
                "investigate",
                str(rig),
                "--machine",
                str(truth),
                "--out",
                str(out),
                "--plan",
                "sobol:60",
                "--budget",
                "1h",
            ]
        )
        == 0
    )
    notebook = (out / "notebook.md").read_text()
    assert "ambiguous:" in notebook and "settled: yes" in notebook and f"alone: {name} at joint 2" in notebook
    (finding,) = json.loads((out / "diagnosis2" / "diagnosis.json").read_text())["findings"]
    assert (finding["effect"], finding["place"], finding["cannot_be_told_from"]) == (name, "joint 2", [])
    assert not (out / "rec3").exists() and (out / "certificate" / "certificate.json").exists()
    assert f"calibration.json: of 2 recordings, with {name} at joint 2" in notebook
    (undone,) = json.loads((out / "calibration.json").read_text())["physics"]["effects"]
    assert undone["effect"] == name


@pytest.mark.slow
def test_an_arm_whose_second_recording_gets_places_of_its_own_is_investigated_to_the_end(tmp_path, capsys):
    """Its second recording leaves both names open, and has base and tool fitted with it."""
    rig, truth, out = tmp_path / "rig.toml", tmp_path / "truth.json", tmp_path / "out"
    rig.write_text(shipped_arms_and_layouts.shipped_arm_rig_toml("ur10"))
    simulate_with_truth(tmp_path, "sobol:3", 3, "--effect", PLAY)
    words = ["investigate", str(rig), "--machine", str(truth), "--out", str(out), "--verify", "12"]
    assert main(words) == 0
    notebook = (out / "notebook.md").read_text()
    assert "Nothing is ambiguous any more." in notebook and "alone: backlash at joint 2" in notebook
    assert (out / "rec3").exists() and "this place is fitted with it" in capsys.readouterr().out


@pytest.mark.slow
def test_a_quiet_arm_is_left_in_peace(tmp_path, capsys):
    rig, truth, out = tmp_path / "rig.toml", tmp_path / "truth.json", tmp_path / "out"
    rig.write_text(shipped_arms_and_layouts.shipped_arm_rig_toml("scara"))
    simulate_with_truth(tmp_path, "sobol:3", 8)
    assert main(["investigate", str(rig), "--machine", str(truth), "--out", str(out), "--budget", "1h"]) == 0
    assert "Nothing is unmodelled." in (out / "notebook.md").read_text() and not (out / "rec2").exists()


@pytest.mark.slow
def test_what_a_camera_in_the_hand_leaves_alike_is_told_apart(tmp_path, capsys):
    """Poses from images: what the experiment would tell is foretold from what the camera would see, and both recordings
    are measured together.
    """
    rig, truth, out = tmp_path / "rig.toml", tmp_path / "truth.json", tmp_path / "out"
    assert main(["design", "--arm", "ur10", "--seen", "hand", "--cameras", "1", "--out", str(rig)]) == 0
    simulate_with_truth(tmp_path, "sobol:3", 3, "--effect", "backlash:joint 2:gap=2e-4")
    assert (
        main(
            [
                "investigate",
                str(rig),
                "--machine",
                str(truth),
                "--out",
                str(out),
                "--plan",
                "sobol:80",
                "--budget",
                "1h",
            ]
        )
        == 0
    )
    notebook = (out / "notebook.md").read_text()
    assert "ambiguous:" in notebook and "settled: yes" in notebook and "alone: backlash at joint 2" in notebook
    assert (
        "calibration.json: of 2 recordings, with backlash at joint 2" in notebook
        and (out / "certificate" / "certificate.json").exists()
    )
