"""The diagnosis of the sealed recordings stays what it was: the same names at the same places, values within a tenth of
their interval.
"""

import json

import numpy as np
import pytest

from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.recording import recording_folder
from tests.calib.diagnose_recording import diagnosis_of
from tests.conftest import ROOT

VERDICTS = json.loads((ROOT / "tests/data/sealed_verdicts.json").read_text())
PART = 0.1  # of an interval's length


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(VERDICTS))
def test_a_sealed_recording_gets_the_verdict_that_it_got(shared, name):
    found, expected = (
        diagnosis_report(diagnosis_of(recording_folder.load_recording(shared / "recordings" / name))).tree(),
        VERDICTS[name],
    )
    assert [(f["effect"], f["place"]) for f in found["findings"]] == [
        (f["effect"], f["place"]) for f in expected["findings"]
    ]
    assert (found["unexplained"] or {}).get("place") == (expected["unexplained"] or {}).get("place")
    for now, before in zip(found["findings"], expected["findings"]):
        assert {(a["effect"], a["place"]) for a in now["cannot_be_told_from"]} == {
            (a["effect"], a["place"]) for a in before["cannot_be_told_from"]
        }
        for parameter, value in before["parameters"].items():
            if "ci95" in value:
                length = np.subtract(*value["ci95"][::-1])
                assert np.all(
                    np.abs(np.subtract(now["parameters"][parameter]["value"], value["value"])) <= PART * np.abs(length)
                ), parameter
