"""Members of an effect's law beside the standard one, against cases worked by hand."""

import numpy as np
import pytest

from rig.effects.catalogue.creep import Creep
from rig.effects.catalogue.hysteresis import PLAYS, Hysteresis
from rig.effects.catalogue.warm_up import WarmUp
from rig.effects.framework.effect_base_class import COUNT, Candidate
from rig.effects.framework.effect_checks_and_fit_coordinates import (
    effect_with_valid_place_and_parameters,
    fit_coordinates_of_effects,
)
from rig.effects.framework.parameters_covariates_and_marker_table import Linear
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model import machine_motion_simulation as motion_simulation
from rig.recording.recording_folder import Commands, Sensors
from tests.rig.effects.test_effect_formulas import home, moved, out_and_back

__all__ = ["home"]  # a fixture of that module, used here too
SHARED = (
    Hysteresis("strut 3", 3e-3, 0.05, (0.1, 0.4, 0.1, 0.2)),
    Creep("strut 3", 0.004, 20.0, (0.3, 0.5)),
    WarmUp("strut 3", 3e-5, 900.0, (2.1, -0.8)),
)


def test_plays_with_shares_by_hand(design, home):
    found = moved(design, out_and_back(home, 0.02), [1, 2], Hysteresis("strut 3", 4e-3, 1e-2, (0.75, 0.25)))
    lag = 0.75 * 1e-3 + 0.25 * 3e-3  # half widths are 1/4 and 3/4 of the range
    np.testing.assert_allclose(found[:, 2], [-1e-2 * lag, 1e-2 * lag], rtol=1e-9)


def test_even_shares_are_the_standard_law(design, home):
    values = out_and_back(home, 0.02)
    even = Hysteresis("strut 3", 4e-3, 1e-2, (1 / PLAYS,) * PLAYS)
    np.testing.assert_allclose(
        moved(design, values, [0.3, 1, 2], even),
        moved(design, values, [0.3, 1, 2], Hysteresis("strut 3", 4e-3, 1e-2)),
        atol=1e-18,
    )


def test_creep_with_two_times_by_hand(design, home):
    values = np.tile(home, (4, 1))
    values[1:, 2] += 0.01
    commands = Commands(np.array([0.0, 1e-6, 20.0, 1e5]), values)
    found = motion_simulation.simulate_machine_run(
        design, commands, np.array([1e-6, 20.0, 9e4]), [Creep("strut 3", 3e-3, 20.0, (0.6, 0.4))]
    ).deviation
    later = 0.6 * np.exp(-1) + 0.4 * np.exp(-0.2)  # the second time is five times the first
    np.testing.assert_allclose(found[:, 2], [-3e-5, -3e-5 * later, 0], rtol=1e-6, atol=1e-12)


def test_one_body_heated_through_another_begins_slowly(design, home):
    commands = Commands(np.array([0.0, 1e5]), np.tile(home, (2, 1)))
    t = np.array([0.0, 9.0, 900.0, 9.9e4])
    found = motion_simulation.simulate_machine_run(
        design, commands, t, [WarmUp("strut 3", 5e-5, 900.0, (-0.5, 1.5))]
    ).deviation
    wanted = 5e-5 * (1 - 1.5 * np.exp(-t / 2700) + 0.5 * np.exp(-t / 900))  # two in a row, one three times as slow
    np.testing.assert_allclose(found[:, 2], wanted, atol=1e-15)
    assert 0 < found[1, 2] < 1e-9


def test_a_strut_follows_its_thermometer_late(design, home):
    log = Sensors(np.array([0.0, 1e-6, 1e4]), {f"strut{i}_temperature_C": np.r_[20.0, 30, 30] for i in range(1, 7)})
    commands = Commands(np.array([0.0, 1e4]), np.tile(home, (2, 1)))
    found = motion_simulation.simulate_machine_run(
        design, commands, np.array([500.0]), [parse_effect("thermal_expansion:rig:coefficient=1e-5,lag=500")], log
    ).deviation
    np.testing.assert_allclose(found[0], home * 1e-4 * (1 - 1 / np.e), rtol=1e-6)


@pytest.mark.parametrize("effect", SHARED, ids=lambda effect: effect.name)
def test_shares_are_written_with_the_sum_of_one_and_do_the_same(design, home, effect):
    written, values = effect_with_valid_place_and_parameters(effect.written()), out_and_back(home, 0.02)
    assert np.isclose(sum(written.shares), 1.0) and not np.isclose(sum(effect.shares), 1.0)
    np.testing.assert_allclose(
        moved(design, values, [0.3, 1, 2], written), moved(design, values, [0.3, 1, 2], effect), rtol=1e-9
    )


@pytest.mark.parametrize("effect", SHARED, ids=lambda effect: effect.name)
def test_shares_of_another_sum_are_refused(effect):
    with pytest.raises(ValueError, match=f"{effect.name}: shares have the sum of 1, not"):
        effect_with_valid_place_and_parameters(effect)


@pytest.mark.parametrize("effect", SHARED, ids=lambda effect: effect.name)
def test_only_another_member_has_its_shares_fitted(effect):
    standard = type(effect)(effect.place)
    assert "shares" not in {c.name for c in fit_coordinates_of_effects((standard,))}
    fitted = [c.index for c in fit_coordinates_of_effects((effect,)) if c.name == "shares"]
    assert fitted == list(range(len(effect.shares)))


def test_members_that_cancel_have_shares_within_their_bounds():
    candidate = Candidate(WarmUp, "strut 1", [], [Linear("amplitude", k, 1e-6) for k in range(2)])
    node = {"time_constant": 1800.0, COUNT: 2}
    made = effect_with_valid_place_and_parameters(candidate.effect(node, np.array([-2.19e-5, 2.29e-5])))
    assert made.shares[0] == pytest.approx(-5) and sum(made.shares) == pytest.approx(1)
    rng = np.random.default_rng(7)
    for size in rng.normal(size=2000):  # the scaled shares end at the bound but for rounding
        small = 1 + 0.05 * rng.random()
        effect_with_valid_place_and_parameters(candidate.effect(node, 1e-5 * size * np.array([-small, 1.0])))
