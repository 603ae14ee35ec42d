"""Chains that cameras see: cubes on the carriage tell stages apart, are drawn and measured, and loops close from
corners and images.
"""

from dataclasses import replace

import numpy as np
import pytest

from calib.models.chain import chain_error_model_and_identification
from calib.models.chain.chain_error_model_and_identification import identify_chain
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.cli import command_line
from rig.errors import FileError
from rig.formats import machine_geometry_and_effects_json_file
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import mechanism_chain
from rig.model.pose import pose_difference
from rig.planning.configuration_generators import sobol_configurations
from rig.recording import recording_folder
from synthetic import rig_meshes
from synthetic.marker_drawing_sensor_and_occlusion import is_occluded
from tests.closed_loops import holds, lines, rig, simulate_with_truth, verified
from tests.gantry_and_hexapod import written


def test_cubes_on_the_carriage_tell_its_stages_apart(tmp_path, capfd):
    """Where the hexapod stands on the carriage is told by what the carriage shows: each figure within 3.5 sigma, none
    untold; without, six are.
    """
    design = written(tmp_path, seen=True, carriage=True)
    simulate_with_truth(tmp_path, "sobol:30", 4)
    true, _ = machine_geometry_and_effects_json_file.load_machine(tmp_path / "truth.json", design)
    read = recording_folder.load_recording(tmp_path / "rec")
    samples = sample_recording(read).samples
    (stage,) = samples.below
    stands = mechanism_chain.stage_poses(samples.commanded, true.mechanism)[0]
    whole = stage.covariance + stage.common @ np.swapaxes(stage.common, 1, 2)
    off = pose_difference(stands, stage.T_base_stage)
    assert stage.stage == 1 and stage.seen.all() and np.abs(off[:, :3]).max() < 1.5e-4
    assert np.einsum("ni,nij,nj->n", off, np.linalg.inv(whole), off).mean() < 12
    found, alone = (
        identify_chain(samples, design.mechanism),
        identify_chain(replace(samples, below=()), design.mechanism),
    )
    assert (
        not found.undetermined
        and {one.base_stages for one in alone.undetermined} >= {(2, 1)}
        and sum(one.base_stages == (2, 1) for one in alone.undetermined) == 6
    )
    assert (
        found.determined_by_stage[1] == (42, 42)
        and alone.determined_by_stage[1][0] <= 36
        and found.below == ((1, 30, 30),)
    )
    exact = replace(
        samples,
        T_base_platform=mechanism_chain.forward(samples.commanded, true.mechanism),
        covariance=samples.covariance * 1e-8,
        common=samples.common[..., :0],
        below=(replace(stage, T_base_stage=stands, covariance=stage.covariance * 1e-8, common=stage.common[..., :0]),),
    )
    step, sigma = identify_chain(exact, design.mechanism).step, np.sqrt(np.diag(found.covariance))
    free = sigma > 0
    assert np.abs((found.step - step)[free] / sigma[free]).max() < 3.5 and np.abs(step[free]).max() > 3 * np.median(
        sigma[free]
    )
    upper = chain_error_model_and_identification.stage_parameter_slices(design.mechanism)[1]
    assert np.median(np.sqrt(np.diag(alone.covariance)[upper])) > 2 * np.median(sigma[upper])


@pytest.mark.slow
def test_stages_that_are_measured_stand_in_files_of_their_own(tmp_path, capfd):
    """What `rig measure` wrote is read again, and what an instrument says of the carriage is used as well."""
    design = written(tmp_path, seen=True, carriage=True)
    simulate_with_truth(tmp_path, "sobol:8", 4)
    capfd.readouterr()
    rig("measure", tmp_path / "rec", "--out", tmp_path / "measured")
    output = capfd.readouterr().out
    assert "stage 1: 8 of 8 frames solved, poses to" in output and "poses_stage1.csv" in output
    assert (
        command_line.main(["measure", str(tmp_path / "rec"), "--places", "free", "--out", str(tmp_path / "free")]) == 1
    )
    assert "positions of markers cannot be adjusted on a rig with targets on stages" in capfd.readouterr().err
    back = recording_folder.load_recording(tmp_path / "measured")
    assert len(back.corners.frame) == len(recording_folder.load_recording(tmp_path / "rec").corners.frame) and list(
        back.stages
    ) == [1]
    by_vision = sample_recording(back).samples
    (tmp_path / "measured" / "corners.csv").unlink()
    by_file = sample_recording(recording_folder.load_recording(tmp_path / "measured")).samples
    assert np.abs(pose_difference(by_vision.below[0].T_base_stage, by_file.below[0].T_base_stage)).max() < 1e-5
    assert by_file.below[0].covariance.shape == (8, 6, 6) and by_file.take(np.arange(3)).below[0].seen.sum() == 3
    (tmp_path / "measured" / "poses_stage1.csv").rename(tmp_path / "measured" / "poses_stage2.csv")
    with pytest.raises(FileError, match="no 'stage 2' below a last platform; there are platform, base, stage 1"):
        recording_folder.load_recording(tmp_path / "measured")
    assert design.targets[-1].stage == 1 and not design.without_stages().targets[-1].stage


@pytest.mark.parametrize(
    "change, says",
    [
        (('body = "stage 1"', 'body = "stage 2"'), "must be one of 'platform', 'base', 'stage 1', not 'stage 2'"),
        (
            ('shutter = "global"', 'shutter = "global"\nmount = "moving"'),
            "which cameras that stand still measure, and camera 'cam0' moves",
        ),
    ],
)
def test_cubes_that_cannot_be_measured_on_a_stage_are_told_by_line(tmp_path, change, says):
    written(tmp_path, seen=True, carriage=True)
    text = (tmp_path / "rig.toml").read_text()
    (tmp_path / "rig.toml").write_text(text.replace(*change, 1))
    with pytest.raises(FileError, match=says) as error:
        design_from_rig_toml.load_design(tmp_path / "rig.toml")
    assert error.value.line is not None


def test_what_stands_on_the_carriage_is_drawn_there_and_hides_what_is_behind(tmp_path):
    design = written(tmp_path, seen=True)
    m = design.mechanism
    x = sobol_configurations(mechanism_chain.travel_ranges(m), 1, 0.9, 3)
    stages = mechanism_chain.stage_poses(x, m)
    poses = rig_meshes.mesh_body_matrices(m, [T[0] for T in stages])
    parts = {part.body for part in rig_meshes.rig_and_background_meshes(design)}
    assert {
        "stage 1",
        "platform",
        "base",
        *(f"stage 2 strut {i + 1} {end}" for i in range(6) for end in ("lower", "upper")),
    } <= parts
    assert parts <= set(poses)
    feet = stages[0][0].apply(m.stages[1].base_joints)
    heads = stages[1][0].apply(m.stages[1].platform_joints)
    for i, (foot, head) in enumerate(zip(feet, heads)):
        np.testing.assert_allclose(poses[f"stage 2 strut {i + 1} lower"][:3, 3], foot, atol=1e-12)
        np.testing.assert_allclose(poses[f"stage 2 strut {i + 1} upper"][:3, 3], head, atol=1e-12)
    across = np.cross(heads[0] - feet[0], [0, 0, 1.0])
    across *= 0.05 / np.linalg.norm(across)
    middle, below = (feet[0] + heads[0]) / 2, stages[0][0].apply([0, 0, -0.1])
    camera_positions = np.array([middle + 5 * across, middle + 5 * across, stages[0][0].apply([0, 0, 0.1])])
    points = np.array([middle - across, middle + across, below])
    assert is_occluded(design, stages, np.zeros(3, int), camera_positions, points).tolist() == [
        True,
        False,
        True,
    ]  # by a strut, by nothing, by the carriage's plate


@pytest.mark.slow
@pytest.mark.parametrize("carriage", [False, True])
def test_a_loop_closes_from_images(tmp_path, capfd, carriage):
    design = written(tmp_path, seen=True, cameras=2, size=(800, 640), carriage=carriage)
    simulate_with_truth(tmp_path, "sobol:24", 2, "--images")
    m = design.mechanism
    holds(
        verified(
            tmp_path,
            capfd,
            lines(mechanism_chain.forward(sobol_configurations(mechanism_chain.travel_ranges(m), 4, 0.5, 5), m)),
            ("--images",),
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize("carriage", [False, True])
def test_a_loop_closes_from_corners(tmp_path, capfd, carriage):
    design = written(tmp_path, seen=True, carriage=carriage)
    simulate_with_truth(tmp_path, "sobol:60", 2)
    m = design.mechanism
    holds(
        verified(
            tmp_path,
            capfd,
            lines(mechanism_chain.forward(sobol_configurations(mechanism_chain.travel_ranges(m), 8, 0.5, 5), m)),
        )
    )
