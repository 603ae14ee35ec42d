"""Curves for what has no name: what they do, where they say nothing, and that no search knows their names."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import Context
from rig.effects.framework.effect_checks_and_fit_coordinates import (
    effect_with_valid_place_and_parameters,
    fit_coordinates_of_effects,
)
from rig.effects.framework.unmodelled_curve_and_formula_quantities import (
    HISTORY,
    PLAYS,
    TIME,
    TRAVEL,
    curve_class_over_covariate,
    curve_classes_by_covariate,
)
from rig.formats.machine_geometry_and_effects_json_file import effect_from_dict, effect_to_dict
from rig.model.machine_motion_simulation import motion_of_commands
from rig.model.mechanisms import kinematics_of
from rig.recording.recording_folder import Commands, Sensors
from tests.rig.effects.test_effect_formulas import home

__all__ = ["home"]  # a fixture of that module, used here too
CHANNEL = "strut3_temperature_C"
KINDS = curve_classes_by_covariate((CHANNEL,))


@pytest.fixture
def motion(design, home):
    """Motion of struts out and back over 100 s, strut 3 warmed by 10 K meanwhile."""
    t = np.linspace(0.0, 100.0, 41)
    values = home + 0.01 * np.sin(2 * np.pi * t / 50.0)[:, None] * np.arange(1, 7) / 6
    sensors = Sensors(np.array([0.0, 100.0]), {CHANNEL: np.array([20.0, 30.0])})
    found = motion_of_commands(design, Commands(t, values), t[1:], (), sensors)
    return replace(found, T=kinematics_of(design.mechanism).forward(found.lengths, design.mechanism))


@pytest.mark.parametrize("kind", KINDS.values(), ids=list(KINDS))
def test_a_curve_is_the_sum_of_its_columns_at_its_place_alone(design, motion, kind):
    context = Context(design, motion.t, motion.sensors, motion)
    for candidate in kind.candidates("strut 3", context):
        node = {**candidate.grid[0], "size": 2e-5}
        sizes = np.linspace(-1, 1, len(candidate.linear))
        curve = effect_with_valid_place_and_parameters(candidate.effect(node, sizes))
        moved = curve.deviation(motion)
        assert np.allclose(moved, 2e-5 * candidate.deviation(candidate.grid[0], motion) @ sizes, atol=1e-18)
        assert moved[:, 2].any() and not np.delete(moved, 2, axis=1).any()
        assert not curve.uncovered(motion).any()
        assert len(fit_coordinates_of_effects((curve,))) == len(sizes)
        assert {c.loose for c in fit_coordinates_of_effects((curve,))} == {1.0}
        assert effect_from_dict(effect_to_dict(curve), KINDS) == curve == pickle.loads(pickle.dumps(curve))


def test_a_sensor_of_another_axis_is_not_tried(design, motion):
    context = Context(design, motion.t, motion.sensors, motion)
    kind = curve_class_over_covariate(CHANNEL)
    assert kind.candidates("strut 3", context) and not kind.candidates("strut 4", context)


def test_no_search_knows_a_curve():
    assert not set(KINDS) & set(BY_NAME)


def test_a_curve_over_time_says_nothing_of_other_times_and_states_its_size(motion):
    curve = curve_class_over_covariate(TIME)("strut 3", 0.0, 50.0, 0.0, 1e-5, (1.0,))
    later = motion.t > 52.5  # a twentieth of the time beyond its end
    assert not curve.deviation(motion)[later].any() and curve.deviation(motion)[~later, 2].any()
    assert np.allclose(curve.uncovered(motion)[later, 2], 1e-5 / np.sqrt(2))
    assert not curve.uncovered(motion)[~later].any()


def test_a_curve_over_a_sensor_is_held_at_its_end(motion):
    curve = curve_class_over_covariate(CHANNEL)("strut 3", 20.0, 25.0, 0.0, 1e-5, (1.0,))
    moved, beyond = curve.deviation(motion)[:, 2], motion.t > 52.5
    assert np.allclose(moved[beyond], -1e-5) and np.allclose(moved[0], 1e-5 * np.cos(np.pi * motion.t[0] / 50))
    assert curve.uncovered(motion)[beyond, 2].all()


def test_one_play_of_a_history_lags_by_its_half_width(motion):
    widths = np.geomspace(1e-4, 1e-4 * 2 ** (PLAYS - 1), PLAYS)
    sizes = (0.0, 1.0, *np.zeros(2 * PLAYS - 2))
    curve = curve_class_over_covariate(HISTORY)(
        "strut 6", float(widths[0]), float(widths[-1]), 0.0, float(widths[1]), sizes
    )
    assert np.allclose(np.abs(curve.deviation(motion)).max(), widths[1])
    assert curve.forgets() == 2 * widths[-1]


def test_recent_travel_grows_by_the_way_and_fades(motion):
    kind = curve_class_over_covariate(TRAVEL)
    long, short = (kind("strut 6", memory=memory)._covariate(motion, 5) for memory in (1e9, 1e-3))
    assert np.allclose(long, motion.path.way[:, 5], rtol=1e-6) and short.max() < 1e-5
