"""The law of every effect: what a recording is simulated with, its diagnosis names first, at its place, and nothing
else.
"""

import json

import pytest

from rig.cli import command_line
from rig.effects.catalogue.effect_list import BY_NAME
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml

EFFECTS = {  # one of each, of a size that rigs show
    "scale_error": "strut3:scale=4e-4",
    "cyclic_error": "strut3:amplitude=1.5e-5,phase=0.3",
    "transmission_error": "strut3:profile=0/2e-5/-2e-5/3e-5/0/2e-5/-3e-5/1e-5",
    "backlash": "strut3:gap=4e-5",
    "hysteresis": "strut3:range=5e-3,weight=8e-3",
    "missed_steps": "strut3:jump=5e-5,time=700",
    "servo_lag": "strut3:time_constant=0.02",
    "creep": "strut3:fraction=8e-3,time_constant=20",
    "thermal_expansion": "rig:coefficient=2e-5",
    "warm_up": "strut3:amplitude=1e-4,time_constant=900",
    "screw_coupling": "rig:gain=0.5",
    "compliance": "rig:stiffness=3e6",
    "joint_clearance": "strut3:gap=8e-5",
    "base_expansion": "rig:coefficient=9e-5",
    "vibration": "rig:amplitude=4e-5,frequency=3.3,phase=1,mode=0.6/0/0.8/0.5/0/0",
    "time_offset": "clock:offset=0.02",
    "clock_drift": "clock:rate=5e-5",
    "lens_distortion": "cam1:terms=0/0/0/0/0/0/0/0/2e-2/0/2e-2/0",
    "focal_drift": "cameras:per_kelvin=3e-4",
    "camera_drift": "cam1:motion=2e-4/0/0/0/4e-4/0,time_constant=900",
    "camera_bump": "cam1:motion=2e-4/0/0/0/4e-4/0,time=700",
    "rolling_shutter": "cameras:row_time=2e-5",
    "refraction": "cam1:thickness=2e-2,normal=0.5/0/0.866",
    "edge_bias": "cameras:bias=0.2",
    "print_scale": "markers:scale=3e-3",
    "face_misplacement": "4:offset=4e-4/0/0,rotation=0/0/0.01",
    "cube_misplacement": "P2:motion=4e-4/0/0/0/0/0.01",
    "marker_swap": "4:turn=1",
    "axis_coupling": "strut3:scale=2e-3,other=5",
    "settling_error": "strut3:fraction=2e-3",
    "joint_offset": "strut3:offset=4e-3",
    "travel_heating": "strut3:per_metre=5e-5,time_constant=600",
    "marker_flatness": "4:height=8e-4,corner=2",
    "encoder_interpolation": "strut3:amplitude=4e-6,periods=3003,phase=0.4",
}


def test_the_law_is_asked_of_every_effect():
    tilting = {"camera_sag"}  # which takes a base that tilts: tests/truth/test_turning_gravity.py
    read = {"base_lean"}  # which takes a tilt sensor: tests/truth/test_leaning_column.py
    of_arms = {"link_bending"}  # which no hexapod has: tests/truth/test_bending_links.py
    assert set(EFFECTS) == set(BY_NAME) - tilting - read - of_arms


@pytest.mark.slow
@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_simulated_is_named(name, tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(hexapod_layout_rig_toml(0.3))
    for argv in (
        [
            "simulate",
            tmp_path / "rig.toml",
            "--plan",
            "standard",
            "--effect",
            f"{name}:{EFFECTS[name]}",
            "--seed",
            5,
            "--noise",
            0.03,
            "--out",
            tmp_path / "rec",
            "--truth",
            tmp_path / "truth.json",
        ],
        ["diagnose", tmp_path / "rec", "--out", tmp_path / "found", "--anyway"],
    ):
        assert command_line.main([str(word) for word in argv]) == 0, capsys.readouterr().err
    true = json.loads((tmp_path / "truth.json").read_text())["effects"][0]
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert found, "nothing was found"
    named = [(found[0]["effect"], found[0]["place"])] + [
        (r["effect"], r["place"]) for r in found[0]["cannot_be_told_from"]
    ]
    assert (true["effect"], true["place"]) in named and len(found) == 1
