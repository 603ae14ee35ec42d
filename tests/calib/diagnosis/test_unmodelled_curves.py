"""What has no name is undone by a curve: on machines of the independent truth, measured where they really go."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.api import calibrate as calibrating
from calib.api.calibrate import CalibrateOptions, calibrate
from calib.api.correct import CorrectOptions, correct
from calib.certification.calibration_evidence_verdict_and_claim_check import calibration_evidence
from calib.correction.physical_effects_of_calibration_and_their_compensation import Unknown
from calib.diagnosis.geometry_refitted_with_diagnosed_effects import Findings
from calib.files import calibration_file
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_checks_and_fit_coordinates import effects_with_coordinates
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.recording.recording_folder import load_recording
from rig.recording.wanted_poses_and_roll_pitch_yaw import WantedPoses
from tests.calib.odd_machines import OddMachine, odd_laws, without_remainder
from tests.truth import case as cases
from tests.truth import draw, record, wanted

WANTED = 0.7  # share of the error that is to be undone
NAMED = "the diagnosis gives the joint a wrong name, and leaves nothing unknown at it"
NAMES = list(odd_laws(draw(1, "thermal_expansion"), np.eye(6)[0]))


def calibrated(machine, *unknown, sigma=None):
    """Calibration of a machine as if a diagnosis had found nothing but these Unknowns; sigma : as of Findings"""
    sampled = sample_recording(machine.recording)
    findings = Findings((), sigma, unknown)
    options = CalibrateOptions(diagnosis=Path("unused"))
    done = calibrating._calibrated(machine.recording, sampled, findings, BY_NAME, options, lambda *_: None)
    return done.calibration


def unknown_at(place, depends_on):
    return Unknown(place, 3e-5, "m", (depends_on,), False)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, law, depends_on, covariate",
    [
        ("hexapod", "heat with a knee", "strut2_temperature_C", "temperature"),
        ("arm", "gap that widens along the screw", "history", "history"),
    ],
)
def test_an_unknown_is_undone_by_a_curve(tmp_path, kind, law, depends_on, covariate):
    machine = OddMachine.of(law, 1, tmp_path, 60, kind)
    with_curve = calibrated(machine, unknown_at(machine.place, depends_on))
    (unknown,) = with_curve.physics.unknown
    assert covariate in unknown.by[0] and unknown.undone
    assert f"unknown at {machine.place}, by {unknown.by[0]}" in unknown.sentence() and "undoes" in unknown.sentence()
    calibration_file.save(tmp_path / "calibration.json", with_curve)
    loaded = calibration_file.load(tmp_path / "calibration.json")
    assert loaded.physics.unknown == with_curve.physics.unknown
    before, _ = machine.driven(without_remainder(calibrated(machine)))
    after, _ = machine.driven(loaded)
    assert after < (1 - WANTED) * before


@pytest.mark.slow
def test_a_curve_over_time_is_left_out_beyond_the_recorded_time(tmp_path):
    machine = OddMachine.of("swing after switching on", 1, tmp_path, 60)
    found = calibrated(machine, unknown_at(machine.place, "time"))
    (unknown,) = found.physics.unknown
    assert "time" in unknown.by and "within the recorded time only" in unknown.sentence()
    assert unknown.sentence() in calibration_evidence(found).unexplained
    T = RigidTransform.from_matrix(wanted(machine.case, 3))
    ends = float(machine.case.journey.t[-1])
    notices = []
    for t in (np.array([60.0, 120.0, 180.0]), np.array([60.0, 120.0, 2 * ends])):
        poses = WantedPoses(Poses(np.arange(3), T, None), t)
        notices.append(correct(found, poses, CorrectOptions(approach="never")).commanded)
    assert not notices[0].uncovered and notices[1].uncovered == ((f"a curve over time at {machine.place}", 1),)
    sure, unsure = (np.trace(done.covariance[2, :3, :3]) for done in notices)
    assert unsure > 2 * sure and np.allclose(notices[0].values[:2], notices[1].values[:2], atol=1e-8)


@pytest.mark.slow
def test_noise_has_no_curve(tmp_path):
    machine = OddMachine.of("dent in the screw", 1, tmp_path, 60)
    case = replace(machine.case, laws=())
    case = replace(case, seen=cases._seen(case, np.random.default_rng(3)))
    plain = OddMachine(case, tmp_path, load_recording(record(case, tmp_path / "plain")))
    found = calibrated(plain, *(unknown_at(f"strut {i}", "time") for i in range(1, 7)))
    assert not found.physics.effects and not any(u.by or u.undone for u in found.physics.unknown)
    assert all("not corrected, as no smooth function" in u.sentence() for u in found.physics.unknown)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hexapod", "arm"])
def test_a_curve_stands_beside_what_another_recording_told(tmp_path, kind):
    machine = OddMachine.of("gap that widens along the screw", 1, tmp_path, 60, kind)
    own, other = (calibrated(machine, unknown_at(machine.place, "history"), sigma=s) for s in (None, np.zeros(0)))
    assert own.physics.effects == other.physics.effects != ()
    assert np.allclose(own.physics.own, other.physics.own, rtol=1e-3, atol=1e-6)


def test_shares_of_an_arms_effect_that_a_bound_cuts_are_written_with_the_sum_of_one():
    made = BY_NAME["creep"]("joint 2", 1e-3, 20.0, (1.0, 1.0))
    (written,) = effects_with_coordinates((made,), [], np.zeros(0))
    assert sum(written.shares) == pytest.approx(1) and written.fraction == pytest.approx(2e-3)


def test_why_nothing_is_undone_is_stated():
    reasons = {
        "camera c1": "changes what cameras see",
        "rig": "belongs to no single axis",
        "strut 2": "no smooth function of configuration, time, travel, history or a sensor",
    }
    for place, reason in reasons.items():
        assert reason in unknown_at(place, "time").sentence()
    assert "scatter that follows nothing recorded" in Unknown("strut 2", 1e-5, "m", (), False).sentence()
    assert Unknown("strut 2", 1e-5, "m", ("pose",), True).undone


def test_what_is_undone_is_stated_in_the_unit_of_the_axis():
    undone = Unknown("crank 2", 1e-3, "rad", ("time",), False, ("time",), (8e-4, 1e-4), "rad")
    assert "undoes 700 µrad of 800 µrad" in undone.sentence()


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind, law, seed",
    [
        *(("hexapod", law, seed) for law in NAMES for seed in (1, 2)),
        ("arm", "gap that widens along the screw", 1),
        ("arm", "swing after switching on", 1),
        pytest.param("arm", "one-sided loop, long", 1, marks=pytest.mark.xfail(strict=True, reason=NAMED)),
        pytest.param("arm", "heat with a knee", 1, marks=pytest.mark.xfail(strict=True, reason=NAMED)),
    ],
)
def test_most_of_an_odd_law_is_undone(tmp_path, kind, law, seed):
    machine = OddMachine.of(law, seed, tmp_path, kind=kind)
    plain = calibrate(machine.recording, CalibrateOptions(quick=True)).calibration
    before, _ = machine.driven(without_remainder(plain))
    after, _ = machine.driven(calibrate(machine.recording, CalibrateOptions(find=True)).calibration)
    assert after < (1 - WANTED) * before
