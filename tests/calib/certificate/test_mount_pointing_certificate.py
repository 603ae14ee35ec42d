"""Certificates of directions: their limits hold as often as stated, and nothing is left out of them."""

import json

import numpy as np
import pytest
from scipy.stats import rice

import calib
from calib.api.calibrate import CalibrateOptions
from calib.certificate.certificate_content_dataclasses import CertifyOptions
from calib.certification.noise_free_errors_and_tolerance_limits import (
    _likelihood,
    tolerance_limits_of_true_errors,
    upper_tolerance_limit,
)
from calib.models.arm.mount_pointing_terms import ARCSEC
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.errors import NotEnoughData, RigError
from tests.calib.models.arm.test_mount_pointing_terms import SIGMA, TRUE, recorded, sky, starred
from tests.truth import pointing as truth


def test_the_likelihood_of_a_length_in_two_dimensions_is_rices():
    lengths, sigma, true = np.array([0.5, 2.0, 6.0]), np.array([1.0, 0.8, 1.2]), np.linspace(0.01, 7, 40)
    expected = rice.pdf(lengths[:, None], true / sigma[:, None], scale=sigma[:, None])
    found = _likelihood(lengths, sigma, true, 2)
    np.testing.assert_allclose(found, expected / expected.max(axis=1, keepdims=True), rtol=1e-9)


def limits_of_a_sky(rng, count, spread, noise):
    """(limits by `count` directions, that of the lengths as measured, true 95 % quantile) of errors with a spread."""
    true = spread * rng.normal(size=(count, 2))
    lengths = np.linalg.norm(true + noise * rng.normal(size=(count, 2)), axis=1)
    found = tolerance_limits_of_true_errors(lengths, np.full(count, noise), dimensions=2)
    return found, upper_tolerance_limit(lengths), spread * np.sqrt(-2 * np.log(0.05))


@pytest.mark.slow
def test_limits_hold_as_often_as_stated():
    rng = np.random.default_rng(1)
    each = [limits_of_a_sky(rng, 400, 1.0, 1.5) for _ in range(100)]
    held = np.mean([found.upper >= true for found, _, true in each])
    tighter = np.median([found.upper / measured for found, measured, _ in each])
    print(f"held {held:.3f}, of the limit as measured {tighter:.3f}")
    assert held > 0.92 and tighter < 0.95


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mount")
    return calib.calibrate(starred(folder / "rec", 1), CalibrateOptions(quick=True)).calibration


@pytest.mark.slow
def test_a_mount_is_certified_and_another_star_counts(tmp_path, calibration):
    new = starred(tmp_path / "new", 1001, 150, 0)
    found = calib.certify(calibration, new, CertifyOptions(tolerances=(("rotation", 10 * ARCSEC),)))
    made, tree = found.certificate, json.loads(json.dumps(found.tree()))
    q = sky(2000, np.random.default_rng(9))
    a, e = truth.altazimuth(*q.T, TRUE)
    other = recorded(tmp_path / "true", q, truth.of_angles(a, e))
    samples = calibration.with_physics(other, sample_recording(other).samples)
    pointed = calibration.correction.predict(samples.effective).rotation.as_matrix()[..., 2]
    off = np.linalg.norm(pointed - truth.of_angles(a, e), axis=1)
    assert (off < made.limits.upper).mean() > 0.95 and made.limits.upper < made.measured < 5 * SIGMA
    assert found.verdict.line.startswith("good") and made.tolerance.verdict == "conforms"
    assert tree["schema"] == "pointing-certificate/1" and tree["promise"]["direction_rad"] == made.limits.upper
    wrong = calib.certify(calibration, starred(tmp_path / "wrong", 1002, 60, 1))
    assert len(wrong.certificate.far) == 1 and wrong.certificate.limits.upper > 10 * made.limits.upper
    assert "another star" in " ".join(wrong.lines())


def test_what_directions_cannot_answer_is_refused(tmp_path, calibration):
    with pytest.raises(NotEnoughData, match="requires 59"):
        calib.certify(calibration, starred(tmp_path / "few", 1003, 40, 0))
    new = starred(tmp_path / "new", 1004, 60, 0)
    with pytest.raises(RigError, match="directions have no length"):
        calib.certify(calibration, new, CertifyOptions(tolerances=(("position", 1e-5),)))
    with pytest.raises(RigError, match="as .json or .html"):
        calib.certify(calibration, new).write(tmp_path / "c.pdf")
