"""`rig arm kinematics`: poses of joint values, all joint values of poses, step by step; calibrated arms finished
numerically; iterations of platforms.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.api.arm_kinematics import ArmKinematics
from calib.api.nominal_and_calibrated_platform_kinematics import PlatformKinematics
from calib.correction.machine_correction import Correction
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_identification_and_joint_profiles import Profile
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics, kinematics_of
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.pose import pose, pose_difference, pose_to_vector
from rig.planning.layout import shipped_arms_and_layouts
from tests.calib import secret_arms as worlds
from tests.cli import command, run
from tests.conftest import ROOT
from tests.rig.arms import UR10


@pytest.fixture
def rig(capsys):
    return command(capsys, "kinematics")


def poses_file(path, T):
    rows = [",".join([str(i), *(repr(float(x)) for x in row)]) for i, row in enumerate(pose_to_vector(T))]
    path.write_text("\n".join(["frame,x,y,z,rx,ry,rz", *rows]) + "\n")
    return path


@pytest.mark.parametrize("name", ["puma560", "ur10", "stanford", "scara"])
def test_what_forward_gives_inverse_takes_back(tmp_path, rig, name):
    arm = shipped_arms_and_layouts.load_shipped_arm_design(name).mechanism
    low, high = arm.limits.T
    q = np.random.default_rng(1).uniform(0.8 * low, 0.8 * high, (4, len(low)))
    rows = [",".join([str(i), *map(repr, row)]) for i, row in enumerate(q.tolist())]
    (tmp_path / "q.csv").write_text("\n".join([",".join(["frame", *arm.axes]), *rows]) + "\n")
    tree = json.loads(rig(name, "--forward", tmp_path / "q.csv", "--steps", "--json"))
    found = np.array([entry["pose"] for entry in tree["frames"]])
    T = pose(found[:, :3], found[:, 3:])
    np.testing.assert_allclose(pose_difference(mechanism.forward(q, arm), T), 0, atol=1e-12)
    assert [step["joint"] for step in tree["frames"][0]["steps"]] == [0, *range(len(low), 0, -1)]
    back = json.loads(rig(name, "--inverse", poses_file(tmp_path / "p.csv", T), "--json"))
    for entry, own in zip(back["frames"], q):
        many = np.array([one["q"] for one in entry["solutions"]])
        apart = (many - own) - np.where(arm.slides, 0.0, 2 * np.pi) * np.round((many - own) / (2 * np.pi))
        assert np.abs(apart).max(axis=1).min() < 1e-7 and len(many) >= 2
        assert (
            np.abs(
                pose_difference(
                    mechanism.forward(many, arm),
                    RigidTransform.from_matrix(np.tile(T[entry["frame"]].as_matrix(), (len(many), 1, 1))),
                )
            ).max()
            < 1e-9
        )


def test_singular_and_unreachable_poses_are_named(tmp_path, rig):
    arm = shipped_arms_and_layouts.load_shipped_arm_design("puma560").mechanism
    far = pose([9.0, 0, 0], [0, 0, 0])
    T = RigidTransform.from_matrix(
        np.stack([mechanism.forward(np.array([0.3, 0.4, 0.5, 0.6, 0.0, 0.8]), arm).as_matrix(), far.as_matrix()])
    )
    output = rig("puma560", "--inverse", poses_file(tmp_path / "p.csv", T), "--steps")
    assert (
        "frame 0: singular: wrist; " in output
        and "frame 1: out of reach: too far, by 8." in output
        and "0 solutions" in output
    )
    assert (
        "joint 1 = " in output
        and "read and returned about the axis through" in output
        and "  D " not in output
        and "  E (" in output
    )
    few = rig("scara", "--inverse", poses_file(tmp_path / "f.csv", T[:1]))
    assert "unreachable: the arm comes no nearer than" in few


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_steps_of_solutions_found_numerically_end_where_the_hand_is_at_zero(tmp_path, rig, name):
    arm = shipped_arms_and_layouts.load_shipped_arm_design(name).mechanism
    T = mechanism.forward(np.array([[0.3, -0.4, 0.1, -1.5, 0.4, 1.2, 0.3][: len(arm.joints)]]), arm)
    file = poses_file(tmp_path / "p.csv", T)
    tree = json.loads(rig(name, "--inverse", file, "--steps", "--json"))
    for one in tree["frames"][0]["solutions"]:
        assert one["found"] == "numerically" and [s["joint"] for s in one["steps"]] == list(range(len(arm.joints) + 1))
        np.testing.assert_allclose(
            list(one["steps"][-1]["points"].values()),
            arm_dynamics_and_step_by_step_kinematics.three_hand_points_at_zero_joint_values(arm),
            atol=1e-9,
        )
        assert [s["value"] for s in one["steps"][1:]] == one["q"]
    output = rig(name, "--inverse", file, "--steps")
    assert "found numerically" in output and ("moved back along the axis through" in output) == (name == "scara")


@pytest.mark.parametrize(
    "content, options, says",
    [
        ("frame,q1\n0,1\n", ("scara", "--forward"), "column 'q2' is missing"),
        ("", ("scara", "--forward"), "is empty"),
        ("frame,q1,q2,q3,q4\n0,1,2,3\n", ("scara", "--forward"), "4 cells in a table of 5 columns"),
        ("frame,x,y,z,rx,ry,rz\n0,1,0,0,0,0,0\n", ("scarab", "--inverse"), "nor is it one of the shipped arms"),
        ("frame,x,y,z,rx,ry,rz\n0,1,0,0,0,0,0\n", ("nowhere.json", "--inverse"), "no such file"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, rig, content, options, says):
    (tmp_path / "in.csv").write_text(content)
    assert says in rig(*options, tmp_path / "in.csv", ok=False)


def test_a_calibrated_arm_is_finished_from_every_branch():
    """Each branch of the nominal model is where the search for the calibrated arm's own begins, and all find theirs."""
    rng = np.random.default_rng(2)
    true = worlds.secret(UR10, rng)
    nominal = replace(UR10, base=worlds.BASE, tool=worlds.TOOL)
    remainder = (Profile(0, np.array([1.0]), np.array([1e-4, -2e-4]), np.zeros((6, 2))), *[None] * 5)
    correction = ArmCorrection(nominal, true, remainder, np.zeros((1, 6)))
    q = np.array([[0.3, -1.0, 1.2, 0.4, 0.9, 0.5], [1.0, -0.6, 1.4, -0.7, -1.1, 2.0]])
    T = correction.predict(q)
    tree = ArmKinematics(nominal, correction).inverse(np.arange(2), T)
    for i, entry in enumerate(tree["frames"]):
        assert len(entry["solutions"]) == 8
        finished = np.array([one["corrected"] for one in entry["solutions"]])
        np.testing.assert_allclose(
            pose_difference(
                correction.predict(finished), RigidTransform.from_matrix(np.tile(T[i].as_matrix(), (8, 1, 1)))
            ),
            0,
            atol=1e-10,
        )
        moved = np.abs(np.exp(1j * finished) - np.exp(1j * np.array([one["q"] for one in entry["solutions"]]))).max(
            axis=1
        )
        assert (moved < 0.05).all() and (moved > 1e-5).all()
        assert np.abs(np.exp(1j * finished) - np.exp(1j * q[i])).max(axis=1).min() < 1e-8


def test_the_hands_points_lie_as_far_apart_as_stated(tmp_path, rig):
    T = mechanism.forward(np.full((1, 6), 0.4), shipped_arms_and_layouts.load_shipped_arm_design("puma560").mechanism)
    file = poses_file(tmp_path / "p.csv", T)
    far, near = (
        json.loads(rig("puma560", "--inverse", file, "--steps", *more, "--json"))["frames"][0]["solutions"][0]["steps"]
        for more in ((), ("--spacing", "100mm"))
    )
    for one, other in zip(far, near):
        np.testing.assert_allclose(other["AB"], 0.1 * np.array(one["AB"]), atol=1e-12)
        np.testing.assert_allclose(np.subtract(other["points"]["C"], other["points"]["A"]), other["AC"], atol=1e-12)
        assert other["points"]["A"] == one["points"]["A"] and other["value"] == one["value"]


def table(path, axes, rows):
    lines = [",".join([str(k), *map(repr, row)]) for k, row in enumerate(np.asarray(rows).tolist())]
    path.write_text("\n".join([",".join(["frame", *axes]), *lines]) + "\n")
    return path


KINEMATICS = ROOT / "docs" / "kinematics"


def platform_file(name, folder):
    """Path of the rig.toml of a platform, by the number of its struts or the name of its kinematics file."""
    if not name.isdigit():
        return KINEMATICS / f"{name}.toml"
    assert run("new", "design", "--radius", 0.3, "--struts", name, "--out", folder / "rig.toml").returncode == 0
    return folder / "rig.toml"


@pytest.mark.parametrize("name", ["6", "8", "delta", "cranks"])
def test_the_steps_of_a_trace_lead_to_the_pose(tmp_path, rig, name):
    """Every step solves B x = b, moves the pose on which the next stands, and the last is the forward solution."""
    path = platform_file(name, tmp_path)
    mechanism = load_design(path).mechanism
    kinematics = kinematics_of(mechanism)
    home = kinematics.home_values(mechanism)
    q = home + np.random.default_rng(4).uniform(-0.01, 0.01, (2, len(home)))
    values = table(tmp_path / "q.csv", mechanism.axes, q)
    tree = json.loads(rig(path, "--forward", values, "--trace", "--json"))
    for entry, own in zip(tree["frames"], q):
        T = kinematics.forward(own, mechanism)
        found = pose(entry["pose"][:3], entry["pose"][3:])
        np.testing.assert_allclose(pose_difference(found, T), 0, atol=1e-12)
        assert len(entry["trace"]) >= 2
        for one, following in zip(entry["trace"], [*entry["trace"][1:], entry]):
            before, after = (pose(each["pose"][:3], each["pose"][3:]) for each in (one, following))
            B, b, x = (np.array(one[key]) for key in "Bbx")
            np.testing.assert_allclose(own - kinematics.inverse(before, mechanism), b, rtol=0, atol=1e-12)
            np.testing.assert_allclose(B.T @ (B @ x - b), 0, atol=1e-12)  # of eight struts, which do not agree, too
            step = np.zeros(6)
            step[[["x", "y", "z", "rx", "ry", "rz"].index(one) for one in entry["unknowns"]]] = x
            turn, R = Rotation.from_rotvec(step[3:]), before.rotation
            moved = (
                RigidTransform.from_components(before.translation + step[:3], turn * R)
                if entry["along"] == "base"
                else RigidTransform.from_components(before.translation + R.apply(step[:3]), R * turn)
            )
            np.testing.assert_allclose(pose_difference(moved, after), 0, atol=1e-12)
    text = rig(path, "--forward", values, "--trace")
    assert "  iteration 2: from position (" in text and "    x, which moves the platform: x " in text
    assert f"  {len(tree['frames'][1]['trace'])} iterations; settled at position (" in text


def test_a_trace_of_axis_values_without_a_pose_is_printed_all_the_same(tmp_path, rig):
    values = table(tmp_path / "q.csv", ("q1", "q2", "q3"), [[0.43, 0.27, 1.4]])
    text = rig(KINEMATICS / "delta.toml", "--forward", values, "--trace")
    assert (
        "have no pose near home" in text and "  iteration 1: from" in text and "iterations; no pose was found" in text
    )


def test_a_row_without_a_pose_as_calibrated_ends_no_table(tmp_path, rig, monkeypatch):
    """The calibrated platform may close on no pose where the nominal one does."""
    nominal = load_design(platform_file("6", tmp_path)).mechanism
    home = kinematics_of(nominal).home_values(nominal)
    longer = replace(nominal, strut_zeros=np.array([5.0, 0, 5.0, 0, 5.0, 0]))
    machine = PlatformKinematics(nominal, Correction(nominal, longer, (None,) * 6))
    monkeypatch.setattr("calib.api.arm_kinematics.load_kinematics", lambda text: machine)
    values = table(tmp_path / "q.csv", nominal.axes, np.array([home, home]))
    (entry, _) = json.loads(rig(tmp_path / "rig.toml", "--forward", values, "--json"))["frames"]
    assert entry["pose"] is not None and entry["corrected"] is None and entry["refused"]
    assert f"  as calibrated {entry['refused']}" in rig(tmp_path / "rig.toml", "--forward", values)


@pytest.mark.parametrize(
    "options, says",
    [
        (("scara", "--forward", "q.csv", "--trace"), "kind 'arm' is a formula: nothing is iterated"),
        (("scara", "--inverse", "q.csv", "--trace"), "--trace prints the iterations of --forward"),
        ((KINEMATICS / "delta.toml", "--forward", "d.csv", "--steps"), "takes --trace"),
        ((ROOT / "docs/hands/humanoid.toml", "--forward", "d.csv"), "hand"),
    ],
)
def test_what_has_no_trace_or_steps_is_refused(tmp_path, monkeypatch, rig, options, says):
    monkeypatch.chdir(tmp_path)
    table(tmp_path / "q.csv", ("q1", "q2", "q3", "q4"), [[0.1, 0.1, 0.1, 0.1]])
    table(tmp_path / "d.csv", ("q1", "q2", "q3"), [[0.35, 0.35, 0.35]])
    assert says in rig(*options, ok=False)
