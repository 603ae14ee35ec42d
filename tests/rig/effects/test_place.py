"""Places: each is a value with the text that files have, and knows what it takes in."""

import numpy as np
import pytest

from rig.effects.catalogue.backlash import Backlash
from rig.model.arm_hands_effect_places_and_tolerances import Place, axis_mask, parse_place_in_stage

PLACES = {
    "strut 3": Place("strut", "3"),
    "joint 12": Place("joint", "12"),
    "slide 1": Place("slide", "1"),
    "stage 2 strut 3": Place("strut", "3", 2),
    "camera left": Place("camera", "left"),
    "marker 0": Place("marker", "0"),
    "target A": Place("target", "A"),
    "rig": Place("rig"),
    "clock": Place("clock"),
    "cameras": Place("cameras"),
    "markers": Place("markers"),
}


@pytest.mark.parametrize("text", PLACES)
def test_a_place_is_its_text(text):
    assert Place.parse(text) == PLACES[text] and str(Place.parse(text)) == text


@pytest.mark.parametrize("text", ["stage 0 strut 3", "stage 2 camera left", "stage 02 strut 3", "a b c", ""])
def test_any_other_text_stays_as_it_is(text):
    assert str(Place.parse(text)) == text and Place.parse(text).stage == 0


def test_the_whole_takes_in_its_kind_alone():
    rig, cameras = Place("rig"), Place("cameras")
    assert rig.includes(Place.axis("strut", 2)) and rig.includes(Place("joint", "1", 2)) and rig.includes(rig)
    assert cameras.includes(Place("camera", "left")) and not cameras.includes(Place("marker", "1"))
    assert not rig.includes(Place("camera", "left")) and not Place("strut", "1").includes(Place("strut", "1", 1))
    assert not rig.includes(Place("target", "A")) and not Place("").includes(Place("rig"))


def test_axes_are_counted_from_one_and_masked():
    places = tuple(str(Place.axis("strut", i)) for i in range(3))
    assert places == ("strut 1", "strut 2", "strut 3") and Place.parse("strut 2").number == 2
    np.testing.assert_array_equal(axis_mask(Place("strut", "2"), places), [0, 1, 0])
    np.testing.assert_array_equal(axis_mask(Place("rig"), places), [1, 1, 1])
    assert [Place.parse(p).axis_word for p in ("joint 1", "stage 1 slide 2", "camera left")] == [
        "joint",
        "slide",
        "strut",
    ]


def test_a_stages_place_may_be_written_short():
    assert parse_place_in_stage("stage2strut3", ("axis",)) == Place("strut", "3", 2)
    assert (
        parse_place_in_stage("stage2strut3", ("camera",)) is None and parse_place_in_stage("strut3", ("axis",)) is None
    )


def test_an_effect_sits_at_its_place():
    effect = Backlash("strut 3", gap=1e-4)
    assert effect.site == Place("strut", "3") and effect.at("strut 3") and effect.at(Place("strut", "3"))
    assert not effect.at(Place("strut", "2"))
