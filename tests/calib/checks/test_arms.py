"""Arms that are as they are: a hand that stays level and zeros a tenth of a radian off are no mistakes; a joint that
turns the other way is one.
"""

import numpy as np
import pytest

from calib.models.arm.arm_command_and_pose_mistakes import find_arm_mistakes
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.recording import recording_folder
from tests.calib import secret_arms
from tests.calib.models.arm.test_instrument_placement import SIGMA, case


def written(folder, seed, spoil=None):
    nominal, _, q, seen, _ = case(seed)
    m = len(q)
    samples = Samples(
        np.arange(m),
        np.arange(m) * 10.0,
        q if spoil is None else q * spoil,
        seen.value,
        seen.covariance,
        np.zeros((m, 6, 0)),
    )
    secret_arms.write(folder, nominal, samples, sigma=SIGMA)
    return recording_folder.load_recording(folder)


@pytest.mark.parametrize("seed", [0, 4])  # a level hand; all joints move
def test_zeros_off_and_a_level_hand_are_no_mistakes(tmp_path, seed):
    assert find_arm_mistakes(written(tmp_path / "rec", seed)) == ()


def test_a_joint_that_turns_the_other_way_is_one_still(tmp_path):
    found = find_arm_mistakes(written(tmp_path / "rec", 4, np.array([1, 1, -1, 1, 1, 1, 1])))
    assert found and found[0].spoils
