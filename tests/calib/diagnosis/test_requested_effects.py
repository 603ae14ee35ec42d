"""What is asked for with a place is asked there; a parameter that the data pull beyond its bound stands at it and is
said to.
"""

import dataclasses

import numpy as np
import pytest

from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.effects.catalogue.screw_coupling import ScrewCoupling
from rig.effects.framework.effect_base_class import Parameter
from rig.errors import RigError
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded


def test_places_are_asked_for_and_left_out():
    requested = RequestedEffects(("backlash", "marker_swap marker 8"), ("backlash strut 2",))
    assert (
        requested.name("marker_swap")
        and requested.place("marker_swap", "marker 8")
        and not requested.place("marker_swap", "marker 6")
    )
    assert (
        requested.place("backlash", "strut 1")
        and not requested.place("backlash", "strut 2")
        and not requested.name("creep")
    )
    with pytest.raises(
        RigError, match=r"backlash cannot sit at 'strut 9' in this recording; it can at strut 1, strut 2"
    ):
        RequestedEffects(("backlash strut 9",)).check({"backlash": ("strut 1", "strut 2")})


@pytest.mark.slow
def test_an_exchange_of_faces_is_asked_for_at_its_marker_alone(tmp_path, design):
    rec = recorded(tmp_path, design, ["marker_swap:8:other=6,turn=1"], route="sobol:30")
    found = {
        only: [
            (f.effect, f.place)
            for f in diagnosis_report(diagnosis_of(rec, only=[only])).findings
            if f.effect == "marker_swap"
        ]
        for only in ("marker_swap", "marker_swap marker 6", "marker_swap marker 8", "marker_swap marker 4")
    }
    ((_, place),) = found["marker_swap"]
    assert (
        found["marker_swap marker 6"] == found["marker_swap marker 8"] == found["marker_swap"]
        and found["marker_swap marker 4"] == []
    )
    assert not [
        f
        for f in diagnosis_report(diagnosis_of(rec, only=["marker_swap"], without=(f"marker_swap {place}",))).findings
        if f.effect == "marker_swap"
    ]
    with pytest.raises(RigError, match="cannot sit at 'marker 99'"):
        diagnosis_of(rec, only=["marker_swap marker 99"])


@pytest.mark.slow
def test_what_a_bound_forbids_is_reported_at_the_bound(tmp_path, design, monkeypatch):
    rec = recorded(tmp_path, design, ["screw_coupling:rig:gain=1"], route="sobol:60")
    tight = tuple(
        dataclasses.replace(p, bounds=(-1.0, 0.97)) if p.name == "gain" else p for p in ScrewCoupling.parameters
    )
    assert isinstance(tight[0], Parameter)
    monkeypatch.setattr(ScrewCoupling, "parameters", tight)
    finding = diagnosis_report(diagnosis_of(rec, only=["screw_coupling"])).findings[0]
    gain = finding.parameters["gain"]
    assert (finding.effect, finding.place, gain.value, gain.at_bound) == ("screw_coupling", "rig", 0.97, 0.97)
    assert np.isfinite(gain.ci95).all()
