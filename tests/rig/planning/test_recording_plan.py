"""Plans: every part stays in reach, exposes what it says, and is the same from run to run."""

import numpy as np
import pytest

from rig.errors import FileError, RigError
from rig.model.mechanisms import hexapod
from rig.model.pose import pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan

EXPECTED = {
    "sobol": 100,
    "grid": 64,
    "division": 729,
    "simplices": 89,
    "axes": 54,
    "combined": 108,
    "iso9283": 150,
    "ladder": 96,
    "payload": 36,
    "moving": 60,
    "zigzag": 60,
    "warmup": 48,
    "repeat": 30,
    "dwell": 20,
}


@pytest.mark.parametrize("part", [name for name in plan.PARTS if name not in ("commands", "wait", "turn")])
def test_every_part_stays_in_reach_and_in_time(design, part):
    found = plan.build_plan(design, part, seed=3)
    assert len(found.t) == EXPECTED[part]
    assert not hexapod.signed_limit_excess(found.commands.values, design.mechanism).any()
    assert (np.diff(found.commands.t) > 0).all() and (np.diff(found.t) > 0).all()
    assert found.t[0] > found.commands.t[0] and found.t[-1] < found.commands.t[-1]
    speed = np.abs(np.diff(found.commands.values, axis=0)).max(axis=1) / np.diff(found.commands.t)
    assert speed.max() <= 1.01 * design.actuator.max_speed
    rebuilt = plan.build_plan(design, part, seed=3)
    assert (rebuilt.commands.values == found.commands.values).all()


def test_a_wait_moves_nothing_and_ends(design):
    bare, waited = plan.build_plan(design, "sobol:4"), plan.build_plan(design, "sobol:2,wait:20,sobol:2")
    assert waited.t[2] - waited.t[1] > 1200 > bare.t[-1] and len(waited.t) == 4
    with pytest.raises(RigError, match="600 minutes at the most, not for 601"):
        plan.build_plan(design, "sobol:2,wait:601")


def test_parts_join(design):
    assert len(plan.build_plan(design, "sobol:5,ladder:1,moving:7").t) == 5 + 24 + 7


def test_settled_exposures_stand_still(design):
    found = plan.build_plan(design, "sobol:20")
    np.testing.assert_allclose(found.commands.at(found.t - 1), found.commands.at(found.t + 0.5), atol=1e-12)


def test_moving_exposures_move(design):
    found = plan.build_plan(design, "moving:20")
    assert np.abs(found.commands.at(found.t + 0.05) - found.commands.at(found.t - 0.05)).max(axis=1).min() > 1e-5


def test_a_ladder_approaches_every_length_from_both_sides(design):
    found = plan.build_plan(design, "ladder:2")
    lengths = found.commands.at(found.t)
    middle = design.mechanism.strut_range.mean(axis=1)
    for strut in range(6):
        own = lengths[8 * strut : 8 * strut + 8, strut] - middle[strut]
        assert np.sign(own[[0, 2, 4, 6]]).tolist() == [1, -1, 1, -1] and np.abs(own[[1, 3, 5, 7]]).max() < 1e-6


def test_iso_9283_visits_the_cubes_middle_and_four_corners_of_a_plane_in_turn(design):
    poses = configuration_generators.iso9283_five_test_pose_commands(design)
    p = hexapod.forward(poses, design.mechanism).translation
    arms = p[1:] - p[0]
    half = np.abs(arms).max()
    assert (
        p[0] == pytest.approx(design.mechanism.home.translation, abs=1e-9)
        and np.abs(arms) == pytest.approx(half, abs=1e-9)
        and half > 0.005
    )
    assert arms[:, 1] == pytest.approx(arms[:, 2], abs=1e-9) and np.ptp(arms, axis=0) == pytest.approx(
        2 * half, abs=1e-9
    )
    found = plan.build_plan(design, "iso9283:3")
    rows = np.searchsorted(found.commands.t, found.t) - 1
    assert np.abs(found.commands.values[rows] - np.tile(poses[::-1], (3, 1))).max() < 1e-6


def test_axes_translate_along_and_turn_about_the_axes(design):
    found = configuration_generators.single_axis_pose_commands(design, 5)
    T = hexapod.forward(found, design.mechanism)
    moved = pose_difference(design.mechanism.home, T).reshape(6, 5, 6)
    for axis in range(6):
        off = np.delete(moved[axis], axis, axis=1)
        assert np.abs(off).max() < 1e-9 and np.ptp(moved[axis][:, axis]) > 0.02


def test_combined_plans_turn_while_they_move_along_every_pair_of_axes(design):
    T = hexapod.forward(configuration_generators.combined_translation_rotation_commands(design, 4), design.mechanism)
    moved = pose_difference(design.mechanism.home, T).reshape(3, 3, 2, 4, 6)
    for i in range(3):
        for j in range(3):
            for k, sign in enumerate((1, -1)):
                part = moved[i, j, k]
                place = T.translation.reshape(3, 3, 2, 4, 3)[i, j, k] - design.mechanism.home.translation
                assert (
                    np.abs(np.delete(place, i, axis=1)).max() < 1e-9
                    and np.abs(np.delete(part[:, 3:], j, axis=1)).max() < 1e-9
                )
                assert np.ptp(place[:, i]) > 0.01 and np.ptp(part[:, 3 + j]) > 0.03
                assert (np.sign(place[[0, -1], i] * part[[0, -1], 3 + j]) == sign).all()


def test_grid_neighbours_differ_in_one_axis(design):
    steps = (
        np.abs(np.diff(configuration_generators.grid_configurations(design.mechanism.strut_range, 3), axis=0)) > 1e-9
    )
    assert (steps.sum(axis=1) == 1).all() and len(steps) == 728


def test_low_discrepancy_covers_evenly(design):
    strokes = design.mechanism.strut_range
    points = (configuration_generators.sobol_configurations(strokes, 64, 1.0) - strokes[:, 0]) / np.ptp(strokes, axis=1)
    for axis in range(6):
        assert (np.bincount((points[:, axis] * 8).astype(int), minlength=8) == 8).all()


def test_payload_steps_are_logged(design):
    from synthetic.random_true_machine_and_truth_file import random_true_and_logged_temperatures

    found = plan.build_plan(design, "payload:4")
    _, log = random_true_and_logged_temperatures(found.commands.t[-1], np.random.default_rng(0))
    sensors = plan.sensors_with_payload(found, log)
    load = sensors.at(found.t, "payload_mass_kg")
    assert load[:4].tolist() == [0] * 4 and (load[4:8] > 1).all() and load[8:].tolist() == [0] * 4


def test_commands_come_from_a_file(design, tmp_path):
    middle = design.mechanism.strut_range.mean(axis=1)
    rows = ["frame,l1,l2,l3,l4,l5,l6"] + [f"{k}," + ",".join(f"{v + 1e-3 * k:.9f}" for v in middle) for k in range(3)]
    path = tmp_path / "commands.csv"
    path.write_text("\n".join(rows) + "\n")
    found = plan.build_plan(design, f"commands:{path}")
    np.testing.assert_allclose(found.commands.at(found.t), middle + 1e-3 * np.arange(3)[:, None], atol=1e-7)
    path.write_text("\n".join(rows[:2] + ["5," + ",".join(["9.9"] * 6)]) + "\n")
    with pytest.raises(FileError, match="strut 1 is commanded out of its range") as caught:
        plan.build_plan(design, f"commands:{path}")
    assert caught.value.line == 3


@pytest.mark.parametrize(
    "text, says",
    [
        ("sobl:3", "no part 'sobl'"),
        ("sobol:x", "whole number"),
        ("sobol:0", "whole number"),
        ("grid:1", "at least 2"),
        ("commands:nowhere.csv", "no such file"),
    ],
)
def test_what_is_no_plan_is_refused(design, text, says):
    with pytest.raises(RigError, match=says):
        plan.build_plan(design, text)
