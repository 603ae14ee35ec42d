"""Closed loops through the command line: designed, simulated, measured, calibrated, corrected, driven, verified."""

import json

import numpy as np

from rig.cli import command_line


def rig(*words):
    """One command of `rig`, in this process, which must succeed."""
    assert command_line.main([str(word) for word in words]) == 0, words


def simulate_with_truth(folder, plan, seed, *words):
    """Simulate the rig of a folder's rig.toml into its rec, with its truth.json."""
    files = ("--out", folder / "rec", "--truth", folder / "truth.json")
    rig("simulate", folder / "rig.toml", "--plan", plan, "--seed", seed, *words, *files)


def design_two_struts(folder, *words):
    """Design a small rig of two struts into a folder's rig.toml."""
    out = ("--cubes", "1", "--cameras", "2", "--out", folder / "rig.toml")
    rig("design", "--mechanism", "planar2", "--radius", "0.3", *words, *out)


def calibrated(folder, capfd, *words):
    """Calibrate a folder's rec into its calibration.json, by way of the standard output: no page is drawn."""
    capfd.readouterr()
    rig("calibrate", folder / "rec", "--out", "-", *words)
    output = capfd.readouterr().out
    (folder / "calibration.json").write_text(output[output.index("{\n") : output.rindex("}") + 1])


def verified(folder, capfd, poses, drive=(), calibrate=(), reached="wanted.csv"):
    """What `rig verify --json` says of wanted poses, driven and measured.

    folder : with rig.toml, the recording rec and its truth.json; poses : lines of wanted poses; drive : options of the
        simulated drive
    reached : what the drive is judged against, of an arm of few joints the poses that it takes instead
    """
    (folder / "wanted.csv").write_text("frame,x,y,z,rx,ry,rz\n" + "\n".join(poses) + "\n")
    calibrated(folder, capfd, *calibrate)
    rig("correct", folder / "calibration.json", "--poses", folder / "wanted.csv", "--out", folder / "commands.csv")
    rig(
        "simulate",
        folder / "rig.toml",
        "--machine",
        folder / "truth.json",
        "--plan",
        f"commands:{folder / 'commands.csv'}",
        "--seed",
        "99",
        *drive,
        "--out",
        folder / "drive",
        "--truth",
        folder / "drive.json",
    )
    capfd.readouterr()
    rig("verify", folder / "calibration.json", folder / "drive", "--wanted", folder / reached, "--json")
    return json.loads(capfd.readouterr().out)


def holds(verification, parts=("position", "rotation")):
    """Assert that poses are off by no more than twice what is stated, and less than uncorrected."""
    wanted = verification["wanted"]
    for part in parts:
        stated = wanted["stated_uncertainty"][part]
        assert 0 < wanted[part]["rms"] <= 2 * stated, (part, wanted[part]["rms"], stated)
    assert verification["after"]["position"]["rms"] < verification["before"]["position"]["rms"]


def lines(T):
    """Lines of a poses.csv of poses T (n,)."""
    from rig.model.pose import pose_to_vector

    return [f"{k}," + ",".join(f"{value:.9f}" for value in np.asarray(row)) for k, row in enumerate(pose_to_vector(T))]
