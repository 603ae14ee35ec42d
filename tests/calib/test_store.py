"""calibration.json: what goes in comes out, and what is none is refused with its place."""

import json

import numpy as np
import pytest

from calib import store
from calib.certificate import certify
from rig.errors import FileError
from rig.mechanisms import hexapod
from tests.calib.test_correction import wavy
from tests.calib.worlds import sampled, workspace


@pytest.fixture(scope="module")
def calibration(design):
    samples, _ = sampled(design, 5, count=150, deviation=wavy)
    correction, found, held = certify(samples, design.mechanism, np.random.default_rng(0))
    return store.Calibration(correction, found.covariance, found.scatter, (1, 2), (3,), held, {"seed": 0})


def test_what_is_saved_corrects_as_before(calibration, design, tmp_path):
    store.save(tmp_path / "c.json", calibration)
    again = store.load(tmp_path / "c.json")
    wanted = workspace(design, 20)
    np.testing.assert_allclose(again.correction.inverse(wanted), calibration.correction.inverse(wanted), atol=1e-12)
    assert again.held_out == calibration.held_out and again.frames == (1, 2) and again.left_out == (3,)
    np.testing.assert_allclose(again.covariance, calibration.covariance)
    tree = json.loads((tmp_path / "c.json").read_text())
    assert tree["schema"] == "calibration/1" and "m, rad" in tree["units"] and "T_base_platform" in tree["frames"]
    assert not list(tmp_path.glob("*.part"))
    assert hexapod.inverse(wanted, again.correction.fitted).shape == (20, 6)


@pytest.mark.parametrize("spoil, says", [
    (lambda text: text[: len(text) // 2], "not valid JSON.*cut off"),
    (lambda text: text.replace("calibration/1", "calibration/9"), "calibration/9"),
    (lambda text: "[]", "no calibration"),
    (lambda text: text.replace('"fitted"', '"futted"'), "fitted is missing; is 'futted' meant"),
    (lambda text: text.replace('"base_joints": [', '"base_joints": [[1, 2, 3],', 1), "base_joints must have 6x3 numbers, got 7 entries"),
])
def test_what_is_no_calibration_is_refused(calibration, tmp_path, spoil, says):
    store.save(tmp_path / "c.json", calibration)
    (tmp_path / "c.json").write_text(spoil((tmp_path / "c.json").read_text()))
    with pytest.raises(FileError, match=says):
        store.load(tmp_path / "c.json")


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        store.load(tmp_path / "typo.json")
