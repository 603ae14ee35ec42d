"""Verdicts of measurements, campaigns and investigations: good only where what they rest on allows it."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from calib.experiment.investigation_folder_and_report import (
    InvestigationRound,
    diagnosis_path,
    plan_path,
    read_investigation_rounds,
)
from calib.experiment.investigation_folder_and_report import investigation_verdict as judged_investigation
from rig.cli.command_line import main
from synthetic.blind_campaign_page import campaign_verdict as judged_campaign
from synthetic.blind_diagnosis_score import Case, Found, Hidden, campaign_rates_with_intervals
from tests import truth
from vision.api import MeasurementResult
from vision.api import measurement_verdict as judged_measurement

SOUND = InvestigationRound(1, "rec1", 12.0, (), (), (), (), (), ())


@pytest.mark.parametrize(
    "ratio, state, says",
    [
        (1.02, "good", "60 of 60 frames"),
        (0.49, "check", "is less than stated"),
        (1.8, "check", "not reliable"),
        (2.6, "bad", "not reliable"),
    ],
)
def test_a_measurement_whose_noise_is_not_the_stated_one_is_not_good(ratio, state, says):
    """Of frames held out, over the squares predicted: noiseless drawings come to 0.49."""
    design = SimpleNamespace(cameras=())
    recording = SimpleNamespace(
        exposures=SimpleNamespace(times=lambda: (np.arange(60), np.arange(60.0))), design=design
    )
    measurement = SimpleNamespace(
        frames=np.arange(60),
        covariance=np.broadcast_to(1e-10 * np.eye(6), (60, 6, 6)),
        unsolved={},
        design=design,
        adjustment=SimpleNamespace(common_image_errors=()),
        readouts=(),
    )
    verdict = judged_measurement(MeasurementResult(recording, measurement, SimpleNamespace(ratio=ratio, scatter=0.03)))
    assert verdict.state == state and says in verdict.why


def test_a_campaign_of_two_cases_is_not_good():
    lag = Hidden("servo_lag", "rig", {}, 30.0)
    right = Case(1, "one", None, [lag], [Found("servo_lag", "rig", {}, [])], False, 1.0, 1.0)
    few, many = (
        judged_campaign(campaign_rates_with_intervals([right] * 2)),
        judged_campaign(campaign_rates_with_intervals([right] * 400)),
    )
    assert few.state == "check" and "too few cases to decide" in few.why and "2 of 2" in few.why
    assert many.state == "good"


def test_an_investigation_is_no_better_than_its_last_diagnosis(tmp_path):
    assert judged_investigation([SOUND], "all is settled").state == "good"
    truth.record(
        truth.draw(1, "none", "none", "sobol", count=30), tmp_path / "rec1"
    )  # place hides what depends on direction
    plan_path(tmp_path, 1).write_text("frame,t\n0,0\n1,60\n")
    assert (
        main(
            [
                "diagnose",
                str(tmp_path / "rec1"),
                "--out",
                str(diagnosis_path(tmp_path, 1)),
                "--next",
                str(plan_path(tmp_path, 2)),
            ]
        )
        == 0
    )
    diagnosed = json.loads((diagnosis_path(tmp_path, 1) / "diagnosis.json").read_text())["verdict"]
    (look,) = read_investigation_rounds(tmp_path)
    verdict = judged_investigation([look], "all is settled")
    assert diagnosed["state"] == verdict.state == "check" and not look.findings
    assert any("play and place" in text for text in verdict.rests_on)
