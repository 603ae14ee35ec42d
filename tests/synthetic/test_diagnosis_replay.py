"""A diagnosed recording drawn anew: with what was found it looks as it did, without it does not."""

import numpy as np
import pytest

from rig.cli import command_line
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder

NOISE = 0.03  # px


def corners(folder):
    """{(frame, camera, marker, corner): uv} of a recording."""
    o = recording_folder.load_recording(folder).corners
    return {tuple(key): uv for *key, uv in zip(o.frame, o.camera, o.marker, o.corner, o.uv)}


def rms(a, b):
    """px per axis between two sets of corners, over those that both hold."""
    both = a.keys() & b.keys()
    assert len(both) > 0.9 * len(a)
    return np.sqrt(np.mean([(a[k] - b[k]) ** 2 for k in both]))


@pytest.mark.slow
def test_the_machine_as_found_repeats_the_recording(tmp_path, capsys):
    (tmp_path / "rig.toml").write_text(hexapod_layout_rig_toml(0.3))
    for argv in (
        [
            "simulate",
            tmp_path / "rig.toml",
            "--plan",
            "sobol:30,ladder:4",
            "--effect",
            "backlash:strut2:gap=3e-4",
            "--noise",
            NOISE,
            "--out",
            tmp_path / "rec",
        ],
        ["diagnose", tmp_path / "rec", "--only", "backlash", "--out", tmp_path / "found"],
        ["simulate", "--from", tmp_path / "found", "--noise", NOISE, "--out", tmp_path / "both"],
    ):
        assert command_line.main([str(word) for word in argv]) == 0, capsys.readouterr().err
    real, *drawn = (corners(tmp_path / name) for name in ("rec", "both/with", "both/without"))
    assert rms(real, drawn[0]) == pytest.approx(np.sqrt(2) * NOISE, rel=0.05)
    assert rms(real, drawn[1]) > 2 * rms(real, drawn[0])


def test_a_folder_without_a_diagnosis_is_refused(tmp_path, capsys):
    assert command_line.main(["simulate", "--from", str(tmp_path), "--out", str(tmp_path / "both")]) == 1
    assert "rig diagnose" in capsys.readouterr().err
