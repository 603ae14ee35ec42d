"""Arms and planar machines simulated: what an instrument writes is what the secret machine did, within its noise."""

import json

import numpy as np
import pytest

from rig.cli import command_line
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.pose import pose_difference
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder
from synthetic.random_true_machine_and_truth_file import load_world_from_truth_file
from tests.rig.effects.test_added_effect import RIGS

SIGMA = (2e-5, 1e-4)  # m, rad


def simulated(folder, kind, *words, place="rig", rotations=True):
    """(Recording, true World, tree of the truth) of a machine of a kind under an instrument."""
    sigma = f"position_sigma = {SIGMA[0]}\n" + (f"rotation_sigma = {SIGMA[1]}\n" if rotations else "")
    (folder / "rig.toml").write_text(
        f'schema = "rig/1"\n{RIGS[kind]}[instrument]\nbase = "{place}"\ntool = "{place}"\n{sigma}'
    )
    argv = [
        "simulate",
        folder / "rig.toml",
        "--plan",
        "sobol:60,ladder:2",
        *words,
        "--out",
        folder / "rec",
        "--truth",
        folder / "truth.json",
    ]
    assert command_line.main([str(word) for word in argv]) == 0
    found = recording_folder.load_recording(folder / "rec")
    return (
        found,
        load_world_from_truth_file(folder / "truth.json", found.design),
        json.loads((folder / "truth.json").read_text()),
    )


@pytest.mark.parametrize(
    "kind, effect, place", [("arm", "backlash:joint2:gap=1e-3", "free"), ("planar2", "backlash:strut2:gap=1e-4", "rig")]
)
def test_an_instrument_sees_what_the_machine_did(tmp_path, kind, effect, place):
    found, world, tree = simulated(tmp_path, kind, "--effect", effect, place=place)
    frames, t = found.exposures.times()
    assert found.poses.frame.tolist() == frames.tolist() and world.effects == (parse_effect(effect),)
    run = motion_simulation.simulate_machine_run(world.true, found.commands, t, world.effects, found.sensors)
    off = pose_difference(run.T_base_platform, found.poses.T_base_platform)
    np.testing.assert_allclose(off.std(axis=0), np.repeat(SIGMA, 3), rtol=0.25)
    without = pose_difference(
        motion_simulation.simulate_machine_run(world.true, found.commands, t).T_base_platform,
        found.poses.T_base_platform,
    )
    assert (
        np.abs(without[:, :3]).max() > 20 * SIGMA[0] if kind == "arm" else np.abs(without[:, :3]).max() > 3 * SIGMA[0]
    )


def test_where_an_arm_stands_is_secret_only_where_nobody_knows(tmp_path):
    _, world, _ = simulated(tmp_path, "arm", "--secret", "0", place="rig")
    assert not pose_difference(world.true.mechanism.base, world.stated.mechanism.base).any()
    np.testing.assert_allclose(world.true.mechanism.rows, world.stated.mechanism.rows, atol=1e-12)


def test_an_instrument_of_positions_writes_positions(tmp_path):
    found, *_ = simulated(tmp_path, "arm", place="free", rotations=False)
    head = (tmp_path / "rec" / "poses.csv").read_text().splitlines()[0]
    assert head == "frame,x,y,z" and np.abs(found.poses.T_base_platform.rotation.magnitude()).max() < 1e-12


def test_cameras_see_the_cubes_in_an_arms_hand(tmp_path):
    """The cameras and cubes of a hexapod's rig.toml about an arm that carries the platform's cubes."""
    text = hexapod_layout_rig_toml(0.3)
    start, end = text.index("[mechanism]"), text.index("[[camera]]")
    # its hand at 0.45 m
    arm = 'kind = "arm"\njoints = [[0.0, 0.2, 0.02, 0.1], [0.0, 0.25, 0.01, 0.0]]\nlimits = [[-0.3, 0.3], [-0.3, 0.3]]'
    (tmp_path / "rig.toml").write_text(f"{text[:start]}[mechanism]\n{arm}\n\n{text[end:]}")
    assert load_design(tmp_path / "rig.toml").mechanism.kind == "arm"
    assert (
        command_line.main(
            ["simulate", str(tmp_path / "rig.toml"), "--plan", "sobol:20", "--out", str(tmp_path / "rec")]
        )
        == 0
    )
    found = recording_folder.load_recording(tmp_path / "rec")
    assert found.poses is None and len(found.corners.uv) > 100
    on_hand = {number for target in found.design.targets if target.body == "platform" for number in target.ids}
    assert on_hand & set(found.corners.marker.tolist())


def test_a_rig_that_nothing_sees_is_refused(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text('schema = "rig/1"\n' + RIGS["planar2"])
    assert command_line.main(["simulate", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "rec")]) == 1
    assert "an instrument that sees poses" in capsys.readouterr().err


def test_an_arm_as_found_is_drawn_anew_by_the_same_machine(tmp_path):
    """A folder as a diagnosis leaves it: the recording's own files, and the machine with what was found."""
    found, world, _ = simulated(tmp_path, "arm", "--effect", "backlash:joint2:gap=1e-3", place="free")
    folder = tmp_path / "diagnosed"
    folder.mkdir()
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        (folder / name).write_bytes((tmp_path / "rec" / name).read_bytes())
    (folder / "machine.json").write_bytes((tmp_path / "truth.json").read_bytes())
    assert command_line.main(["simulate", "--from", str(folder), "--out", str(tmp_path / "both")]) == 0
    drawn = {
        kind: recording_folder.load_recording(tmp_path / "both" / kind).poses.T_base_platform
        for kind in ("with", "without")
    }
    off = {kind: pose_difference(T, found.poses.T_base_platform).std(axis=0) for kind, T in drawn.items()}
    np.testing.assert_allclose(off["with"], np.sqrt(2) * np.repeat(SIGMA, 3), rtol=0.3)
    assert off["without"][:3].max() > 5 * SIGMA[0]
