"""The diagnosis names what another formula of the same law did to a recording, at its place and with its size."""

import numpy as np
import pytest

from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.effects_by_other_formulas import OffsetSignals, SwungCardan, WarmedScrew
from tests.calib.lifted_corners import recording_with_lifted_corner
from tests.calib.recordings_with_effects import PLAN, recorded

PITCH = 3.1e-4  # m
SMALL = {"encoder_interpolation"}  # of some micrometres, which take the many lengths of the standard plan
CASES = {  # name: (what the recording holds, the effects asked for besides, {parameter: truth})
    "joint_offset": (
        SwungCardan("strut 3", 4e-3, 1.0),
        ("screw_coupling", "scale_error", "base_expansion"),
        {"offset": 4e-3, "end": 1.0},
    ),
    "travel_heating": (
        WarmedScrew("strut 3", 5e-5, 600.0),
        ("warm_up", "creep", "missed_steps"),
        {"per_metre": 5e-5, "time_constant": 600.0},
    ),
    "encoder_interpolation": (
        OffsetSignals("strut 3", PITCH, (0.06, 0.08)),
        ("cyclic_error", "transmission_error"),
        {"amplitude": 0.1 * PITCH / (2 * np.pi), "periods": 1 / PITCH},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_what_another_formula_does_is_named(tmp_path, design, name):
    twin, alike, truth = CASES[name]
    route = "standard" if name in SMALL else PLAN
    found_alone(recorded(tmp_path, design, [twin], route=route), name, twin.place, alike, truth)


@pytest.mark.slow
@pytest.mark.parametrize("number, corner", [(8, 2), (4, 1)])
def test_a_lifted_corner_is_no_misplaced_face(tmp_path, design, number, corner):
    rec = recording_with_lifted_corner(tmp_path, design, number, corner, 5e-4, PLAN)
    alike = ("face_misplacement", "cube_misplacement", "print_scale", "edge_bias")
    found_alone(rec, "marker_flatness", f"marker {number}", alike, {"height": 5e-4, "corner": float(corner)})


def found_alone(rec, name, place, alike, truth):
    """The diagnosis of a recording names an effect at a place alone, with its parameters; alike : asked for besides."""
    report = diagnosis_report(diagnosis_of(rec, only=[name, *alike]))
    assert [(f.effect, f.place) for f in report.findings] == [(name, place)] and not report.unexplained
    for parameter, value in truth.items():
        found = report.findings[0].parameters[parameter]
        if found.ci95 is None:
            assert found.value == value
            continue
        sigma = (found.ci95[1] - found.ci95[0]) / 3.92
        assert abs(found.value - value) < 3 * sigma and sigma < 0.1 * abs(value)
