"""calibration.json: what goes in comes out, and what is none is refused with its place."""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib import store
from calib.certify.calibration import Calibration
from calib.certify.certificate import certify, promised
from rig.errors import FileError
from rig.mechanisms import hexapod
from tests.calib.correct.test_correction import wavy
from tests.calib.worlds import sampled, workspace


@pytest.fixture(scope="module")
def calibration(design):
    samples, _ = sampled(design, 5, count=150, deviation=wavy)
    done = certify(samples, design.mechanism, np.random.default_rng(0))
    claim = promised(samples, done, np.random.default_rng(0))
    return Calibration(done.correction, done.found.covariance, done.found.scatter, (1, 2), (3,), done.held_out, {"seed": 0}, claim)


def test_what_is_saved_corrects_as_before(calibration, design, tmp_path):
    store.save(tmp_path / "c.json", calibration)
    again = store.load(tmp_path / "c.json")
    wanted = workspace(design, 20)
    np.testing.assert_allclose(again.correction.inverse(wanted), calibration.correction.inverse(wanted), atol=1e-12)
    assert again.held_out == calibration.held_out and again.claim == calibration.claim and again.frames == (1, 2) and again.left_out == (3,)
    np.testing.assert_allclose(again.covariance, calibration.covariance)
    tree = json.loads((tmp_path / "c.json").read_text())
    assert tree["schema"] == "calibration/1" and "m, rad" in tree["units"] and "T_base_platform" in tree["frames"]
    assert not list(tmp_path.glob("*.part"))
    assert hexapod.inverse(wanted, again.correction.fitted).shape == (20, 6)


def test_few_configurations_keep_the_files_shape(calibration, design, tmp_path):
    samples, _ = sampled(design, 6, count=5)
    done = certify(samples, design.mechanism, np.random.default_rng(0))
    few = replace(calibration, correction=done.correction, held_out=done.held_out, claim=promised(samples, done, np.random.default_rng(0)))
    store.save(tmp_path / "c.json", few)
    tree, again = json.loads((tmp_path / "c.json").read_text()), store.load(tmp_path / "c.json")
    assert tree["held_out"]["after"] == {"n": 0, "position": [None] * 3, "rotation": [None] * 3, "bias": [None] * 6, "mean": [None] * 2}
    assert again.held_out is None and again.claim == few.claim and "takes 8" in again.claim.reason


def test_a_file_of_before_there_was_a_claim_is_read(calibration, tmp_path):
    store.save(tmp_path / "c.json", calibration)
    tree = json.loads((tmp_path / "c.json").read_text())
    del tree["claim"], tree["held_out"]["configurations"]
    (tmp_path / "c.json").write_text(json.dumps(tree))
    assert store.load(tmp_path / "c.json").claim is None and store.load(tmp_path / "c.json").held_out.configurations == 150


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
