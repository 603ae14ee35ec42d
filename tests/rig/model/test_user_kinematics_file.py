"""Kinematics files: what is wrong with one is named with file, line and value; derivatives; machines that it makes."""

import pickle

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import rig
from rig.errors import FileError, NotConverged, Unreachable
from rig.model.mechanisms import kinematics_of
from rig.model.mechanisms.user_kinematics_file_mechanism import (
    loop_closure_parameter_jacobian,
    nominal_mechanism_of_kinematics_file,
    with_scaled_parameters,
)
from rig.model.pose import exp, pose, pose_difference
from tests.conftest import ROOT
from tests.numerical_derivatives import jacobian

EXAMPLES = ROOT / "docs" / "kinematics"
GANTRY = """
import numpy as np
from rig.model.mechanisms import Axis, Parameter

axes = (Axis("q1", "m", -0.2, 0.2), Axis("q2", "m", -0.2, 0.2), Axis("q3", "m", -0.2, 0.2))
parameters = (Parameter("zeros", [0.0, 0.0, 0.0], "m", 5e-4), Parameter("skew", 0.0, "rad", 1e-3))
freedoms = ("x", "y", "z")
home = (0.01, 0.02, 0.03, 0.0, 0.0, 0.0)

def inverse(pose, p):
    x, y, z = pose[..., 0, 3], pose[..., 1, 3], pose[..., 2, 3]
    return np.stack([x - y * np.tan(p["skew"]), y / np.cos(p["skew"]), z], axis=-1) - p["zeros"]
"""
FORWARD = """
def forward(values, p):
    out = np.eye(4)
    x, y, z = values + p["zeros"]
    out[:3, 3] = x + y * np.sin(p["skew"]), y * np.cos(p["skew"]), z
    return out
"""


def test_a_file_with_and_without_forward_is_the_same_machine():
    plain, both = (
        nominal_mechanism_of_kinematics_file("g.py", GANTRY),
        nominal_mechanism_of_kinematics_file("g.py", GANTRY + FORWARD),
    )
    assert plain.stated.batched and not both.stated.forward_batched and both.stated.has_forward
    moved = [with_scaled_parameters(one, np.array([1e-3, -2e-3, 5e-4, 4e-3])) for one in (plain, both)]
    assert moved[0].parameters[3] == pytest.approx(4e-3 / 5e-4 * 1e-3)  # a tolerance of 1 mrad counts as 0.5 mm
    values = np.random.default_rng(0).uniform(-0.2, 0.2, (20, 3))
    T = [kinematics_of(one).forward(values, one) for one in moved]
    assert np.abs(pose_difference(*T)).max() < 1e-12
    unpickled = pickle.loads(pickle.dumps(moved[0]))
    assert np.abs(pose_difference(kinematics_of(unpickled).forward(values, unpickled), T[0])).max() == 0


def test_coordinates_that_are_no_freedoms_are_those_of_home():
    m = nominal_mechanism_of_kinematics_file("g.py", GANTRY)
    tilted = pose([0.1, 0.0, 0.05], [0.2, 0.1, 0.3])
    assert np.allclose(kinematics_of(m).inverse(tilted, m), [0.1, 0.0, 0.05])
    level = kinematics_of(m).forward(kinematics_of(m).inverse(tilted, m), m)
    assert np.allclose(level.rotation.as_rotvec(), 0) and np.allclose(level.translation, tilted.translation)


@pytest.mark.parametrize(("name", "by_complex"), [("delta", True), ("hexaglide", True), ("cranks", False)])
def test_derivatives_agree_with_differences(name, by_complex):
    m = rig.load_design(EXAMPLES / f"{name}.toml").mechanism
    assert m.stated.complex_step is by_complex  # arctan2 of the cranks takes no complex numbers
    kinematics, some = kinematics_of(m), list(m.pose_coordinates)
    T = kinematics.forward(kinematics.home_values(m) + 0.02, m)
    found = jacobian(lambda xi: kinematics.inverse(T * exp(xi), m), np.zeros(6))
    assert np.abs(kinematics.jacobian(T, m) - found)[:, some].max() < 1e-6
    by_parameter = jacobian(
        lambda p: kinematics.inverse(T, with_scaled_parameters(m, p)), np.zeros(len(m.stated.tolerances.nonzero()[0]))
    )
    assert np.abs(loop_closure_parameter_jacobian(T, m) + by_parameter).max() < 1e-6


def test_a_function_of_one_pose_is_called_pose_by_pose():
    one = GANTRY.replace(
        "    x, y, z = pose[..., 0, 3]", "    assert pose.shape == (4, 4)\n    x, y, z = pose[..., 0, 3]"
    )
    m = nominal_mechanism_of_kinematics_file("g.py", one)
    assert not m.stated.batched
    values = np.random.default_rng(0).uniform(-0.1, 0.1, (2, 3, 3))
    assert np.abs(kinematics_of(m).inverse(kinematics_of(m).forward(values, m), m) - values).max() < 1e-12


def test_forward_kinematics_asks_a_slow_function_for_few_poses():
    """A function of one pose is what takes the time: Newton's derivatives take 24 of them for each pose."""
    m = nominal_mechanism_of_kinematics_file("cranks.py", (EXAMPLES / "cranks.py").read_text())
    function, asked = m.stated.module.inverse, []

    def counted(poses, p):
        asked.append(1 if poses.ndim == 2 else len(poses))
        return function(poses, p)

    low, high = kinematics_of(m).travel_ranges(m).T
    values = np.random.default_rng(1).uniform(low + 0.2 * (high - low), high - 0.2 * (high - low), (60, len(low)))
    m.stated.module.inverse = counted
    T = kinematics_of(m).forward(values, m)
    assert sum(asked) < 60 * 60
    assert np.abs(kinematics_of(m).inverse(T, m) - values).max() < 1e-12


def test_poses_out_of_reach_are_named():
    m = rig.load_design(EXAMPLES / "delta.toml").mechanism
    T = RigidTransform.from_translation([[0.0, 0.0, 0.1], [0.4, 0.0, 0.1]])
    with pytest.raises(Unreachable, match=r"delta.py: inverse gives no axis values for 1 of 2 poses") as raised:
        kinematics_of(m).inverse(T, m)
    assert list(raised.value.index) == [1]
    with pytest.raises(NotConverged, match=r"delta.py: 1 of 2 axis values have no pose") as lost:
        kinematics_of(m).forward(np.array([[0.35, 0.35, 0.35], [0.9, 0.1, 0.1]]), m)
    assert list(lost.value.index) == [1]


def test_an_error_of_math_is_a_pose_out_of_reach():
    """A file written with Python's math has no answer where numpy has NaN; any other ValueError is the file's fault."""
    scalar = "import math\n" + GANTRY.replace(
        "    x, y, z = pose[..., 0, 3]", "    x, y, z = math.sqrt(1 - pose[0, 3]) ** 0 * pose[..., 0, 3]"
    )
    m = nominal_mechanism_of_kinematics_file("g.py", scalar)
    T = RigidTransform.from_translation([[0.05, 0.0, 0.0], [2.0, 0.0, 0.0]])
    with pytest.raises(Unreachable, match="no axis values for 1 of 2 poses") as raised:
        kinematics_of(m).inverse(T, m)
    assert list(raised.value.index) == [1]
    with pytest.raises(FileError, match="inverse fails: ValueError"):
        _ = nominal_mechanism_of_kinematics_file(
            "g.py", scalar.replace("math.sqrt(1 - pose[0, 3])", "float('x')")
        ).stated


def line_of(text: str, start: str) -> int:
    """Number of the first line of a text that begins so."""
    return next(k for k, line in enumerate(text.splitlines(), 1) if line.startswith(start))


@pytest.mark.parametrize(
    ("change", "at", "says"),
    [
        (("def inverse", "def invert"), None, r"states no inverse: a function inverse\(pose, parameters\)"),
        (("home =", "start ="), None, "states no home"),
        (
            ('"m", -0.2, 0.2), Axis("q2"', '"mm", -0.2, 0.2), Axis("q2"'),
            "axes",
            "unit of axis 'q1' is m or rad, not 'mm'",
        ),
        (("-0.2, 0.2), Axis", "-200.0, 200.0), Axis"), "axes", "is -200 m, more than 50 m: is it in millimetres"),
        (('Axis("q2"', 'Axis("q1"'), "axes", "'q1' is stated twice"),
        (('"m", 5e-4', '"m", 0.5'), "parameters", "tolerance of parameter 'zeros' is 0.5 m, .* is it in millimetres"),
        (('"m", 5e-4', '"m", -5e-4'), "parameters", "it cannot be negative"),
        (("[0.0, 0.0, 0.0]", "[0.0, 0.0, float('nan')]"), "parameters", "is nan, expected a finite number"),
        (("0.03, 0.0, 0.0, 0.0)", "0.03)"), "home", "home must be six numbers"),
        (("home = (0.01", "home = (0.41"), "home", "needs axis q1 at 0.41 m, outside its travel -0.2 .. 0.2 m"),
        (("0.03, 0.0, 0.0, 0.0)", "0.03, 0.0, 0.0, 0.1)"), "home", "stands parallel to the base"),
        (('("x", "y", "z")', '("x", "y")'), "freedoms", "3 axes move 2 freedoms"),
        (('("x", "y", "z")', '("x", "y", "rx")'), "freedoms", "freedoms x, y, rx are not supported"),
        (('("x", "y", "z")', '("z", "y", "x")'), "freedoms", "in this order"),
        (("z], axis=-1)", "z, z], axis=-1)"), "    return", "inverse fails: ValueError"),
        (("    return np", "    return 'no' or np"), "def inverse", r"inverse returns shape \(\), expected \(3,\)"),
        (("np.tan(p", "np.sqrt(-1 - p"), "def inverse", "inverse returns nan for axis q1 at home"),
        (("np.tan(p", "undefined(p"), "    return", "inverse fails: NameError: name 'undefined'"),
        (('y / np.cos(p["skew"])', "y"), None, None),
        ((", z], axis", ", 0 * z], axis"), "def inverse", "inverse is singular at home"),
        (
            ("[x - y", "[x + 1e-3 * np.sign(np.sin(1e5 * x)) - y"),
            "def inverse",
            "freedom x by differences of two steps",
        ),
        (("import numpy as np", "import numpy as np\n)"), ")", "is no Python"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(change, at, says):
    assert change[0] in GANTRY
    text = GANTRY.replace(*change, 1)
    if says is None:
        nominal_mechanism_of_kinematics_file("g.py", text)
        return
    with pytest.raises(FileError, match=says) as raised:
        nominal_mechanism_of_kinematics_file("g.py", text)
    assert raised.value.path == "g.py" and raised.value.line == (at and line_of(text, at))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("x + y * np.sin", "x + 1e-6 + y * np.sin"), r"inverse\(forward\(values\)\) is 1e-06 off values"),
        (("values + p", "values - p"), "off values"),  # a round trip by the nominal parameters alone
        (("np.eye(4)", "2 * np.eye(4)"), "matrices that are no poses"),
        (("return out", "return out[:3]"), r"forward returns shape \(3, 4\), expected \(4, 4\)"),
        (("x, y, z = values", "x, y, z = values * float('nan')"), "forward returns no finite pose for axis values"),
        (("def forward(", "forward = 3\ndef other("), "forward must be a function"),
    ],
)
def test_a_forward_that_does_not_undo_inverse_is_refused(change, says):
    assert change[0] in FORWARD
    with pytest.raises(FileError, match=says) as raised:
        nominal_mechanism_of_kinematics_file("g.py", GANTRY + FORWARD.replace(*change, 1))
    assert raised.value.path == "g.py" and raised.value.line is not None


def test_a_parameter_that_moves_nothing_is_refused():
    text = GANTRY.replace("1e-3),)", '1e-3), Parameter("idle", 1.0, "m", 1e-3))')
    with pytest.raises(FileError, match="parameter 'idle' changes no axis at any pose about home"):
        nominal_mechanism_of_kinematics_file(
            "g.py", text.replace('"rad", 1e-3))', '"rad", 1e-3), Parameter("idle", 1.0, "m", 1e-3))')
        )


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("file:none.py", "none.py: no such file"),
        ("file:../delta.py", "names a Python file beside"),
        ("file:", "beside"),
    ],
)
def test_rig_toml_names_a_file_beside_it(kind, says, tmp_path):
    (tmp_path / "rig.toml").write_text(f'schema = "rig/1"\n[mechanism]\nkind = "{kind}"\n')
    with pytest.raises(FileError, match=says):
        rig.load_design(tmp_path / "rig.toml")
