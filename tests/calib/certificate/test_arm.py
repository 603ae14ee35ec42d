"""An arm's certificate is the same certificate: simulated, calibrated, certified by another recording."""

import json
from importlib.resources import files

import jsonschema
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calib.files import calibration_file
from rig.model.pose import pose_difference
from rig.recording import recording_folder
from tests.calib.certificate.test_certificate import rig
from tests.conftest import ROOT

INSTRUMENT = '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 10e-6\nrotation_sigma = 50e-6\n'


@pytest.mark.slow
def test_an_arm_is_certified(tmp_path):
    toml = tmp_path / "rig.toml"
    toml.write_text((files("rig") / "arms" / "puma560.toml").read_text() + INSTRUMENT)
    rig("simulate", toml, "--plan", "sobol:60", "--seed", "1", "--out", tmp_path / "a", "--truth", tmp_path / "a.json")
    rig(
        "simulate",
        toml,
        "--plan",
        "sobol:64,ladder:1,repeat:9",
        "--seed",
        "2",
        "--machine",
        tmp_path / "a.json",
        "--out",
        tmp_path / "b",
        "--truth",
        tmp_path / "b.json",
    )
    rig("calibrate", tmp_path / "a", "--out", tmp_path / "cal.json")
    rig("certify", tmp_path / "cal.json", tmp_path / "b", "--out", tmp_path / "made", "--tolerance", "300um")
    made = json.loads((tmp_path / "made" / "certificate.json").read_text())
    jsonschema.validate(made, json.loads((ROOT / "calib/certificate/certificate.schema.json").read_text()))
    seen = recording_folder.load_recording(tmp_path / "b")
    true = RigidTransform.from_matrix(np.reshape(json.loads((tmp_path / "b.json").read_text())["poses"], (-1, 4, 4)))
    lengths = np.linalg.norm(
        pose_difference(calibration_file.load(tmp_path / "cal.json").correction.predict(seen.commanded()[2]), true)[
            :, :3
        ],
        axis=1,
    )
    assert (
        made["machine"] == "arm"
        and made["promise"]["n"] == 68
        and np.quantile(lengths, 0.95) <= made["promise"]["position_m"] < 60e-6
    )
    assert [axis["axis"] for axis in made["iso230"]] == [f"joint {k}" for k in range(1, 7)] and made["iso230"][0][
        "unit"
    ] == "rad"
    for name in ("html", "pdf", "xml"):
        assert (tmp_path / "made" / f"certificate.{name}").stat().st_size > 5000
