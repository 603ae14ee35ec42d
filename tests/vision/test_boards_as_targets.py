"""Boards as targets: markers where OpenCV's own boards have them, faults named, recordings of them measured."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from rig.errors import FileError
from rig.formats.rig_toml import design_from_rig_toml
from rig.formats.rig_toml.camera_instrument_experiment_and_cube_turn_entries import (
    rig_toml_with_target_markers_replaced,
)
from rig.model.design import markers_of_target
from rig.model.pose import pose_difference
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import image_simulation, random_true_machine_and_truth_file, recording_simulation
from synthetic import printable_target_sheets as print_sheets
from vision.marker_corner_prediction import marker_map
from vision.recording_measurement import measure_recording

PAGE = Path(__file__).parents[2] / "docs" / "measuring.md"
SQUARE = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])


def example():
    """The tables of two boards that the documentation shows."""
    section = PAGE.read_text(encoding="utf-8").partition("## Boards\n")[2].partition("\n## ")[0]
    return "\n".join(line[4:] for line in section.splitlines() if line.startswith("    ")) + "\n"


EXAMPLE = example()


def with_boards(rig_text, boards=EXAMPLE):
    """A rig.toml text with these targets in place of its own."""
    return re.sub(r"\[\[target\]\].*?(?=\n\[(?!\[?target)|\Z)", "", rig_text, flags=re.S) + "\n" + boards


def loaded(folder, text):
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return design_from_rig_toml.load_design(path)


def target(folder, description, more=""):
    stated = f'name = "B"\nbody = "base"\nboard = "{description}"\n{more}\n'
    where = "pose = { position = [1.0, 2.0, 3.0], rotvec = [0.0, 0.0, 0.0] }"
    text = f'schema = "rig/1"\n[mechanism]\nkind = "free"\n[[target]]\n{stated}{where}\n'
    return loaded(folder, text).targets[0]


def corners_in_board_frame(board, height):
    """Corners (m, 4, 3) of OpenCV's board from its lower left corner, y up."""
    return np.array(board.getObjPoints()) * [1, -1, -1] + [0, height, 0]


@pytest.mark.parametrize(("columns", "rows", "legacy"), [(7, 5, False), (5, 6, False), (5, 6, True)])
def test_a_charucos_markers_are_where_opencv_has_them(tmp_path, columns, rows, legacy):
    found = target(tmp_path, f"charuco:{columns}x{rows}:0.04:0.03:DICT_5X5_100", "legacy = true" if legacy else "")
    opencv = cv2.aruco.CharucoBoard(
        (columns, rows), 0.04, 0.03, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    )
    opencv.setLegacyPattern(legacy)
    assert found.ids == tuple(opencv.getIds().ravel())
    corners = np.array([m.T_body_marker.apply(SQUARE * m.side) for m in markers_of_target(found)])
    np.testing.assert_allclose(corners, corners_in_board_frame(opencv, rows * 0.04) + [1, 2, 3], atol=1e-6)
    assert len(found.ids) + len(found.board.black_squares()) == columns * rows


@pytest.mark.parametrize("kind", ["aruco", "aprilgrid"])
def test_a_grids_markers_are_where_opencv_has_them(tmp_path, kind):
    found = target(tmp_path, f"{kind}:4x3:0.05:0.015:DICT_APRILTAG_36h11", "first = 7")
    ids = np.arange(7, 19).reshape(3, 4)[:: -1 if kind == "aprilgrid" else 1]  # Kalibr counts upwards
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    opencv = cv2.aruco.GridBoard((4, 3), 0.05, 0.015, dictionary, ids.ravel())
    own = {m.id: m.T_body_marker.apply(SQUARE * m.side) for m in markers_of_target(found)}
    theirs = corners_in_board_frame(opencv, 3 * 0.065 - 0.015) + [1, 2, 3]
    np.testing.assert_allclose([own[k] for k in opencv.getIds().ravel()], theirs, atol=1e-6)
    lowest = own[7] if kind == "aprilgrid" else own[15]
    np.testing.assert_allclose(lowest[3], [1, 2, 3], atol=1e-9)  # its lower left corner is the origin


def test_lengths_of_a_board_are_in_the_files_units(tmp_path):
    head = 'schema = "rig/1"\n[mechanism]\nkind = "free"\n'
    want = loaded(tmp_path, head + EXAMPLE)
    in_mm = re.sub(r"-?\d\.\d+", lambda found: f"{float(found[0]) * 1e3:g}", EXAMPLE)
    assert "charuco:7x5:40:30:" in in_mm
    found = loaded(tmp_path, head.replace("[mech", 'units = "mm, mrad"\n[mech') + in_mm)
    np.testing.assert_allclose(marker_map(found).corners, marker_map(want).corners, atol=1e-9)


@pytest.mark.parametrize(
    ("description", "more", "line", "says"),
    [
        ("chess:4x3:0.05:0.01:DICT_5X5_100", "", 7, "'chess' is no kind of board; there are charuco:COLUMNS"),
        ("aruco:9x6:0.05:0.01:DICT_5X5_50", "", 7, "has 54 markers, DICT_5X5_50 only 50"),
        ("charuco:4x3:0.03:0.04:DICT_5X5_50", "", 7, "a marker of 0.04 m does not fit into a square of 0.03 m"),
        ("aruco:4x3:50:0.01:DICT_5X5_50", "", 7, "side = 50 m is implausible"),
        ("aruco:4x3:0.05:0.01:DICT_5X5_50", "first = 40", 8, "DICT_5X5_50 has identities 0..49, not 50"),
        ("aruco:4x3:0.05:0.01:DICT_5X5_50", "legacy = true", 8, "legacy is of charuco boards alone, not of aruco"),
        ("aruco:4x3:0.05:0.01:DICT_5X5_50", 'dictionary = "DICT_5X5_50"', 8, "unknown key 'target.1.dictionary'"),
    ],
)
def test_faults_of_a_board_name_file_line_and_value(tmp_path, description, more, line, says):
    with pytest.raises(FileError, match=re.escape(says)) as caught:
        target(tmp_path, description, more)
    assert caught.value.line == line and caught.value.path == str(tmp_path / "rig.toml")


def test_one_identity_on_two_boards_is_refused_at_the_second(tmp_path):
    twice = EXAMPLE.replace("DICT_APRILTAG_36h11", "DICT_5X5_100").replace("first = 20", "first = 11")
    with pytest.raises(FileError, match="marker 11 of target 'FLOOR' already belongs to target 'PLATE'"):
        loaded(tmp_path, 'schema = "rig/1"\n[mechanism]\nkind = "free"\n' + twice)


def test_adjusted_places_replace_a_board_by_its_markers(rig_text, tmp_path):
    text = with_boards(rig_text)
    design = loaded(tmp_path, text)
    written = loaded(tmp_path, rig_toml_with_target_markers_replaced(text, {t.name: t.listed for t in design.targets}))
    assert [t.board for t in written.targets] == [None, None]
    assert [t.dictionary for t in written.targets] == [t.dictionary for t in design.targets]
    np.testing.assert_allclose(marker_map(written).corners, marker_map(design).corners, atol=1e-9)


def test_a_board_is_printed_on_one_sheet(rig_text, tmp_path):
    design = loaded(tmp_path, with_boards(rig_text))
    pages = [page for one in design.targets for page in print_sheets.sheets_of_target(one, "A3")]
    assert len(pages) == 2
    for page in pages:
        figure, axes = print_sheets.blank_sheet_figure_and_axes(page.paper)
        print_sheets.draw_sheet(axes, page)
        sides = [patch.get_width() for patch in axes.patches]
        assert sum(abs(side - page.target.board.side * 1e3) < 1e-9 for side in sides) >= len(page.loose)
        corners = np.array([[one.x, one.y] for one in page.loose])
        apart = np.linalg.norm(corners[:, None] - corners, axis=2)[~np.eye(len(corners), dtype=bool)].min()
        pitch = page.target.board.pitch * 1e3
        assert apart == pytest.approx(pitch * (2**0.5 if page.target.board.kind == "charuco" else 1))


@pytest.mark.slow
@pytest.mark.parametrize("images", [False, True], ids=["corners", "images"])
def test_a_recording_of_boards_is_measured(rig_text, tmp_path, images, request):
    text = with_boards(rig_text)
    if images:
        request.getfixturevalue("opengl")
    design = loaded(tmp_path, text)
    rng = np.random.default_rng(3)
    world = random_true_machine_and_truth_file.random_true_machine(design, rng, 0.5)
    done = recording_simulation.simulate_world(world, plan.build_plan(design, "sobol:3", 1), rng)
    pictures = image_simulation.Images(world.true.sensor, processes=1) if images else None
    recording_simulation.write_recording(done, tmp_path / "rec", text, rng, 0.04, pictures)
    measured, _ = measure_recording(recording_folder.load_recording(tmp_path / "rec"), places="stated")
    assert len(measured.frames) == 3 and not measured.unsolved
    error = pose_difference(measured.T_base_platform, done.run.T_base_platform)
    score = np.einsum("ni,nij,nj->n", error, np.linalg.inv(measured.covariance), error).mean()
    assert score < 15  # of 6 on average
    assert np.abs(error[:, :3]).max() < 1e-3 and np.abs(error[:, 3:]).max() < 1e-3  # m, rad
