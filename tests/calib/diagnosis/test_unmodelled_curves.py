"""What has no name is undone by a curve: on machines of the independent truth, measured where they really go."""

from pathlib import Path

import numpy as np
import pytest

from calib.api import calibrate as calibrating
from calib.api.calibrate import CalibrateOptions
from calib.correction.physics_compensation import Unknown
from calib.diagnosis.findings_refit import Findings
from calib.files import calibration_file
from calib.samples.pose_samples import sample_recording
from rig.effects.catalogue.effect_list import BY_NAME
from tests.calib.odd_machines import OddMachine, odd_laws, without_remainder
from tests.truth import draw

WANTED = 0.7  # share of the error that is to be undone
NAMES = list(odd_laws(draw(1, "thermal_expansion"), np.eye(6)[0]))


def calibrated(machine, *unknown):
    """Calibration of a machine as if a diagnosis had found nothing but these Unknowns."""
    sampled = sample_recording(machine.recording)
    findings = Findings((), None, unknown)
    options = CalibrateOptions(diagnosis=Path("unused"))
    done = calibrating._calibrated(machine.recording, sampled, findings, BY_NAME, options, lambda *_: None)
    return done.calibration


def unknown_at(place, depends_on):
    return Unknown(place, 3e-5, "m", (depends_on,), False)


@pytest.mark.parametrize(
    "law, depends_on, covariate",
    [
        ("heat with a knee", "strut2_temperature_C", "temperature"),
        ("gap that widens along the screw", "history", "history"),
    ],
)
def test_an_unknown_is_undone_by_a_curve(tmp_path, law, depends_on, covariate):
    machine = OddMachine.of(law, 1, tmp_path, 60)
    with_curve = calibrated(machine, unknown_at(machine.place, depends_on))
    (unknown,) = with_curve.physics.unknown
    assert covariate in unknown.by[0] and unknown.undone
    assert f"unknown at {machine.place}, by {unknown.by[0]}" in unknown.sentence() and "undoes" in unknown.sentence()
    calibration_file.save(tmp_path / "calibration.json", with_curve)
    loaded = calibration_file.load(tmp_path / "calibration.json")
    assert loaded.physics.unknown == with_curve.physics.unknown
    before, _ = machine.driven(without_remainder(calibrated(machine)))
    after, _ = machine.driven(loaded)
    assert after < (1 - WANTED) * before


def test_a_curve_over_time_is_left_out_beyond_the_recorded_time(tmp_path):
    machine = OddMachine.of("swing after switching on", 1, tmp_path, 60)
    found = calibrated(machine, unknown_at(machine.place, "time"))
    (unknown,) = found.physics.unknown
    assert "time" in unknown.by and "within the recorded time only" in unknown.sentence()
