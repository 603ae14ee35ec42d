"""Physics in a calibration: taken in, kept, undone in time whatever it is, with approaches and uncertainties that are
honest.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    correction_with_pose_space_map,
    fit_field,
    home_pose,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import FieldSamples
from calib.correction.machine_correction import Correction, fit_geometry_and_remainder_of_correction
from calib.correction.physical_effects_of_calibration_and_their_compensation import (
    Machine,
    Physics,
    Unknown,
    command_uncertainty_from_unknown_history,
    compensated_commands_at_poses,
)
from calib.correction.timed_command_sequence_and_pose_space_correction_map import HOLDING, TURNING, Pace, timed_route
from calib.diagnosis.geometry_refitted_with_diagnosed_effects import Findings
from calib.files import calibration_file
from calib.models.wanted_pose_commands import commands_along_route
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.cli.command_line import main
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import MOTION_STAGES
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import FileError, RigError, Unreachable
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference, pose_to_vector
from rig.planning import configuration_generators
from rig.recording.recording_folder import Sensors
from synthetic import random_true_machine_and_truth_file
from tests.bench.physics import ROUTE, effect_of
from tests.calib.rigs_with_unmodelled_physics import driven, learnt, measured_by, three_ways, write
from tests.rig.effects.test_effects import SOME

CHANNELS = {
    "ambient_temperature_C": (20.5, 0.8),
    "payload_mass_kg": (0.0, 2.0),
    **{f"strut{i + 1}_temperature_C": (22.0, 0.9) for i in range(6)},
}
MOVING = [kind for kind in ALL if kind.stage in MOTION_STAGES and kind.lasting and not kind.of_links]


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """(text, Design) of a rig whose poses an outside instrument sees."""
    text = measured_by()
    path = tmp_path_factory.mktemp("seen") / "rig.toml"
    path.write_text(text)
    return text, design_from_rig_toml.load_design(path)


def physics_of(design, *effects, sigma=0.02):
    """Physics of effects whose coordinates are known to a share of themselves."""
    own = np.diag([(sigma * c.read(effects[c.effect])) ** 2 + 1e-24 for c in fit_coordinates_of_effects(effects)])
    return Physics(
        tuple(effects), own, np.zeros((42, len(own))), design.gravity, design.actuator, design.platform, CHANNELS
    )


def known_to_be(design, *effects):
    """Calibration of a machine that is as stated, but for effects."""
    m = design.mechanism
    return Calibration(
        Correction(m, m, (None,) * 6),
        1e-14 * np.eye(42),
        np.zeros(6),
        (),
        (),
        None,
        {},
        None,
        physics_of(design, *effects),
    )


def wanted(design, count=12, every=20.0, seed=3):
    """(poses (count,), times (count,) s, Sensors over them)."""
    lengths = configuration_generators.sobol_configurations(design.mechanism.strut_range, count, 0.6, seed)
    t = 40 + every * np.arange(count)
    _, log = random_true_machine_and_truth_file.random_true_and_logged_temperatures(t[-1], np.random.default_rng(seed))
    log = Sensors(log.t, {**log.channels, "payload_mass_kg": np.linspace(0, 7, len(log.t))})
    return hexapod.forward(lengths, design.mechanism), t, log


@pytest.mark.parametrize("kind", MOVING, ids=[kind.name for kind in MOVING])
def test_whatever_moves_the_machine_is_undone(design, kind):
    calibration = known_to_be(
        design, parse_effect(f"{kind.name}:{SOME[kind.name]}"), parse_effect("backlash:strut4:gap=9e-5")
    )
    T, t, log = wanted(design)
    home, pace = hexapod.home_values(design.mechanism), Pace(t, 0.0, 0.02, None)
    done = commands_along_route(calibration, T, home, pace, log)
    run = motion_simulation.simulate_machine_run(
        design, done.route.commands(done.values), t, calibration.physics.effects, log
    )
    assert np.abs(pose_difference(run.T_base_platform, T)).max() < 2e-9
    plain = motion_simulation.simulate_machine_run(
        design,
        timed_route(pace, hexapod.inverse(T, design.mechanism), home).commands(hexapod.inverse(T, design.mechanism)),
        t,
        calibration.physics.effects,
        log,
    )
    assert np.abs(pose_difference(plain.T_base_platform, T)).max() > 1e-6


def test_a_pose_held_again_after_a_small_drift_comes_out_of_the_gap(design):
    """Within a gap an axis has no effect: the fixed point's plain steps would take thousands to leave it."""
    calibration = known_to_be(
        design, parse_effect("backlash:strut2:gap=2e-4"), parse_effect("thermal_expansion:strut2:coefficient=1e-5")
    )
    T, t, _ = wanted(design, 6, 60.0)
    warm = Sensors(
        np.array([0.0, 1e3]), {"strut2_temperature_C": np.array([20.0, 20.3])}
    )  # the strut's length drifts by 80 nm from pose to pose
    T = type(T).from_matrix(np.repeat(T.as_matrix()[:1], 6, axis=0))
    done = commands_along_route(calibration, T, hexapod.home_values(design.mechanism), Pace(t, 0.0, 0.02, None), warm)
    run = motion_simulation.simulate_machine_run(
        design, done.route.commands(done.values), t, calibration.physics.effects, warm
    )
    assert np.abs(pose_difference(run.T_base_platform, T)).max() < 2e-9


def test_maps_in_pose_space_are_undone_along_with_physics(design):
    """What physics adds is nearly nothing here: the commands are those of the configuration and the map."""
    known = known_to_be(design, parse_effect("scale_error:strut1:scale=1e-9"))
    home = home_pose(design.mechanism)
    x = home.translation + 0.05 * np.random.default_rng(2).uniform(-1, 1, (60, 3))
    x = np.hstack([x, np.random.default_rng(3).uniform(-0.2, 0.2, (60, 3))])
    strokes = np.stack([x.min(axis=0), x.max(axis=0)], axis=1)
    field = fit_field("polynomial", FieldSamples(x, np.full(x.shape, 4e-5), np.full(x.shape, 1e-14), strokes))
    known = replace(known, correction=correction_with_pose_space_map(known.correction, field))
    T, _, _ = wanted(design)
    by_map = known.correction.inverse_without_physics(T)
    assert np.abs(by_map - hexapod.inverse(T, design.mechanism)).max() > 2e-5
    done = commands_along_route(known, T, hexapod.home_values(design.mechanism))
    assert np.abs(done.values - by_map).max() < 1e-9


@pytest.mark.parametrize("name", ["backlash", "compliance"])
def test_a_rig_with_an_effect_ends_as_good_as_without(tmp_path, seen, name):
    text, design = seen
    rng = np.random.default_rng(5)
    effect = effect_of(name, rng)
    rough = replace(effect, **{key: 1.3 * value for key, value in effect.values().items() if isinstance(value, float)})
    rec, secret = write(tmp_path / "with", design, text, 11, (effect,), "sobol:30,ladder:1,payload:6")
    bare, innocent = write(tmp_path / "without", design, text, 11, (), "sobol:30,ladder:1,payload:6")
    known, plain = (learnt(rec, sample_recording(rec), found, "none") for found in (Findings((rough,), None, ()), None))
    after, before = driven(known, secret, 77), driven(plain, secret, 77)
    without = driven(learnt(bare, sample_recording(bare), None, "none"), innocent, 77)
    assert after.error[0] < 1.5 * without.error[0] and after.error[1] < 1.5 * without.error[1]
    assert before.error[0] > 2 * after.error[0] and 0.5 < after.error[0] / after.stated < 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "backlash",
        "hysteresis",
        "thermal_expansion",
        "base_expansion",
        "compliance",
        "joint_clearance",
        "creep",
        "cyclic_error",
        "screw_coupling",
        "transmission_error",
    ],
)
def test_found_by_the_diagnosis_it_ends_as_good_as_without(tmp_path, seen, name):
    text, design = seen
    ratios = []
    for k in range(3):
        ways = three_ways(
            tmp_path / str(k), design, text, 40 + k, effect_of(name, np.random.default_rng([k, 7])), ROUTE
        )
        ratios.append(ways[0].error[0] / ways[2].error[0])
    assert np.median(ratios) <= 1.5


def test_what_nobody_remembers_is_approached_where_there_is_time_and_room(design):
    calibration = known_to_be(design, parse_effect("backlash:strut2:gap=1e-4"))
    m = design.mechanism
    home = hexapod.home_values(m)
    T = hexapod.forward(home + np.array([[0, 2e-5, 0, 0, 0, 0], [1e-2, -3e-5, 0, 0, 0, 0], [0, 2e-2, 0, 0, 0, 0]]), m)
    t = np.array([30.0, 60.0, 90.0])
    never, auto, always = (
        commands_along_route(calibration, T, home, Pace(t, 0.0, 0.02, 0.05), None, approach)
        for approach in ("never", "auto", "always")
    )
    doubt = command_uncertainty_from_unknown_history(
        Machine(calibration.correction, calibration.physics, None), T, never.route, never.values
    )
    assert (
        doubt[0, 1] > 1e-5 and not doubt[2].any() and not doubt[:, [0, 2, 3, 4, 5]].any()
    )  # 2 cm of travel have cleared it up
    assert (
        auto.route.approached.tolist() == [True, False, False]
        and always.route.approached.all()
        and not never.route.approached.any()
    )
    sure, unsure = (np.trace(done.covariance[0, :3, :3]) for done in (auto, never))
    assert sure < 0.3 * unsure
    turn = auto.route.values(auto.values)[auto.route.doing == TURNING][0]
    assert turn[1] < auto.values[0, 1] - 1e-4 and np.allclose(np.delete(turn - auto.values[0], 1), 0)
    hurried = commands_along_route(calibration, T, home, Pace(np.array([0.012, 60.0, 90.0]), 0.0, 0.005, 0.01), None)
    assert not hurried.route.approached[0] and np.trace(hurried.covariance[0, :3, :3]) > 2 * sure  # no time: it says so


def test_poses_that_come_too_soon_are_listed(design):
    T, t, log = wanted(design)
    t[5] = t[4] + 0.2
    with pytest.raises(Unreachable, match="pose 5: .* of travel in 0.2 s") as caught:
        commands_along_route(
            known_to_be(design), T, hexapod.home_values(design.mechanism), Pace(t, 0.0, 0.02, 0.05), log
        )
    assert caught.value.index.tolist() == [5]


def test_missing_sensors_and_shaking_widen_what_is_stated(design):
    T, t, log = wanted(design)
    home, pace = hexapod.home_values(design.mechanism), Pace(t, 0.0, 0.02, None)

    def stated(effect, sensors):
        done = commands_along_route(known_to_be(design, parse_effect(effect)), T, home, pace, sensors)
        return np.sqrt(np.trace(done.covariance[:, :3, :3], axis1=1, axis2=2).mean()), done.missing

    warm, blind = (stated("thermal_expansion:rig:coefficient=2e-5", sensors) for sensors in (log, None))
    assert warm[1] == () and {f"strut{i + 1}_temperature_C" for i in range(6)} == set(
        blind[1]
    )  # and not the payload, which does nothing here
    assert blind[0] > 8e-6 > 4 * warm[0]
    loaded, unweighed = (
        stated("compliance:rig:stiffness=1e6", s)
        for s in (log, Sensors(log.t, {"ambient_temperature_C": log.channels["ambient_temperature_C"]}))
    )
    assert unweighed[1] == ("payload_mass_kg",) and unweighed[0] > 1.5 * loaded[0]
    assert stated("vibration:rig:amplitude=2e-5,frequency=3.3", log)[0] > 1e-5


def test_no_commands_are_said_to_be_none(design):
    calibration = known_to_be(design, parse_effect("scale_error:strut1:scale=5e-3"))
    T, t, _ = wanted(design, 3)
    of = Machine(calibration.correction, calibration.physics, None)
    route = timed_route(
        Pace(t, 0.0, 0.02, None), hexapod.inverse(T, design.mechanism), hexapod.home_values(design.mechanism)
    )
    commands = compensated_commands_at_poses(of, T, route, hexapod.inverse(T, design.mechanism))
    np.testing.assert_allclose(
        of.effective(route.commands(commands), t, T), hexapod.inverse(T, design.mechanism), atol=1e-10
    )
    assert (route.doing == HOLDING).sum() == 3


def test_physics_is_kept_whole_and_versioned(tmp_path, design):
    effects = tuple(
        parse_effect(text)
        for text in (
            "backlash:strut3:gap=4e-5",
            "compliance:rig:stiffness=5e6",
            "edge_bias:cam1:bias=0.2",
            "transmission_error:strut2:profile=0/1e-5/-2e-5/1e-5",
            "marker_swap:4:turn=1",
        )
    )
    full = replace(known_to_be(design, *effects), provenance={"seed": 0})
    full = replace(
        full, physics=replace(full.physics, unknown=(Unknown("strut 4", 3e-5, "m", ("strut 1's position",), True),))
    )
    calibration_file.save(tmp_path / "c.json", full)
    loaded = calibration_file.load(tmp_path / "c.json").physics
    tree = json.loads((tmp_path / "c.json").read_text())
    assert tree["schema"] == "calibration/2" and loaded.effects == effects and loaded.unknown == full.physics.unknown
    assert (
        loaded.channels == CHANNELS
        and loaded.actuator == design.actuator
        and loaded.platform.mass == design.platform.mass
    )
    np.testing.assert_array_equal(loaded.own, full.physics.own)
    assert tree["physics"]["parameter_order"][:2] == [
        "gap of backlash at strut 3",
        "1 / stiffness of compliance at rig",
    ]
    calibration_file.save(tmp_path / "plain.json", replace(full, physics=None))
    assert (
        json.loads((tmp_path / "plain.json").read_text())["schema"] == "calibration/1"
        and calibration_file.load(tmp_path / "plain.json").physics is None
    )
    tree["physics"]["effects"][0]["parameters"]["gap"] = 4.0
    (tmp_path / "c.json").write_text(json.dumps(tree))
    with pytest.raises(FileError, match="gap must lie in"):
        calibration_file.load(tmp_path / "c.json")
    with pytest.raises(RigError, match="backlash at strut 3"):
        full.refuse_physics("learning on-line")


def run(capsys, *arguments, ok=True):
    status = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert (status == 0) == ok, err
    return out if ok else err


def test_diagnosed_calibrated_corrected_driven_verified(tmp_path, seen, capsys):
    text, design = seen
    _, secret = write(
        tmp_path / "rec", design, text, 21, (parse_effect("backlash:strut5:gap=1e-4"),), "sobol:40,ladder:1"
    )
    random_true_machine_and_truth_file.write_truth(tmp_path / "truth.json", secret, design.mechanism.home)
    (tmp_path / "rig.toml").write_text(text)
    run(capsys, "diagnose", tmp_path / "rec", "--out", tmp_path / "d", "--only", "backlash")
    output = run(capsys, "calibrate", tmp_path / "rec", "--diagnosis", tmp_path / "d", "--out", tmp_path / "c.json")
    assert "compensated by commands: backlash at strut 5" in output
    T, t, log = wanted(design, 20)
    clock = 1_700_000_000
    rows = [
        f"{i},{clock + a:.3f}," + ",".join(f"{x:.10f}" for x in v) for i, (a, v) in enumerate(zip(t, pose_to_vector(T)))
    ]
    (tmp_path / "w.csv").write_text("frame,t,x,y,z,rx,ry,rz\n" + "\n".join(rows) + "\n")
    names = list(log.channels)
    (tmp_path / "s.csv").write_text(
        ",".join(["t", *names])
        + "\n"
        + "".join(
            f"{clock + a:.1f}," + ",".join(f"{log.channels[name][i]:.3f}" for name in names) + "\n"
            for i, a in enumerate(log.t)
        )
    )
    run(
        capsys,
        "correct",
        tmp_path / "c.json",
        "--poses",
        tmp_path / "w.csv",
        "--sensors",
        tmp_path / "s.csv",
        "--out",
        tmp_path / "k.csv",
    )
    lines = (tmp_path / "k.csv").read_text().splitlines()
    assert (
        lines[0] == "frame,t,l1,l2,l3,l4,l5,l6"
        and lines[1].startswith(",1700000000.0")
        and sum(line[0] != "," for line in lines[1:]) == 20
    )
    run(
        capsys,
        "simulate",
        tmp_path / "rig.toml",
        "--machine",
        tmp_path / "truth.json",
        "--plan",
        f"commands:{tmp_path / 'k.csv'}",
        "--sensors",
        tmp_path / "s.csv",
        "--seed",
        "3",
        "--out",
        tmp_path / "drive",
    )
    judged = json.loads(
        run(capsys, "verify", tmp_path / "c.json", tmp_path / "drive", "--wanted", tmp_path / "k.poses.csv", "--json")
    )["wanted"]
    assert judged["position"]["rms"] < 1.5 * judged["stated_uncertainty"]["position"] < 1.5e-5
    refused = run(
        capsys,
        "correct",
        tmp_path / "c.json",
        "--poses",
        tmp_path / "w.csv",
        "--out",
        tmp_path / "k2.csv",
        "--start",
        "0,0",
        ok=False,
    )
    assert "--start must be home or 6 values" in refused
    assert "is in time" in run(
        capsys,
        "simulate",
        tmp_path / "rig.toml",
        "--plan",
        f"sobol:2,commands:{tmp_path / 'k.csv'}",
        "--out",
        tmp_path / "x",
        ok=False,
    )


def test_what_another_recording_told_counts_beside_this_one(tmp_path, seen):
    """A recording in one room says nothing of its warmth: what is known of it from another remains unchanged, and as
    sure.
    """
    text, design = seen
    rec, _ = write(tmp_path / "rec", design, text, 31, (), "sobol:30")
    effects = (parse_effect("base_expansion:rig:coefficient=6e-5"),)
    sampled = sample_recording(rec)
    alone, with_prior = (
        learnt(rec, sampled, Findings(effects, sigma, ()), "none") for sigma in (None, np.array([1e-6]))
    )
    assert (
        abs(with_prior.physics.effects[0].coefficient - 6e-5) < 3e-6 < abs(alone.physics.effects[0].coefficient - 6e-5)
    )
    assert 0.5e-6 < np.sqrt(with_prior.physics.own[0, 0]) <= 1e-6 < np.sqrt(alone.physics.own[0, 0])


def test_the_geometry_knows_that_the_physics_is_not_sure(tmp_path, seen):
    text, design = seen
    rec, _ = write(tmp_path / "rec", design, text, 32, (), "sobol:30")
    sampled = sample_recording(rec)
    known = learnt(rec, sampled, Findings((parse_effect("scale_error:strut1:scale=1e-4"),), None, ()), "none")
    _, found = fit_geometry_and_remainder_of_correction(sampled.samples, design.mechanism, "none")
    assert (np.diag(known.covariance) >= np.diag(found.covariance) * 0.999).all() and np.abs(
        known.physics.cross
    ).max() > 0
    whole = np.block([[known.covariance, known.physics.cross], [known.physics.cross.T, known.physics.own]])
    scale = np.sqrt(np.diag(whole))
    assert np.linalg.eigvalsh(whole / scale / scale[:, None])[0] > -1e-9
