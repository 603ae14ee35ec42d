"""A true value at the end of what a parameter can be is found as any other: a gain of one, play without clearance, a
coil wholly wound up.
"""

import pytest

from rig.effects.catalogue import effect_list
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded

MODE = "phase=1,mode=0.6/0/0.8/0.5/0/0"
SHIFT = "motion=2e-4/0/0/0/4e-4/0"
AT_LIMITS = [  # what is not a size at both ends of what rigs show
    "screw_coupling:rig:gain=1",
    "screw_coupling:rig:gain=-1",
    "hysteresis:strut3:range=1e-3,weight=8e-3",
    "hysteresis:strut3:range=2e-2,weight=8e-3",
    "creep:strut3:fraction=8e-3,time_constant=1",
    "creep:strut3:fraction=8e-3,time_constant=1000",
    "warm_up:strut3:amplitude=1e-4,time_constant=600",
    "warm_up:strut3:amplitude=1e-4,time_constant=7200",
    "cyclic_error:strut3:amplitude=1.5e-5,phase=0,order=1",
    "cyclic_error:strut3:amplitude=1.5e-5,phase=3.1416,order=2",
    f"vibration:rig:amplitude=4e-5,frequency=0.1,{MODE}",
    f"vibration:rig:amplitude=4e-5,frequency=50,{MODE}",
    f"camera_drift:cam1:{SHIFT},time_constant=60",
    f"camera_drift:cam1:{SHIFT},time_constant=7200",
    "missed_steps:strut3:jump=5e-5,time=60",
    f"camera_bump:cam1:{SHIFT},time=60",
    "marker_swap:4:turn=3",
    "servo_lag:strut3:time_constant=0.05",
    "joint_clearance:strut3:gap=1.2e-4",
    "rolling_shutter:cameras:row_time=3e-5",
    "settling_error:strut3:fraction=2e-3",
    "encoder_interpolation:strut3:amplitude=4e-6,periods=1290.2",
    "encoder_interpolation:strut3:amplitude=4e-6,periods=9890.6",
    "travel_heating:strut3:per_metre=2e-4,time_constant=100",
    "travel_heating:strut3:per_metre=1e-4,time_constant=2000",
]


def test_every_parameter_that_is_no_size_has_its_ends_here():
    tested = {parse_effect(text).name for text in AT_LIMITS}
    for kind in effect_list.ALL:
        if any(p.role in ("log", "even", "frequency") for p in kind.parameters):
            assert kind.name in tested, kind.name


@pytest.mark.slow
@pytest.mark.parametrize("text", AT_LIMITS)
def test_what_lies_at_a_limit_is_named_at_its_place(tmp_path, design, text):
    true, found = parse_effect(text), diagnosis_of(recorded(tmp_path, design, [text], 11, "standard", 0.03))
    named = [(s.name, s.place) for s in found.evidence.swapped] + [(e.name, e.place) for e in found.effects]
    same = [
        (a.score.candidate.name, a.score.candidate.place) for f in found.selection.findings[:1] for a in f.alternatives
    ]
    assert (true.name, true.place) in [*named[:1], *same] and len(named) == 1 and not found.left
