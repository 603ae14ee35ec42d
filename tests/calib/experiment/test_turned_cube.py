"""A cube put back turned: its seat is free in what is measured and diagnosed, its faces are the same, and it tells a
face from its cube.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.linearised_corners import SEAT_LABELS, corner_derivatives
from rig.cli.command_line import main
from rig.model.design import quarter_turns_of_cubes
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from tests.closed_loops import simulate_with_truth
from vision.recording_combination_and_moved_cameras import combine_recordings
from vision.recording_measurement import measure_recording

FACE = "face_misplacement:marker 0:offset=4e-4/2e-4/0"
CUBE = "cube_misplacement:target P1:motion=4e-4/3e-4/0/1e-3/0/1e-3"
STEP = 1e-5  # m, rad


@pytest.fixture(scope="module")
def second(rig_text, tmp_path_factory):
    """Folder of a recording for which cube P1 was put back turned; its truth stands beside it."""
    at = tmp_path_factory.mktemp("two")
    (at / "rig.toml").write_text(rig_text)
    assert (
        main(
            [
                "simulate",
                str(at / "rig.toml"),
                "--seed",
                "1",
                "--plan",
                "turn:P1,sobol:8",
                "--truth",
                str(at / "truth.json"),
                "--out",
                str(at / "two"),
            ]
        )
        == 0
    )
    return at / "two"


def test_a_recording_says_that_a_cube_was_put_back_and_its_faces_hold_no_pose(second):
    second = recording_folder.load_recording(second)
    assert quarter_turns_of_cubes(second.design) == {"P1": 1}
    measured, _ = measure_recording(second)
    o, own = measured.observations, np.array([t == "P1" for t in marker_targets(measured)])
    loose = own[o.marker]
    assert loose.any() and not measured.inliers[loose].any() and measured.inliers[~loose].mean() > 0.95
    off = np.sqrt(np.nanmean(measured.residuals[loose] ** 2))
    assert (
        1.5 * measured.noise < off < 20 * measured.noise
    )  # it is seen where it stands but for what putting it back does
    corners = second.corners
    moved = corners.uv + 5.0 * np.isin(corners.marker, [0, 1, 2, 3, 4])[:, None]
    remeasured, _ = measure_recording(replaced(second, moved))
    assert (measured.T_base_platform.as_matrix() == remeasured.T_base_platform.as_matrix()).all()


def marker_targets(measured):
    """Names of the targets of a measurement's marker map, row by row."""
    return measured.adjustment.state.placed.target


def replaced(read, uv):
    """A recording with other corners uv (n, 2) px."""
    return replace(read, corners=replace(read.corners, uv=uv))


@pytest.mark.slow
def test_the_seat_of_a_cube_moves_its_corners_as_the_forward_model_has_it(second):
    at = second.parent
    assert (
        main(
            [
                "simulate",
                str(at / "rig.toml"),
                "--seed",
                "1",
                "--plan",
                "sobol:12",
                "--machine",
                str(at / "truth.json"),
                "--out",
                str(at / "one"),
            ]
        )
        == 0
    )
    both = combine_recordings([recording_folder.load_recording(at / "one"), recording_folder.load_recording(second)])
    assert (
        "cube P1 was put back turned by a quarter turn for two: it is target P1@2 here, with a separate pose"
        in both.lines()
    )
    point, _, _ = operating_point_source_and_measurement(both.recording)
    (seat,) = point.seats
    assert seat.place == "target P1@2"
    rows, n = corner_derivatives(point, point.pixels()), len(point.observed.observations)
    at = [rows.names.index((seat.place, label)) for label in SEAT_LABELS]
    frame = np.repeat(point.observed.observations.frame[rows.order], 2)
    whole = rows.table + np.einsum("nl,nlp->np", rows.local, rows.inner[frame])  # before poses were taken out
    table = whole.reshape(n, 2, -1)[..., at]
    for j in range(6):
        motions = [tuple(sign * STEP * (np.arange(6) == j)) for sign in (1, -1)]
        high, low = (replace(point, seats=(replace(seat, motion=m),)).pixels() for m in motions)
        expected = np.einsum("nij,nj->ni", rows.whiten, ((high - low) / (2 * STEP))[rows.order])
        np.testing.assert_allclose(table[..., j], expected, rtol=2e-3, atol=1e-3 * np.abs(expected).max())
    moved = np.abs(table).sum(axis=(1, 2)) > 1e-9 * np.abs(table).max()
    assert moved.sum() == (point.observed.observations.frame >= 12).sum() - others(point)


def others(point):
    """How many corners of the second recording belong to other cubes."""
    o, names = point.observed.observations, np.array(point.observed.markers.target)
    return int(((o.frame >= 12) & (names[o.marker] != "P1@2")).sum())


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "name"), [(FACE, "face_misplacement"), (CUBE, "cube_misplacement")])
def test_a_face_is_told_from_its_cube_by_turning_it(tmp_path, capsys, effect, name):
    """One camera sees one face of a cube; a quarter turn brings both of its faces before it."""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=1)
    start, end = text.index('name = "P1"'), text.index('name = "P2"')
    block = re.sub(r"faces = .*", 'faces = { "-y" = 0, "-x" = 1 }', text[start:end])
    block = re.sub(r"rotvec = \[0.0, 0.0, [\d.]+\]", "rotvec = [0.0, 0.0, 1.135]", block)
    rig, truth, out = tmp_path / "rig.toml", tmp_path / "truth.json", tmp_path / "out"
    rig.write_text(text[:start] + block + text[end:] + '\n[experiment]\nmay = ["turn cube 1"]\n')
    simulate_with_truth(tmp_path, "sobol:3", 5, "--effect", effect)
    assert (
        main(
            [
                "investigate",
                str(rig),
                "--machine",
                str(truth),
                "--out",
                str(out),
                "--plan",
                "sobol:30",
                "--budget",
                "30min",
                "--verify",
                "12",
            ]
        )
        == 0
    )
    output = capsys.readouterr().out
    assert (
        "next: turn:P1,sobol:12" in output
        and "before it begins: take cube P1 off its socket and put it back turned by a quarter turn" in output
    )
    notebook = (out / "notebook.md").read_text()
    assert "request to the operator: before it begins: take cube P1 off" in notebook and "settled: yes" in notebook
    (finding,) = json.loads((out / "diagnosis2" / "diagnosis.json").read_text())["findings"]
    assert (finding["effect"], finding["cannot_be_told_from"]) == (name, [])
    assert not (out / "rec3").exists() and "turned_P1" in (out / "verify2.csv").read_text()
