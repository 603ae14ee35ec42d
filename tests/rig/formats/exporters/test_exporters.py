"""Exports: what another program makes of the numbers alone is what we make of them."""

import csv
import io
import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.formats.exporters import json_csv_linuxcnc_and_camera_file_exports, urdf_and_sdf_export_of_arms_and_hexapods
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Arm, Hexapod
from rig.model.mechanisms import arm_kinematics_limits_and_loads as serial
from rig.model.mechanisms import hexapod
from rig.model.pose import pose, pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from synthetic import random_true_machine_and_truth_file
from tests.rig.arms import GANTRY, STANFORD
from tests.rig.genhexkins import forward, settings


@pytest.fixture(scope="module")
def true(design):
    return random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(3)).true


@pytest.mark.parametrize("units, scale", [("mm", 1e3), ("m", 1.0)])
def test_genhexkins_goes_where_we_go(true, units, scale):
    m = true.mechanism
    commands = configuration_generators.sobol_configurations(m.strut_range, 60, 0.9)
    found = forward(json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(m, units), commands, m.home, scale)
    error = pose_difference(hexapod.forward(commands, m), found)
    assert np.linalg.norm(error[:, :3], axis=1).max() < 1e-9 and np.abs(error[:, 3:]).max() < 1e-8
    assert (
        settings(json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(m, units))["genhexkins.screw-lead"] == 0
    )


@pytest.mark.parametrize("gain", [1.0, -0.6])
def test_genhexkins_screws_couple_as_ours_do(true, gain):
    """Turning cardans drive the screws: our effect in the forward model of motion against genhexkins' strut length
    correction.
    """
    m = true.mechanism
    steps = plan.plan_of_configurations(
        configuration_generators.sobol_configurations(m.strut_range, 40, 0.9), m.strut_range.mean(axis=1), 0.05
    )
    run = motion_simulation.simulate_machine_run(
        true, steps.commands, steps.t, (parse_effect(f"screw_coupling:rig:gain={gain}"),)
    )
    plain = motion_simulation.simulate_machine_run(true, steps.commands, steps.t)
    assert np.linalg.norm(pose_difference(plain.T_base_platform, run.T_base_platform)[:, :3], axis=1).max() > 5e-6
    text = json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(m, "mm", true.actuator.screw_lead, gain)
    error = pose_difference(run.T_base_platform, forward(text, steps.commands.at(steps.t), m.home, 1e3))
    assert np.linalg.norm(error[:, :3], axis=1).max() < 1e-9


def test_genhexkins_refuses_what_it_cannot_hold(true):
    with pytest.raises(RigError, match="lead, m per revolution"):
        json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(true.mechanism, screw_coupling=0.5)
    with pytest.raises(ValueError, match="mm or m"):
        json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(true.mechanism, "inch")
    turned = replace(
        true.mechanism,
        platform_joints=Rotation.from_rotvec([0, 0, 1.2]).apply(np.array(true.mechanism.platform_joints)),
    )
    with pytest.raises(RigError, match="degrees to each other"):
        json_csv_linuxcnc_and_camera_file_exports.genhexkins_settings(turned, screw_lead=0.004, screw_coupling=1.0)


def test_sheets_hold_every_bit_of_a_hexapod(true):
    m = true.mechanism
    tree = json.loads(json_csv_linuxcnc_and_camera_file_exports.geometry_json(m))
    rebuilt = Hexapod(
        tree["base_joints"],
        tree["platform_joints"],
        tree["strut_range"],
        pose(tree["home"]["position"], tree["home"]["rotvec"]),
        tree["strut_zeros"],
    )
    lengths = configuration_generators.sobol_configurations(m.strut_range, 20)
    np.testing.assert_allclose(
        pose_difference(hexapod.forward(lengths, m), hexapod.forward(lengths, rebuilt)), 0, atol=1e-14
    )
    rows = np.array(
        [
            [float(cell) for cell in row]
            for row in list(csv.reader(io.StringIO(json_csv_linuxcnc_and_camera_file_exports.geometry_csv(m))))[1:]
        ]
    )
    from_rows = Hexapod(rows[:, 1:4], rows[:, 4:7], rows[:, 8:10], m.home, rows[:, 7])
    np.testing.assert_allclose(
        pose_difference(hexapod.forward(lengths, m), hexapod.forward(lengths, from_rows)), 0, atol=1e-11
    )


ARMS = {
    "six joints": [
        [0.1, 0.3, 0.02, -np.pi / 2],
        [-0.2, 0, 0.6, 0.01],
        [0.3, 0.15, 0.1, np.pi / 2],
        [0, 0.5, 0, -np.pi / 2],
        [0.05, 0, 0, np.pi / 2],
        [1.0, 0.1, 0, 0],
    ],
    "nearly parallel, Hayati": [[0, 0.3, 0, np.pi / 2, 0], [0.2, 0, 0.5, 1e-3, 2e-3], [0, 0, 0.4, 0, -3e-3]],
}


@pytest.mark.parametrize("arm", [STANFORD, GANTRY], ids=["stanford", "gantry"])
def test_urdf_of_an_arm_with_slides_is_the_same_chain(arm):
    for q in np.random.default_rng(0).uniform(*arm.limits.T, (20, len(arm.joints))):
        T = driven(urdf_and_sdf_export_of_arms_and_hexapods.arm_urdf(arm), dict(zip(arm.axes, q)))
        np.testing.assert_allclose(T.as_matrix(), serial.forward(q, arm).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("rows", ARMS.values(), ids=ARMS)
def test_urdf_is_the_same_chain(rows):
    arm = Arm(rows, [[-3, 3]] * len(rows))
    for q in np.random.default_rng(0).uniform(-3, 3, (20, len(rows))):
        T = RigidTransform.identity()
        for angle, row in zip(q, rows):
            theta, d, a, alpha, beta = [*row, 0][:5]
            T = (
                T
                * pose([0, 0, d], [0, 0, theta + angle])
                * pose([a, 0, 0], [alpha, 0, 0])
                * pose([0, 0, 0], [0, beta, 0])
            )
        np.testing.assert_allclose(
            driven(urdf_and_sdf_export_of_arms_and_hexapods.arm_urdf(arm, "a & b"), dict(zip(arm.axes, q))).as_matrix(),
            T.as_matrix(),
            atol=1e-12,
        )


def driven(text, angles):
    """RigidTransform of the last link in the first, from a URDF's joints alone."""
    joints = {joint.find("parent").get("link"): joint for joint in ElementTree.fromstring(text).findall("joint")}
    T, link = RigidTransform.identity(), "base"
    while link in joints:
        joint = joints[link]
        xyz, rpy = (np.array(joint.find("origin").get(key).split(), float) for key in ("xyz", "rpy"))
        T = T * RigidTransform.from_components(xyz, Rotation.from_euler("xyz", rpy))
        if joint.get("type") == "revolute":
            axis = np.array(joint.find("axis").get("xyz").split(), float)
            T = T * pose([0, 0, 0], axis * angles[joint.get("name")])
        elif joint.get("type") == "prismatic":
            T = T * pose(np.array(joint.find("axis").get("xyz").split(), float) * angles[joint.get("name")], [0, 0, 0])
        link = joint.find("child").get("link")
    return T


def test_arms_have_sheets_too():
    arm = Arm(ARMS["six joints"], [[-3, 3]] * 6)
    assert json.loads(json_csv_linuxcnc_and_camera_file_exports.geometry_json(arm))["joints"] == arm.joints.tolist()
    rows = list(csv.reader(io.StringIO(json_csv_linuxcnc_and_camera_file_exports.geometry_csv(arm))))
    assert rows[0][0] == "joint" and len(rows) == 7 and float(rows[3][2]) == 0.15 and float(rows[3][5]) == 0
