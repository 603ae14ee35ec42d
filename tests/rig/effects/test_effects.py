"""Every effect, over ALL: nothing from zero parameters, nothing from a finer history, the same in text and file."""

from dataclasses import replace

import numpy as np
import pytest

from rig.effects.catalogue.effect_list import ALL, BY_NAME
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.formats.machine_geometry_and_effects_json_file import effect_from_dict, effect_to_dict
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.design import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as kinematics
from rig.model.pose import pose_difference
from rig.recording.recording_folder import Commands
from tests.rig.arms import UR10
from vision.marker_corner_prediction import State, marker_map, predict_sightings, sightings_facing_cameras_anywhere

PLACES = {
    "axis": "strut 3",
    "rig": "rig",
    "clock": "clock",
    "camera": "camera cam1",
    "cameras": "cameras",
    "marker": "marker 4",
    "markers": "markers",
    "target": "target P2",
}
EVERYWHERE = [(kind, "joint 2" if kind.of_links else PLACES[place]) for kind in ALL for place in kind.places]
SOME = {  # one instance of each, of a size that rigs show
    "scale_error": "strut3:scale=2e-4",
    "cyclic_error": "strut3:amplitude=1e-5,phase=0.3",
    "transmission_error": "strut3:profile=0/1e-5/-2e-5/1e-5",
    "backlash": "strut3:gap=4e-5",
    "hysteresis": "strut3:range=5e-3,weight=5e-3",
    "missed_steps": "strut3:jump=4e-5,time=50",
    "servo_lag": "rig:time_constant=0.01",
    "creep": "rig:fraction=3e-3,time_constant=20",
    "thermal_expansion": "rig:coefficient=2e-5",
    "warm_up": "strut3:amplitude=5e-5,time_constant=900",
    "screw_coupling": "rig:gain=0.5",
    "compliance": "rig:stiffness=5e6",
    "joint_clearance": "strut3:gap=3e-5",
    "base_expansion": "rig:coefficient=5e-5",
    "vibration": "rig:amplitude=2e-5,frequency=3.3,phase=1",
    "time_offset": "clock:offset=0.01",
    "clock_drift": "clock:rate=2e-5",
    "lens_distortion": "cam1:terms=0.01/0/0/0/0/0.02/0/0/0/0/0/0",
    "focal_drift": "cameras:per_kelvin=1e-4",
    "camera_drift": "cam1:motion=1e-4/0/0/0/1e-4/0,time_constant=900",
    "camera_sag": "cam1:yields=" + "/".join(["0"] * 12 + ["1e-4"] * 6),
    "camera_bump": "cam1:motion=1e-4/0/0/0/1e-4/0,time=50",
    "rolling_shutter": "cameras:row_time=2e-5",
    "refraction": "cam1:thickness=5e-3",
    "edge_bias": "cameras:bias=0.2",
    "print_scale": "markers:scale=1e-3",
    "face_misplacement": "4:offset=2e-4/0/0,rotation=0/0/0.01",
    "cube_misplacement": "P2:motion=2e-4/0/0/0/0/0.01",
    "marker_swap": "4:turn=1",
    "axis_coupling": "strut3:scale=1e-3,other=5",
    "settling_error": "strut3:fraction=2e-3",
    "joint_offset": "strut3:offset=3e-3,end=1",
    "travel_heating": "strut3:per_metre=1e-4,time_constant=400",
    "marker_flatness": "4:height=5e-4,corner=2",
    "encoder_interpolation": "strut3:amplitude=4e-6,periods=3003,phase=0.4",
    "base_lean": "rig:compliance=2e-5,depth=0.4",
    "link_bending": "joint2:stiffness=2e4",
}


def setting_with_links(setting):
    """The setting with an arm that holds the platform where the hexapod has it at home, and moves it little."""
    design, commands, t, sensors = setting
    middle = np.array([[0.0, -1.0, 1.2, -1.6, -1.57, 0.0]])
    arm = Arm(UR10.joints, UR10.limits)
    arm = replace(arm, base=design.mechanism.home * kinematics.forward(middle, arm)[0].inv())
    swings = 0.1 * (commands.values - commands.values.mean(axis=0)) / np.ptp(commands.values, axis=0)
    return replace(design, mechanism=arm), Commands(commands.t, middle + swings), t, sensors


@pytest.fixture
def setting_of(setting):
    """An effect, or its class -> a setting of a machine that can have it."""
    return lambda effect: setting_with_links(setting) if effect.of_links else setting


def corners(setting, effects):
    """All corners that face a camera, through machine and cameras with the effects."""
    design, commands, t, sensors = setting
    clean = motion_simulation.simulate_machine_run(design, commands, t)
    found = sightings_facing_cameras_anywhere(State(design.cameras, clean.T_base_platform, {}), marker_map(design))
    run = motion_simulation.simulate_machine_run(design, commands, t, effects, sensors, rates=True)
    return predict_sightings(
        found, State(design.cameras, run.T_base_platform, {}), marker_map(design), t, effects, sensors, run
    )


def test_the_catalogue_is_whole():
    assert len(ALL) == len(BY_NAME) and set(SOME) == set(BY_NAME)
    for kind in ALL:
        assert (
            kind.stage in ("command", "struts", "structure", "targets", "view")
            and kind.places
            and kind.parameters
            and kind.experiment
        )
        for parameter in kind.parameters:
            assert parameter.bounds[0] <= parameter.usual[0] <= parameter.usual[1] <= parameter.bounds[1]
            if parameter.role not in (
                "choice",
                "moment",
                "direction",
            ):  # a bound at what nature prefers (gain 1) would cut half of its estimates
                least = -parameter.usual[1] if parameter.signed else parameter.usual[0]
                assert (
                    parameter.bounds[0] <= least - 0.5 * abs(least) and 1.5 * parameter.usual[1] <= parameter.bounds[1]
                )


@pytest.mark.parametrize("kind, place", EVERYWHERE, ids=[f"{kind.name} at {place}" for kind, place in EVERYWHERE])
def test_zero_parameters_change_nothing(setting_of, kind, place):
    setting = setting_of(kind)
    np.testing.assert_allclose(
        corners(setting, [effect_with_valid_place_and_parameters(kind(place))]), corners(setting, []), atol=1e-9
    )


@pytest.mark.parametrize("name", SOME)
def test_some_of_it_changes_something_finite_and_keeps_shapes(setting_of, name):
    setting = setting_of(BY_NAME[name])
    clean, with_it = corners(setting, []), corners(setting, [parse_effect(f"{name}:{SOME[name]}")])
    assert with_it.shape == clean.shape and np.isfinite(with_it).all() and np.abs(with_it - clean).max() > 1e-4


@pytest.mark.parametrize("name", SOME)
def test_halving_the_step_of_the_history_changes_nothing(setting_of, name):
    design, commands, t, sensors = setting_of(BY_NAME[name])
    effect = parse_effect(f"{name}:{SOME[name]}")
    halves = (commands.t[1:] + commands.t[:-1]) / 2
    finer = np.sort(np.r_[commands.t, halves])
    fine = Commands(finer, commands.at(finer))
    one, two = (
        motion_simulation.simulate_machine_run(design, c, t, [effect], sensors).T_base_platform
        for c in (commands, fine)
    )
    np.testing.assert_allclose(pose_difference(one, two), 0, atol=1e-11)


@pytest.mark.parametrize("name", SOME)
def test_text_and_dict_say_the_same(name):
    effect = parse_effect(f"{name}:{SOME[name]}")
    assert effect_from_dict(effect_to_dict(effect)) == effect


@pytest.mark.parametrize(
    "text, says",
    [
        ("backlsh:strut3:gap=1e-5", "'backlash' meant"),
        ("backlash:rig:gap=1e-5", "cannot sit at 'rig'"),
        ("backlash:strut3:gap=1", "must lie in"),
        ("backlash:strut3:gp=1e-5", "no PARAMETER=VALUE"),
        ("backlash:strut3:gap=x", "no number"),
        ("backlash::gap=1e-5", "cannot sit|which strut"),
        ("camera_bump:cam1:motion=1/2", "has 6 numbers"),
        ("backlash:strut3:gap=1e-5/2e-5", "one number"),
    ],
)
def test_what_is_no_effect_is_refused_by_name(text, says):
    with pytest.raises(RigError, match=says):
        parse_effect(text)


def test_effects_act_together(setting):
    """Several at once is not the sum of each alone, but nearly: effects are small."""
    design, commands, t, sensors = setting
    clean = motion_simulation.simulate_machine_run(design, commands, t).T_base_platform
    both = [parse_effect("compliance:rig:stiffness=5e6"), parse_effect("screw_coupling:rig:gain=0.5")]
    alone = sum(
        pose_difference(
            clean, motion_simulation.simulate_machine_run(design, commands, t, [e], sensors).T_base_platform
        )
        for e in both
    )
    together = pose_difference(
        clean, motion_simulation.simulate_machine_run(design, commands, t, both, sensors).T_base_platform
    )
    np.testing.assert_allclose(together, alone, atol=0.01 * np.abs(alone).max())


def test_forces_balance_the_weight(setting):
    design, commands, t, sensors = setting
    state = motion_simulation.motion_of_commands(design, commands, t, (), sensors)
    run = motion_simulation.simulate_machine_run(design, commands, t)
    forces = replace(state, T=run.T_base_platform).loads()
    tips = run.T_base_platform.as_matrix()[:, None, :3, :3] @ design.mechanism.platform_joints[..., None]
    tips = tips[..., 0] + run.T_base_platform.translation[:, None]
    u = tips - design.mechanism.base_joints
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    np.testing.assert_allclose(
        (forces[..., None] * u).sum(axis=1), np.tile([0, 0, design.platform.mass * 9.80665], (len(t), 1)), atol=1e-9
    )
    arm = tips - run.T_base_platform.apply(design.platform.centre_of_mass)[:, None]
    np.testing.assert_allclose(np.cross(arm, forces[..., None] * u).sum(axis=1), 0, atol=1e-9)


def test_sizes_far_beyond_what_rigs_show_are_said_to_be_so():
    backlash, compliance = BY_NAME["backlash"], BY_NAME["compliance"]
    assert backlash.unusual("strut 1", {"gap": 1e-4}) is None and backlash.unusual("joint 1", {"gap": 4e-3}) is None
    assert "far beyond what rigs show" in backlash.unusual("strut 1", {"gap": 4e-3}), (
        "usual at a joint, where it is an angle, and not at a strut"
    )
    assert compliance.unusual("strut 1", {"stiffness": 5e6}) is None
    assert "at the least" in compliance.unusual("strut 1", {"stiffness": 5e4})
    assert compliance.unusual("joint 5", {"rms": 2e-4}) is None and "mrad" in compliance.unusual(
        "joint 5", {"rms": 1.2e-3}
    )
