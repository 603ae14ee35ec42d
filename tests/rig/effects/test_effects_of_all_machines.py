"""The laws of effects over all mechanisms: what sits there changes nothing at zero, something finite when drawn; what
cannot, says why.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.problems.platform.platform_vibration_frequency_search import rank_one_direction_and_phase_fits
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import MOTION_STAGES, Context
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from rig.effects.framework.machine_motion_and_play import Path
from rig.effects.framework.parameters_covariates_and_marker_table import Drawing
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model import mechanisms
from rig.model.base_and_link_tilt_sensors import GRAVITY
from rig.model.design import Actuator, Arm, Design, Planar2, Platform
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Commands, Sensors
from tests.rig.arms import UR10

KINDS = ("hexapod", "planar2", "arm")
MOVING = [kind for kind in ALL if kind.stage in MOTION_STAGES]
ALONE = {
    "screw_coupling": {"hexapod"},
    "base_expansion": {"hexapod", "planar2"},
    "joint_offset": {"hexapod"},
    "encoder_interpolation": {"hexapod", "planar2"},
    "link_bending": {"arm"},
}  # where not all mechanisms can have them


def setting_of(design, kind):
    """(design, Commands, t, Sensors) of a machine of a kind that moves to and fro, all logged that there is to log."""
    gravity, platform = design.gravity, Platform(3.0, np.array([0.01, 0.0, 0.02]), np.zeros(3))
    if kind == "planar2":
        mechanism = Planar2([[0.0, 0.0], [1.0, 0.0]], [[0.6, 1.2], [0.6, 1.2]])
        gravity = np.array([0.0, -9.80665, 0.0])
    else:
        mechanism = Arm(UR10.joints, [[-2.5, 2.5]] * 6) if kind == "arm" else design.mechanism
    design = Design(kind, gravity, mechanism, None, Actuator(0.004, "cardan-cardan", None), platform, (), ())
    low, high = mechanisms.kinematics_of(mechanism).travel_ranges(mechanism).T
    rng = np.random.default_rng(5)
    t = np.cumsum(np.r_[0.0, rng.uniform(0.5, 4, 80)])
    values = (low + high) / 2 + 0.6 * (high - low) / 2 * rng.uniform(-1, 1, (81, len(low)))
    values[10:20] = values[10]
    channels = {f"strut{i + 1}_temperature_C": np.array([20.0, 24.0]) for i in range(len(low))} if kind != "arm" else {}
    channels |= {name: np.full(2, own) for name, own in zip(GRAVITY, design.gravity)}  # as an accelerometer has it
    sensors = Sensors(np.array([0.0, 1e3]), {"ambient_temperature_C": np.array([21.0, 25.0]), **channels})
    return design, Commands(t, values), np.sort(rng.uniform(1, t[-1], 60)), sensors


def context_of(setting):
    design, commands, t, sensors = setting
    T = motion_simulation.simulate_machine_run(design, commands, t).T_base_platform
    return Context(
        design, t, sensors, replace(motion_simulation.motion_of_commands(design, commands, t, (), sensors), T=T)
    )


@pytest.fixture(scope="module", params=KINDS)
def mechanism_setting(request, design):
    """(kind of mechanism, its setting, its Context)."""
    setting = setting_of(design, request.param)
    return request.param, setting, context_of(setting)


def test_an_interface_is_kept_by_every_mechanism(mechanism_setting):
    kind, (design, *_), context = mechanism_setting
    module, m = mechanisms.kinematics_of(design.mechanism), context.motion
    assert mechanisms.axis_place_texts(design.mechanism) == tuple(f"{module.AXIS} {i + 1}" for i in range(len(m.home)))
    power = module.axis_forces_and_torques(m.T, m.lengths, design.mechanism, np.zeros((60, 6)))
    assert power.shape == m.lengths.shape and not power.any()


@pytest.mark.parametrize("kind", MOVING, ids=lambda kind: kind.name)
def test_zero_changes_nothing_and_a_drawn_one_something(mechanism_setting, kind):
    mechanism, (design, commands, t, sensors), context = mechanism_setting
    if mechanism not in ALONE.get(kind.name, KINDS):
        with pytest.raises(RigError, match=f"{kind.name} takes"):
            kind.sites(context)
        return
    clean = motion_simulation.simulate_machine_run(design, commands, t, (), sensors).T_base_platform
    rng = np.random.default_rng(1)
    drawing = Drawing(design, t, context.motion, lambda effect, camera: 1.0)
    for place in _sites(kind, context)[-2:]:
        zero = motion_simulation.simulate_machine_run(
            design, commands, t, [_other(effect_with_valid_place_and_parameters(kind(place)), context)], sensors
        )
        np.testing.assert_allclose(pose_difference(zero.T_base_platform, clean), 0, atol=1e-9)
        found = motion_simulation.simulate_machine_run(
            design, commands, t, [effect_with_valid_place_and_parameters(kind.drawn(place, drawing, rng))], sensors
        )
        moved = np.abs(pose_difference(found.T_base_platform, clean))
        assert moved.shape == (60, 6) and np.isfinite(moved).all() and 1e-9 < moved.max() < 0.5


def _sites(kind, context):
    """Places at which an effect can sit; of what is fitted by an instrument of its own, and so not searched, too."""
    return kind.places if kind.instrumented else kind.sites(context)


def _other(effect, context):
    return (
        replace(effect, other=2.0) if effect.place == context.motion.places[0] and hasattr(effect, "other") else effect
    )


@pytest.mark.parametrize("kind", MOVING, ids=lambda kind: kind.name)
def test_columns_are_the_derivatives_of_the_model(mechanism_setting, kind):
    """A candidate's columns times its coefficients are what its effect does."""
    mechanism, (design, *_), context = mechanism_setting
    if (
        mechanism not in ALONE.get(kind.name, KINDS)
        or kind.stage == "command"
        or "frequency" in {p.role for p in kind.parameters}
    ):
        return
    rng = np.random.default_rng(2)
    for place in _sites(kind, context)[-2:]:
        for candidate in kind.candidates(place, context):
            shape = candidate.grid[len(candidate.grid) // 2]
            columns = candidate.deviation(shape, context.motion)
            assert columns.shape == (*context.motion.lengths.shape, max(len(candidate.linear), 1))
            coefficients = np.array([column.step for column in candidate.linear]) * rng.uniform(
                0.5, 2, len(candidate.linear)
            )
            effect = effect_with_valid_place_and_parameters(candidate.effect(shape, coefficients))
            predicted = columns @ (coefficients if len(coefficients) else np.ones(1))
            np.testing.assert_allclose(
                effect.deviation(context.motion), predicted, rtol=1e-6, atol=1e-3 * np.abs(predicted).max() * 1e-3
            )


def test_covariates_are_drawn_for_every_axis(mechanism_setting):
    mechanism, _, context = mechanism_setting
    drawing = Drawing(context.design, context.t, context.motion, lambda effect, camera: 1.0)
    for kind in MOVING:
        if mechanism in ALONE.get(kind.name, KINDS):
            shown = kind.drawn(_sites(kind, context)[0], drawing, np.random.default_rng(3)).covariate(context.motion)
            assert (
                len(shown.values) == 60
                and np.isfinite(shown.values).all()
                and "," in shown.label
                or "turn" in shown.label
            )


def test_what_a_machine_lacks_is_said(design):
    bare = setting_of(design, "arm")
    bare = (replace(bare[0], platform=Platform(None, None, None)), *bare[1:])
    context = context_of(bare)
    for text, says in (
        ("compliance:joint2:stiffness=1e5", "needs .platform. mass"),
        ("compliance:joint2:moments=1e-6", "takes up to 24 moments"),
        ("screw_coupling:rig:gain=0.5", "takes a hexapod"),
        ("backlash:strut2:gap=1e-5", "axes are joint 1 to joint 6"),
        ("axis_coupling:joint2:scale=1e-3,other=9", "1 to 6"),
        ("axis_coupling:joint2:scale=1e-3,other=2", "than its own"),
    ):
        with pytest.raises(RigError, match=says):
            motion_simulation.simulate_machine_run(*bare[:3], [parse_effect(text)], bare[3])
    found = [
        c
        for name in ("compliance", "joint_clearance")
        for kind in ALL
        if kind.name == name
        for c in kind.candidates("joint 2", context)
    ]
    assert [c.kind.name for c in found] == ["compliance"] * 3 + ["joint_clearance"] and all(c.grid for c in found)
    links = [c.grid[0]["_count"] for c in found[:3]]  # joints 2 to 4 are parallel, so that their links all load it
    assert links == [16, 20, 24] and np.diff([len(c.linear) for c in found[:3]]).min() > 0  # linear in the weights


def test_effects_that_show_on_the_way_are_not_asked_for_at_rest(design):
    design, commands, t, sensors = setting_of(design, "planar2")
    still = Commands(commands.t, np.tile(commands.values[:1], (len(commands.t), 1)))
    context = context_of((design, still, t, sensors))
    for kind in MOVING:
        if kind.moving:
            with pytest.raises(RigError, match="at rest"):
                kind.sites(context)


def test_a_joint_holds_its_links_as_newton_and_euler_say(design):
    """The regressor times masses and mass moments is the torque of recursive Newton-Euler at rest."""
    from rig.model.mechanisms import arm_dynamics_and_step_by_step_kinematics
    from rig.model.mechanisms import arm_kinematics_limits_and_loads as arm

    rng, mechanism = np.random.default_rng(4), Arm(UR10.joints, UR10.limits)
    q, mass, centre = rng.uniform(-2, 2, (20, 6)), rng.uniform(1, 5, 6), rng.uniform(-0.1, 0.1, (6, 3))
    own = np.column_stack([mass, mass[:, None] * centre]).ravel()
    torque = arm_dynamics_and_step_by_step_kinematics.joint_torques(
        q,
        np.zeros(6),
        np.zeros(6),
        mechanism,
        arm_dynamics_and_step_by_step_kinematics.LinkMasses(mass, centre, np.zeros((6, 3, 3))),
        design.gravity,
    )
    np.testing.assert_allclose(arm.link_weight_loads(None, q, mechanism, design.gravity) @ own, torque, atol=1e-9)


def test_links_that_grow_move_the_hand_as_longer_links_do():
    from rig.model.mechanisms import arm_kinematics_limits_and_loads as arm

    q, grown = (
        np.random.default_rng(6).uniform(-2, 2, (10, 6)),
        replace(UR10, joints=UR10.rows * [1, 1 + 1e-6, 1 + 1e-6, 1, 1]),
    )
    sway = arm.axis_deviation_and_sway_by_member_growth(None, q, UR10, np.full((10, 6), 1e-6))[1]
    np.testing.assert_allclose(sway, pose_difference(arm.forward(q, UR10), arm.forward(q, grown)), atol=1e-11)


def test_a_shaking_has_one_notation(design):
    """A direction and a phase may be written in many ways: all shake alike, and `written` is the same for all."""
    setting = setting_of(design, "hexapod")
    motion = context_of(setting).motion
    texts = (
        "mode=0.6/0/0.8/0.5/0/0,phase=1",
        "mode=1.2/0/1.6/1/0/0,phase=1",
        f"mode=-0.6/0/-0.8/-0.5/0/0,phase={1 - np.pi}",
    )
    shakes = [parse_effect(f"vibration:rig:amplitude=2e-5,frequency=3.3,{text}") for text in texts]
    for shake in shakes:
        np.testing.assert_allclose(shake.sway(motion), shakes[0].sway(motion), atol=1e-18)
        np.testing.assert_allclose(shake.written().sway(motion), shakes[0].sway(motion), atol=1e-18)
        np.testing.assert_allclose(
            [*shake.written().mode, shake.written().phase], [0.6, 0, 0.8, 0.5, 0, 0, 1], atol=1e-12
        )


def test_one_direction_is_found_among_twelve_numbers():
    rng = np.random.default_rng(7)
    X = rng.normal(size=(5, 200, 12)) * np.tile([1, 1, 1, 50, 50, 50], 2)
    angle, direction = rng.uniform(0, np.pi, 5), rng.normal(size=(5, 6))
    phase = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x = np.einsum("kp,ki->kpi", phase, direction).reshape(5, 12)
    G = np.swapaxes(X, 1, 2) @ X
    drops, found = rank_one_direction_and_phase_fits(np.einsum("kij,kj->ki", G, x), G)
    np.testing.assert_allclose(found, x, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(drops, np.einsum("ki,kij,kj->k", x, G, x))


def test_a_last_step_does_not_depend_on_knots_or_waits():
    t, values = (
        np.array([0.0, 1, 2, 3, 5, 6, 9]),
        np.array([[0.0, 0], [0, 0], [1, 2], [1, 2], [3, 0], [4, -1], [4, -1]]),
    )
    path = Path(t, values, np.array([1, 2, 3, 4, 5, 6]))
    expected = [[0, 0], [1, 2], [1, 2], [2, -2], [3, -3], [3, -3]]  # the last two knots lie on one straight way
    np.testing.assert_allclose(path.last_step, expected)
    np.testing.assert_allclose(path.with_knots(np.linspace(0.1, 8.9, 40)).last_step, expected, atol=1e-12)
