"""Physics in an arm's calibration: whatever moves its joints or its hand is undone by commands, and what was found of
it is sure as it says.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.correction.timed_command_sequence_and_pose_space_correction_map import Pace
from calib.files import calibration_file
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_certification import start_arm_of_fit
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_error_model_and_instrument_observations import observations_of_samples
from calib.models.arm.joint_effect_fit_and_held_out_scatter import History, Prior, fit_geometry_and_effects
from calib.models.wanted_pose_commands import commands_along_route
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.cli.command_line import main
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.pose import pose_difference
from rig.planning import recording_plan as plan
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout import shipped_arms_and_layouts
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import write_poses
from rig.recording.recording_folder import Poses, Sensors
from synthetic import random_true_machine_and_truth_file, recording_simulation

MOVING = (
    "backlash:joint 2:gap=4e-4",
    "hysteresis:joint 2:range=0.5,weight=0.001",
    "cyclic_error:joint 2:amplitude=3e-4,order=40,phase=0.5",
    "transmission_error:joint 1:profile=0/4e-4/-3e-4/1e-4",
    "servo_lag:joint 1:time_constant=0.02",
    "scale_error:joint 1:scale=4e-4",
    "creep:rig:fraction=0.002,time_constant=30",
    "axis_coupling:joint 2:scale=3e-4,other=1",
    "thermal_expansion:rig:coefficient=2e-5",
)
SAG = "compliance:joint 2:moments=" + "/".join(
    ["0", "3e-5", "2e-5", "0"] * 2 + ["0"] * 16
)  # a horizontal arm's joints carry no weight
GAP = "backlash:joint 2:gap=4e-4"


def arm_named(tmp_path, name):
    (tmp_path / "rig.toml").write_text(shipped_arms_and_layouts.shipped_arm_rig_toml(name))
    return design_from_rig_toml.load_design(tmp_path / "rig.toml")


def known_to_be(design, *effects):
    """Calibration of an arm that is as stated, but for effects."""
    m, n = design.mechanism, len(fit_coordinates_of_effects(effects))
    physics = Physics(
        effects,
        1e-12 * np.eye(n),
        np.zeros((12 + 5 * len(m.joints), n)),
        design.gravity,
        design.actuator,
        design.platform,
        {"ambient_temperature_C": (21.0, 1.0)},
    )
    visited = sobol_configurations(m.limits, 40, 0.7, 5)
    return Calibration(
        ArmCorrection(m, m, (None,) * len(m.joints), visited),
        1e-14 * np.eye(12 + 5 * len(m.joints)),
        np.zeros(6),
        (),
        (),
        None,
        {},
        None,
        physics,
    )


@pytest.mark.parametrize(
    ("name", "text"), [("puma560", text) for text in (*MOVING, SAG)] + [("scara", text) for text in MOVING]
)
def test_whatever_moves_the_arm_is_undone(tmp_path, name, text):
    design = arm_named(tmp_path, name)
    calibration = known_to_be(design, parse_effect(text), parse_effect("scale_error:joint 1:scale=1e-4"))
    m, count = design.mechanism, 8
    T = arm_error_model_and_instrument_observations.predicted_target_poses(
        sobol_configurations(m.limits, count, 0.6, 3), m
    )
    t = 60 + 40.0 * np.arange(count)
    warm = Sensors(np.array([0.0, 500.0]), {"ambient_temperature_C": np.array([20.0, 27.0])})
    done = commands_along_route(calibration, T, np.zeros(len(m.joints)), Pace(t, 0.0, 0.5, None), warm)
    run = motion_simulation.simulate_machine_run(
        design, done.route.commands(done.values), t, calibration.physics.effects, warm
    )
    rest = pose_difference(run.T_base_platform, T)
    atol = 1e-8 if name == "puma560" else 2e-5  # what a growing link leaves to four joints is no joint's to undo
    assert np.abs(rest[:, :3]).max() < 1e-8 and np.abs(rest[:, 3:]).max() < atol
    plain = calibration.correction.inverse_without_physics(T)
    bare = motion_simulation.simulate_machine_run(
        design, done.route.commands(plain), t, calibration.physics.effects, warm
    )
    assert np.abs(pose_difference(bare.T_base_platform, T)).max() > 1e-5
    np.testing.assert_allclose(done.T_base_platform.as_matrix(), T.as_matrix(), atol=1e-9)


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """(Recording of a SCARA whose second joint has play, its secret)."""
    at = tmp_path_factory.mktemp("scara")
    design, rng = arm_named(at, "scara"), np.random.default_rng(3)
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, (parse_effect(GAP),))
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, plan.build_plan(design, "sobol:70", 3), rng),
        at / "rec",
        shipped_arms_and_layouts.shipped_arm_rig_toml("scara"),
        rng,
    )
    return recording_folder.load_recording(at / "rec"), secret


def fitted(read, effects, before=None, rows=slice(None)):
    """Together of a recording's samples, from rough effects on."""
    sampled = sample_recording(read)
    samples = sampled.samples.take(np.arange(len(sampled.samples))[rows])
    start = start_arm_of_fit(observations_of_samples(samples), read.design.mechanism, sampled.instrument)
    return fit_geometry_and_effects(samples, History(read.design, read.commands, read.sensors), start, effects, before)


@pytest.mark.slow
def test_a_gap_is_found_as_sure_as_it_says_whatever_it_starts_from(played):
    read, _ = played
    found = [fitted(read, (parse_effect(f"backlash:joint 2:gap={gap}"),)) for gap in (1e-5, 9e-4)]
    sigma = np.sqrt(found[0].own[0, 0])
    assert 1e-6 < sigma < 3e-5 and abs(found[0].effects[0].gap - 4e-4) < 3 * sigma
    assert found[0].effects[0].gap == pytest.approx(found[1].effects[0].gap, abs=0.02 * sigma)
    sure = fitted(read, (parse_effect(GAP),), Prior(np.array([3e-4]), np.array([sigma])))
    between = (found[0].effects[0].gap + 3e-4) / 2  # as sure of the one as of the other
    assert sure.effects[0].gap == pytest.approx(between, abs=0.05 * sigma) and sure.own[0, 0] == pytest.approx(
        sigma**2 / 2, rel=0.05
    )


def test_what_is_held_out_says_nothing_of_the_gap(played):
    """Held-out poses are poisoned: the gap that foretells them is found without."""
    read, _ = played
    found = fitted(read, (parse_effect(GAP),))
    held = np.arange(len(found.measured)) % 3 == 0
    moved = found.measured.T_base_platform.as_matrix()
    moved[held, :3, 3] += 0.05
    spoilt = replace(found, measured=replace(found.measured, T_base_platform=RigidTransform.from_matrix(moved)))
    np.testing.assert_allclose(spoilt.without(held).known, found.without(held).known, atol=1e-12)
    assert np.abs(found.without(held).known - found.samples.known).max() > 1e-7


def drives(tmp_path, capsys, name, effects, without=(), another=False):
    """{"c", "plain"}: what `rig verify --wanted --json` says of poses that an arm was told to take, with the physics
    found and without.

    without : how lines begin that its rig.toml lacks; another : whether another recording than the one calibrated was
        diagnosed
    """
    rig, truth = tmp_path / "rig.toml", tmp_path / "truth.json"
    text = shipped_arms_and_layouts.shipped_arm_rig_toml(name)
    rig.write_text("\n".join(line for line in text.splitlines() if not (without and line.startswith(without))) + "\n")

    def printed(*words):
        assert main([str(word) for word in words]) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    options = [word for effect in effects for word in ("--effect", effect)]
    printed(
        "simulate", rig, "--plan", "sobol:120", *options, "--seed", "3", "--out", tmp_path / "rec", "--truth", truth
    )
    printed("diagnose", tmp_path / "rec", "--out", tmp_path / "d")
    if another:
        printed(
            "simulate",
            rig,
            "--machine",
            truth,
            "--plan",
            "sobol:100",
            "--seed",
            "9",
            "--out",
            tmp_path / "rec",
            "--force",
        )
    output = printed("calibrate", tmp_path / "rec", "--diagnosis", tmp_path / "d", "--out", tmp_path / "c.json")
    assert "beyond the geometry: the identified effects" in output and "compensated by commands: " in output
    printed("calibrate", tmp_path / "rec", "--out", tmp_path / "plain.json")
    known = calibration_file.load(tmp_path / "c.json").correction
    ends = np.stack([known.visited.min(axis=0), known.visited.max(axis=0)], axis=1)
    write_poses(
        tmp_path / "w.csv",
        Poses(
            np.arange(60),
            arm_error_model_and_instrument_observations.predicted_target_poses(
                sobol_configurations(ends, 60, 0.7, 17), known.fitted
            ),
            None,
        ),
    )
    out = {}
    for kind in ("c", "plain"):
        printed("correct", tmp_path / f"{kind}.json", "--poses", tmp_path / "w.csv", "--out", tmp_path / f"{kind}.csv")
        printed(
            "simulate",
            rig,
            "--machine",
            truth,
            "--plan",
            f"commands:{tmp_path / f'{kind}.csv'}",
            "--seed",
            "11",
            "--out",
            tmp_path / f"drive-{kind}",
        )
        reached_poses = tmp_path / f"{kind}.poses.csv"
        out[kind] = json.loads(
            printed(
                "verify",
                tmp_path / f"{kind}.json",
                tmp_path / f"drive-{kind}",
                "--wanted",
                reached_poses if reached_poses.exists() else tmp_path / "w.csv",
                "--json",
            )
        )["wanted"]
    return out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "effects", "without", "another"),
    [
        (
            "puma560",
            ("hysteresis:joint 2:range=0.5,weight=0.001", "cyclic_error:joint 3:amplitude=3e-4,order=3,phase=0.5"),
            (),
            False,
        ),
        ("puma560", (SAG, "transmission_error:joint 4:profile=0/4e-4/-3e-4/1e-4/-2e-4"), (), True),
        ("scara", ("backlash:joint 2:gap=1e-3",), ("rotation_sigma",), False),
    ],
)
def test_commands_undo_what_was_found_as_sure_as_they_say(tmp_path, capsys, name, effects, without, another):
    """The bound is the stated uncertainty, the instrument's own included; positions alone are measured of the last
    arm.
    """
    judged = drives(tmp_path, capsys, name, effects, without, another)
    with_physics, plain = (judged[kind]["position"]["rms"] for kind in ("c", "plain"))
    assert 0.8 < with_physics / judged["c"]["stated_uncertainty"]["position"] < 1.2
    assert plain > 1.5 * with_physics
