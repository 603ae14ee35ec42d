"""The workspace in cells: shares and counts that are known, the room of a pose oriented as home, bounds that are the
covariance's; kept in files.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.platform_certification import corrected_platform_pose_covariance
from calib.correction.machine_correction import Correction, fit_geometry_and_remainder_of_correction
from calib.files import calibration_file
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.machine_parameters_and_file_entries import calibration_with_workspace
from calib.workspace import workspace_page
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import COLUMNS, map_workspace, workspace_rows
from rig.errors import FileError
from rig.model.design import Planar2
from rig.model.mechanisms import hexapod
from rig.model.pose import pose
from tests.calib.noisy_samples import sampled
from tests.calib.secret_arms import secret
from tests.rig.arms import UR10

STROKES = [[0.6, 1.2], [0.6, 1.2]]
PLANAR = Planar2([[0.0, 0.0], [1.0, 0.0]], STROKES)


def same(T, commands):
    """The same covariance everywhere: 1 um and 2 urad along each axis."""
    return np.tile(np.diag(np.repeat([1e-12, 4e-12], 3)), (len(commands), 1, 1))


@pytest.fixture(scope="module")
def calibrated(design):
    samples, _ = sampled(design, 3, 60)
    correction, found = fit_geometry_and_remainder_of_correction(samples, design.mechanism)
    return calibration_with_workspace(
        Calibration(correction, found.covariance, found.scatter, (), (), None, {"seed": 0})
    )


def test_shares_and_counts_are_those_of_the_plane():
    w = map_workspace(Correction(PLANAR, Planar2(PLANAR.base_joints, STROKES, [0.03, -0.06]), (None, None)), same, 4096)
    assert (
        w.lost == pytest.approx(1 - 0.95 * 0.9, abs=2e-3) == w.gained
    )  # one strut loses a twentieth of its stroke, the other a tenth
    assert w.flat and w.believed.sum() == w.reached.sum() == 4096 and w.lost_in.sum() == pytest.approx(4096 * w.lost)
    assert (w.lost_in <= w.believed).all() and (w.gained_in <= w.reached).all()
    np.testing.assert_allclose(w.bound[w.reached > 0], [[2 * 3**0.5 * 1e-6, 4 * 3**0.5 * 1e-6]] * (w.reached > 0).sum())
    assert np.nanmax(w.singular) < 1 + 1e-9  # two struts at a right angle hold the hinge alike
    right = w.centre[np.nanargmax(w.singular), :2]
    assert abs(right @ (right - [1.0, 0.0])) < 0.1


def test_nothing_is_lost_where_nothing_is_corrected():
    w = map_workspace(Correction(PLANAR, PLANAR, (None, None)), same, 512)
    assert w.lost == w.gained == 0.0 and not w.lost_in.any() and not w.gained_in.any()


def test_room_is_that_of_the_pose_in_a_cells_middle_turned_like_home(calibrated, design):
    w, home = calibrated.workspace, design.mechanism.home
    for cell in (int(np.argmax(w.room)), int(np.argmin(w.room))):
        T = pose(w.centre[cell], home.rotation.as_rotvec())
        commands = calibrated.correction.inverse(T)
        low, high = design.mechanism.strut_range.T
        assert w.room[cell] == pytest.approx(min((commands - low).min(), (high - commands).min()), abs=1e-12)
    assert w.room.max() > 0.02 and w.room.min() < 0


def test_bounds_are_the_covariance_of_the_poses_there(calibrated):
    w = calibrated.workspace
    middle = calibrated.correction.predict(calibrated.correction.nominal.strut_range.mean(axis=1)[None])
    cell = int(np.argmin(np.abs(w.centre - middle.translation).max(axis=1)))
    stated = 2 * np.sqrt(np.trace(corrected_platform_pose_covariance(calibrated, middle)[0, :3, :3]))
    assert stated < w.bound[cell, 0] < 5 * stated
    looser = map_workspace(calibrated.correction, lambda T, q: 4 * corrected_platform_pose_covariance(calibrated, T))
    np.testing.assert_allclose(looser.bound, 2 * w.bound)


def test_an_arm_has_cells_that_it_reaches_and_one_of_five_joints_no_share_of_lost():
    rng = np.random.default_rng(1)
    true = replace(secret(UR10, rng), base=UR10.base, tool=UR10.tool)
    w = map_workspace(ArmCorrection(UR10, true, (None,) * 6, np.zeros((1, 6))), same, 256)
    assert 0 <= w.lost < 0.2 and 0 <= w.gained < 0.2 and w.reached.sum() == 256
    assert np.nanmin(w.room) >= 0 and 0 <= np.nanmin(w.singular) < np.nanmax(w.singular) < 1
    assert not workspace_page.workspace_lines(w, "rad")[0].startswith("workspace: an arm of fewer")
    five = replace(UR10, joints=UR10.joints[:5], limits=UR10.limits[:5], slides=UR10.slides[:5])
    w = map_workspace(
        ArmCorrection(five, replace(five, joints=true.rows[:5]), (None,) * 5, np.zeros((1, 5))), same, 128
    )
    assert w.lost is None and w.gained is None and not w.lost_in.any() and w.reached.sum() == 128
    assert workspace_page.workspace_lines(w, "rad")[0].startswith("workspace: an arm of fewer than six joints")


def test_a_calibration_keeps_its_workspace_and_one_without_is_still_read(calibrated, tmp_path):
    path = tmp_path / "c.json"
    calibration_file.save(path, calibrated)
    loaded = calibration_file.load(path).workspace
    for name in type(loaded).__slots__:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(calibrated.workspace, name))
    calibration_file.save(path, replace(calibrated, workspace=None))
    assert "workspace" not in json.loads(path.read_text()) and calibration_file.load(path).workspace is None


@pytest.mark.parametrize(
    "name, value, says",
    [
        ("index", [[0, 0, -1]], "whole numbers"),
        ("believed", [1], "numbers"),
        ("size", 0, "> 0"),
        ("lost", 1.5, "<= 1"),
        ("schema", "workspace/9", "workspace/9"),
        ("index", [], "one cell"),
    ],
)
def test_a_workspace_that_cannot_be_is_refused_by_name(calibrated, tmp_path, name, value, says):
    path = tmp_path / "c.json"
    calibration_file.save(path, calibrated)
    tree = json.loads(path.read_text())
    tree["workspace"][name] = value
    path.write_text(json.dumps(tree))
    with pytest.raises(FileError, match=f"{name}.*{says}"):
        calibration_file.load(path)


def test_every_column_of_cells_is_drawn_and_written(calibrated):
    w = calibrated.workspace
    rows = list(workspace_rows(w))
    assert len(rows) == len(w.index) and all(len(row.split(",")) == len(COLUMNS) for row in rows)
    for q in (
        workspace_page.LOST,
        workspace_page.GAINED,
        workspace_page.POSITION,
        workspace_page.ROTATION,
        workspace_page.SINGULAR,
        workspace_page.workspace_map_quantity_of_axis_margin("m"),
    ):
        unit, seen = workspace_page.workspace_cell_views_unit_and_svg(w, q)
        assert seen.count("<rect") == len(np.unique(w.index[:, :2], axis=0)) + len(
            np.unique(w.index[:, [0, 2]], axis=0)
        )
        assert "nan" not in seen and "inf" not in seen
    column = (w.index[:, :2] == w.index[np.argmax(w.lost_in), :2]).all(axis=1)
    share = w.lost_in[column].sum() / w.believed[column].sum()
    assert (
        f">{share * 100:.1f}</text>" in workspace_page.workspace_cell_views_unit_and_svg(w, workspace_page.LOST)[1]
        or f">{share * 100:.0f}</text>" in workspace_page.workspace_cell_views_unit_and_svg(w, workspace_page.LOST)[1]
    )
    coarse = replace(w, bound=w.bound * 1e3)
    assert (
        workspace_page.workspace_cell_views_unit_and_svg(w, workspace_page.POSITION)[0] == "um"
        and workspace_page.workspace_cell_views_unit_and_svg(coarse, workspace_page.POSITION)[0] == "mm"
    ), "three digits fit into a cell"


def test_poses_are_counted_where_the_platform_stands(calibrated, design):
    w = calibrated.workspace
    inside = hexapod.forward(design.mechanism.strut_range.mean(axis=1), design.mechanism).translation
    cell = np.flatnonzero((w.index == np.floor((inside - w.origin) / w.size)).all(axis=1))
    assert len(cell) == 1 and w.believed[cell[0]] > np.median(w.believed)
