"""Cameras of the second writer: figures by hand, and each fault of seeing does what its formula says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from tests.truth import SIGHTS, draw, record
from tests.truth.camera_sets import HIGH, WIDE, Cube, Sight, looking, watching
from tests.truth.motion import Conditions
from tests.truth.sights import Edges, Printed, Rolling, Window, Zooming

DAY = Conditions((25.0, 0.0, 0.0, 1.0, 1.0), np.zeros(6), np.array([[0.0, 0.0]]))


def seen(fault, moving=0.0):
    """Rows of corners without noise, of a platform at its home height that moves along x at so many m/s."""
    rng = np.random.default_rng(1)
    camera_set = replace(watching(0.3, 0.45, fault, 0.0, rng))
    at = np.tile(np.eye(4), (1, 1, 1))
    at[0, 2, 3] = 0.45
    way = moving * np.eye(4)[0][:, None] * np.eye(4)[3]
    return camera_set, camera_set.corners(np.array([5.0]), lambda late: at + late[:, None, None] * way, DAY, rng)


def test_the_top_of_a_cube_by_hand():
    camera = looking("above", np.array([0.1, 0.0, 2.0]), np.array([0.1, 1e-9, 0.0]), 1000.0, np.zeros(5))
    camera_set = replace(
        watching(0.3, 0.4, Sight(), 0.0, np.random.default_rng(0)),
        cameras=(camera,),
        cubes=(Cube("B1", False, 0.2, 0.1, 30, np.eye(4)),),
    )
    rows = camera_set.corners(np.zeros(1), lambda late: np.eye(4)[None], DAY, np.random.default_rng(0))
    assert set(rows[:, 2]) == {34}  # the top alone, 1.9 m away; its up is +y, and so is the camera's
    uv = rows[:, 4:] - np.array([(WIDE - 1) / 2, (HIGH - 1) / 2])
    half, left = 1000 * 0.05 / 1.9, 1000 * 0.1 / 1.9
    assert np.allclose(np.abs(uv - uv.mean(axis=0)), half, atol=1e-6) and np.isclose(
        np.linalg.norm(uv.mean(axis=0)), left
    )
    sides = np.roll(uv, -1, axis=0) - uv
    assert (
        sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0] > 0
    ).all()  # clockwise, v down


def test_a_window_shifts_a_ray_as_drawn():
    window = Window(0, 0.02, np.array([0, 0, 1.0]))
    point = np.array([[0.5, 0.0, 1.0]])

    def reached(sine):  # along x after 1 m, of which 0.02 m in glass
        inside = np.arcsin(sine / 1.5)
        return 0.98 * np.tan(np.arcsin(sine)) + 0.02 * np.tan(inside) - 0.5

    sine = brentq(reached, 0.1, 0.9, xtol=1e-15)
    bent = window.bent(0, point)[0]
    assert np.isclose(bent[0] / bent[2], np.tan(np.arcsin(sine)), rtol=1e-9)
    assert (window.bent(1, point) == point).all()


def test_edges_move_inward_by_so_many_px():
    square = np.array([[[600.0, 500], [640, 500], [640, 540], [600, 540]]])
    assert np.allclose(
        Edges(0.5, 0.0).bordered(0, square), [[[600.5, 500.5], [639.5, 500.5], [639.5, 539.5], [600.5, 539.5]]]
    )


def test_zoom_prints_and_rows():
    camera_set, rows = seen(Sight())
    zoomed, printed, rolled = (
        seen(fault)[1] for fault in (Zooming(np.full(2, 1e-4)), Printed(np.full(2, 0.01)), Rolling(1e-5))
    )
    middle = np.stack([camera_set.cameras[int(k)].middle for k in rows[:, 1]])
    assert np.allclose(zoomed[:, 4:] - middle, (rows[:, 4:] - middle) * 1.0005, atol=1e-9)  # 5 K above the reference
    spread = [
        r[:, 4:].reshape(-1, 4, 2) - r[:, 4:].reshape(-1, 4, 2).mean(axis=1, keepdims=True) for r in (rows, printed)
    ]
    assert np.allclose(np.linalg.norm(spread[1], axis=2) / np.linalg.norm(spread[0], axis=2), 1.01, atol=3e-3)
    assert np.allclose(rolled, rows)  # nothing moves
    (_, still), (_, early) = seen(Sight(), 0.1), seen(Rolling(1e-5), 0.1)
    moved, later = early[:, 4] - still[:, 4], (early[:, 5] - HIGH / 2) * 1e-5
    cubes = still[:, 2] < 12  # on the platform
    assert np.abs(moved[~cubes]).max() == 0 < np.abs(moved[cubes]).max() < 0.1 * np.abs(later).max() * 1650 / 0.6


@pytest.mark.parametrize("effect", SIGHTS)
def test_faults_of_seeing_show_in_corners(effect):
    def corners(strength):
        case = draw(8, effect, strength, "shuffled", count=14, variant=0)
        return {tuple(row[:4]): row[4:] for row in case.seen}, case.camera_set.sigma

    (sound, sigma), (weak, _), (strong, _) = (corners(s) for s in ("none", "weak", "strong"))
    common = sorted(set(sound) & set(weak) & set(strong))
    sizes = [
        np.sqrt(np.mean([((found[k] - sound[k]) ** 2).sum() / 2 for k in common])) / sigma for found in (weak, strong)
    ]
    assert len(common) > 500 and sizes[1] > (0.5 if effect == "rolling_shutter" else 1.2)
    assert effect == "marker_swap" or sizes[0] < sizes[1]


def test_a_recording_of_corners_has_its_tables(tmp_path):
    folder = record(draw(8, "none", "none", "shuffled", count=14, seen=True), tmp_path / "rec")
    assert sorted(p.name for p in folder.iterdir()) == ["commands.csv", "corners.csv", "frames.csv", "rig.toml"]
