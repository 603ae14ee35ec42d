"""Readings of an operator: what is asked, in the units of rig.toml, and what is taken for an answer."""

from dataclasses import replace

import numpy as np
import pytest

from rig.driving.readings_entered_by_operator_during_run import ReadingForm, permitted_figure_counts_of_reading
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_length_and_angle_units
from rig.model import mechanisms
from rig.model.design import Instrument


@pytest.fixture
def form(design):
    return ReadingForm(design.mechanism, parse_length_and_angle_units("mm, deg"), (3, 6))


def test_a_place_is_named_in_the_units_of_the_rig(form, design):
    lengths = mechanisms.kinematics_of(design.mechanism).inverse(design.mechanism.home, design.mechanism)
    asked = form.question(4, lengths, (3, 6))
    x, y, z = design.mechanism.home.translation * 1e3
    assert asked.startswith(f"frame 4 stands at {x:g} {y:g} {z:g} mm, 0 0 0 deg by the nominal model (struts ")
    assert asked.endswith(
        "press Enter once it is measured, after x y z or x y z rx ry rz (mm, deg) if it is to be recorded"
    )
    assert form.question(4, lengths, ()).endswith("once it is measured")


def test_a_reading_is_stored_in_metres_and_radians(form):
    assert form.reading("", (3, 6)) == form.reading("  ", (3,)) == ()
    np.testing.assert_allclose(form.reading("1 2 450.5", (3, 6)), [1e-3, 2e-3, 0.4505], atol=1e-15)
    np.testing.assert_allclose(
        form.reading("1, 2, 450.5, 0, 0, 90", (3, 6)), [1e-3, 2e-3, 0.4505, 0, 0, np.pi / 2], atol=1e-15
    )


@pytest.mark.parametrize(
    ("text", "sizes", "why"),
    [
        ("1 2", (3, 6), r"2 figures; expected 3 figures \(x y z\) or 6 figures"),
        ("1 2 3", (6,), r"3 figures; expected 6 figures \(x y z rx ry rz\)"),
        ("1 2 3", (), "expected nothing"),
        ("1 2 x", (3,), "not a number: 'x'"),
        ("1 2 nan", (3,), "not finite"),
        ("1 2 60000", (3,), "a position of 60000 mm is implausible"),
    ],
)
def test_what_is_no_reading_is_refused_in_words(form, text, sizes, why):
    with pytest.raises(RigError, match=why):
        form.reading(text, sizes)


def test_the_instrument_states_what_a_reading_has():
    pose = Instrument("free", "free", 1e-5, 1e-4)
    assert permitted_figure_counts_of_reading(None) == (3, 6) and permitted_figure_counts_of_reading(pose) == (6,)
    assert permitted_figure_counts_of_reading(replace(pose, rotation_sigma=None)) == (3,)
    assert permitted_figure_counts_of_reading(replace(pose, kind="distance")) == ()
