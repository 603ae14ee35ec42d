"""An arm's C file: joint commands become those of `rig correct`, and by other kinematics give the wanted poses."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

from calib.api.correct import CorrectOptions, correct
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction_field_methods_fitting_combination_and_json import fit_field
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import FieldSamples
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_identification_and_joint_profiles import Profile
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout import shipped_arms_and_layouts
from tests.calib import secret_arms
from tests.calib.controllers_in_c import (
    BAD_POSE,
    LONGEST,
    NO_STATE,
    NOT_CONVERGED,
    OK,
    OUT_OF_STROKE,
    Controller,
    c_text,
    needs_compiler,
    pointer,
)
from tests.rig.arms import GANTRY, SCARA, SEVEN, STANFORD, UR10
from tests.truth import kinematics, rigid

SAME = 1e-9  # rad, m
MANY, AT_ONCE = 1_000_000, 1 << 15  # joint commands
REGULAR = 0.05  # least singular value of a Jacobian; nearer to a singularity `rig correct` may change the posture
PUMA = shipped_arms_and_layouts.load_shipped_arm_design("puma560").mechanism
ARMS = {"puma": PUMA, "ur10": UR10, "stanford": STANFORD, "scara": SCARA, "gantry": GANTRY}
GEARS = (
    "backlash:joint 2:gap=4e-4",
    "scale_error:joint 1:scale=4e-4",
    "cyclic_error:joint 2:amplitude=3e-4,order=40,phase=0.5",
    "axis_coupling:joint 2:scale=3e-4,other=1",
)


def slow(name):
    """A case of the long tests."""
    return pytest.param(name, marks=pytest.mark.slow)


def truly(nominal, seed=3, profiled=True):
    """ArmCorrection of a secret arm: other figures, and profiles of the second joint and the last."""
    rng, n = np.random.default_rng(seed), len(nominal.joints)
    fitted = secret_arms.secret(nominal, rng)
    owners = replace(nominal, base=secret_arms.BASE, tool=secret_arms.TOOL)
    parts = [None] * n
    for j in {min(1, n - 1), n - 1} if profiled else ():
        others = 1e-4 * rng.normal(size=(n, 2))
        others[j] = 0.0
        parts[j] = Profile(j, np.array([1.0, 3.0, 16.0]), 1e-4 * rng.normal(size=6), others)
    return ArmCorrection(owners, fitted, tuple(parts), sobol_configurations(nominal.limits, 64, 0.8, 5))


def calibration_of(correction, *texts):
    """Calibration of it, and of effects at its joints."""
    effects = tuple(parse_effect(text) for text in texts)
    n, p = len(fit_coordinates_of_effects(effects)), 12 + 5 * len(correction.nominal.joints)
    design = secret_arms.design(correction.nominal)
    known = (design.gravity, design.actuator, design.platform, {})
    physics = Physics(effects, 1e-12 * np.eye(n), np.zeros((p, n)), *known) if texts else None
    correction = replace(correction, physics=tuple(f"{e.name} at {e.place}" for e in effects))
    return Calibration(correction, 1e-14 * np.eye(p), np.zeros(6), (), (), None, {}, None, physics)


def regular(correction, count, fill=0.8, seed=9):
    """(m, joints) commands of the nominal arm all over its limits, none near a singularity."""
    q = sobol_configurations(correction.nominal.limits, count, fill, seed)
    J = mechanism.jacobian(q, correction.fitted)
    rank = min(6, q.shape[1])
    return q[np.linalg.svd(J, compute_uv=False)[:, rank - 1] > REGULAR]


def visiting(calibration, q):
    """The calibration as of a recording that visited q: `rig correct` takes a pose as these took it."""
    return replace(calibration, correction=replace(calibration.correction, visited=q))


def reached(correction, commands):
    """(n, 4, 4) where the hand really comes to, by kinematics and profiles of the tests' own."""
    fitted, values = correction.fitted, np.array(commands)
    for j, part in enumerate(correction.remainder):
        if part is not None:
            half, away = len(part.orders), np.zeros(len(values))
            for k, order in enumerate(part.orders):
                away += part.own[k] * np.sin(order * commands[:, j])
                away += part.own[half + k] * np.cos(order * commands[:, j])
            for i, (sine, cosine) in enumerate(part.others):
                away += sine * np.sin(commands[:, i]) + cosine * np.cos(commands[:, i])
            values[:, j] -= away
    n = len(fitted.joints)
    own = kinematics.Arm(fitted.rows[:, :4], fitted.slides, np.zeros(n), fitted.limits, fitted.rows[:, 4])
    return fitted.base.as_matrix() @ own.forward(values) @ fitted.tool.as_matrix()


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """name -> (Calibration, Controller) of an arm without effects, each compiled once."""
    found = {}

    def make(name):
        if name not in found:
            calibration = calibration_of(truly(ARMS[name]))
            found[name] = calibration, Controller(calibration, tmp_path_factory.mktemp("c"))
        return found[name]

    return make


@needs_compiler
@pytest.mark.parametrize("name", [slow(name) if name == "gantry" else name for name in ARMS])
def test_joint_commands_become_those_of_rig_correct(compiled, name):
    calibration, controller = compiled(name)
    q = regular(calibration.correction, 300)
    commands, status = controller(q)
    wanted = mechanism.forward(q, calibration.correction.nominal)
    done = correct(visiting(calibration, q), wanted)
    assert len(q) > 80 and (status == OK).all()
    assert np.abs(commands - done.values).max() < SAME
    assert np.abs(commands - q).max() > 1e-4


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", ARMS)
def test_very_many_joint_commands_become_those_of_rig_correct(compiled, name, capsys):
    calibration, controller = compiled(name)
    count, worst, most, total, seed = 0, 0.0, 0.0, 0.0, 2
    while count < MANY:
        q = regular(calibration.correction, AT_ONCE, seed=seed)
        commands, status = controller(q)
        assert (status == OK).all()
        done = calibration.correction.inverse(mechanism.forward(q, calibration.correction.nominal), q)
        worst = max(worst, np.abs(commands - done).max())
        slowest, mean = controller.took(q, LONGEST)
        most, total = max(most, slowest), total + mean * len(q)
        count, seed = count + len(q), seed + 1
    with capsys.disabled():
        print(
            f"\n{name}: {count} joint commands, {worst:.2g} rad or m at most; the slowest {most * 1e6:.2f} us, "
            f"{total / count * 1e6:.2f} us in the mean"
        )
    assert worst < SAME and most < LONGEST


shares = st.lists(st.floats(-1, 1), min_size=6, max_size=6)


@needs_compiler
@pytest.mark.parametrize("name", ["puma", "ur10", "stanford"])
@given(places=st.lists(shares, min_size=1, max_size=4))
@settings(max_examples=60, deadline=None)
def test_wherever_the_arm_is_sent_it_comes_by_other_kinematics(compiled, name, places):
    """Singular postures too: what is commanded gives the pose, and else the joints are refused."""
    calibration, controller = compiled(name)
    low, high = calibration.correction.nominal.limits.T
    q = (low + high) / 2 + 0.45 * (high - low) * np.array(places)
    commands, status = controller(q)
    good = status == OK
    assert np.isnan(commands[~good]).all() and set(status[~good]) <= {OUT_OF_STROKE, NOT_CONVERGED}
    if good.any():
        nominal = calibration.correction.nominal
        own = kinematics.Arm(nominal.rows[:, :4], nominal.slides, np.zeros(6), nominal.limits, nominal.rows[:, 4])
        wanted = nominal.base.as_matrix() @ own.forward(q[good]) @ nominal.tool.as_matrix()
        assert np.abs(rigid.errors(reached(calibration.correction, commands[good]), wanted)).max() < SAME


@needs_compiler
def test_seven_joints_give_the_pose_with_little_motion(tmp_path):
    """`rig correct` picks one of a family of joint values; the file stays next to those commanded."""
    correction = truly(SEVEN)
    q = regular(correction, 200)
    commands, status = Controller(calibration_of(correction), tmp_path)(q)
    wanted = mechanism.forward(q, correction.nominal).as_matrix()
    assert (status == OK).all() and np.abs(rigid.errors(reached(correction, commands), wanted)).max() < SAME
    near = correction.near(RigidTransform.from_matrix(wanted), q)
    least = np.linalg.norm(near - q, axis=1)
    assert (np.linalg.norm(commands - q, axis=1) < 1.2 * least + 1e-4).all()


@needs_compiler
@pytest.mark.parametrize("kind", ["simplex", *map(slow, ("linear", "axes", "radial", "polynomial"))])
def test_corrections_over_the_joint_space_are_contained(tmp_path, kind):
    box = np.array([0.3, -1.2, 1.4, -0.7, -1.4, 0.2])[:, None] + [-0.15, 0.15]
    grid = np.stack(np.meshgrid(*np.linspace(box[:, 0], box[:, 1], 2, axis=1), indexing="ij"), -1).reshape(-1, 6)
    x = grid if kind in ("simplex", "linear") else sobol_configurations(box, 120, 1.0, 5)
    values = 2e-4 * np.sin(2 * x + x[:, ::-1])
    field = fit_field(kind, FieldSamples(x, values, np.full(x.shape, 1e-14), box))
    calibration = calibration_of(replace(truly(UR10, profiled=False), extension=field))
    q = sobol_configurations(box, 60, 0.9, 3)
    commands, status = Controller(calibration, tmp_path)(q)
    done = correct(visiting(calibration, q), mechanism.forward(q, calibration.correction.nominal))
    assert (status == OK).all() and np.abs(commands - done.values).max() < SAME


@needs_compiler
@pytest.mark.parametrize("name", [slow("puma"), "scara"])
def test_play_and_gears_are_undone_in_the_order_of_the_moves(tmp_path, name):
    calibration = calibration_of(truly(ARMS[name]), *GEARS)
    controller = Controller(calibration, tmp_path)
    q = regular(calibration.correction, 60)
    commands, status = controller(q)
    wanted = mechanism.forward(q, calibration.correction.nominal)
    done = correct(visiting(calibration, q), wanted)
    assert (status == OK).all() and np.abs(commands - done.values).max() < SAME
    half = q[len(q) // 2 :]
    assert controller.start(commands[len(q) // 2 - 1]) == OK
    second_half = correct(
        visiting(calibration, half), wanted[len(q) // 2 :], CorrectOptions(start=commands[len(q) // 2 - 1])
    )
    assert np.abs(controller(half)[0] - second_half.values).max() < SAME
    controller.state = None
    assert (controller(q[:1])[1] == NO_STATE).all()


def test_what_moves_the_hand_beyond_its_joints_is_refused_by_name():
    known = calibration_of(truly(PUMA), "thermal_expansion:rig:coefficient=2e-5")
    with pytest.raises(RigError, match="no C file states thermal expansion at rig"):
        c_text(replace(known, physics=replace(known.physics, channels={"ambient_temperature_C": (21.0, 1.0)})))


@needs_compiler
def test_what_cannot_be_commanded_is_refused_and_changes_nothing(compiled):
    _, controller = compiled("puma")
    assert controller.start() == OK
    for bad in (np.nan, np.inf):
        row, out = np.r_[np.zeros(5), bad], np.full(6, 7.0)
        status = controller.library.rig_correct(*map(pointer, (row, None, controller.state, out)))
        assert status == BAD_POSE and (out == 7).all()
    assert (controller.state[:6] == 0).all()


@needs_compiler
def test_limits_end_where_rig_correct_ends_them(tmp_path):
    """All about the limits, which are narrower than a turn: each is refused by both or by none."""
    correction = truly(STANFORD)
    low, high = np.maximum(STANFORD.limits[:, 0], -1.5), np.minimum(STANFORD.limits[:, 1], 1.5)
    correction = replace(correction, nominal=replace(correction.nominal, limits=np.stack([low, high], axis=1)))
    q = regular(correction, 500, fill=1.002)
    _, status = Controller(calibration_of(correction), tmp_path)(q)
    near = correction.near(mechanism.forward(q, correction.nominal), q)
    inside = (mechanism.signed_limit_excess(near, correction.nominal) == 0).all(axis=1)
    assert 0 < inside.sum() < len(q) and ((status == OK) == inside).all() and set(status) == {OK, OUT_OF_STROKE}


@needs_compiler
@pytest.mark.slow
def test_a_position_out_of_the_reach_of_the_real_arm_is_refused(tmp_path):
    """The nominal arm is longer than the real one: stretched out, it means poses that nothing reaches."""
    nominal = replace(PUMA, joints=PUMA.rows * np.array([1.0, 1.05, 1.05, 1.0, 1.0]))
    correction = ArmCorrection(nominal, PUMA, (None,) * 6, np.zeros((1, 6)))
    q = sobol_configurations(PUMA.limits, 5000, 1.0, 1)
    real, believed = (np.linalg.norm(mechanism.forward(q, arm).translation, axis=1) for arm in (PUMA, nominal))
    stretched = q[believed > 1.02 * real.max()]
    assert len(stretched) and (Controller(calibration_of(correction), tmp_path)(stretched)[1] == NOT_CONVERGED).all()


@pytest.mark.parametrize("name", ARMS)
def test_nothing_is_allocated_and_no_loop_is_open(name):
    text = c_text(calibration_of(truly(ARMS[name])))
    assert re.findall("#include.*", text) == ["#include <math.h>"]
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|goto|while|do|float|long)\b", code)
    bodies = re.findall(r"^[\w ]+?\b(\w+)\([^;{]*\)\n\{\n(.*?)^\}", code, flags=re.MULTILINE | re.DOTALL)
    order = [found for found, _ in bodies]
    assert order[-1] == "rig_correct" and {"forward", "missing", "solve", "settle"} <= set(order)
    for i, (_, body) in enumerate(bodies):  # none calls itself or one that comes after it: no recursion
        assert not set(re.findall(r"\b(\w+)\(", body)) & set(order[i:])


def test_profiles_alone_are_named_in_the_head():
    text = c_text(calibration_of(truly(STANFORD)))
    assert "remainder of joint 2; remainder of joint 6" in text and "const double joints[6]" in text
