"""What scatters beyond the noise that is stated is reported as unexplained, whatever it depends on; no verdict is
all-clear beside it.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import (
    MATERIAL,
    detect_excess_scatter,
)
from calib.diagnosis.problems.arm.arm_recording_evidence import ArmEvidence
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import linearised_arm_poses_and_geometry
from calib.diagnosis.problems.evidence_interface_and_requested_effects import ASSUMED_NOISE, RESIDUALS, STATED
from calib.diagnosis.recording_diagnosis import diagnose_evidence
from calib.diagnosis.report.diagnosis_page import diagnosis_verdict
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report, summary_sentence
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Arm
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.report.verdict_refutations_and_result_display import State
from tests.calib import secret_arms
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded
from tests.truth import draw, record

MOUNT = Arm(
    np.array([[0, 0.3, 0, np.pi / 2], [0, 0, 1.0, 0]]), np.array([[-2.8, 2.8], [0.2, 1.4]])
)  # azimuth, elevation; a star's direction at 1 m
NOISE = 2e-5  # m, as stated
STARS = 130


def stars(folder, jitter, seed=1, repeats=0):
    """Recording of directions that a mount pointed to; jitter : rad, what its joints do beyond their command, anew
    every time.
    """
    rng = np.random.default_rng(seed)
    samples = secret_arms.tracked(
        secret_arms.secret(MOUNT, rng),
        MOUNT,
        STARS,
        rng,
        (NOISE, 1e-4),
        repeats=repeats,
        deviation=lambda q: jitter * rng.normal(size=q.shape),
    )
    secret_arms.write(folder, MOUNT, samples, positions_alone=True, sigma=(NOISE, 1e-4))
    return recording_folder.load_recording(folder)


@pytest.mark.parametrize("repeats", [0, 20])
def test_a_scatter_thirty_times_the_stated_noise_is_unexplained(tmp_path, repeats):
    report = diagnosis_report(diagnosis_of(stars(tmp_path / "rec", 6e-4, repeats=repeats)))
    tree = json.loads(json.dumps(report.tree()))
    assert (
        tree["unexplained"]["place"] == "rig"
        and tree["unexplained"]["unit"] == "m"
        and tree["unexplained"]["depends_on"] == []
    )
    assert tree["unexplained"]["magnitude"] == pytest.approx(np.sqrt(2) * 6e-4, rel=0.25)
    assert [f["effect"] for f in tree["findings"]] == ["unknown"] and tree["noise_from"] == STATED
    assert diagnosis_verdict(report).state is State.CHECK and "Nothing is unmodelled" not in summary_sentence(report)


def test_a_mount_within_its_noise_is_all_clear(tmp_path):
    report = diagnosis_report(diagnosis_of(stars(tmp_path / "rec", 0.0)))
    assert report.unexplained is None and diagnosis_verdict(report).state is State.GOOD


def test_noise_that_nobody_states_proves_nothing(tmp_path):
    rec = stars(tmp_path / "rec", 6e-4)
    poses = Poses(rec.poses.frame, rec.poses.T_base_platform, None)
    assert sample_recording(replace(rec, poses=poses, design=replace(rec.design, instrument=None))).assumed
    found, geometry = linearised_arm_poses_and_geometry(sample_recording(rec).samples, rec.design, rec.commands)
    report = diagnosis_report(
        diagnose_evidence(ArmEvidence(lambda gone: (replace(found, assumed=True), geometry), "poses.csv"), "rec")
    )
    assert report.noise_from == ASSUMED_NOISE and not report.findings
    assert diagnosis_verdict(report).state is State.CHECK and any(
        "the noise is not stated" in reason for reason in diagnosis_verdict(report).rests_on
    )


@pytest.mark.slow
def test_struts_that_scatter_in_few_poses_are_unexplained(tmp_path, design):
    """A seventh of the poses are off: the middle of all residuals shows nothing of it."""
    rec = recorded(tmp_path, design, [], route="sobol:90")
    rng = np.random.default_rng(2)
    values = rec.commands.values.copy()
    _, t = rec.exposures.times()
    for i in rng.permutation(90)[:13]:  # all that is commanded from the move to a pose until it has been exposed
        values[np.abs(rec.commands.t - t[i]) < 3.0, 4] += rng.choice([-1, 1]) * rng.uniform(1e-4, 2e-4)
    off = replace(rec, commands=replace(rec.commands, values=values))
    report = diagnosis_report(diagnosis_of(off, ["scale_error"]))
    assert report.unexplained.place == "strut 5" and diagnosis_verdict(report).state is State.CHECK
    assert report.fits["closures"].heldout_after > 1.5 * report.fits["closures"].noise_floor


@pytest.mark.slow
def test_corners_noisier_than_stated_are_unexplained(tmp_path, design):
    rec = recorded(tmp_path, design, [], route="sobol:30")
    assert diagnosis_report(diagnosis_of(rec, ["edge_bias"])).noise_from == RESIDUALS
    for sigma, place in ((0.04, None), (0.01, "cameras")):  # px; 0.04 was drawn
        stated = replace(rec.corners, covariance=np.tile(sigma**2 * np.eye(2), (len(rec.corners.frame), 1, 1)))
        report = diagnosis_report(diagnosis_of(replace(rec, corners=stated), ["edge_bias"]))
        assert (report.unexplained and report.unexplained.place) == place and report.noise_from == STATED
        assert diagnosis_verdict(report).state is (State.GOOD if place is None else State.CHECK)
    assert report.unexplained.unit == "px" and report.unexplained.magnitude == pytest.approx(
        np.sqrt(0.04**2 - 0.01**2), rel=0.1
    )


def test_chance_alone_is_never_beyond_the_noise():
    rng = np.random.default_rng(0)
    squares = [float((rng.normal(size=60) ** 2).sum()) for _ in range(3000)]
    assert not any(detect_excess_scatter(Place("rig"), "m", 1.0, s, 60) for s in squares)
    assert detect_excess_scatter(
        Place("rig"), "m", 1.0, 0.99 * MATERIAL**2 * 5000, 5000
    ) is None and detect_excess_scatter(Place("rig"), "m", 1.0, 1.1 * MATERIAL**2 * 5000, 5000)


@pytest.mark.parametrize("seed", [940392, pytest.param(940436, marks=pytest.mark.slow)])
def test_a_strut_that_scatters_more_by_chance_makes_no_vibration(tmp_path, seed):
    """The struts' noise is correlated: a scatter of one strut's own that is less likely than none is none."""
    quiet = draw(seed, "none", "none", "sobol", "hexapod", count=100)
    found = diagnosis_of(recording_folder.load_recording(record(quiet, tmp_path / "rec")))
    assert not found.findings and not found.left
