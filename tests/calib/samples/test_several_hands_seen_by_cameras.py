"""Cubes on both hands before cameras: each hand's poses, all in one recording or one hand's alone."""

import re
import shutil

import numpy as np
import pytest

import synthetic
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.errors import RigError
from rig.model.pose import pose_difference
from rig.recording.frame_selection_and_content_hashes import select_hand
from rig.recording.recording_folder import load_recording
from tests.cli import run
from tests.two_armed import seen_by_cameras


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """(folder of a recording, {hand: T (n,)})."""
    folder = tmp_path_factory.mktemp("seen")
    (folder / "rig.toml").write_text(seen_by_cameras())
    made = synthetic.simulate(folder / "rig.toml", synthetic.SimulateOptions(plan="sobol:16", seed=3))
    made.write(folder / "REC")
    return folder / "REC", made.simulation.hand_pose_of_each_row()


def test_cameras_see_the_poses_of_both_hands(simulated):
    folder, T = simulated
    samples = sample_recording(load_recording(folder), several_hands=True).samples
    assert samples.frame.tolist() == np.repeat(range(16), 2).tolist() and samples.hand.tolist() == [0, 1] * 16
    for number, own, alone in samples.by_hand():
        off = pose_difference(T[("left", "right")[number]], alone.T_base_platform)
        squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(samples.total_covariance()[own]), off)
        assert 2 < np.median(squares) < 15  # six numbers of each, errors that cameras share among them


@pytest.mark.slow
def test_one_hand_is_measured_alone_and_several_must_be_chosen_from(simulated, tmp_path):
    folder, _ = simulated
    recording = load_recording(folder)
    right = sample_recording(select_hand(recording, "right")).samples
    both = sample_recording(recording, several_hands=True).samples
    np.testing.assert_array_equal(right.T_base_platform.as_matrix(), both.by_hand()[1][2].T_base_platform.as_matrix())
    with pytest.raises(RigError, match=r"is of several hands \(left, right\)"):
        sample_recording(recording)
    assert "choose it with --hand" in run("measure", folder, "--out", tmp_path / "OUT", ok=False).stderr
    run("measure", folder, "--hand", "right", "--out", tmp_path / "OUT")
    found = load_recording(tmp_path / "OUT").poses
    assert set(found.hand.tolist()) == {1} and len(found.frame) == 16


def without_targets_of(text, hand):
    """Text of a rig.toml without the targets of a hand."""
    return "".join(part for part in re.split(r"(?=\[\[target\]\])", text) if f'body = "{hand}"' not in part)


@pytest.mark.slow
@pytest.mark.parametrize(("seen", "other"), [("left", "right"), ("right", "left")])
@pytest.mark.parametrize("stated", [True, False])
def test_what_is_seen_of_one_hand_alone_is_all_of_the_samples(simulated, tmp_path, seen, other, stated):
    """The other hand's targets are not stated, or stated and never seen; a hand of two corners has no pose."""
    recording = load_recording(simulated[0])
    markers = [number for target in select_hand(recording, other).design.targets for number in target.ids]
    base = [number for target in recording.design.targets if target.body == "base" for number in target.ids]
    gone = set(markers) - set(base)
    shutil.copytree(simulated[0], tmp_path / "REC")
    lines = (tmp_path / "REC" / "corners.csv").read_text().splitlines(True)
    hidden = [line for line in lines[1:] if int(line.split(",")[2]) in gone]
    retained = [lines[0], *(line for line in lines[1:] if int(line.split(",")[2]) not in gone)]
    (tmp_path / "REC" / "corners.csv").write_text("".join(retained))
    if not stated:
        path = tmp_path / "REC" / "rig.toml"
        path.write_text(without_targets_of(path.read_text(), other))
    assert "nothing wrong or unlikely" in run("check", tmp_path / "REC").stdout
    found = sample_recording(load_recording(tmp_path / "REC"), several_hands=True)
    number = ("left", "right").index(seen)
    assert len(found.samples) == 16 and (found.samples.hand is None or set(found.samples.hand.tolist()) == {number})
    alone = sample_recording(select_hand(recording, seen)).samples
    np.testing.assert_allclose(
        found.samples.T_base_platform.as_matrix(), alone.T_base_platform.as_matrix(), rtol=0, atol=1e-9
    )
    if stated:
        assert found.source == f"corners.csv of {seen} ({other} was not measured: none of its markers is seen)"
        (tmp_path / "REC" / "corners.csv").write_text("".join([*retained, *hidden[:2]]))
        found = sample_recording(load_recording(tmp_path / "REC"), several_hands=True)
        assert len(found.samples) == 16 and f"{other} was not measured: none of 16 frames" in found.source


def test_a_target_is_on_a_hand_or_on_the_base_and_cameras_stand_still(tmp_path):
    text = seen_by_cameras()
    (tmp_path / "rig.toml").write_text(text.replace('body = "right"', 'body = "platform"', 1))
    output = run("simulate", tmp_path / "rig.toml", "--plan", "sobol:3", "--out", tmp_path / "NO", ok=False).stderr
    assert "body must be one of 'base', 'left', 'right', not 'platform'" in output
    (tmp_path / "rig.toml").write_text(text.replace('name = "cam1"', 'name = "cam1"\nmount = "hand"', 1))
    output = run("simulate", tmp_path / "rig.toml", "--plan", "sobol:3", "--out", tmp_path / "NO", ok=False).stderr
    assert "cameras that see several hands stand still" in output
