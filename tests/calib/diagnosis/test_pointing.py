"""A mount is never said to be complete while what it leaves out is far beyond the noise of its stars."""

import json

import numpy as np
import pytest

from calib.api.calibrate import calibrate
from calib.diagnosis.report.diagnosis_page import diagnosis_verdict
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report, summary_sentence
from rig.report.verdict_refutations_and_result_display import State
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.models.arm.test_mount_pointing_terms import SIGMA, starred

LARGE = 30 * SIGMA  # of an unmodelled periodic error
LEFT_OUT = {
    "slow wave of elevation": lambda q: LARGE * np.sin(3 * q[:, 1] + 0.7),
    "gear of elevation": lambda q: LARGE * np.sin(101 * q[:, 1]),
    "elevation by azimuth": lambda q: LARGE * np.sin(2 * q[:, 0]),
    "outside the catalogue": lambda q: LARGE * np.sin(3 * q[:, 0]) * np.cos(5 * q[:, 1]),
    "at no known cause": lambda q: LARGE / np.sqrt(2) * np.random.default_rng(5).normal(size=len(q)),
}


@pytest.mark.parametrize("left_out", LEFT_OUT)
def test_a_term_that_is_left_in_is_told(tmp_path, left_out):
    report = diagnosis_report(diagnosis_of(starred(tmp_path / "rec", 7, extra=LEFT_OUT[left_out])))
    assert report.findings and diagnosis_verdict(report).state is State.CHECK
    assert "Nothing is unmodelled" not in summary_sentence(report)
    tree = json.loads(json.dumps(report.tree()))
    assert tree["noise"]["pose_m"] is None and tree["noise"]["pose_rad"] == pytest.approx(np.sqrt(2) * SIGMA, rel=1e-3)
    assert tree["fit"]["unit"] == "rad"


def test_the_flexure_of_the_tube_is_told_whatever_it_is_like(tmp_path):
    """Between 15 and 80 degrees the cosine of the elevation is nearly a scale error."""
    report = diagnosis_report(diagnosis_of(starred(tmp_path / "rec", 7)))
    (found,) = report.findings
    assert "compliance" in {found.effect, *(other.effect for other in found.cannot_be_told_from)}
    assert report.unexplained is None


@pytest.mark.slow
def test_a_calibration_searches_beside_the_flexure(tmp_path):
    made = calibrate(starred(tmp_path / "rec", 7))
    assert [effect.name for effect in made.calibration.physics.effects] == ["compliance"]
    assert made.pointing_terms.names[-1] == "TF" and not made.calibration.physics.unknown
    made = calibrate(starred(tmp_path / "more", 7, extra=LEFT_OUT["gear of elevation"]))
    assert {effect.name for effect in made.calibration.physics.effects} == {"compliance", "cyclic_error"}
