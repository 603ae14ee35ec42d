"""A hexapod's URDF, as pinocchio builds it, closes its loops at every pose for the lengths that our own kinematics has;
SDF has the same joints.
"""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from rig.errors import RigError
from rig.formats.exporters import urdf_and_sdf_export_of_arms_and_hexapods
from rig.formats.exporters.urdf_and_sdf_export_of_arms_and_hexapods import simulator_strut_models
from rig.model.mechanisms import hexapod
from rig.planning import configuration_generators
from rig.planning.layout import hexapod_layout_and_camera_placement
from synthetic import random_true_machine_and_truth_file
from tests.calib.checks.test_mistakes import run_in_process


@pytest.fixture(scope="module")
def machine(design):
    """A hexapod with zeros, none of whose joints lie evenly."""
    return random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(3)).true.mechanism


def cardans(direction, T_base_cross):
    """(turn, tilt from the cross) rad of a strut along a direction, by the two axes of its cross."""
    x, y, z = T_base_cross.rotation.inv().apply(direction)
    return np.arctan2(-y, z), np.arcsin(x)


def driven(model, T, m):
    """pinocchio's Data for a platform pose T, joints worked out by hand."""
    q = pinocchio.neutral(model)

    def put(name, value):
        q[model.joints[model.getJointId(name)].idx_q] = value

    for n, (strut, length) in enumerate(zip(simulator_strut_models(m), hexapod.inverse(T, m)), 1):
        along = T.apply(m.platform_joints[n - 1]) - m.base_joints[n - 1]
        turn, tilt = cardans(along / np.linalg.norm(along), strut.T_base_cross)
        put(f"strut_{n}_turn", turn)
        put(f"strut_{n}_tilt", tilt - strut.tilt)
        put(f"l{n}", length)
        if n == 1:
            R = strut.T_base_cross.rotation * Rotation.from_rotvec([turn, 0, 0]) * Rotation.from_rotvec([0, tilt, 0])
            ball = (R * strut.T_base_strut().rotation.inv() * m.home.rotation).inv() * T.rotation
            for name, angle in zip(("platform_x", "platform_y", "platform_z"), ball.as_euler("XYZ")):
                put(name, angle)
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    return data


def test_urdf_closes_its_loops_at_every_pose(machine):
    model = pinocchio.buildModelFromXML(urdf_and_sdf_export_of_arms_and_hexapods.hexapod_urdf(machine, "a & b"))
    assert model.nq == 21
    for T in hexapod.forward(configuration_generators.sobol_configurations(machine.strut_range, 20, 0.9), machine):
        data = driven(model, T, machine)
        np.testing.assert_allclose(data.oMf[model.getFrameId("platform")].homogeneous, T.as_matrix(), atol=1e-9)
        for n in range(1, 7):
            tip = data.oMf[model.getFrameId(f"strut_{n}_tip")].translation
            np.testing.assert_allclose(tip, data.oMf[model.getFrameId(f"platform_joint_{n}")].translation, atol=1e-9)
            np.testing.assert_allclose(tip, T.apply(machine.platform_joints[n - 1]), atol=1e-9)
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    for n in range(6):
        k = model.joints[model.getJointId(f"l{n + 1}")].idx_q
        np.testing.assert_allclose([low[k], high[k]], machine.strut_range[n], rtol=1e-11)


def stood(link):
    figures = np.array((link.findtext("pose") or "0 0 0 0 0 0").split(), float)
    return RigidTransform.from_components(figures[:3], Rotation.from_euler("xyz", figures[3:]))


def test_sdf_stands_at_home_with_joints_where_they_are(machine):
    model = ElementTree.fromstring(urdf_and_sdf_export_of_arms_and_hexapods.hexapod_sdf(machine)).find("model")
    links, joints = (
        {link.get("name"): stood(link) for link in model.findall("link")},
        {j.get("name"): j for j in model.findall("joint")},
    )
    assert np.abs((links["platform"].inv() * machine.home).as_matrix() - np.eye(4)).max() < 1e-12
    for n in range(1, 7):
        strut, rod = links[f"strut_{n}"], links[f"strut_{n}_rod"]
        np.testing.assert_allclose(strut.translation, machine.base_joints[n - 1], atol=1e-12)
        np.testing.assert_allclose(rod.translation, machine.home.apply(machine.platform_joints[n - 1]), atol=1e-12)
        length = np.linalg.norm(rod.translation - strut.translation)
        np.testing.assert_allclose(strut.apply([0, 0, length]), rod.translation, atol=1e-12)
        limits = [float(joints[f"l{n}"].findtext(f"axis/limit/{end}")) for end in ("lower", "upper")]
        np.testing.assert_allclose(
            np.add(limits, length - machine.strut_zeros[n - 1]), machine.strut_range[n - 1], atol=1e-10
        )
        base = joints[f"strut_{n}_base"]
        first, second = (np.array(base.findtext(f"{axis}/xyz").split(), float) for axis in ("axis", "axis2"))
        assert abs(first[2]) < 1e-12 and abs(first[:2] @ machine.base_joints[n - 1, :2]) < 1e-12
        assert abs(first @ second) < 1e-12 and abs(second @ (rod.translation - strut.translation)) < 1e-12
        assert joints[f"strut_{n}_platform"].findtext("child") == "platform"


def test_a_joint_on_the_axis_has_no_cardan(machine):
    joints = np.array(machine.base_joints)
    joints[2] = [0, 0, 0.1]
    with pytest.raises(RigError, match="strut 3: its base joint lies on the z axis"):
        urdf_and_sdf_export_of_arms_and_hexapods.hexapod_urdf(replace(machine, base_joints=joints))


def test_simulators_files_come_from_the_command_line(tmp_path):
    (tmp_path / "rig.toml").write_text(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=2, cubes=2)
    )
    for kind in ("urdf", "sdf"):
        assert (
            run_in_process("export", tmp_path / "rig.toml", "--format", kind, "--out", tmp_path / f"h.{kind}")[0] == 0
        )
        assert ElementTree.parse(tmp_path / f"h.{kind}").getroot().tag == {"urdf": "robot", "sdf": "sdf"}[kind]
