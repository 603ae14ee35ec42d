"""What a recording's design cannot separate is stated: direction, time, temperature and load as functions of place."""

import json

import numpy as np
import pytest

from calib.samples.position_confounds_and_poses_on_one_clock import (
    DIRECTION,
    LOAD,
    TIME,
    Confounds,
    approach_text,
    confounds_of_experimental_design,
)
from rig.recording.recording_folder import PAYLOAD

AXES = tuple(f"strut {i + 1}" for i in range(6))


def _design(n: int = 40, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(-0.02, 0.02, (n, 6)), rng.choice([-1.0, 1.0], (n, 6)), 10.0 * np.arange(n)


def _causes(found: Confounds) -> set[tuple[str, str]]:
    return {(row.cause, row.axis) for row in found.serious}


def test_a_direction_that_is_the_half_of_the_stroke_is_a_confound_and_a_random_one_is_none() -> None:
    values, direction, t = _design()
    assert not confounds_of_experimental_design(values, direction, t, {}, AXES).serious
    direction[:, 2:5] = np.sign(values[:, 2:5])
    found = confounds_of_experimental_design(values, direction, t, {}, AXES)
    assert _causes(found) == {(DIRECTION, axis) for axis in AXES[2:5]}
    assert "100 % a function of place on struts 3-5: play and place cannot be separated" in found.line()
    assert json.loads(json.dumps(found.tree()))["serious"] == [f"direction of approach on {axis}" for axis in AXES[2:5]]


@pytest.mark.parametrize(
    ("name", "cause"), [("t", TIME), ("strut_3_temperature_C", "strut_3_temperature_C"), (PAYLOAD, LOAD)]
)
def test_what_goes_with_place_is_a_confound(name: str, cause: str) -> None:
    values, direction, t = _design()
    slope = 20.0 + 100.0 * values[:, 0]
    channels = {} if name == "t" else {name: slope}
    found = confounds_of_experimental_design(values, direction, 1e3 * slope if name == "t" else t, channels, AXES)
    assert {row.cause for row in found.serious} == {cause}


def test_a_serpentine_grid_confounds_time_and_direction() -> None:
    levels = np.array(np.meshgrid(*[[-1.0, 1.0]] * 6, indexing="ij")).reshape(6, -1).T
    found = confounds_of_experimental_design(levels, np.sign(levels), 5.0 * np.arange(len(levels)), {}, AXES)
    assert {row.cause for row in found.serious} == {DIRECTION, TIME}


def test_chance_is_no_confound_however_few_the_poses() -> None:
    """Of 200 random designs of 12 to 60 poses at most one is confounded; the mean share is what is expected by
    chance.
    """
    shares, chances, accused = [], [], 0
    for seed in range(200):
        found = confounds_of_experimental_design(*_design(12 + seed % 49, seed), {}, AXES)
        accused += bool(found.serious)
        shares += [row.share for row in found.rows]
        chances += [row.chance for row in found.rows]
    assert accused <= 1
    assert np.mean(shares) == pytest.approx(np.mean(chances), abs=0.01)


def test_what_never_varied_is_named_and_too_few_poses_state_nothing() -> None:
    values, direction, t = _design()
    direction[:, 0] = 1.0
    found = confounds_of_experimental_design(values, direction, t, {PAYLOAD: np.zeros(40)}, AXES)
    assert found.constant == (f"{DIRECTION} on strut 1", LOAD)
    assert found.one_sided == "strut 1" and not confounds_of_experimental_design(*_design(), {}, AXES).one_sided
    few = confounds_of_experimental_design(values[:4], direction[:4], t[:4], {}, AXES)
    assert not few.rows and few.unjudged and "none can be estimated from 4 poses" in few.line()


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        (0.0, "struts 1-6"),  # a log that begins at the first pose: nothing had moved before it
        (-1.0, "struts 1-6"),  # one pose of 80 from the other side tells nothing of play
    ],
)
def test_an_axis_that_comes_to_nearly_all_poses_from_one_side_is_one_sided(start: float, expected: str) -> None:
    values, direction, t = _design(80)
    direction[:] = 1.0
    direction[0] = start
    found = confounds_of_experimental_design(values, direction, t, {}, AXES)
    assert found.one_sided == expected
    assert approach_text(values, direction, AXES) == "from one side by every axis"


def test_without_any_direction_nothing_is_said_of_sides() -> None:
    values, direction, t = _design(80)
    found = confounds_of_experimental_design(values, 0 * direction, t, {}, AXES)
    assert found.one_sided == "" and f"{DIRECTION} on strut 1" in found.unjudged
    assert approach_text(values, 0 * direction, AXES) == "not determined by the commands"


def test_sides_of_a_few_poses_or_of_four_in_five_are_both() -> None:
    values, direction, t = _design(80)
    direction[:] = 1.0
    few, mixed = direction.copy(), direction.copy()
    few[4:] = 0.0
    mixed[::5, 1:] = -1.0
    assert confounds_of_experimental_design(values, few, t, {}, AXES).one_sided == ""
    assert confounds_of_experimental_design(values, mixed, t, {}, AXES).one_sided == "strut 1"
    assert approach_text(values, mixed, AXES) == "from one side on strut 1"
    assert approach_text(*_design(80)[:2], AXES) == "from both sides"
