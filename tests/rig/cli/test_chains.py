"""Mechanisms one upon the other: a hexapod on a gantry, moved, calibrated stage by stage from one recording, corrected,
driven and verified.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.files import calibration_file
from calib.models.chain import chain_error_model_and_identification
from calib.models.chain.chain_error_model_and_identification import identify_chain
from calib.samples.commanded_and_measured_pose_samples import Samples, sample_recording
from rig.cli import command_line
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import effect_with_existing_place, parse_effect
from rig.errors import FileError, RigError, Unreachable
from rig.formats import csv_and_parquet_tables_and_time_origin, machine_geometry_and_effects_json_file
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.machine_motion_simulation import simulate_machine_run
from rig.model.mechanisms import arm_kinematics_limits_and_loads as arm
from rig.model.mechanisms import axis_place_texts as chain_places
from rig.model.mechanisms import hexapod, mechanism_chain
from rig.model.pose import exp, log, pose, pose_difference
from rig.planning.configuration_generators import sobol_configurations
from rig.recording import recording_folder
from rig.recording.recording_folder import Commands
from tests.closed_loops import holds, lines, rig, simulate_with_truth, verified
from tests.gantry_and_hexapod import written
from tests.numerical_derivatives import jacobian as differences


@pytest.fixture
def design(tmp_path):
    return written(tmp_path)


@pytest.fixture
def gantry(design):
    return design.mechanism


def test_a_chain_is_its_stages_one_upon_the_other(gantry):
    x = sobol_configurations(mechanism_chain.travel_ranges(gantry), 20, 0.9)
    T = arm.forward(x[:, :3], gantry.stages[0]) * hexapod.forward(x[:, 3:], gantry.stages[1])
    assert np.abs(pose_difference(T, mechanism_chain.forward(x, gantry))).max() < 1e-14
    assert gantry.axes == ("s1q1", "s1q2", "s1q3", "s2l1", "s2l2", "s2l3", "s2l4", "s2l5", "s2l6")
    assert (
        mechanism_chain.signed_limit_excess(x + 1.0, gantry).all()
        and not mechanism_chain.signed_limit_excess(x, gantry).any()
    )


def test_a_single_pose_and_a_grid_of_poses_have_the_values_of_a_batch(gantry):
    T = mechanism_chain.forward(sobol_configurations(mechanism_chain.travel_ranges(gantry), 6, 0.5), gantry)
    values = mechanism_chain.inverse(T, gantry)
    np.testing.assert_allclose(mechanism_chain.inverse(T[2], gantry), values[2], atol=1e-12)
    grid = RigidTransform.from_matrix(T.as_matrix().reshape(2, 3, 4, 4))
    np.testing.assert_allclose(mechanism_chain.inverse(grid, gantry), values.reshape(2, 3, -1), atol=1e-12)


def test_the_jacobians_are_the_differences(gantry):
    x = sobol_configurations(mechanism_chain.travel_ranges(gantry), 1, 0.5)[0]
    at = mechanism_chain.forward(x, gantry)
    np.testing.assert_allclose(
        mechanism_chain.jacobian(x, gantry),
        differences(lambda v: log(at.inv() * mechanism_chain.forward(v, gantry)), x),
        atol=1e-8,
    )
    still = np.zeros(len(chain_error_model_and_identification.parameter_names(gantry)))
    of = differences(
        lambda p: log(
            at.inv()
            * mechanism_chain.forward(x, chain_error_model_and_identification.chain_with_parameter_step(gantry, p))
        ),
        still,
    )
    np.testing.assert_allclose(
        chain_error_model_and_identification.parameter_jacobian(x[None], gantry)[0], of, atol=1e-7
    )


def test_the_inverse_reaches_poses_within_the_travels_and_says_which_it_does_not(gantry):
    x = sobol_configurations(mechanism_chain.travel_ranges(gantry), 12, 0.5, 3)
    wanted = mechanism_chain.forward(x, gantry)
    found = mechanism_chain.inverse(wanted, gantry)
    assert (
        np.abs(pose_difference(mechanism_chain.forward(found, gantry), wanted)).max() < 1e-10
        and not mechanism_chain.signed_limit_excess(found, gantry).any()
    )
    middle, span = (
        mechanism_chain.travel_ranges(gantry).mean(axis=1),
        np.ptp(mechanism_chain.travel_ranges(gantry), axis=1),
    )
    assert (
        np.linalg.norm((found - middle) / span, axis=1) < np.linalg.norm((x - middle) / span, axis=1) + 1e-6
    ).all()  # nearest the middle
    with pytest.raises(Unreachable, match="1 of 2 poses") as error:
        mechanism_chain.inverse(RigidTransform.concatenate([wanted[0], pose([0, 0, 0.4], [3.0, 0, 0])]), gantry)
    assert error.value.index.tolist() == [1]


def test_stages_are_told_from_one_recording_and_what_cannot_be_is_named(tmp_path):
    """z-scores of every parameter of every stage; the six figures of where the hexapod stands on the carriage have no
    information.
    """
    design = written(tmp_path)
    simulate_with_truth(tmp_path, "sobol:60", 2)
    true, _ = machine_geometry_and_effects_json_file.load_machine(tmp_path / "truth.json", design)
    samples = sample_recording(recording_folder.load_recording(tmp_path / "rec")).samples
    found = identify_chain(samples, design.mechanism)
    # the true machine in the parameters that are freedoms of their own: what poses without noise say of it, to the last
    # digit
    exact = identify_chain(
        replace(
            samples,
            T_base_platform=mechanism_chain.forward(samples.commanded, true.mechanism),
            covariance=samples.covariance * 1e-8,
        ),
        design.mechanism,
    )
    assert (
        np.abs(
            pose_difference(
                mechanism_chain.forward(samples.commanded, exact.chain),
                mechanism_chain.forward(samples.commanded, true.mechanism),
            )
        ).max()
        < 1e-7
    )
    free = np.diag(found.covariance) > 0
    off, covariance = (found.step - exact.step)[free], found.covariance[np.ix_(free, free)]
    for part in chain_error_model_and_identification.stage_parameter_slices(design.mechanism):  # stage by stage
        assert (
            np.abs(
                (found.step - exact.step)[part][free[part]] / np.sqrt(np.diag(found.covariance)[part][free[part]])
            ).max()
            < 3
        )
    eigen = np.linalg.eigh(covariance)
    sharp = eigen.eigenvalues < (2e-4) ** 2  # combinations told better than machines are off
    z = eigen.eigenvectors[:, sharp].T @ off / np.sqrt(eigen.eigenvalues[sharp])
    assert len(z) > 30 and 0.6 < np.sqrt((z**2).mean()) < 1.4 and np.abs(z).max() < 4
    assert np.abs(exact.step[free]).max() > 20 * np.sqrt(eigen.eigenvalues[sharp]).min()  # there was something to find
    assert len(found.undetermined) == 6 and {one.base_stages for one in found.undetermined} == {(2, 1)}
    assert "6 of 6 figures of the pose of stage 2 on stage 1" in "\n".join(found.report())


def test_of_a_machine_as_stated_nothing_is_off(gantry):
    """A machine as stated: nothing is found to be off, and what is named as untold is told by parameters of its own."""
    x = sobol_configurations(mechanism_chain.travel_ranges(gantry), 40, 0.9)
    T = mechanism_chain.forward(x, gantry) * exp(np.zeros(6))
    samples = Samples(
        np.arange(40),
        np.arange(40.0),
        x,
        T,
        np.tile(np.diag([1e-10] * 3 + [1e-9] * 3), (40, 1, 1)),
        np.zeros((40, 6, 0)),
    )
    found = identify_chain(samples, gantry)
    assert np.abs(found.step).max() < 1e-6 and found.inliers.all()
    for one in found.undetermined:
        v = np.zeros(len(found.step))
        for name, weight in one.parameters:
            v[chain_error_model_and_identification.parameter_names(gantry).index(name)] = weight
        assert v.any() and one.left > 0.5


def test_a_loop_closes_under_an_instrument(tmp_path, capfd):
    design = written(tmp_path)
    simulate_with_truth(tmp_path, "sobol:60", 2)
    m = design.mechanism
    found = verified(
        tmp_path,
        capfd,
        lines(mechanism_chain.forward(sobol_configurations(mechanism_chain.travel_ranges(m), 8, 0.5, 5), m)),
    )
    holds(found)
    assert found["before"]["position"]["rms"] > 10 * found["after"]["position"]["rms"]
    loaded = calibration_file.load(tmp_path / "calibration.json").correction
    assert [stage.kind for stage in loaded.fitted.stages] == ["arm", "hexapod"] and json.loads(
        (tmp_path / "calibration.json").read_text()
    )["claim"]


def test_an_instrument_that_sees_positions_alone_says_so_of_a_carriage_too(design, tmp_path, capfd):
    rig("simulate", tmp_path / "rig.toml", "--plan", "sobol:6", "--seed", "4", "--out", tmp_path / "rec")
    short = [line.split(",")[:4] for line in (tmp_path / "rec" / "poses.csv").read_text().splitlines()]
    for name in ("poses.csv", "poses_stage1.csv"):
        (tmp_path / "rec" / name).write_text("".join(",".join(cells) + "\n" for cells in short))
    stated = (tmp_path / "rec" / "rig.toml").read_text()
    (tmp_path / "rec" / "rig.toml").write_text(stated.replace("rotation_sigma = 5e-5\n", ""))
    stage = recording_folder.load_recording(tmp_path / "rec").stages[1]
    np.testing.assert_array_equal(stage.T_base_platform.translation, np.array(short[1:], float)[:, 1:])
    assert stage.T_base_platform.rotation.magnitude().max() == 0 and stage.covariance is None
    capfd.readouterr()
    assert command_line.main(["calibrate", str(tmp_path / "rec"), "--out", str(tmp_path / "c.json")]) == 1
    assert "positions alone calibrate arms, not a mechanism of kind 'chain'" in capfd.readouterr().err


@pytest.mark.parametrize(
    "change, says",
    [
        (('kind = "chain"', 'kind = "chian"'), "must be one of"),
        (('kind = "arm"', 'kind = "chain"'), "must be one of"),
        (("[[mechanism.stage]]   # a gantry", "[[mechanism.spare]]   # a gantry"), "two stages or more"),
    ],
)
def test_what_is_no_chain_is_told_by_line(tmp_path, change, says):
    written(tmp_path)
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace(*change, 1))
    with pytest.raises(FileError, match=says) as error:
        design_from_rig_toml.load_design(tmp_path / "rig.toml")
    assert error.value.line is not None


@pytest.mark.parametrize(
    "text, place",
    [("backlash:stage2strut3:gap=1e-4", "stage 2 strut 3"), ("backlash:stage 1 joint 2:gap=1e-4", "stage 1 slide 2")],
)
def test_effects_sit_at_the_axes_of_stages(design, gantry, text, place):
    effect = effect_with_existing_place(parse_effect(text), design)
    assert effect.place == place
    t = np.array([0.0, 1.0, 2.0, 3.0])
    home, far = mechanism_chain.home_values(gantry), mechanism_chain.travel_ranges(gantry)[:, 0]
    still, held = (
        simulate_machine_run(design, Commands(t, np.array([home, far, home, home])), t[2:], effects).deviation
        for effects in ((), (effect,))
    )
    at = chain_places(gantry).index(place)
    assert np.abs(held[:, at] - still[:, at]).min() > 4e-5 and not np.delete(held - still, at, axis=1).any()


@pytest.mark.parametrize(
    "text, says",
    [
        ("backlash:stage 3 strut 1:gap=1e-4", "no such axis; is 'stage 2 strut 1' meant"),
        ("backlash:stage 1 strut 2:gap=1e-4", "no such axis"),
        ("backlash:s1q1:gap=1e-4", "cannot sit at"),
    ],
)
def test_places_that_a_chain_does_not_have_are_refused(design, text, says):
    with pytest.raises(RigError, match=says):
        effect_with_existing_place(parse_effect(text), design)


@pytest.mark.slow
def test_configurations_are_planned_that_tell_all_stages(tmp_path, capfd):
    written(tmp_path)
    rig("plan", tmp_path / "rig.toml", "--for", "parameters", "--count", "16", "--out", tmp_path / "plan.csv")
    output = capfd.readouterr().out
    assert "6 combinations are determined by no pose" in output and "16 configurations for 54 parameters" in output
    rows = [line.split() for line in output.splitlines() if " um  " in line or " urad  " in line]
    assert len(rows) == 8 and all(float(row[0]) < float(row[1]) for row in rows)
    m = design_from_rig_toml.load_design(tmp_path / "rig.toml").mechanism
    assert not mechanism_chain.signed_limit_excess(
        csv_and_parquet_tables_and_time_origin.read_csv_table(tmp_path / "plan.csv", ("frame", *m.axes)).matrix(m.axes),
        m,
    ).any()


@pytest.mark.slow
def test_effects_are_found_at_their_stages(tmp_path, capfd):
    """Of the whole catalogue, at both stages, the two that are there are found, as large as they are; the page draws
    both stages.
    """
    written(tmp_path)
    simulate_with_truth(
        tmp_path,
        "sobol:120,ladder:2",
        3,
        "--effect",
        "backlash:stage 1 slide 2:gap=1e-4",
        "--effect",
        "cyclic_error:stage 2 strut 3:amplitude=4e-5",
    )
    rig("diagnose", tmp_path / "rec", "--out", tmp_path / "found")
    assert "backlash at stage 1 slide 2: gap" in capfd.readouterr().out
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert [(f["effect"], f["place"]) for f in found] == [
        ("backlash", "stage 1 slide 2"),
        ("cyclic_error", "stage 2 strut 3"),
    ]
    for one, name, true in zip(found, ("gap", "amplitude"), (1e-4, 4e-5)):
        low, high = one["parameters"][name]["ci95"]
        assert low < true < high and one["parameters"][name]["unit"] == "m"
    page = (tmp_path / "found" / "diagnosis.html").read_text()
    assert "stage 1 slide 2" in page and page.count("<svg") + page.count("data:image") >= 3
    rig("simulate", "--from", tmp_path / "found", "--out", tmp_path / "again")


@pytest.mark.slow
def test_moves_that_tell_effects_of_two_stages_apart(tmp_path, capfd):
    written(tmp_path)
    rig(
        "plan",
        tmp_path / "rig.toml",
        "--separate",
        "backlash:stage1slide1:gap=1e-4",
        "backlash:stage2strut1:gap=1e-4",
        "--out",
        tmp_path / "plan.csv",
    )
    output = capfd.readouterr().out
    assert float(output.splitlines()[1].split()[0]) > 5 and "best: " in output
