"""Effects of the catalogue do what the same law does by another formula, pose by pose."""

from dataclasses import replace

import numpy as np
import pytest

from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.planning import recording_plan as plan
from synthetic import random_true_machine_and_truth_file, recording_simulation
from tests.calib.effects_by_other_formulas import OffsetSignals, SwungCardan, WarmedScrew
from tests.calib.lifted_corners import lifted

TOLERANCE = 1e-10  # m
SIGNAL = 2e-3 * 2.5e-4 / (2 * np.pi)  # m, what an offset of 2e-3 makes of a pitch of 0.25 mm
TWINS = [
    ("joint_offset:strut3:offset=4e-3", SwungCardan("strut 3", 4e-3), TOLERANCE),
    ("joint_offset:strut6:offset=-15e-3,end=1", SwungCardan("strut 6", -15e-3, 1.0), TOLERANCE),
    ("travel_heating:strut3:per_metre=1e-4,time_constant=300", WarmedScrew("strut 3", 1e-4, 300.0), 3e-8),
    (
        f"encoder_interpolation:strut3:amplitude={SIGNAL},periods=4000",  # its harmonics: 1e-3 of it
        OffsetSignals("strut 3", 2.5e-4, (2e-3, 0.0)),
        2e-3 * SIGNAL,
    ),
]


def deviations(design, effect):
    route = plan.build_plan(design, "moving:10,sobol:30", 3)
    return motion_simulation.simulate_machine_run(design, route.commands, route.t, [effect]).deviation


@pytest.mark.parametrize("text, twin, atol_m", TWINS, ids=[text for text, *_ in TWINS])
def test_another_formula_gives_the_same_deviation(design, text, twin, atol_m):
    found, expected = (deviations(design, effect) for effect in (parse_effect(text), twin))
    np.testing.assert_allclose(found, expected, atol=atol_m)
    assert np.ptp(expected, axis=0).max() > 3e2 * atol_m


def test_a_joint_without_a_second_axis_has_no_offset(design):
    free = replace(design, actuator=replace(design.actuator, joints="cardan-ball"))
    assert np.abs(deviations(free, parse_effect("joint_offset:strut3:offset=4e-3"))).max() > 1e-6
    with pytest.raises(RigError, match="takes a cardan at end 0 of the strut"):
        deviations(free, parse_effect("joint_offset:strut3:offset=4e-3,end=1"))


def test_an_axis_that_rests_cools(design):
    law = parse_effect("travel_heating:strut3:per_metre=1e-4,time_constant=300")
    route = plan.build_plan(design, "sobol:5", 3)
    end = float(route.t[-1])
    t = end + np.array([0.0, 300.0, 600.0])
    found = motion_simulation.simulate_machine_run(design, route.commands, t, [law]).deviation[:, 2]
    np.testing.assert_allclose(found / found[0], np.exp([0, -1, -2]), rtol=1e-9)


def test_a_lifted_corner_is_a_point_in_space(design):
    law = parse_effect("marker_flatness:8:height=1e-3,corner=1")
    route, rng = plan.build_plan(design, "sobol:6", 3), np.random.default_rng(2)
    flat, bent = (
        recording_simulation.simulate_world(
            random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(1), 1.0, effects),
            route,
            np.random.default_rng(4),
        )
        for effects in ((), (law,))
    )
    found = recording_simulation.noisy_corners(bent, 0.0, rng)
    expected = lifted(flat, recording_simulation.noisy_corners(flat, 0.0, rng), 8, 1, 1e-3)
    np.testing.assert_allclose(found.uv, expected.uv, atol=1e-8)
    own = (found.marker == 8) & (found.corner == 1)
    moved = np.abs(found.uv - recording_simulation.noisy_corners(flat, 0.0, rng).uv).max(axis=1)
    assert own.any() and not moved[~own].any() and np.median(moved[own]) > 0.1


def test_a_corner_does_not_sink_into_its_face():
    with pytest.raises(RigError, match="must lie in 0"):
        parse_effect("marker_flatness:8:height=-1e-3,corner=1")
    with pytest.raises(RigError, match="corner is a whole number"):
        parse_effect("marker_flatness:8:height=1e-3,corner=1.5")
