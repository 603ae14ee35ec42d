"""Measuring limbs in place of vision: their file, what is learnt from them alone, and that a slip is noticed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from calib.certification import measuring_limb_calibration_slips_and_vision_agreement
from calib.certification.loop_closure_checks_of_redundant_measuring_limbs import Limbs
from calib.models.platform.platform_identification import pose_parameter_jacobian
from calib.online import accepted_measuring_limbs_file, measuring_limb_poses_checked_by_vision
from calib.online.hexapod_information_filter import Online
from calib.online.measuring_limb_poses_checked_by_vision import IN_A_ROW, LimbCheck, LiveLimbPoses
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.errors import FileError, RigError
from rig.model.mechanisms import hexapod
from rig.model.pose import exp, pose_difference
from rig.planning.configuration_generators import sobol_configurations
from rig.recording import recording_folder
from rig.recording.recording_folder import Sensors


@pytest.fixture(scope="module")
def by_vision(limbed):
    """Samples by vision of the first recording."""
    return sample_recording(limbed[1]).samples


@pytest.fixture(scope="module")
def accepted(limbed, by_vision):
    """Accepted limbs of the first recording."""
    design, read, _ = limbed
    frames, lengths = measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(read)
    samples, nominal = (
        measuring_limb_calibration_slips_and_vision_agreement.samples_with_limb_readings_as_commands(
            by_vision, frames, lengths
        ),
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design),
    )
    T, expected = measuring_limb_calibration_slips_and_vision_agreement.held_out_limb_poses_and_expected_covariance(
        samples, nominal, 1e-6
    )
    found = measuring_limb_calibration_slips_and_vision_agreement.limb_agreement(
        samples.T_base_platform, T, expected, (5e-5, 3e-4)
    )
    return accepted_measuring_limbs_file.Accepted(
        measuring_limb_calibration_slips_and_vision_agreement.calibrated_limbs_and_identification(
            samples, nominal, 1e-6
        )[0],
        nominal,
        found,
        None,
        {"data": ["a"]},
    )


@pytest.fixture(scope="module")
def second_recording(limbed):
    """The same machine another day."""
    return recording_folder.load_recording(limbed[1].folder.parent / "again")


def slipped(read, limb, by, at):
    """The Recording with a limb (1..6) that reads less by `by` (m) from a frame on."""
    log, t = read.sensors, read.exposures.times()[1]
    channels = dict(log.channels)
    channels[f"m{limb}"] = channels[f"m{limb}"] - by * (log.t > t[at] - 0.5)
    return replace(read, sensors=Sensors(log.t, channels))


def test_a_file_gives_back_what_was_accepted(accepted, limbed, tmp_path):
    path = tmp_path / "limbs.json"
    accepted_measuring_limbs_file.save_limbs(path, accepted)
    back = accepted_measuring_limbs_file.load_accepted_limbs_for_design(path, limbed[0])
    np.testing.assert_array_equal(back.limbs.covariance, accepted.limbs.covariance)
    np.testing.assert_array_equal(back.limbs.hexapod.base_joints, accepted.limbs.hexapod.base_joints)
    np.testing.assert_array_equal(back.agreement.limits, accepted.agreement.limits)
    assert back.verdict == "accepted" and back.provenance == {"data": ["a"]}
    accepted_measuring_limbs_file.save_limbs(
        path, accepted_measuring_limbs_file.limbs_with_acceptance_withdrawn(back, "rec", 7, "it slipped")
    )
    with pytest.raises(RigError, match="withdrawn at frame 7 of rec: it slipped"):
        accepted_measuring_limbs_file.load_accepted_limbs_for_design(path, limbed[0])


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda tree: tree.pop("covariance"), "covariance is missing"),
        (lambda tree: tree["reading_sigma"].__setitem__(2, 0.0), "reading_sigma must be"),
        (lambda tree: tree["agreement"]["bias"].pop(), "agreement.bias must have 6 numbers, got 5"),
        (
            lambda tree: tree["agreement"]["surely"].__setitem__(0, 1.0),
            "verdict is 'accepted', but its own figures give 'refused'",
        ),
        (lambda tree: tree["covariance"][3].__setitem__(3, -1.0), "covariance is not a covariance"),
        (lambda tree: tree.update(schema="limbs/2"), "its schema"),
        (lambda tree: tree.update(chosen=[1, 2, 3, 4, 5, 5]), "six different limbs"),
        (
            lambda tree: tree.update(
                checks=[
                    {
                        "limb": 9,
                        "base_joint": [0, 0, 0],
                        "platform_joint": [0, 0, 0],
                        "zero": 0,
                        "reading_sigma": 1e-6,
                        "covariance": np.eye(7).tolist(),
                    }
                ]
            ),
            "the limbs of checks .9. must be all limbs, each once",
        ),
    ],
)
def test_a_spoilt_file_names_file_and_value(accepted, tmp_path, spoil, says):
    path = tmp_path / "limbs.json"
    accepted_measuring_limbs_file.save_limbs(path, accepted)
    tree = json.loads(path.read_text())
    spoil(tree)
    path.write_text(json.dumps(tree))
    with pytest.raises(FileError, match=says) as error:
        accepted_measuring_limbs_file.load_limbs_of_any_verdict(path)
    assert str(path) in str(error.value)
    path.write_text(json.dumps(tree)[:200])
    with pytest.raises(FileError, match="cut off"):
        accepted_measuring_limbs_file.load_limbs_of_any_verdict(path)


def test_limbs_of_another_rig_do_not_stand_for_vision(accepted, limbed, tmp_path):
    path, design = tmp_path / "limbs.json", limbed[0]
    accepted_measuring_limbs_file.save_limbs(path, accepted)
    moved = design.insitu.base_joints + 1e-4 * np.eye(6)[:, :1] * np.eye(3)[0]
    with pytest.raises(
        RigError, match="of other limbs than rig.toml states in .insitu.: base_joints of limb 1 differs by 0.1 mm"
    ):
        accepted_measuring_limbs_file.load_accepted_limbs_for_design(
            path, replace(design, insitu=replace(design.insitu, base_joints=moved))
        )
    refused = replace(accepted.agreement, tolerance=np.full(6, 1e-9))
    accepted_measuring_limbs_file.save_limbs(path, replace(accepted, agreement=refused))
    with pytest.raises(RigError, match="did not pass"):
        accepted_measuring_limbs_file.load_accepted_limbs_for_design(path, design)


@pytest.mark.slow
def test_learning_from_limbs_alone_agrees_with_vision_within_its_covariance(accepted, second_recording, limbed):
    nominal = limbed[0].mechanism
    by_limbs = measuring_limb_poses_checked_by_vision.samples_of_limb_poses(
        second_recording, measuring_limb_poses_checked_by_vision.limb_poses(second_recording, accepted)
    ).samples
    learners = [
        Online(nominal, samples.common.shape[2]) for samples in (by_limbs, sample_recording(second_recording).samples)
    ]
    for learner, samples in zip(learners, (by_limbs, sample_recording(second_recording).samples)):
        for pose in zip(samples.commanded, samples.T_base_platform, samples.covariance, samples.common):
            assert not learner.update(*pose).changes
    apart, covariance = learners[0].p - learners[1].p, learners[0].covariance + learners[1].covariance
    assert apart @ np.linalg.solve(covariance, apart) < chi2.ppf(0.99, 42)
    slip = apart + 3e-5 * np.eye(42)[38]
    T = [hexapod.forward(sobol_configurations(nominal.strut_range, 30, 0.8), learner.mechanism) for learner in learners]
    to_pose = pose_parameter_jacobian(T[1], learners[1].mechanism)
    expected = np.sqrt(np.einsum("nij,jk,nik->ni", to_pose, covariance, to_pose))
    left = pose_difference(T[1], T[0])
    assert (np.abs(left) < 4 * expected).all() and np.abs(left[:, :3]).max() < 3e-5
    assert (np.abs(np.einsum("nij,j->ni", to_pose, slip)) > 2 * expected).any(), (
        "a strut that is off by 30 um would show"
    )


@pytest.mark.parametrize("limb, every", [(3, 5), (6, 20)])
def test_a_limb_that_slips_30_um_is_noticed_within_five_poses(accepted, second_recording, limb, every):
    at = 22
    read = slipped(second_recording, limb, 3e-5, at)
    found = measuring_limb_poses_checked_by_vision.check_limb_poses_by_redundancy_and_vision(
        read, accepted, measuring_limb_poses_checked_by_vision.limb_poses(read, accepted), every
    )
    assert found.disagreement is not None and found.disagreement.limb == limb and at <= found.frame < at + 5
    assert abs(float(found.disagreement.reason.split("by ")[1].split(" ")[0]) - 30) < 10


@pytest.mark.parametrize("limb, at", [(3, 35), (6, 60)])
@pytest.mark.slow
def test_limbs_that_slip_while_they_are_held_against_vision_are_not_accepted(limbed, by_vision, limb, at):
    design, read, _ = limbed
    for by in (0.0, 3e-5):
        samples = measuring_limb_calibration_slips_and_vision_agreement.samples_with_limb_readings_as_commands(
            by_vision,
            *measuring_limb_calibration_slips_and_vision_agreement.frames_and_limb_readings(
                slipped(read, limb, by, at)
            ),
        )
        limbs, _ = measuring_limb_calibration_slips_and_vision_agreement.calibrated_limbs_and_identification(
            samples, measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design), 1e-6
        )
        found = measuring_limb_calibration_slips_and_vision_agreement.detect_limb_slip(samples, limbs, 1e-6)
        assert (found is None) == (by == 0)
        assert found is None or (
            found.limb == limb and abs(found.frame - at) <= 2 and abs(found.size - by) < 4 * found.sigma < 2e-5
        )


def test_limbs_that_stay_agree_and_few_poses_are_looked_at(accepted, second_recording):
    found = measuring_limb_poses_checked_by_vision.check_limb_poses_by_redundancy_and_vision(
        second_recording, accepted, measuring_limb_poses_checked_by_vision.limb_poses(second_recording, accepted), 5
    )
    assert found == measuring_limb_poses_checked_by_vision.Checked(8, None, None)
    unseen = replace(second_recording, corners=None)
    assert (
        measuring_limb_poses_checked_by_vision.check_limb_poses_by_redundancy_and_vision(
            unseen, accepted, measuring_limb_poses_checked_by_vision.limb_poses(second_recording, accepted), 5
        ).count
        == 0
    )


def readings_and_poses(accepted, count, slip=0.0, at=10**9, wrong=()):
    """(readings (6,), vision's pose) of the limbs as they are, one slipping by `slip` (m) at a pose, vision wrong at
    some.
    """
    rng, limbs = np.random.default_rng(4), accepted.limbs.hexapod
    for k, commanded in enumerate(hexapod.inverse(limbs.home, limbs) + rng.uniform(-0.03, 0.03, (count, 6))):
        T = hexapod.forward(commanded, limbs)
        yield (
            commanded - slip * (k >= at) * np.eye(6)[1],
            T * exp(np.sqrt(np.diag(COVARIANCE)) * rng.normal(size=6) + 3e-4 * (k in wrong)),
        )


COVARIANCE = np.diag(np.r_[np.full(3, 5e-6), np.full(3, 2e-5)] ** 2)


def test_one_wrong_pose_of_vision_withdraws_nothing_and_several_do(accepted):
    limbs = Limbs(accepted.limbs.hexapod, accepted.limbs.covariance * 1e-4, np.full(6, 1e-6))
    check = LimbCheck(limbs)
    assert [check.take(*each, COVARIANCE) for each in readings_and_poses(accepted, 30, wrong=(12,))] == [None] * 30
    rng, check, found = np.random.default_rng(0), LimbCheck(limbs), []
    for k, (read, T) in enumerate(readings_and_poses(accepted, 30)):
        found.append(check.take(read, T * exp(3e-4 * rng.normal(size=6) * (k >= 12)), COVARIANCE))
    first = next(k for k, one in enumerate(found) if one is not None)
    assert 12 <= first <= 12 + 2 * IN_A_ROW


def test_a_run_by_limbs_looks_now_and_then_and_closely_when_struts_tell_otherwise(accepted):
    source, looks = LiveLimbPoses(accepted, 10), []
    for k, (read, T) in enumerate(readings_and_poses(accepted, 40, 3e-5, 33)):
        if source.is_check_due(unsure=k in (24, 34)):
            looks.append(k)
            if source.check(read, T, COVARIANCE) is not None:
                break
    assert looks[:3] == [0, 10, 20] and looks[3:8] == [24, 25, 26, 27, 28]
    assert not source.in_force and 34 <= looks[-1] < 38
