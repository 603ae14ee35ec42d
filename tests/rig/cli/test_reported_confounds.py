"""Every command that fits or judges states in a line and in JSON what its recording cannot separate."""

import json
from pathlib import Path

import numpy as np
import pytest

from calib.files import calibration_file
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.recording_plan import axis_strokes
from rig.recording import corner_and_pose_csv_tables
from tests.cli import command
from tests.conftest import BENCH

INSTRUMENT = '\n[instrument]\nkind = "pose"\nbase = "rig"\ntool = "rig"\nposition_sigma = 5e-6\nrotation_sigma = 2e-5\n'


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """rig.toml with an instrument, and two recordings, "sorted" and "other", in which every configuration is visited
    from low to high.
    """
    base = tmp_path_factory.mktemp("confounds")
    text = (BENCH / "fit" / "rig.toml").read_text()
    (base / "rig.toml").write_text(text + INSTRUMENT)
    design = design_from_rig_toml.load_design(base / "rig.toml")
    from rig.cli.command_line import main

    for seed, name in enumerate(("sorted", "other")):
        values = sobol_configurations(axis_strokes(design), 60, seed=seed)
        strut = np.argsort(values[:, 0])
        corner_and_pose_csv_tables.write_configurations(base / f"{name}.csv", design.mechanism.axes, values[strut])
        assert not main(
            [
                "simulate",
                str(base / "rig.toml"),
                "--plan",
                f"commands:{base / name}.csv",
                "--seed",
                "3",
                "--out",
                str(base / name),
            ]
        )
    return base


@pytest.mark.slow
def test_what_place_absorbs_is_stated_by_every_command(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base, rig = recorded, command(capsys)
    assert "a function of place on struts 1-6: drift and place cannot be separated" in rig(
        "calibrate", base / "sorted", "--out", base / "c.json"
    )
    stored = json.loads((base / "c.json").read_text())["confounds"]
    assert "time on strut 1" in stored["serious"] and stored["n"] == 60
    assert calibration_file.load(base / "c.json").confounds.tree() == stored
    assert "drift and place cannot be separated" in rig("verify", base / "c.json", base / "other")
    assert json.loads(rig("verify", base / "c.json", base / "other", "--json"))["confounds"]["serious"]
    certificate = base / "certificate.json"
    assert "drift and place cannot be separated" in rig(
        "certify", base / "c.json", base / "other", "--out", certificate
    )
    assert json.loads(certificate.read_text())["confounds"]["serious"]
    rig("diagnose", base / "other", "--only", "backlash", "--out", base / "d")
    assert json.loads((base / "d" / "diagnosis.json").read_text())["confounds"]["serious"]
    assert "drift and place cannot be separated" in rig("watch", base / "c.json", base / "other", ok=True)
    assert json.loads(rig("online", base / "other", "--json"))["confounds"]["serious"]
