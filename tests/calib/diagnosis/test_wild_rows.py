"""Wild rows are left out before anything is searched and listed with why; names do not depend on which of them an
operator masks by hand.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.platform_certification import certify_platform, platform_workspace_claim
from calib.diagnosis import recording_diagnosis
from calib.diagnosis.problems.arm import arm_recording_evidence
from calib.diagnosis.report.diagnosis_page import diagnosis_verdict
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from calib.identify.bounded_and_robust_least_squares_fit import (
    MOST,
    isolated_outlier_rows,
    robust_fit,
    rows_with_several_deviating_or_one_gross_number,
    tail_quantile_ratio_to_normal_within_gate,
)
from calib.models.arm.arm_certification import certify_arm as arm_certify
from calib.models.arm.joint_space_correction_and_workspace_claim import arm_workspace_claim as arm_promised
from calib.models.platform.platform_identification import Loops, identify_platform
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters
from rig.model.pose import exp
from rig.recording import frame_selection_and_content_hashes, recording_folder
from rig.report.verdict_refutations_and_result_display import State
from tests.calib import secret_arms
from tests.calib.diagnose_recording import diagnosis_of, page_text
from tests.calib.recordings_with_effects import recorded
from tests.calib.wild_rows import posed, spoilt_corners, spoilt_poses
from tests.rig.arms import SCARA, UR10
from tests.truth import draw, record
from tests.truth.wild import spoilt

HIDDEN = {
    "backlash:strut3:gap=6e-5": [("backlash", "strut 3")],
    "missed_steps:strut2:jump=8e-5,time=300": [("missed_steps", "strut 2")],
    "warm_up:strut2:amplitude=6e-5": [("warm_up", "strut 2")],
}


def names(found):
    return [(f.effect, f.place) for f in diagnosis_report(found).findings]


def masks(frames, rng, count):
    """So many draws of the frames, each in with even chance, as --mask takes them."""
    drawn = [frames[rng.random(len(frames)) < 0.5] for _ in range(count)]
    return [",".join(map(str, some)) for some in drawn if len(some)]


def test_a_robust_fit_shows_wild_rows_whole():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(120, 1, 12)), rng.normal(size=(120, 1))
    wild = rng.permutation(120)[:8]
    y[wild, 0] += rng.uniform(30, 3000, 8) * rng.choice([-1, 1], 8)
    found = robust_fit([(y + X @ np.full(12, 50.0), X)])
    assert set(np.flatnonzero(np.abs(found.relative[:, 0]) > 7)) == set(wild) and found.scale[0] == pytest.approx(
        1.0, rel=0.25
    )


@pytest.mark.parametrize("seed", [1, 8, 9])
def test_rows_in_a_wrong_unit_show_where_few_others_hold_their_place(seed):
    """Polynomials of degree 7 over fourteen places, three of them returned to, in each of six struts: what a wild row
    bends of the fit takes dozens of rounds to let go."""
    rng = np.random.default_rng(seed)
    places = np.concatenate([np.arange(14), rng.integers(0, 3, 32)])
    parts = []
    for _ in range(6):
        x = rng.permutation(14) / 7 - 1
        parts.append((rng.normal(size=(46, 1)), (x[:, None, None] ** np.arange(8))[places]))
    for residual, _ in parts:
        residual[[5, 9], 0] += rng.uniform(3e4, 6e5, 2)
    assert np.flatnonzero(np.abs(robust_fit(parts).relative).max(axis=1) > 7).tolist() == [5, 9]


def test_what_a_neighbour_shows_as_well_is_not_wild():
    rng = np.random.default_rng(1)
    t, q, left = np.arange(60.0), rng.uniform(size=(60, 3)), rng.normal(size=(60, 3))
    left[57:] += [40.0, 0.0, -20.0]  # from a moment near the end on
    left[[10, 30]] += [0.0, 25.0, 0.0]  # twice at nearly one configuration
    q[30] = q[10] + 1e-3
    left[20] += [15.0, 15.0, 0.0]
    assert np.flatnonzero(isolated_outlier_rows(left, t, q, 7.0)).tolist() == [20]


def test_where_a_tail_is_long_no_row_in_it_is_wild():
    """What is left out of a model leaves some rows far off; a wild one is off beyond all of them."""
    rng = np.random.default_rng(3)
    t, q, left = np.arange(200.0), rng.uniform(size=(200, 6)), rng.normal(size=(200, 6))
    assert tail_quantile_ratio_to_normal_within_gate(left, 7.0) == pytest.approx(1.0, abs=0.15)
    left[rng.permutation(200)[:50]] *= 3.5
    assert (
        tail_quantile_ratio_to_normal_within_gate(left, 7.0) > 1.8
        and np.abs(left).max() > 7
        and not isolated_outlier_rows(left, t, q, 7.0).any()
    )
    left[20] += 60.0
    assert np.flatnonzero(isolated_outlier_rows(left, t, q, 7.0)).tolist() == [20]


@pytest.mark.slow
def test_names_do_not_depend_on_which_wild_rows_are_masked(tmp_path, design):
    for number, (text, expected) in enumerate(list(HIDDEN.items())[:2]):
        rng = np.random.default_rng(number)
        bad, frames = spoilt_poses(posed(tmp_path / str(number), design, [text], number), rng)
        for mask in ["", *masks(frames, rng, 1)]:
            found = diagnosis_of(frame_selection_and_content_hashes.remove_frames(bad, mask) if mask else bad)
            assert names(found) == expected
            gone = {one.frame for one in found.outliers.left_out}
            assert gone <= set(frames.tolist()) and len(gone) + len(mask.split(",")) * bool(mask) >= len(frames) - 2


def test_rows_that_were_left_out_are_listed_with_why(tmp_path, design):
    rec = posed(tmp_path / "rec", design, [], 3)
    poses = rec.poses.T_base_platform.as_matrix()
    poses[50, 0, 3] += 1e-3
    bad = replace(rec, poses=replace(rec.poses, T_base_platform=type(rec.poses.T_base_platform).from_matrix(poses)))
    found = diagnosis_of(bad, ["backlash"])
    report = diagnosis_report(found)
    (entry,) = json.loads(json.dumps(report.tree()))["left_out"]
    assert (
        entry["frame"] == 50
        and entry["what"] == "pose"
        and entry["place"].startswith("strut ")
        and entry["unit"] == "m"
    )
    assert 1e-4 < entry["off"] < 1e-3 and entry["times"] > 20 and "agree with no other" in entry["reason"]
    page_text(tmp_path / "page.html", rec, found, report)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert (
        "Excluded before the search" in page
        and entry["reason"] in page
        and diagnosis_verdict(report).state is State.CHECK
    )


def test_a_pose_far_from_all_others_does_not_hide_itself(tmp_path, design):
    """At a pose of another length unit the struts lie as at no other: geometry may explain it alone."""
    rec = posed(tmp_path / "rec", design, [], 3)
    poses = rec.poses.T_base_platform.as_matrix()
    poses[44, :3, 3] *= 1e-3
    bad = replace(rec, poses=replace(rec.poses, T_base_platform=type(rec.poses.T_base_platform).from_matrix(poses)))
    found = diagnosis_of(bad, ["backlash"])
    assert [one.frame for one in found.outliers.left_out] == [44] and names(found) == [] and found.left == []


@pytest.mark.slow
def test_a_chain_with_wild_poses_is_diagnosed_as_without_them(tmp_path):
    """One whose fit would lead where no stage closes."""
    case = draw(1037, "axis_coupling", "strong", "sobol", "chain", 80)
    bad, frames, _ = spoilt(case, 1037)
    rec, mask = recording_folder.load_recording(record(bad, tmp_path / "wild")), ",".join(map(str, frames))
    found, expected = (
        diagnosis_of(one, ["scale_error"]) for one in (rec, frame_selection_and_content_hashes.remove_frames(rec, mask))
    )
    assert {one.frame for one in found.outliers.left_out} == set(frames.tolist()) and expected.outliers.left_out == ()
    with_wild_poses, without = (diagnosis_report(one).tree()["findings"] for one in (found, expected))
    assert with_wild_poses == without and [f["effect"] for f in with_wild_poses] == ["scale_error"]


@pytest.mark.slow
def test_many_rows_far_off_are_no_wild_rows(tmp_path, design):
    bad, frames = spoilt_poses(posed(tmp_path / "rec", design, [], 4), np.random.default_rng(4), 0.2)
    report = diagnosis_report(diagnosis_of(bad, ["backlash"]))
    assert report.left_out == () and report.crowd is not None and report.crowd.count > MOST * report.crowd.of
    assert report.unexplained is not None and diagnosis_verdict(report).state is State.CHECK


@pytest.mark.slow
def test_an_arms_wild_poses_are_left_out(tmp_path):
    rng = np.random.default_rng(2)
    true = secret_arms.secret(UR10, rng)
    secret_arms.write(
        tmp_path / "rec",
        UR10,
        secret_arms.tracked(true, UR10, 150, rng, deviation=lambda q: 3e-3 * q * (np.arange(6) == 3)),
    )
    rec = recording_folder.load_recording(tmp_path / "rec")
    bad, frames = spoilt_poses(rec, rng)
    clean = diagnosis_report(diagnosis_of(rec, ["scale_error"]))
    assert len(clean.left_out) <= 1
    for mask in ["", *masks(frames, rng, 1)]:
        found = diagnosis_report(
            diagnosis_of(frame_selection_and_content_hashes.remove_frames(bad, mask) if mask else bad, ["scale_error"])
        )
        assert (
            [(f.effect, f.place) for f in found.findings]
            == [("scale_error", "joint 4")]
            == [(f.effect, f.place) for f in clean.findings]
        )
        gone = {one.frame for one in found.left_out}
        assert len(gone & set(frames.tolist())) + len(mask.split(",")) * bool(mask) >= len(frames) - 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_poses_that_agree_with_no_model_are_no_scatter_of_the_others(tmp_path, seed):
    """A twentieth of a SCARA's poses off by 4 to 8 standard deviations, some too near to the others to be excluded."""
    rng = np.random.default_rng(seed)
    samples = secret_arms.tracked(secret_arms.secret(SCARA, rng), SCARA, 100, rng)
    wild = rng.permutation(100)[:5]
    off = np.zeros((100, 6))
    off[wild] = rng.uniform(4, 8, (5, 1)) * rng.choice([-1, 1], (5, 6)) * np.repeat([2e-5, 1e-4], 3)
    secret_arms.write(tmp_path / "rec", SCARA, replace(samples, T_base_platform=samples.T_base_platform * exp(off)))
    found = diagnosis_of(recording_folder.load_recording(tmp_path / "rec"), ["scale_error"])
    report = diagnosis_report(found)
    set_aside = {int(frame) for frame in found.selection.fit.arms.frame[found.selection.fit.aside]}
    assert set_aside and set_aside | {one.frame for one in report.left_out} <= set(wild.tolist())
    assert names(found) == [] and report.unknown == [] and report.unexplained is None


@pytest.mark.parametrize("rounds", [1, 2])
def test_what_an_arm_lists_as_left_out_is_what_its_last_search_left_out(tmp_path, monkeypatch, rounds):
    """Where nothing is gross beforehand, wild poses show after a search: after the last one it is too late to leave
    them out.
    """
    monkeypatch.setattr(arm_recording_evidence, "GROSS", np.inf)
    monkeypatch.setattr(recording_diagnosis, "ROUNDS", rounds)
    rng = np.random.default_rng(2)
    secret_arms.write(tmp_path / "rec", UR10, secret_arms.tracked(secret_arms.secret(UR10, rng), UR10, 60, rng))
    rec = spoilt_poses(recording_folder.load_recording(tmp_path / "rec"), rng)[0]
    found = diagnosis_of(rec, ["scale_error"])
    searched = found.selection.fit.arms.frame[found.selection.fit.used]
    left_out = sorted(one.frame for one in found.outliers.left_out)
    assert left_out == np.setdiff1d(rec.poses.frame, searched).tolist() and bool(left_out) == (rounds > 1)


@pytest.mark.slow
def test_a_misread_marker_is_left_out_alone(tmp_path, design):
    rec = recorded(tmp_path, design, [], route="sobol:60")
    assert diagnosis_of(rec, ["edge_bias"]).outliers.left_out == ()
    bad, frames = spoilt_corners(rec, np.random.default_rng(2))
    found = diagnosis_of(bad, ["edge_bias"])
    assert {one.frame for one in found.outliers.left_out} == set(frames.tolist()) and len(
        found.outliers.left_out
    ) == len(frames)
    assert all(one.what == "corners" and one.unit == "px" and "marker" in one.place for one in found.outliers.left_out)
    assert names(found) == [] and len(found.selection.fit.refined.point.frames) == 60


@pytest.mark.parametrize("text", ["missed_steps:strut2:jump=2e-4,time=530", "compliance:rig:stiffness=3e6"])
def test_a_short_event_is_not_wild(tmp_path, design, text):
    """A jump before the last few exposures, a load in two of them."""
    rec = posed(tmp_path / "rec", design, [text], 5, "sobol:90,payload:2")
    assert np.count_nonzero(rec.exposures.times()[1] > 530) == 6
    found = diagnosis_of(rec, [text.split(":")[0]])
    assert found.outliers.left_out == () and names(found) == [
        (text.split(":")[0], text.split(":")[1].replace("strut", "strut "))
    ]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_names_are_those_of_the_recording_without_wild_rows(tmp_path, design, seed):
    rng = np.random.default_rng(seed)
    for text, expected in HIDDEN.items():
        clean = posed(tmp_path / text.split(":")[0], design, [text], seed)
        bad, frames = spoilt_poses(clean, rng)
        assert names(diagnosis_of(clean)) == expected
        for mask in masks(frames, rng, 3):
            assert names(diagnosis_of(frame_selection_and_content_hashes.remove_frames(bad, mask))) == expected


def test_what_one_strut_does_alone_is_not_wild():
    left = np.random.default_rng(2).normal(size=(40, 6))
    left[7, 2] = 15.0
    left[9] += 15.0
    assert np.flatnonzero(rows_with_several_deviating_or_one_gross_number(left, 7.0)).tolist() == [9]


@pytest.mark.slow
def test_a_platform_is_calibrated_with_wild_poses_as_without_them(tmp_path, design):
    """A recording whose fit would not even close from a start that wild poses weigh in."""
    bad, frames = spoilt_poses(
        posed(tmp_path / "rec", design, ["backlash:strut3:gap=6e-5"], 1), np.random.default_rng(1)
    )
    some, without = (
        sample_recording(rec).samples
        for rec in (bad, frame_selection_and_content_hashes.remove_frames(bad, ",".join(map(str, frames))))
    )
    made, expected = (
        certify_platform(samples, design.mechanism, np.random.default_rng(0)) for samples in (some, without)
    )
    assert sorted(some.frame[~made.found.inliers]) == frames.tolist()
    assert made.held_out.after.position == pytest.approx(expected.held_out.after.position, rel=0.05)
    assert platform_workspace_claim(some, made, np.random.default_rng(0)).after[0] == pytest.approx(
        platform_workspace_claim(without, expected, np.random.default_rng(0)).after[0]
    )


def test_a_fit_starts_without_wild_poses_only_where_it_does_not_close_with_them(tmp_path, design, monkeypatch):
    starts, robust = [], Loops.agreeing
    monkeypatch.setattr(Loops, "agreeing", lambda *given: starts.append(robust(*given)) or starts[-1])
    bad, frames = spoilt_poses(
        posed(tmp_path / "rec", design, ["backlash:strut3:gap=6e-5"], 1), np.random.default_rng(1)
    )
    some, without = (
        sample_recording(rec).samples
        for rec in (bad, frame_selection_and_content_hashes.remove_frames(bad, ",".join(map(str, frames))))
    )
    expected = identify_platform(without, design.mechanism)
    assert not starts and expected.inliers.all()
    found = identify_platform(some, design.mechanism)
    assert len(starts) == 1 and not starts[0][np.isin(some.frame, frames)].any()
    assert sorted(some.frame[~found.inliers]) == frames.tolist()
    assert np.abs(geometric_parameters(found.mechanism) - geometric_parameters(expected.mechanism)).max() < 1e-6


def test_an_arm_is_calibrated_with_wild_poses_as_without_them(tmp_path):
    rng = np.random.default_rng(0)
    secret_arms.write(tmp_path / "rec", UR10, secret_arms.tracked(secret_arms.secret(UR10, rng), UR10, 120, rng))
    bad, frames = spoilt_poses(recording_folder.load_recording(tmp_path / "rec"), rng)
    some, without = (
        sample_recording(rec)
        for rec in (bad, frame_selection_and_content_hashes.remove_frames(bad, ",".join(map(str, frames))))
    )
    made, expected = (arm_certify(s.samples, UR10, s.instrument, np.random.default_rng(0)) for s in (some, without))
    assert sorted(some.samples.frame[~made.found.inliers]) == frames.tolist()
    assert made.held_out.after.position[0] == pytest.approx(expected.held_out.after.position[0], rel=0.2)
    claims = [
        arm_promised(s.samples, done, np.random.default_rng(0)).after[0][0]
        for s, done in ((some, made), (without, expected))
    ]
    assert claims[0] == pytest.approx(claims[1], rel=0.5)
