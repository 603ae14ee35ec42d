"""Several recordings of one rig: nothing of the one before is remembered, and what cannot be one rig is refused by
name.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.effects.framework.parameters_covariates_and_marker_table import Drawing
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.pose import exp, pose, pose_to_vector
from rig.recording import recording_folder as recording
from rig.recording.combined_recordings import first_recording_by_camera, join_recordings
from rig.recording.exposures_and_image_files import Exposures
from rig.recording.recording_folder import Commands, Recording
from tests.rig.effects.test_effects_of_all_machines import MOVING, context_of, setting_of

OWN_CLOCK = ("moment", "phase")  # roles of parameters that are told by one recording's clock
BOTH = [k for k in MOVING if not (k.instrumented or k.of_links) and not any(p.role in OWN_CLOCK for p in k.parameters)]
REMEMBER = (
    "backlash:strut 6:gap=1e-4",
    "creep:rig:fraction=5e-3,time_constant=600",
    "hysteresis:strut 2:range=5e-3,weight=5e-3",
    "warm_up:rig:amplitude=1e-4",
)


@pytest.fixture(scope="module")
def two(design):
    """([Recording] of two, the second's moves in another order; the one of both)."""
    rig, commands, t, sensors = setting_of(design, "hexapod")
    t = np.r_[1e-4, t[1:]]  # at once, while what was before would still show
    exposures = Exposures(np.arange(len(t)), t, [""] * len(t), [""] * len(t))
    parts = [
        Recording(
            Path(f"/rec{k}"),
            rig,
            Commands(commands.t, np.roll(commands.values, 17 * k, axis=0)),
            exposures,
            replace(sensors, channels={n: v + k for n, v in sensors.channels.items()}),
            None,
            None,
        )
        for k in range(2)
    ]
    return parts, join_recordings(parts, first_recording_by_camera(parts))


@pytest.mark.parametrize("kind", BOTH, ids=lambda kind: kind.name)
def test_an_effect_knows_nothing_of_the_recording_before(two, kind):
    parts, both = two
    rig, first = both.design, parts[0]
    setting = (rig, first.commands, first.exposures.t, first.sensors)
    context = context_of(setting)
    drawing = Drawing(rig, first.exposures.t, context.motion, lambda effect, camera: 1.0)
    effect = kind.drawn(kind.sites(context)[-1], drawing, np.random.default_rng(3))

    alone = np.concatenate([positions(r, r.commands, effect) for r in parts])
    np.testing.assert_allclose(positions(both, both.commands, effect), alone, atol=1e-10)


@pytest.mark.parametrize("text", REMEMBER)
def test_had_it_gone_on_remembering_that_would_show(two, text):
    _, both = two
    effect = parse_effect(text)
    apart = positions(both, both.commands, effect) - positions(both, replace(both.commands, starts=np.zeros(0)), effect)
    assert np.abs(apart[:60]).max() == 0 and np.abs(apart[60:]).max() > 1e-6


def positions(recorded, commands, effect):
    """(n, 3) m where the platform of a recording's rig stands at its exposures."""
    return motion_simulation.simulate_machine_run(
        recorded.design, commands, recorded.exposures.times()[1], (effect,), recorded.sensors
    ).T_base_platform.translation


def test_frames_times_and_logs_stand_apart(two):
    parts, both = two
    frames, t = both.exposures.times()
    assert frames.tolist() == [*range(60), *range(100, 160)] and (np.diff(t) > 0).all() and len(both.parts) == 2
    second = both.parts[1]
    np.testing.assert_allclose(both.commands.at(t[60:]), parts[1].commands.at(parts[1].exposures.t), atol=1e-12)
    np.testing.assert_allclose(
        both.sensors.at(t[60:], "ambient_temperature_C"),
        parts[1].sensors.at(t[60:] - second.t, "ambient_temperature_C"),
    )
    assert both.sensors.starts[0] in both.sensors.t and both.name == "rec0 + rec1"


def test_what_cannot_be_one_rig_is_refused_by_name(recording_folder, tmp_path, capsys):
    def other(name, old, new, file="rig.toml"):
        shutil.copytree(recording_folder, tmp_path / name)
        text = (tmp_path / name / file).read_text()
        assert old in text
        (tmp_path / name / file).write_text(text.replace(old, new, 1))
        return str(tmp_path / name)

    (tmp_path / "empty").mkdir()
    half = other("half", "frame,t,camera,image", "frame,t", "frames.csv")
    cases = {
        str(tmp_path / "none"): "no such folder",
        str(tmp_path / "empty"): "empty folder",
        half: "frames.csv",
        str(recording_folder): "named twice",
        other("copied", "", ""): "6 of 6 frames are in another",
        other("heavier", "mass = 12.15", "mass = 14.15"): "payload_mass_kg",
        other("other", "screw_lead = 0.004", "screw_lead = 0.005"): "actuator.screw_lead: 0.004 and 0.005",
    }
    for folder, says in cases.items():
        command = "calibrate" if says == "frames.csv" else "diagnose"
        assert main([command, str(recording_folder), folder, "--out", str(tmp_path / "out.json")]) == 1
        assert says in capsys.readouterr().err, folder
    assert (
        main(
            ["diagnose", str(recording_folder), str(tmp_path / "copied"), "--mask", "1", "--out", str(tmp_path / "out")]
        )
        == 1
    )
    assert "--mask names frames of one recording" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_camera_stated_with_another_lens_is_another_camera(recording_folder, tmp_path):
    shutil.copytree(recording_folder, tmp_path / "again")
    text = (tmp_path / "again" / "rig.toml").read_text()
    (tmp_path / "again" / "rig.toml").write_text(text.replace("[-0.1, 0.08,", "[-0.12, 0.08,", 1))
    parts = [recording.load_recording(recording_folder), recording.load_recording(tmp_path / "again")]
    assert first_recording_by_camera(parts)[1] == {"cam0": 1, "cam1": 0, "cam2": 0}
    both = join_recordings(parts, first_recording_by_camera(parts))
    assert [c.name for c in both.design.cameras] == ["cam0", "cam1", "cam2", "cam0@2"]
    assert set(np.array(both.corners.camera)[both.corners.frame >= 10]) == {"cam0@2", "cam1", "cam2"}


@pytest.mark.slow
def test_a_moved_camera_is_told_and_the_diagnosis_is_of_both(tmp_path, capsys, rig_text):
    """What one recording alone shows less surely, two show with a narrower interval; the calibration of both is held
    out of neither.
    """
    (tmp_path / "rig.toml").write_text(rig_text)
    one, two = str(tmp_path / "one"), str(tmp_path / "two")
    rig = str(tmp_path / "rig.toml")
    assert (
        main(
            [
                "simulate",
                rig,
                "--plan",
                "moving:20,sobol:50,ladder:1",
                "--effect",
                "backlash:strut 3:gap=4e-5",
                "--seed",
                "1",
                "--out",
                one,
                "--truth",
                str(tmp_path / "truth.json"),
            ]
        )
        == 0
    )
    truth = json.loads((tmp_path / "truth.json").read_text())
    at = np.array(truth["cameras"][1]["pose"])
    truth["cameras"][1]["pose"] = pose_to_vector(
        pose(at[:3], at[3:]) * exp(np.array([2e-3, 0, 1e-3, 3e-3, 0, 0]))
    ).tolist()
    (tmp_path / "moved.json").write_text(json.dumps(truth))
    assert (
        main(
            [
                "simulate",
                rig,
                "--plan",
                "sobol:40,moving:10",
                "--machine",
                str(tmp_path / "moved.json"),
                "--seed",
                "2",
                "--out",
                two,
            ]
        )
        == 0
    )
    capsys.readouterr()
    assert main(["diagnose", one, two, "--out", str(tmp_path / "both")]) == 0
    output = capsys.readouterr().out
    assert (
        "camera cam1 stands elsewhere, by 2." in output
        and "where cameras cam0, cam2 stand;" in output
        and "backlash at strut 3" in output
    )
    assert main(["diagnose", one, "--out", str(tmp_path / "alone")]) == 0
    found = [json.loads((tmp_path / name / "diagnosis.json").read_text()) for name in ("both", "alone")]
    low, high = zip(*(f["findings"][0]["parameters"]["gap"]["ci95"] for f in found))
    assert high[0] - low[0] < high[1] - low[1] and low[0] < 4e-5 < high[0]
    assert [(r["name"], r["frames"]) for r in found[0]["recordings"]] == [
        ("one", 0),
        ("two", 100),
    ] and "recordings" not in found[1]
    capsys.readouterr()
    assert (
        main(
            ["calibrate", one, two, "--diagnosis", str(tmp_path / "both"), "--out", str(tmp_path / "calibration.json")]
        )
        == 0
    )
    assert "backlash at strut 3" in capsys.readouterr().out
    assert main(["certify", str(tmp_path / "calibration.json"), two, "--out", str(tmp_path / "certificate.json")]) == 1
    assert "took part in fitting" in capsys.readouterr().err
