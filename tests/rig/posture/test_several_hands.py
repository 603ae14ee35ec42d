"""Postures and wrenches of an arm with several hands are refused: each is of one hand."""

import numpy as np
import pytest

from rig.errors import RigError
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.posture.best_posture import PostureOptions, best_posture
from rig.posture.external_wrench_from_torque_table import measure_wrench
from tests.cli import run
from tests.two_armed import HUMANOID, humanoid

ONE = "for arms with one hand; this one has 2: left, right"


def test_a_posture_is_searched_for_one_hand(tmp_path):
    arm = humanoid().mechanism
    with pytest.raises(RigError, match=f"postures are searched {ONE}"):
        best_posture(arm, PostureOptions(mechanism.forward(np.zeros(15), arm)))
    run("simulate", HUMANOID, "--plan", "sobol:4", "--out", tmp_path / "REC")
    assert (
        f"postures are searched {ONE}" in run("arm", "posture", HUMANOID, "--among", tmp_path / "REC", ok=False).stderr
    )


def test_a_wrench_is_of_one_hand(tmp_path):
    with pytest.raises(RigError, match=f"a wrench is estimated {ONE}"):
        measure_wrench(HUMANOID, tmp_path / "none.csv")
