"""Plans whose direction of approach and time are no function of place, by construction: same configurations, same
count, same from run to run.
"""

import numpy as np
import pytest

from calib.samples.exposure_conditions import approach_direction
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds, confounds_of_experimental_design
from rig.model import mechanisms
from rig.model.design import Design
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.planning.timed_plan_and_visiting_order import REACHES
from rig.recording.recording_folder import PAYLOAD

SCATTERED = (
    "sobol:14",
    "sobol:40",
    "grid:2",
    "simplices:2",
    "division:1",
    "axes:9",
    "combined:3",
    "payload:14",
    "repeat:30",
    "warmup:30",
)


def _confounds(design: Design, text: str, seed: int) -> Confounds:
    found = plan.build_plan(design, text, seed)
    mass = found.payload[np.searchsorted(found.payload[:, 0], found.t, side="right") - 1, 1]
    return confounds_of_experimental_design(
        found.commands.at(found.t),
        approach_direction(found.commands, found.t),
        found.t,
        {PAYLOAD: mass},
        mechanisms.axis_place_texts(design.mechanism),
    )


@pytest.mark.parametrize("text", SCATTERED)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_neither_direction_nor_time_nor_load_is_a_function_of_place(design: Design, text: str, seed: int) -> None:
    """No share exceeds what as many poses in random order would give by much, and where there are many poses none is
    left at all.
    """
    found = _confounds(design, text, seed)
    assert not found.serious and found.rows
    for row in found.rows:
        assert row.share < max(0.1, 1.3 * row.chance), (text, row)
    assert all(not cause.startswith("direction") for cause in found.constant)


def test_configurations_are_those_that_were_asked_for(design: Design) -> None:
    found, wanted = (
        plan.build_plan(design, "sobol:40", 5),
        configuration_generators.sobol_configurations(
            plan.axis_strokes(design), 40, seed=int(np.random.default_rng(5).integers(1 << 30))
        ),
    )
    visited = found.commands.at(found.t)
    assert len(found.t) == 40
    order = np.abs(visited[:, None] - wanted).max(axis=2).argmin(axis=1)
    assert sorted(order) == list(range(40)) and np.abs(visited - wanted[order]).max() < 1e-6
    assert np.abs(np.diff(order)).min() >= 1 and (np.diff(order) != 1).mean() > 0.8


def test_last_moves_are_long_and_short_from_either_side(design: Design) -> None:
    """What follows the size of a move is told from what follows its direction, and neither is a function of place."""
    found = plan.build_plan(design, "sobol:60")
    extent = np.ptp(plan.axis_strokes(design), axis=1)
    rows = np.searchsorted(found.commands.t, found.t)
    last = (found.commands.values[rows - 1] - found.commands.values[rows - 2]) / extent
    place = found.commands.at(found.t)
    assert (
        np.abs(last).min() > REACHES[0] - 1e-5
        and np.abs(last).max() < REACHES[1] + 1e-5
        and np.abs(last).min() < 0.3 * np.abs(last).max()
    )
    assert np.abs(np.sign(last).mean(axis=0)).max() < 0.05
    for i in range(6):
        assert (
            abs(np.corrcoef(last[:, i], place[:, i])[0, 1]) < 0.4
            and np.corrcoef(last[:, i], np.sign(last[:, i]))[0, 1] < 0.95
        )


def test_an_axis_at_its_end_comes_from_within(design: Design) -> None:
    found = plan.build_plan(design, "division:1@1")
    low, high = plan.axis_strokes(design).T
    assert (found.commands.values > low - 1e-6).all() and (found.commands.values < high + 1e-6).all()


def test_a_one_sided_plan_comes_from_below_everywhere(design: Design) -> None:
    found = plan.build_plan(design, "sobol:20,repeat:6", one_sided=True)
    assert (approach_direction(found.commands, found.t) == 1).all()


@pytest.mark.parametrize("count", [3, 5, 8])
def test_few_configurations_are_balanced_too(design: Design, count: int) -> None:
    found = plan.build_plan(design, f"sobol:{count}", 1)
    sides = approach_direction(found.commands, found.t)
    assert np.abs(sides.sum(axis=0)).max() <= 2 and np.ptp(sides, axis=0).min() == 2
