"""An effect of no size changes no command: nothing is refused for it, and its uncertainty remains stated."""

from dataclasses import replace

import numpy as np
import pytest

from calib.correction.hexapod_correction_c_source_and_shared_c_file_parts import controller_terms_of_compensable_effects
from calib.correction.timed_command_sequence_and_pose_space_correction_map import Pace
from calib.models.wanted_pose_commands import commands_along_route
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model.mechanisms import hexapod
from tests.calib.correction.test_physics import known_to_be, wanted

NONE, PLAY = parse_effect("backlash:strut2:gap=0"), parse_effect("backlash:strut4:gap=5e-5")
SIGMA = 1e-5  # m, of a gap


def with_sigma(calibration):
    """Calibration whose gaps are known to SIGMA."""
    physics = calibration.physics
    return replace(calibration, physics=replace(physics, own=SIGMA**2 * np.eye(len(physics.own))))


def test_nothing_is_refused_for_an_effect_of_no_size(design):
    calibration = known_to_be(design, NONE)
    calibration.refuse_physics("learning on-line")
    assert calibration.correction.physics == ()
    assert not controller_terms_of_compensable_effects(calibration.correction, calibration.physics).terms
    T, _, _ = wanted(design, 3)
    np.testing.assert_allclose(calibration.correction.inverse(T), hexapod.inverse(T, design.mechanism), atol=1e-9)


def test_an_effect_with_a_size_is_refused_by_its_name_alone(design):
    calibration = known_to_be(design, NONE, PLAY)
    assert calibration.correction.physics == ("backlash at strut 4",)
    with pytest.raises(RigError, match="physics that changes them \\(backlash at strut 4\\)"):
        calibration.refuse_physics("learning on-line")


def test_what_is_uncertain_of_an_effect_of_no_size_is_stated(design):
    """A gap that is 0 to 10 um leaves some of that at every pose, as a gap of another size does."""
    T, t, log = wanted(design, 6)
    home, pace = hexapod.home_values(design.mechanism), Pace(t, 0.0, 0.02, None)
    variances = [
        np.einsum("nii->ni", commands_along_route(with_sigma(known_to_be(design, one)), T, home, pace, log).covariance)
        for one in (NONE, parse_effect("backlash:strut2:gap=5e-5"))
    ]
    none, play = (np.sqrt(each[:, :3].sum(axis=1).max()) for each in variances)
    assert none > 0.5 * play > 1e-6
