"""Poses for a controller that takes poses: its nominal kinematics makes the corrected lengths of them."""

from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.files.calibration_file import save
from calib.models.wanted_pose_commands import pose_commands_for_controller_with_own_kinematics
from rig.cli.command_line import main
from rig.driving.driving_clock import SimulatedClock
from rig.driving.emulators.emulated_axis_motion_and_controller_faults import EmulatedMachine, Faults, MovingAxes
from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
from rig.driving.emulators.gcs import GCSHexapod
from rig.driving.protocols.controller_poses_for_hexapod_strut_lengths import (
    AXES,
    PoseFrames,
    poses_of_xyz_mm_uvw_degrees,
    xyz_mm_uvw_degrees_of_poses,
)
from rig.errors import NotConverged, RigError
from rig.model import mechanisms
from rig.model.pose import pose, pose_difference
from rig.recording.corner_and_pose_csv_tables import Poses, write_poses
from synthetic import random_true_machine_and_truth_file
from tests.rig.arms import random_arm

FRAMES = {
    "base": PoseFrames(),
    "frames": PoseFrames(pose([0.1, 0, 0.3], [0, 0, 0.4]), pose([0, 0.02, 0.05], [0.3, 0, 0]), np.array([0, 0, 0.08])),
}


def wanted_poses(hexapod, count=40):
    rng = np.random.default_rng(5)
    moves = np.concatenate([rng.uniform(-0.01, 0.01, (count, 3)), rng.uniform(-0.05, 0.05, (count, 3))], axis=1)
    return hexapod.home * pose(moves[:, :3], moves[:, 3:])


@pytest.mark.parametrize("frames", FRAMES.values(), ids=FRAMES)
def test_the_platform_comes_where_it_is_wanted_as_by_lengths(design, frames):
    """A controller that takes poses, with the nominal geometry, moves a machine that is built otherwise."""
    nominal = design.mechanism
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(4)).true.mechanism
    wanted = wanted_poses(nominal)
    lengths = Correction(nominal, true, (None,) * 6).inverse_without_physics(wanted)
    commands = pose_commands_for_controller_with_own_kinematics(nominal, lengths, wanted, frames)
    made = mechanisms.hexapod.inverse(frames.pose_of_command(commands), nominal)  # what such a controller does
    before, by_lengths, by_poses = (
        np.linalg.norm(pose_difference(mechanisms.hexapod.forward(one, true, wanted), wanted)[:, :3], axis=1)
        for one in (mechanisms.hexapod.inverse(wanted, nominal), lengths, made)
    )
    assert np.sqrt(np.mean(before**2)) > 1e-4
    assert by_poses.max() < 1e-8 and by_lengths.max() < 1e-8


def test_a_turn_leaves_the_pivot_where_it_is():
    frames = PoseFrames(pivot=np.array([0.01, 0.02, 0.1]))
    turned = frames.pose_of_command(pose([0, 0, 0], [0.1, 0.2, 0.3]))
    np.testing.assert_allclose(turned.apply(frames.pivot), frames.pivot, atol=1e-15)
    target = pose([0.3, 0.2, 0.1], [0.1, -0.2, 0.3])
    round_trip = FRAMES["frames"].pose_of_command(FRAMES["frames"].command_of_pose(target))
    np.testing.assert_allclose(pose_difference(round_trip, target), 0, atol=1e-15)


def test_lengths_that_no_pose_gives_are_refused(design):
    wanted = wanted_poses(design.mechanism, 3)
    lengths = mechanisms.hexapod.inverse(wanted, design.mechanism)
    lengths[1, 0] += 2.0
    with pytest.raises(NotConverged, match="1 of 3 poses"):
        pose_commands_for_controller_with_own_kinematics(design.mechanism, lengths, wanted, PoseFrames())


def test_only_a_hexapod_takes_poses():
    arm = random_arm(np.random.default_rng(0))
    with pytest.raises(RigError, match="takes poses drives a hexapod, not a mechanism of kind 'arm'"):
        pose_commands_for_controller_with_own_kinematics(
            arm, np.zeros((1, 6)), pose([[0, 0, 0]], [[0, 0, 0]]), PoseFrames()
        )


@pytest.mark.parametrize("pivot", [np.zeros(3), np.array([0.0, 0.01, 0.05])], ids=["origin", "pivot"])
def test_an_emulated_hexapod_controller_with_its_own_geometry_comes_as_near_as_by_lengths(design, pivot):
    """MOV with corrected poses, over the wire; the machine is built otherwise, and its calibration is not perfect."""
    nominal, rng = design.mechanism, np.random.default_rng(6)
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(4)).true.mechanism
    fitted = replace(true, base_joints=true.base_joints + 2e-5 * rng.standard_normal((6, 3)))
    clock, home = SimulatedClock(1000.0), home_lengths(nominal)
    axes = MovingAxes(clock.now(), home, np.full(6, 0.1), np.full(6, 5.0))
    machine = EmulatedMachine(axes, np.zeros(6), home, Faults(), known=True)
    controller = GCSHexapod(machine, Faults(), clock, nominal, nominal.strut_range)

    def say(text):
        controller.receive(text.encode() + b"\n")
        clock.sleep(1.0)
        return controller.due().decode().split()

    wanted = wanted_poses(nominal, 20)
    lengths = Correction(nominal, fitted, (None,) * 6).inverse_without_physics(wanted)
    frames = PoseFrames(work=nominal.home, pivot=pivot, angles="moving")
    commands = xyz_mm_uvw_degrees_of_poses(
        pose_commands_for_controller_with_own_kinematics(nominal, lengths, wanted, frames)
    )
    say("SVO " + " ".join(f"{axis} 1" for axis in AXES))
    say("SPI " + " ".join(f"{name} {1e3 * value}" for name, value in zip("RST", pivot)))
    assert say("SPI?") == [f"{name}={1e3 * value:.6f}" for name, value in zip("RST", pivot)]
    reached = []
    for row in commands:
        say("MOV " + " ".join(f"{axis} {value:.6f}" for axis, value in zip(AXES, row)))
        assert say("ERR?") == ["0"]
        shown = np.array([float(word.partition("=")[2]) for word in say("POS?")])
        np.testing.assert_allclose(shown, row, atol=2e-6)
        reached.append(machine.axes.at(clock.now()))
    by_lengths, by_poses = (
        np.sqrt(np.mean(pose_difference(mechanisms.hexapod.forward(one, true, wanted), wanted)[:, :3] ** 2))
        for one in (lengths, np.array(reached))
    )
    assert by_poses <= 1.05 * by_lengths and by_lengths > 1e-6
    say("MOV Z 900")
    assert say("ERR?") == ["7"] and say("MOV Q 1") == [] and say("ERR?") == ["15"]
    say("SPI R 5")
    assert say("ERR?") == ["7"]  # the platform is turned


def test_the_command_writes_poses_as_it_writes_lengths(design, rig_text, tmp_path, capsys):
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(4)).true.mechanism
    correction = Correction(design.mechanism, true, (None,) * 6)
    none = np.eye(42) * 1e-12, np.zeros(6), (0,), (), None, {"inputs_sha256": {}}
    save(tmp_path / "calibration.json", Calibration(correction, *none))
    wanted = wanted_poses(design.mechanism, 5)
    write_poses(tmp_path / "wanted.csv", Poses(np.arange(5), wanted, None))
    words = ["correct", str(tmp_path / "calibration.json"), "--poses", str(tmp_path / "wanted.csv"), "--out"]

    def written(kind, *options):
        path = tmp_path / f"{kind}{len(options)}.csv"
        assert main([*words, str(path), "--as", kind, *options]) == 0
        lines = path.read_text().splitlines()
        return lines[0], np.array([[float(cell) for cell in line.split(",")[1:]] for line in lines[1:]])

    (axes, lengths), (columns, poses) = written("lengths"), written("poses")
    assert axes == "frame,l1,l2,l3,l4,l5,l6" and columns == "frame,x,y,z,rx,ry,rz"
    commanded = pose(poses[:, :3], poses[:, 3:])
    np.testing.assert_allclose(mechanisms.hexapod.inverse(commanded, design.mechanism), lengths, atol=1e-9)
    columns, values = written("gcs", "--pivot", "0,0,0.1", "--work", "0,0,0.2,0,0,0")
    frames = PoseFrames(work=pose([0, 0, 0.2], [0, 0, 0]), pivot=np.array([0, 0, 0.1]))
    round_trip = frames.pose_of_command(poses_of_xyz_mm_uvw_degrees(values))
    assert columns == "frame,X,Y,Z,U,V,W"
    np.testing.assert_allclose(pose_difference(round_trip, commanded), 0, atol=1e-9)
    columns, newport = written("hxp", "--tool", "0,0,0.1,0,0,0", "--work", "0,0,0.2,0,0,0")
    frames = PoseFrames(work=pose([0, 0, 0.2], [0, 0, 0]), tool=pose([0, 0, 0.1], [0, 0, 0]))
    round_trip = frames.pose_of_command(poses_of_xyz_mm_uvw_degrees(newport))
    assert columns == "frame,X,Y,Z,U,V,W"
    np.testing.assert_allclose(pose_difference(round_trip, commanded), 0, atol=1e-9)
    np.testing.assert_allclose(newport[:, 3:], values[:, 3:], atol=1e-9)
    columns, symetrie = written("symetrie", "--tool", "0,0,0.1,0,0,0", "--work", "0,0,0.2,0,0,0")
    round_trip = frames.pose_of_command(poses_of_xyz_mm_uvw_degrees(symetrie, "fixed"))
    np.testing.assert_allclose(pose_difference(round_trip, commanded), 0, atol=1e-9)
    assert columns == "frame,X,Y,Z,U,V,W" and not np.allclose(symetrie[:, 3:], newport[:, 3:], atol=1e-6)
    capsys.readouterr()
    for options in (
        ["--pivot", "0,0,1"],
        ["--as", "hxp", "--pivot", "0,0,1"],
        ["--as", "symetrie", "--pivot", "0,0,1"],
        ["--as", "gcs", "--work", "0,0,1"],
        ["--as", "poses", "--tool", "a"],
    ):
        assert main([*words, str(tmp_path / "none.csv"), *options]) == 1
        assert "rig correct: --" in capsys.readouterr().err
    assert not (tmp_path / "none.csv").exists()


def test_angles_turn_about_axes_that_move_along():
    T = poses_of_xyz_mm_uvw_degrees([1.0, 2.0, 3.0, 90.0, 0.0, 90.0])
    np.testing.assert_allclose(T.apply([1.0, 0, 0]), [1e-3, 2e-3, 3e-3 + 1], atol=1e-15)  # first U, then W about new z
    np.testing.assert_allclose(xyz_mm_uvw_degrees_of_poses(T), [1, 2, 3, 90, 0, 90], atol=1e-9)
