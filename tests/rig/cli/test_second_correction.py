"""One more pass through the command line: over poses and in a part, its place in the order kept; wishes that cannot be
are refused.
"""

import json

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.model.mechanisms import hexapod
from rig.model.pose import exp
from rig.planning.configuration_generators import sobol_configurations
from rig.recording import corner_and_pose_csv_tables
from rig.recording.corner_and_pose_csv_tables import Poses

SIGMAS = '\n[instrument]\nbase = "rig"\ntool = "rig"\nposition_sigma = 1e-6\nrotation_sigma = 1e-5\n'


def recorded(folder, design, rig_text, seed, count=60):
    """A recording by a tracker of a hexapod whose platform leans the farther out it stands, beyond what struts
    explain.
    """
    folder.mkdir()
    (folder / "rig.toml").write_text(rig_text + SIGMAS)
    commands = sobol_configurations(design.mechanism.strut_range, count, 0.8, seed)
    T = hexapod.forward(commands, design.mechanism)
    x = T.translation - [0.0, 0.0, 0.44]
    T = T * exp(np.concatenate([1e-3 * x + 5e-3 * x * x[:, [1, 2, 0]], 1e-3 * x[:, ::-1]], axis=1))
    times = np.arange(count) * 10.0
    corner_and_pose_csv_tables.write_table(
        folder / "frames.csv", ("frame", "t", "camera", "image"), [f"{k},{t + 5},," for k, t in enumerate(times)]
    )
    corner_and_pose_csv_tables.write_table(
        folder / "commands.csv",
        ("t", *design.mechanism.axes),
        [
            ",".join([f"{t + wait}", *(f"{value:.9f}" for value in row)])
            for t, row in zip(times, commands)
            for wait in (4.0, 6.0)
        ],
    )
    corner_and_pose_csv_tables.write_poses(folder / "poses.csv", Poses(np.arange(count), T, None))
    return str(folder)


def calibrated(out, recording, *words):
    assert main(["calibrate", recording, *words, "--out", str(out), "--anyway"]) == 0


@pytest.fixture(scope="module")
def first(tmp_path_factory, design, rig_text):
    """(folder, REC2, CALIBRATION) of a machine that is calibrated once."""
    base = tmp_path_factory.mktemp("passes")
    one, two = (recorded(base / name, design, rig_text, seed) for name, seed in (("one", 1), ("two", 2)))
    calibrated(base / "one.json", one, "--extend", "axes", "--alone")
    return base, two, str(base / "one.json")


@pytest.mark.slow
def test_order_count_space_and_part_are_kept(first, capsys):
    base, two, one = first
    calibrated(
        base / "two.json", two, "--extend", "polynomial", "--onto", one, "--space", "pose", "--within", "z=0.3:0.6"
    )
    output = capsys.readouterr().out
    assert "a map in pose space: within" in output and "pass 2" in output
    source = json.loads((base / "two.json").read_text())["provenance"]
    assert source["pass"] | {"samples": 0} == {
        "number": 2,
        "way": "polynomial",
        "space": "pose",
        "within": "z=0.3:0.6",
        "samples": 0,
        "chosen": ["polynomial"],
    }
    assert [one["recording"] for one in source["passes"]] == ["one"]
    calibrated(base / "three.json", two, "--extend", "polynomial", "--onto", str(base / "two.json"))
    result = json.loads((base / "three.json").read_text())
    assert result["schema"] == "calibration/3" and result["provenance"]["pass"]["number"] == 3
    assert [one.get("pass", {}).get("space") for one in result["provenance"]["passes"]] == [None, "pose"]
    assert main(["workspace", str(base / "three.json")]) == 0


@pytest.mark.slow
def test_a_pass_that_leaves_less_than_noise_has_a_claim_that_is_read_again(first, tmp_path, capsys):
    base, two, one = first
    calibrated(tmp_path / "two.json", two, "--extend", "radial", "--onto", one)
    claim = json.loads((tmp_path / "two.json").read_text(), parse_constant=pytest.fail)["claim"]
    assert claim["ratio"] is not None and claim["after"][0][1] < claim["after"][0][2]
    (tmp_path / "wanted.csv").write_text("frame,x,y,z,rx,ry,rz\n0,0,0,0.44,0,0,0\n")
    assert (
        main(
            [
                "correct",
                str(tmp_path / "two.json"),
                "--poses",
                str(tmp_path / "wanted.csv"),
                "--out",
                str(tmp_path / "c.csv"),
            ]
        )
        == 0
    )


@pytest.mark.parametrize(
    "words, says",
    [
        ("--space pose", "name with --onto"),
        ("--onto ONE --within l7=0:1", "--within takes NAME=LOW:HIGH"),
        ("--onto ONE --within l1=1:0", "low below high"),
        ("--onto ONE --within l1", "not 'l1'"),
        ("--onto ONE --within x=0:0.1", "bounded by the axes"),
        ("--onto ONE --space pose --within l1=0.4:0.5", "bounded by x y z"),
        ("--onto ONE --within l1=0.9:", "none of 60 samples"),
        ("--onto NOWHERE", "no such file"),
    ],
)
def test_what_cannot_be_is_refused(first, words, says, tmp_path, capsys):
    base, two, one = first
    assert (
        main(
            [
                "calibrate",
                two,
                "--extend",
                "polynomial",
                *[one if word == "ONE" else word for word in words.split()],
                "--out",
                str(tmp_path / "c.json"),
                "--anyway",
            ]
        )
        == 1
    )
    assert says in capsys.readouterr().err and not (tmp_path / "c.json").exists()
