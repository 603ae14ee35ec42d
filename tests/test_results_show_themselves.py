"""Results in a console: one short line each, whatever they hold."""

import sys
from types import SimpleNamespace

import numpy as np
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


def test_a_measurement_is_a_table_of_poses_and_one_of_residuals(results, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    measured = results[2]
    assert measured.to_pandas()["frame"] is measured.measurement.frames
    table = measured.residuals_to_pandas()
    assert {len(column) for column in table.values()} == {len(measured.measurement.inliers)}
    residuals = np.column_stack([table["residual_u_px"], table["residual_v_px"]])
    np.testing.assert_array_equal(residuals, measured.measurement.residuals)
