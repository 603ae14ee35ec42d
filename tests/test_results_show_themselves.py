"""Results in a console: one short line each, whatever they hold."""

import pytest

import calib
import rig
import vision
from tests.conftest import BENCH


@pytest.fixture(scope="module")
def results():
    recording = rig.load(BENCH / "fit")
    made = calib.calibrate(recording)
    return recording, recording.design, vision.measure(recording), made, made.calibration


@pytest.mark.parametrize("number", range(5))
def test_a_result_is_one_short_line_that_says_more_than_its_class(results, number):
    shown = repr(results[number])
    assert shown.startswith(f"<{type(results[number]).__name__}: ") and shown.endswith(">")
    assert 20 < len(shown) < 400 and "\n" not in shown and "array(" not in shown
