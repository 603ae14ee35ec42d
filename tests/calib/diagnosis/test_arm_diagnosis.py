"""What an arm leaves out: hidden at its joints, found there; where nothing is hidden, nothing is found."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.api.diagnose import diagnose
from calib.diagnosis.engine.forward_and_backward_term_selection import select_terms
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.arm_recording_evidence import ArmEvidence
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    joint_candidates_and_untested_effects,
)
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import (
    Geometry,
    linearised_arm_poses_and_geometry,
)
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.recording_diagnosis import diagnose_evidence
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.cli import command_line
from rig.effects.framework.machine_motion_and_play import play_operator
from rig.errors import NotEnoughData
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics
from rig.recording import recording_folder as recordings
from tests.calib import secret_arms
from tests.rig.arms import UR10
from tests.truth.case import draw
from tests.truth.written import record

GRAVITY = np.array([0, 0, -9.80665])
STIFFNESS = 2e5  # N m/rad
GAP = 6e-4  # rad
SCALE = 5e-4
RIGHT = np.pi / 2
INDUSTRIAL = np.array(
    [
        [0, 0.615, 0.1, -RIGHT],
        [-RIGHT, 0, 0.705, 0],
        [0, 0, 0.135, -RIGHT],
        [0, 0.755, 0, RIGHT],
        [0, 0, 0, -RIGHT],
        [0, 0.085, 0, 0],
    ]
)
TRAVEL = np.array(
    [[-6.2, 6.2], [-2.25, 2.75], [-2.0, 2.0], [-6.8, 6.8], [-4.0, 4.0], [-9.0, 9.0]]
)  # rad, of which half is visited
STANDING = replace(UR10, base=secret_arms.BASE)  # it leans, and so does its weight
LINKS = arm_dynamics_and_step_by_step_kinematics.LinkMasses(
    np.array([8.0, 12.0, 6.0, 2.0, 1.0, 0.5]), np.tile([-0.05, 0.02, 0.06], (6, 1)), np.zeros((6, 3, 3))
)


def recorded(deviation, count=260, seed=5):
    """(Arms, Identified) of an arm whose joints do deviation(q) beyond their command."""
    rng = np.random.default_rng(seed)
    true = secret_arms.secret(UR10, rng)
    samples = secret_arms.tracked(true, UR10, count, rng, deviation=deviation)
    return linearised_arm_poses_and_geometry(samples, secret_arms.design(UR10)), true


def hidden(q):
    """Compliance of joint 2, a profile of joint 1, backlash of joint 3."""
    out = np.zeros(q.shape)
    out[:, 0] = (
        2e-4 * np.sin(5 * q[:, 0])
        + 1.5e-4 * np.cos(11 * q[:, 0])
        + 1.2e-4 * np.sin(8 * q[:, 0] + 1)
        + 1e-4 * np.sin(2 * q[:, 0])
    )
    torque = arm_dynamics_and_step_by_step_kinematics.joint_torques(
        q, np.zeros(q.shape), np.zeros(q.shape), STANDING, LINKS, GRAVITY
    )
    out[:, 1] = -torque[:, 1] / STIFFNESS
    out[:, 2] = (play_operator(q, GAP / 2) - q)[:, 2]
    return out


@pytest.fixture(scope="module")
def found():
    (arms, _), _ = recorded(hidden)
    candidates, _ = joint_candidates_and_untested_effects(arms, RequestedEffects())
    problem = ArmProblem(arms, candidates)
    return problem, select_terms(problem)


def test_hidden_effects_are_found_at_their_joints(found):
    names = {(t.candidate.name, t.candidate.place) for t in found[1].fit.terms}
    assert ("compliance", "joint 2") in names and ("backlash", "joint 3") in names
    assert {place for name, place in names if name in ("transmission_error", "cyclic_error")} == {"joint 1"}
    assert {place for _, place in names} == {"joint 1", "joint 2", "joint 3"}


@pytest.mark.slow
def test_sizes_are_those_that_were_hidden(found):
    problem, chosen = found
    geometry = Geometry(UR10, np.zeros((0, 0)), lambda step: UR10)
    evidence = ArmEvidence(lambda gone: (problem.arms, geometry), "poses.csv", stretches=(30,))
    d = diagnose_evidence(evidence, "arm")
    assert [f.number for f in d.findings] == [f.number for f in chosen.findings]
    by_name = {f.effect: f for f in diagnosis_report(d).findings}
    gap = by_name["backlash"].parameters["gap"]
    assert gap.ci95[0] <= GAP <= gap.ci95[1] and gap.ci95[1] - gap.ci95[0] < 0.3 * GAP
    load = hidden(problem.arms.q)[:, 1]
    assert by_name["compliance"].parameters["rms"].value == pytest.approx(load.std(), rel=0.15)
    assert "joint" in by_name["backlash"].action and all(f.matters for f in by_name.values())
    json.dumps(diagnosis_report(d).tree())


def giving_way(q):
    """Compliance at joints 2 and 3 of a heavy arm, and a gear of joint 3 that turns too far."""
    heavy = replace(LINKS, mass=np.array([70.0, 45.0, 55.0, 12.0, 8.0, 2.0]))
    standing = replace(STANDING, joints=INDUSTRIAL, limits=TRAVEL)
    still = np.zeros(q.shape)
    torque = arm_dynamics_and_step_by_step_kinematics.joint_torques(q, still, still, standing, heavy, GRAVITY)
    out = np.zeros(q.shape)
    out[:, 1:3] = -torque[:, 1:3] / 1e6
    out[:, 2] += SCALE * q[:, 2]
    return out


@pytest.mark.slow
def test_what_a_heavy_arm_and_a_gear_do_shows_at_one_reflector():
    """A joint's load takes few numbers, so that compliance of both joints and a scale are found apart, each as large
    as it is."""
    rng = np.random.default_rng(4)
    stated = replace(UR10, joints=INDUSTRIAL, limits=TRAVEL)
    true = secret_arms.secret(stated, rng)
    samples = secret_arms.tracked(true, stated, 200, rng, sigma=(5e-5, 1e-4), deviation=giving_way)
    covariance = samples.covariance.copy()
    covariance[:, range(3, 6), range(3, 6)] = np.inf  # a reflector has no rotation
    arms, _ = linearised_arm_poses_and_geometry(replace(samples, covariance=covariance), secret_arms.design(stated))
    fit = select_terms(ArmProblem(arms, joint_candidates_and_untested_effects(arms, RequestedEffects())[0])).fit
    terms = {(t.candidate.name, t.candidate.place): n for n, t in enumerate(fit.terms)}
    assert set(terms) == {("compliance", "joint 2"), ("compliance", "joint 3"), ("scale_error", "joint 3")}
    number, load = terms["scale_error", "joint 3"], giving_way(arms.q)
    (scale,), sigma = fit.theta[fit.slices[number]], float(np.sqrt(fit.covariance(number)[0, 0]))
    assert abs(scale - SCALE) < 3 * sigma < 0.6 * SCALE
    load[:, 2] -= SCALE * arms.q[:, 2]
    for joint in (1, 2):
        found = fit.part(terms["compliance", f"joint {joint + 1}"])
        assert found.std() == pytest.approx(load[:, joint].std(), rel=0.3)


def test_nothing_hidden_nothing_found():
    for seed in (1, 2):
        (arms, _), _ = recorded(None, 200, seed)
        assert (
            select_terms(ArmProblem(arms, joint_candidates_and_untested_effects(arms, RequestedEffects())[0])).fit.terms
            == ()
        )


def test_few_poses_are_an_error():
    with pytest.raises(NotEnoughData, match="too few to diagnose an arm or a chain: minimum 20 for 30 numbers"):
        recorded(None, 19)


@pytest.mark.slow
def test_few_poses_are_asked_what_they_bear():
    """25 poses bear three numbers of an effect; what has more is stated with the poses that it takes; 60 bear all."""
    few, many = (
        joint_candidates_and_untested_effects(recorded(None, count)[0][0], RequestedEffects()) for count in (25, 60)
    )
    reasons = {one.effect: one.reason for one in few[1]}
    numbers = [len(one.prior(node)) + one.extra for one in few[0] for node in one.grid]
    assert max(numbers) == 3 and {"scale_error", "backlash", "cyclic_error", "hysteresis"} <= {c.name for c in few[0]}
    for name in ("compliance", "hysteresis"):
        assert reasons[name].startswith("25 poses bear 3 numbers of an effect; forms of more than 3 numbers are not")
        assert 30 < int(reasons[name].split("record ")[1].split()[0]) < 60
    assert "so few poses as 25" in reasons["transmission_error"]
    assert {"compliance", "transmission_error"} <= {c.name for c in many[0]}
    assert not any("poses bear" in one.reason or "so few poses" in one.reason for one in many[1])


@pytest.mark.slow
def test_a_large_backlash_shows_in_25_poses_and_nothing_in_quiet_ones():
    """A play of several times the noise is found from 25 poses, at its joint; without it nothing is."""
    for seed in range(2):
        (arms, _), _ = recorded(None, 25, seed)
        assert (
            select_terms(ArmProblem(arms, joint_candidates_and_untested_effects(arms, RequestedEffects())[0])).fit.terms
            == ()
        )
    third = np.arange(6) == 2
    (arms, _), _ = recorded(lambda q: third * (play_operator(q, 3 * GAP / 2) - q), 25, 0)
    found = select_terms(ArmProblem(arms, joint_candidates_and_untested_effects(arms, RequestedEffects())[0])).fit.terms
    assert [(term.candidate.name, term.candidate.place) for term in found] == [("backlash", "joint 3")]


@pytest.mark.slow
def test_forty_quiet_recordings_of_25_poses_stay_quiet(tmp_path):
    """Arms of an independent truth, without a fault: nothing is named and nothing is unexplained."""
    for seed in range(40):
        case = draw(seed, "none", "none", kind="arm", count=25)
        report = diagnose(recordings.load_recording(record(case, tmp_path / str(seed)))).report
        assert not report.findings and report.unexplained is None, seed


@pytest.mark.slow
def test_command_line_writes_diagnosis_and_page(tmp_path, capsys):
    rng = np.random.default_rng(3)
    true = secret_arms.secret(UR10, rng)
    samples = secret_arms.tracked(true, UR10, 150, rng, deviation=lambda q: 3e-3 * q * (np.arange(6) == 3))
    secret_arms.write(tmp_path / "rec", UR10, samples)
    assert (
        command_line.main(
            [
                "diagnose",
                str(tmp_path / "rec"),
                "--out",
                str(tmp_path / "out"),
                "--only",
                "scale_error",
                "--only",
                "creep",
            ]
        )
        == 0
    )
    tree = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    first = tree["findings"][0]
    low, high = first["parameters"]["scale"]["ci95"]
    assert (first["effect"], first["place"]) == ("scale_error", "joint 4") and low < 3e-3 < high
    assert tree["fit"]["heldout_after"] < 0.5 * tree["fit"]["heldout_before"]
    page = (tmp_path / "out" / "diagnosis.html").read_text()
    assert "Scale error at joint 4" in page and "Findings that affect individual poses" in page
    table = np.genfromtxt(tmp_path / "out" / "contributions.csv", delimiter=",", names=True)
    lever = np.linalg.norm(
        secret_arms.arm_error_model_and_instrument_observations.joint_jacobian(samples.commanded, true)[:, :3, 3],
        axis=1,
    )
    q = samples.commanded[:, 3]
    assert np.corrcoef(table["scale_error_joint_4"], 3e-3 * np.abs(q - 0.0) * lever)[0, 1] > 0.99
    assert table["what_remains"].mean() < 1e-4 < table["scale_error_joint_4"].mean()
    regions = tree["held_out_by_region"]
    assert [r["joint"] for r in regions] == [1, 2, 3, 4, 5, 6] and all(
        r["findings"][0]["gain_sigma"] > 2 for r in regions
    )
    assert "scale_error at joint 4" in capsys.readouterr().out


def test_a_joint_that_gives_way_to_a_stated_load_is_told_by_its_stiffness(tmp_path):
    rig, rec, out = (str(tmp_path / name) for name in ("rig.toml", "rec", "out"))
    assert command_line.main(["design", "--mechanism", "arm", "--arm", "ur10", "--out", rig]) == 0
    (tmp_path / "rig.toml").write_text(
        (tmp_path / "rig.toml").read_text() + "\n[platform]\nmass = 8.0\ncentre_of_mass = [0.05, 0.0, 0.1]\n"
    )
    assert (
        command_line.main(
            [
                "simulate",
                rig,
                "--plan",
                "sobol:80",
                "--effect",
                "compliance:joint2:stiffness=2e5",
                "--seed",
                "3",
                "--out",
                rec,
            ]
        )
        == 0
    )
    assert command_line.main(["diagnose", rec, "--only", "compliance joint 2", "--out", out]) == 0
    stiffness = json.loads((tmp_path / "out" / "diagnosis.json").read_text())["findings"][0]["parameters"]["stiffness"]
    low, high = stiffness["ci95"]
    assert low < 2e5 < high < 1.2 * low and low < stiffness["value"] < high


@pytest.mark.slow
def test_what_was_found_is_drawn_anew_and_found_again(tmp_path, capsys):
    rng = np.random.default_rng(3)
    true = secret_arms.secret(UR10, rng)
    samples = secret_arms.tracked(true, UR10, 150, rng, deviation=lambda q: 3e-3 * q * (np.arange(6) == 3))
    secret_arms.write(tmp_path / "rec", UR10, samples)
    ask = ["--only", "scale_error"]
    assert command_line.main(["diagnose", str(tmp_path / "rec"), "--out", str(tmp_path / "out"), *ask]) == 0
    assert command_line.main(["simulate", "--from", str(tmp_path / "out"), "--out", str(tmp_path / "both")]) == 0
    drawn = {
        kind: recordings.load_recording(tmp_path / "both" / kind).poses.T_base_platform for kind in ("with", "without")
    }
    apart = {
        kind: np.linalg.norm(T.translation - samples.T_base_platform.translation, axis=1).mean()
        for kind, T in drawn.items()
    }
    assert apart["with"] < 4 * 2e-5 < 5e-4 < apart["without"]
    for kind, count in (("with", 1), ("without", 0)):
        assert command_line.main(["diagnose", str(tmp_path / "both" / kind), "--out", str(tmp_path / kind), *ask]) == 0
        found = json.loads((tmp_path / kind / "diagnosis.json").read_text())["findings"]
        assert [f["place"] for f in found if f["effect"] == "scale_error"] == ["joint 4"] * count
    (tmp_path / "out" / "machine.json").write_text("{}")
    assert command_line.main(["simulate", "--from", str(tmp_path / "out"), "--out", str(tmp_path / "again")]) == 1
    assert "machine.json" in capsys.readouterr().err


@pytest.mark.slow
def test_a_real_arms_gears_are_found_and_what_was_not_asked_stays_unknown(shared, tmp_path):
    assert (
        command_line.main(
            [
                "diagnose",
                str(shared / "recordings/arm-1"),
                "--out",
                str(tmp_path / "out"),
                "--only",
                "transmission_error",
            ]
        )
        == 0
    )
    tree = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    named = {f["place"] for f in tree["findings"] if f["effect"] == "transmission_error"}
    assert named == {f"joint {j}" for j in range(1, 7)} and {f["effect"] for f in tree["findings"]} == {
        "transmission_error",
        "unknown",
    }
    assert {"joint 2", "joint 3"} <= {
        f["place"] for f in tree["findings"] if f["effect"] == "unknown"
    }  # what carries the arm's weight
    for held in tree["held_out"]:
        assert held["after"]["mean_m"] < 0.2e-3 < 0.38e-3 < held["before"]["mean_m"]
    assert (
        250 < tree["repeats"]["pairs"] < 300
        and 2e-5 < tree["fit"]["noise_floor"] < 4e-5
        and len(tree["set_aside"]) < 10
    )
