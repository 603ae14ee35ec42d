"""Arms of one's own from a URDF or a table of rows: the same kinematics to 1e-12, and what an arm cannot state."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from rig.errors import RigError
from rig.formats.exporters.urdf_and_sdf_export_of_arms_and_hexapods import arm_urdf
from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import ArmFileOptions, read_arm_file
from rig.formats.numbers_and_units import parse_length_and_angle_units
from rig.formats.rig_toml import design_from_rig_toml
from rig.formats.rig_toml.rig_toml_text_in_other_units import rig_toml_in_units
from rig.model.mechanisms import arm_kinematics_limits_and_loads as serial
from rig.model.pose import pose
from rig.planning.layout.shipped_arms_and_layouts import load_shipped_arm_design, shipped_arm_names
from tests.cli import run
from tests.rig.arms import configurations, random_arm
from tests.rig.formats.importers.urdf_products import product, robot

TURN = {"limit": (-3.0, 2.0)}
HALF = np.pi / 2


def written(tmp_path, text, name="arm.urdf"):
    path = tmp_path / name
    path.write_text(text)
    return path


def read(tmp_path, text, tip=None, root=None):
    """(ReadArm, its arm as rig.toml has it)."""
    found = read_arm_file(ArmFileOptions(written(tmp_path, text), () if tip is None else (tip,), root))
    (tmp_path / "rig.toml").write_text(found.rig_toml())
    return found, design_from_rig_toml.load_design(tmp_path / "rig.toml").mechanism


def agrees(text, found, arm, tip, atol=1e-12):
    """Hold forward kinematics of an arm to the URDF's own product at random joint values."""
    rng = np.random.default_rng(5)
    for q in configurations(arm, 20, rng):
        expected = product(text, dict(zip(found.joint_names, q)), tip)
        np.testing.assert_allclose(serial.forward(q, arm).as_matrix(), expected, rtol=0, atol=atol)


@pytest.mark.parametrize("name", shipped_arm_names())
def test_a_shipped_arm_comes_back_from_its_urdf(tmp_path, name):
    stated = load_shipped_arm_design(name).mechanism
    text = arm_urdf(stated, name)
    found, arm = read(tmp_path, text)
    agrees(text, found, arm, "platform")
    assert found.joint_names == stated.axes and found.name == name
    np.testing.assert_allclose(arm.limits, stated.limits, atol=1e-11)
    np.testing.assert_array_equal(arm.slides, stated.slides)
    for q in configurations(stated, 5, np.random.default_rng(1)):
        np.testing.assert_allclose(
            serial.forward(q, arm).as_matrix(), serial.forward(q, stated).as_matrix(), rtol=0, atol=1e-12
        )


@pytest.mark.parametrize("seed", range(4))
def test_an_arm_at_random_comes_back_from_its_urdf(tmp_path, seed):
    stated = random_arm(np.random.default_rng(seed), 6, (1, 4))
    text = arm_urdf(stated)
    found, arm = read(tmp_path, text)
    agrees(text, found, arm, "platform")


AXES = {
    "negative": [(0, 0, -1), (0, -1, 0), (-1, 0, 0), (0, 0, -1)],
    "parallel": [(0, 1, 0), (0, 1, 0), (0, -1, 0), (0, 1, 0)],
    "collinear": [(0, 0, 1), (0, 0, 1), (0, 0, -1), (0, 0, 1)],
    "slanted": [(0.3, -0.2, 0.9), (1, 1, 0), (-0.1, 0.7, -0.4), (0.6, 0.0, 0.8)],
    "nearly parallel": [(0, 0, 1), (3e-6, 0, 1), (0, 4e-3, 1), (1e-5, 0, -1)],
}


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("kinds", [("revolute",) * 4, ("prismatic", "revolute", "continuous", "prismatic")])
def test_axes_in_any_direction(tmp_path, axes, kinds):
    places = [(0, 0, 0.3), (0, 0, 0.2), (0, 0, 0.1), (0, 0, 0.4)] if axes == "collinear" else None
    places = places or [(0.1, -0.2, 0.3), (0.4, 0.1, 0.0), (-0.2, 0.3, 0.5), (0.05, 0, 0.1)]
    joints = [
        (f"joint_{k}", kind, f"link_{k}", f"link_{k + 1}", {"xyz": place, "axis": axis} | TURN)
        for k, (kind, axis, place) in enumerate(zip(kinds, AXES[axes], places))
    ]
    tool = ("flange", "fixed", "link_4", "tool0", {"xyz": (0.01, 0.02, 0.03), "rpy": (0.1, -0.2, 2.0)})
    text = robot(*joints, tool)
    found, arm = read(tmp_path, text)
    agrees(text, found, arm, "tool0")
    assert np.abs(arm.rows[:, 1:3]).max() < 5  # no common normal that is far away


def test_turned_frames_rounded_angles_and_a_root_that_is_named(tmp_path):
    rng = np.random.default_rng(2)
    joints = [("world_fixed", "fixed", "world", "link_0", {"xyz": (1, 2, 3), "rpy": (0.1, 0.2, 0.3)})]
    for k in range(6):
        given = {"xyz": rng.normal(size=3), "rpy": (1.5708, -1.5708 * (k % 2), 0.0), "axis": (0, 0, 1)} | TURN
        joints.append((f"joint_{k}", "revolute", f"link_{k}", f"link_{k + 1}", given))
    text = robot(*joints)
    found, arm = read(tmp_path, text)
    agrees(text, found, arm, "link_6", 4e-12)  # origins are some metres away
    inner, below = read(tmp_path, text, tip="link_5", root="link_0")
    M = np.linalg.inv(product(text, {}, "link_0"))
    q = rng.uniform(-2, 2, 5)
    expected = M @ product(text, dict(zip(inner.joint_names, q)), "link_5")
    np.testing.assert_allclose(serial.forward(q, below).as_matrix(), expected, rtol=0, atol=4e-12)


def test_what_is_read_of_each_joint_is_stated(tmp_path):
    text = robot(
        ("mount", "fixed", "world", "a", {}),
        ("lift", "prismatic", "a", "b", {"axis": (0, 0, 1), "limit": (0, 0.4)}),
        ("spin", "continuous", "b", "c", {"axis": (0, 0, 1)}),
        ("elbow", "revolute", "c", "d", {"axis": (0, 1, 0)} | TURN),
        ("finger", "prismatic", "d", "e", {"limit": (0, 0.1), "mimic": "elbow"}),
    )
    found, _ = read(tmp_path, text, tip="d")
    assert found.lines == (
        "read joint mount: fixed, part of the geometry",
        "read joint lift: prismatic, limits 0 .. 400 mm",
        "read joint spin: continuous, turns without end; limits assumed -360 .. 360 deg",
        "read joint elbow: revolute, limits -171.887 .. 114.592 deg",
        "ignored joint finger: it follows elbow (mimic) and is not between root and tip",
    )
    assert "# q3: elbow" in found.rig_toml()


COUPLED = robot(
    ("turn", "revolute", "base", "l1", {"axis": (0, 0, 1), "xyz": (0, 0, 0.3)} | TURN),
    ("shoulder", "revolute", "l1", "l2", {"axis": (0, 1, 0), "xyz": (0.1, 0, 0.1)} | TURN),
    ("elbow", "revolute", "l2", "l3", {"axis": (0, 1, 0.1), "xyz": (0, 0, 0.4), "mimic": ("wrist", 2.0, 0.1)} | TURN),
    ("reach", "prismatic", "l3", "l4", {"axis": (1, 0, 0), "limit": (-0.1, 0.3), "mimic": ("shoulder", 0.05)}),
    ("wrist", "revolute", "l4", "l5", {"axis": (0, 1, 0), "xyz": (0.4, 0, 0), "mimic": ("shoulder", -0.8, 0.1)} | TURN),
    ("flange", "revolute", "l5", "tool", {"axis": (1, 0, 0.2), "xyz": (0.1, 0.1, 0)} | TURN),
)


def test_joints_that_mimic_others_follow_their_leaders(tmp_path):
    """Also one that mimics a follower, a slide that follows a joint that turns, and in a rig.toml in other units."""
    found, arm = read(tmp_path, COUPLED)
    agrees(COUPLED, found, arm, "tool")
    assert [(one.joint, one.leader) for one in arm.couplings] == [(2, 1), (3, 1), (4, 1)]
    assert found.lines[2] == "read joint elbow: revolute, follows wrist (mimic): 2 x wrist + 5.72958 deg"
    assert found.lines[3] == "read joint reach: prismatic, follows shoulder (mimic): 0.05 x shoulder + 0 mm"
    np.testing.assert_allclose(
        arm.limits[1], [(0.3 - 2.0) / 1.6, 2.0], atol=1e-12
    )  # in which the elbow is within its own
    q = arm.with_followers(np.array([0.3, -0.4, 9.0, 9.0, 9.0, 0.2]))
    np.testing.assert_allclose(q, [0.3, -0.4, 2 * 0.42 + 0.1, -0.02, 0.42, 0.2], atol=1e-15)
    (tmp_path / "mm.toml").write_text(rig_toml_in_units(found.rig_toml(), parse_length_and_angle_units("mm,deg")))
    again = design_from_rig_toml.load_design(tmp_path / "mm.toml").mechanism
    assert "multiplier = 0.8726646" in (tmp_path / "mm.toml").read_text()  # mm/deg
    for one in (again, read(tmp_path, arm_urdf(arm))[1]):
        T = serial.forward(q, one).as_matrix()
        np.testing.assert_allclose(T, serial.forward(q, arm).as_matrix(), rtol=0, atol=1e-8)


SIX = robot(*[(f"j{k}", "revolute", f"l{k}", f"l{k + 1}", {"axis": (0, 0, 1)} | TURN) for k in range(3)])
FORKED = robot(
    ("j0", "revolute", "base", "wrist", TURN),
    ("j1", "fixed", "wrist", "camera", {}),
    ("j2", "revolute", "wrist", "hand", TURN),
)


@pytest.mark.parametrize(
    "text, options, message",
    [
        (SIX, {"tips": ("l33",)}, "--tip 'l33' is no link; is 'l3' meant?"),
        (SIX, {"root": "elsewhere"}, "--root 'elsewhere' is no link; there are l0, l1, l2, l3"),
        (SIX, {"tips": ("l1",), "root": "l2"}, "--root 'l2' is not above --tip 'l1'"),
        (FORKED, {}, r"--tip LINK .*: camera \(1 moving joints\), hand \(2 moving joints\)"),
        (SIX[: len(SIX) // 2], {}, r"arm.urdf:\d+:\d+: is not XML: .*the file is cut off"),
        (SIX.replace('type="revolute"', 'type="floating"', 1), {}, r"arm.urdf:7: joint 'j0': is floating"),
        (SIX.replace('type="revolute"', 'type="planar"', 1), {}, "is planar, which an arm cannot state"),
        (SIX.replace('type="revolute"', 'type="revolut"', 1), {}, "is 'revolute' meant"),
        (SIX.replace('parent link="l1"', 'parent link="l01"'), {}, "its parent 'l01' is no link; is 'l1' meant?"),
        (SIX.replace('child link="l3"', 'child link="l0"'), {"tips": ("l1",)}, "the links above 'l1' make a loop"),
        (SIX.replace('child link="l3"', 'child link="l1"'), {}, "is the child of joint 'j0' already"),
        (SIX.replace('lower="-3.0"', 'lower="3.0"', 1), {}, "limits must run from small to large, not 3 .. 2"),
        (SIX.replace('lower="-3.0"', 'lower="abc"', 1), {}, "lower of <limit>, line 12: not a number"),
        (SIX.replace('axis xyz="0.0 0.0 1.0"', 'axis xyz="0 0 0"', 1), {}, "its axis has no direction"),
        (SIX.replace('origin xyz="0.0 0.0 0.0"', 'origin xyz="0 0 333"', 1), {}, "in millimetres"),
        (SIX.replace("<robot", "<model").replace("</robot", "</model"), {}, "begins with <model>, not <robot>"),
        (
            SIX.replace('name="j0"', 'name="${prefix}j0"'),
            {},
            r"arm.urdf:7: is Xacro.*`xacro .*arm.urdf > .*expanded.urdf`",
        ),
        ('<!DOCTYPE r [<!ENTITY a "b">]>' + SIX.split("\n", 1)[1], {}, "arm.urdf:1: declares a document type"),
        (robot(("j", "fixed", "a", "b", {})), {}, "no joint between 'a' and 'b' moves"),
        (robot(("j", "revolute", "a", "b", {})), {}, "joint 'j': is revolute and has no <limit"),
        (
            robot(("j", "revolute", "a", "b", TURN), ("k", "revolute", "b", "c", {"mimic": "j"} | TURN)),
            {"root": "b"},
            r"joint 'k' follows 'j' \(mimic\), which does not move between root and tip",
        ),
        (
            robot(
                ("j", "revolute", "a", "b", {"mimic": "k"} | TURN), ("k", "revolute", "b", "c", {"mimic": "j"} | TURN)
            ),
            {},
            r"follows itself \(mimic\)",
        ),
        (
            robot(("j", "revolute", "a", "b", TURN), ("k", "revolute", "b", "c", {"mimic": ("j", 1.0, 9.0)} | TURN)),
            {},
            "leave its leader 'j' none",
        ),
        (
            robot(("j", "revolute", "a", "b", TURN), ("k", "revolute", "b", "c", {"mimic": ("j", 0.0)} | TURN)),
            {},
            "multiplier of <mimic>, line .* is 0",
        ),
    ],
)
def test_refusals_name_the_line_and_what_to_do(tmp_path, text, options, message):
    with pytest.raises(RigError, match=message):
        read_arm_file(ArmFileOptions(written(tmp_path, text), **options))


def craig(rows, q):
    """(4, 4) of modified rows theta, d, a, alpha."""
    M = np.eye(4)
    for (theta, d, a, alpha), value in zip(rows, q):
        step = np.eye(4)
        turn = Rotation.from_rotvec([alpha, 0, 0]).as_matrix()
        step[:3, :3] = turn @ Rotation.from_rotvec([0, 0, theta + value]).as_matrix()
        step[:3, 3] = np.array([a, 0, 0]) + turn @ [0, 0, d]
        M = M @ step
    return M


def test_a_table_of_modified_rows_is_converted(tmp_path):
    rng = np.random.default_rng(3)
    rows = rng.uniform(-1, 1, (6, 4)) * [2, 0.5, 0.5, 2]
    body = "\n".join(",".join(repr(float(x)) for x in row[[3, 1, 0, 2]]) for row in rows)
    table = written(tmp_path, f"alpha,d,theta,a\n{body}\n", "dh.csv")
    arm = read_arm_file(ArmFileOptions(dh=table, modified=True)).arm
    for q in rng.uniform(-3, 3, (5, 6)):
        np.testing.assert_allclose(serial.forward(q, arm).as_matrix(), craig(rows, q), rtol=0, atol=1e-12)


def screws(rng, slide, n=6):
    """(text of a random arm's screw axes, m; function of joint values -> (4, 4) by matrix exponentials; home)."""
    w = rng.normal(size=(n, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    v = -np.cross(w, rng.uniform(-1, 1, (n, 3)))
    v[slide], w[slide] = w[slide], 0.0
    home = rng.uniform(-1, 1, 6)
    body = "\n".join(",".join(repr(float(x)) for x in [*v[i], *w[i], -1.5, 2.0]) for i in range(n))

    def forward(q):
        M = np.eye(4)
        for axis, moment, value in zip(w, v, q):
            twist = np.zeros((4, 4))
            twist[:3, :3], twist[:3, 3] = np.cross(np.eye(3), axis), moment
            M = M @ expm(twist * value)
        return M @ pose(home[:3], home[3:]).as_matrix()

    return f"vx,vy,vz,wx,wy,wz,lower,upper\n{body}\n", forward, tuple(home)


def test_a_table_of_screw_axes_has_their_product_of_exponentials(tmp_path):
    rng = np.random.default_rng(5)
    text, forward, home = screws(rng, 2)
    found = read_arm_file(ArmFileOptions(poe=written(tmp_path, text, "poe.csv"), home=home))
    assert found.arm.slides.tolist() == [False, False, True, False, False, False]
    for q in rng.uniform(-1.5, 2, (5, 6)):
        np.testing.assert_allclose(serial.forward(q, found.arm).as_matrix(), forward(q), rtol=0, atol=1e-12)
    assert found.lines[0].startswith("read joint q1: revolute, about (") and " mm, limits -85.9437 " in found.lines[0]
    assert found.lines[2].startswith("read joint q3: prismatic, along (")
    mm = text.replace("vx,vy,vz", "vx_mm,vy_mm,vz_mm").splitlines()
    rows = [line.split(",") for line in mm[1:]]
    rows = [[repr(1e3 * float(x)) for x in row[:3]] + row[3:] if i != 2 else row for i, row in enumerate(rows)]
    table = "\n".join([mm[0], *map(",".join, rows)])
    again = read_arm_file(ArmFileOptions(poe=written(tmp_path, table, "mm.csv"), home=home))
    np.testing.assert_allclose(again.arm.rows, found.arm.rows, atol=1e-12)


@pytest.mark.parametrize(
    "row, message",
    [
        ("0,0,2,0,0,0", "poe.csv:2: w has length 2, and must have length 1"),
        ("0,0,0,0,0,0.5", "poe.csv:2: v of a joint that slides"),
        ("0,0,1,0,0,0.1", "w . v = 0.1, a screw's"),
        ("0,0,1,0,250,0", "is it in mm"),
        ("0,0,0,0,0,1", "a prismatic joint has no limits"),
    ],
)
def test_refusals_of_screw_axes(tmp_path, row, message):
    path = written(tmp_path, f"wx,wy,wz,vx,vy,vz\n{row}\n", "poe.csv")
    with pytest.raises(RigError, match=message):
        read_arm_file(ArmFileOptions(poe=path, home=(0.0,) * 6))


def test_units_of_a_table_by_header_or_stated(tmp_path):
    text = "name,theta_deg,d_mm,a [mm],alpha (deg),lower,upper\nbase,0,127.3,0,90,-180,180\nelbow,0,0,-612,0,-90,90\n"
    found = read_arm_file(ArmFileOptions(dh=written(tmp_path, text, "dh.csv"), units="mm,deg"))
    np.testing.assert_allclose(found.arm.joints[:, :4], [[0, 0.1273, 0, HALF], [0, 0, -0.612, 0]], atol=1e-15)
    np.testing.assert_allclose(found.arm.limits, [[-np.pi, np.pi], [-HALF, HALF]])
    assert found.lines[1] == "read joint elbow: revolute, limits -90 .. 90 deg"
    plain = written(tmp_path, "theta,d,a,alpha\n0,127.3,0,90\n0,0,-612,0\n", "plain.csv")
    stated = read_arm_file(ArmFileOptions(dh=plain, units="mm,deg")).arm
    np.testing.assert_array_equal(stated.joints, found.arm.joints)


@pytest.mark.parametrize(
    "text, options, message",
    [
        ("theta,d,a,alpha\n0,0.1,0,90\n", {}, r"dh.csv:2:4: alpha = 90 rad is implausible.*alpha_deg"),
        ("theta,d,a,alpha\n0,127.3,0,1\n", {}, "d_mm"),
        ("theta,d,a\n0,0.1,0\n", {}, "has no column alpha"),
        ("theta,d,a,alhpa\n0,0.1,0,1\n", {}, "column 'alhpa' is unknown; is 'alpha' meant?"),
        ("theta,d,a,alpha\n0,0.1,0,x\n", {}, "dh.csv:2:4: column 'alpha' is not a valid number"),
        ("joint,theta,d,a,alpha\nball,0,0.1,0,1\n", {}, "dh.csv:2:1: joint 'ball' is neither"),
        ("joint,theta,d,a,alpha\nprismatic,0,0.1,0,1\n", {}, "dh.csv:2: a prismatic joint has no limits"),
        ("theta,d,a,alpha,lower,upper\n0,0.1,0,1,2,-2\n", {}, "dh.csv:2: lower is not below upper"),
        ("theta,d,a,alpha,beta\n0,0.1,0,1,0\n", {"modified": True}, "Craig's convention has none"),
        ("theta,d,a,alpha\n0,0.1,0,1\n", {"units": "mm"}, "--units takes"),
        ("theta,d,a,alpha\n0,0.1,0,1\n0,0.1\n", {}, "cut off|rows of as many cells"),
    ],
)
def test_refusals_of_a_table(tmp_path, text, options, message):
    with pytest.raises(RigError, match=message):
        read_arm_file(ArmFileOptions(dh=written(tmp_path, text, "dh.csv"), **options))


def test_options_that_do_not_belong_together(tmp_path):
    path = written(tmp_path, SIX)
    with pytest.raises(RigError, match="give only one"):
        ArmFileOptions(path, dh=path)
    with pytest.raises(RigError, match="give --urdf"):
        ArmFileOptions(tips=("l3",))
    with pytest.raises(RigError, match="give --dh"):
        ArmFileOptions(path, modified=True)
    assert "omit --arm" in run("new", "design", "--urdf", path, "--arm", "ur10", ok=False).stderr


def test_the_command_writes_a_rig_that_loads_and_names_joints(tmp_path):
    out = tmp_path / "rig.toml"
    done = run("new", "design", "--urdf", written(tmp_path, SIX), "--name", "mine", "--out", out)
    assert "read joint j1: revolute, limits -171.887 .. 114.592 deg" in done.stderr
    design = design_from_rig_toml.load_design(out)
    assert design.name == "mine" and design.mechanism.axes == ("q1", "q2", "q3") and design.instrument.base == "free"


def test_the_command_reads_screw_axes(tmp_path):
    table = written(tmp_path, screws(np.random.default_rng(2), 1, 4)[0], "poe.csv")
    out, home = tmp_path / "rig.toml", (0.3, 0.0, 0.5, 0.0, 1.5707963, 0.0)
    done = run("new", "design", "--poe", table, "--home", *home, "--out", out)
    assert "read joint q2: prismatic, along (" in done.stderr
    assert design_from_rig_toml.load_design(out).mechanism.slides.tolist() == [False, True, False, False]
    assert "--home X Y Z RX RY RZ" in run("new", "design", "--poe", table, "--out", out, ok=False).stderr


def test_placements_in_rig_toml_are_checked(tmp_path):
    found, _ = read(tmp_path, SIX.replace('rpy="0.0 0.0 0.0"', 'rpy="0.5 0.0 0.0"', 1))
    text = found.rig_toml()
    assert "base = { position" in text
    (tmp_path / "rig.toml").write_text(text.replace("base = {", "bass = {"))
    with pytest.raises(RigError, match="is 'base' meant"):
        design_from_rig_toml.load_design(tmp_path / "rig.toml")
