"""Sweeps of self-motions: even steps, the hand still, one lap of a closed one; recorded, they feed --among."""

import json
from importlib.resources import files

import numpy as np
import pytest

from rig.cli import command_line
from rig.errors import RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose_difference
from rig.posture.arm_force_transmission_and_exertable_wrench import TransmissionObjective, transmission_measure
from rig.posture.self_motion_sweep import sweep_self_motion
from tests.rig.arms import configurations

PANDA = design_from_rig_toml.load_design(files("rig") / "arms" / "panda.toml").mechanism
INSTRUMENT = '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-5\nrotation_sigma = 1e-5\n'


def hand_off(q, arm, start):
    """m and rad by which the hand leaves its place at postures q (k, n)."""
    return np.abs(pose_difference(mechanism.forward(q, arm), mechanism.forward(start, arm))).max()


def test_a_sweep_goes_from_end_to_end_in_even_steps_with_the_hand_still():
    start = configurations(PANDA, 1, np.random.default_rng(8), 0.5)[0]
    sweep = sweep_self_motion(start, PANDA, 0.1)
    visited = sweep.q[sweep.exposed]
    assert not sweep.closed and len(visited) > 5 and hand_off(visited, PANDA, start) < 1e-9
    assert hand_off(sweep.q, PANDA, start) < 1e-9 and np.abs(np.diff(sweep.q, axis=0)).max() < 0.05
    assert 0 < np.abs(np.diff(visited, axis=0)).max() <= 0.1 + 1e-6
    low, high = PANDA.limits.T
    for end in visited[[0, -1]]:  # a joint at its limit ends it
        assert np.minimum(end - low, high - end).min() < 1e-3
    assert (mechanism.signed_limit_excess(sweep.q, PANDA) == 0).all()
    assert np.abs(sweep.q[0] - start).max() < 0.05  # it begins where the arm stands


@pytest.mark.parametrize("limit", [6.2, 9.0])  # ends behind, and nowhere
def test_a_self_motion_that_closes_is_visited_once_round(limit):
    wide = Arm(PANDA.joints, np.tile([-limit, limit], (7, 1)))
    start = np.array([0.1, 0.5, -0.2, -1.6, 0.3, 1.8, 0.2])
    sweep = sweep_self_motion(start, wide, 0.2)
    visited = sweep.q[sweep.exposed]
    assert sweep.closed and np.abs(visited[0] - start).max() < 1e-9 and hand_off(visited, wide, start) < 1e-9
    apart = visited - start
    apart = np.abs(apart - 2 * np.pi * np.round(apart / (2 * np.pi))).max(axis=1)
    assert (apart[1:] > 0.05).all()  # none is visited twice


def test_a_recorded_sweep_is_compared_by_among(tmp_path, capsys):
    rig, plan, back = tmp_path / "arm.toml", tmp_path / "sweep.csv", tmp_path / "back.csv"
    rig.write_text((files("rig") / "arms" / "panda.toml").read_text() + INSTRUMENT)
    words = ["posture", str(rig), "--pose", "0.4,0.1,0.5,3,0.2,0"]
    assert command_line.main([*words, "--sweep", "20deg", "--out", str(plan), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(plan, ("frame", *PANDA.axes))
    visited = rows.matrix(PANDA.axes)[[bool(cell) for cell in rows.text("frame")]]
    assert tree["postures"] == len(visited) and tree["step"] <= np.radians(20)
    rec = str(tmp_path / "rec")
    assert command_line.main(["simulate", str(rig), "--plan", f"commands:{plan}", "--out", rec]) == 0
    capsys.readouterr()
    assert command_line.main([*words, "--among", rec, "--force-axes", "z", "--out", str(back), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    value = transmission_measure(visited, PANDA, TransmissionObjective(("fz",)))
    assert tree["compared"] == len(visited) and tree["elsewhere"] == 0 and tree["frame"] == value.argmax()
    ways = csv_and_parquet_tables_and_time_origin.read_csv_table(back, ("t", *PANDA.axes)).matrix(PANDA.axes)
    np.testing.assert_allclose(ways[[0, -1]], visited[[-1, value.argmax()]], atol=1e-7)
    assert hand_off(ways, PANDA, visited[0]) < 1e-6  # the way back holds the hand too


@pytest.mark.parametrize(
    "words, says",
    [
        (["--sweep", "0"], "at least 0.001 rad"),
        (["--sweep", "10deg", "--force-axes", "z"], "searches none"),
        (["--sweep", "10deg", "--hold", "position"], "has 4 dimensions"),
        (["--sweep", "10deg", "--from", "0,0,0,-1.5,0,1.5,0"], "--from has another hand pose"),
    ],
)
def test_what_cannot_be_swept_is_refused(words, says, capsys):
    assert command_line.main(["posture", "panda", "--pose", "0.4,0.1,0.5,3,0.2,0", *words]) == 1
    assert says in capsys.readouterr().err


def test_an_arm_without_a_joint_to_spare_is_refused():
    arm = design_from_rig_toml.load_design(files("rig") / "arms" / "ur10.toml").mechanism
    with pytest.raises(RigError, match="without redundancy"):
        sweep_self_motion(np.full(6, 0.3), arm, 0.1)
