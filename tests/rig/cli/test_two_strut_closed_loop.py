"""Two struts in a plane, through the command line: what the method does for a hexapod it does for its own worked
example.
"""

import json

import numpy as np
import pytest

from rig.cli import command_line
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import two_strut_planar_mechanism
from rig.planning.configuration_generators import sobol_configurations
from tests.closed_loops import calibrated, design_two_struts, holds, lines, rig, simulate_with_truth, verified


def recorded(folder, *words, plan="sobol:24", size="640x512", same_machine=False):
    design_two_struts(folder, "--size", size, *(["--force"] if same_machine else []))
    simulate_with_truth(folder, plan, 3, *words)


def wanted(folder, count=6):
    m = design_from_rig_toml.load_design(folder / "rig.toml").mechanism
    return lines(two_strut_planar_mechanism.forward(sobol_configurations(m.strut_range, count, 0.7, 5), m))


def test_a_loop_closes_from_corners(tmp_path, capfd):
    recorded(tmp_path)
    found = verified(tmp_path, capfd, wanted(tmp_path))
    holds(found, ("position",))
    assert (
        found["wanted"]["stated_uncertainty"]["rotation"] == 0 and found["before"]["rotation"]["rms"] is None
    )  # a hinge does not turn
    assert found["before"]["position"]["rms"] > 2 * found["after"]["position"]["rms"]
    tree, truth = (json.loads((tmp_path / name).read_text()) for name in ("calibration.json", "truth.json"))
    off = np.concatenate(
        [np.ravel(tree["fitted"][name]) - np.ravel(truth[name]) for name in ("base_joints", "strut_zeros")]
    )
    sigma = np.sqrt(np.diag(tree["parameter_covariance"]))
    assert np.abs(off / sigma).max() < 3 and np.linalg.norm(off[:4]) < 3e-3


def test_four_samples_are_exact_where_they_were_taken(tmp_path, capfd):
    """The source's way: two lengths of either strut, on the nominal model alone, [0082] to [0091]."""
    recorded(tmp_path, "--noise", "0.001", plan="division:1")
    calibrated(tmp_path, capfd, "--extend", "linear", "--alone")
    rig("verify", tmp_path / "calibration.json", tmp_path / "rec", "--json")
    found = json.loads(capfd.readouterr().out)
    assert found["after"]["position"]["max"] < 1e-9 < 1e-4 < found["before"]["position"]["rms"]


def test_configurations_are_planned(tmp_path, capfd):
    design_two_struts(tmp_path)
    rig("plan", tmp_path / "rig.toml", "--for", "parameters", "--count", "10", "--out", tmp_path / "plan.csv")
    output = capfd.readouterr().out
    rows = [line.split() for line in output.splitlines() if " um  " in line]
    assert (
        "10 configurations for 6 parameters" in output
        and len(rows) == 6
        and all(float(row[0]) < float(row[1]) for row in rows)
    )
    recorded(tmp_path, plan=f"commands:{tmp_path / 'plan.csv'}", same_machine=True)
    calibrated(tmp_path, capfd)
    assert (
        command_line.main(
            [
                "plan",
                str(tmp_path / "rig.toml"),
                "--for",
                "parameters",
                "--count",
                "3",
                "--out",
                str(tmp_path / "few.csv"),
            ]
        )
        != 0
    )
    assert "3 configurations cannot determine 6 parameters" in capfd.readouterr().err


@pytest.mark.slow
def test_what_holds_a_strut_back_is_found_at_that_strut(tmp_path):
    recorded(tmp_path, "--effect", "backlash:strut2:gap=3e-4", plan="sobol:30,ladder:3")
    rig("diagnose", tmp_path / "rec", "--only", "backlash", "--out", tmp_path / "found")
    found = json.loads((tmp_path / "found" / "diagnosis.json").read_text())["findings"]
    assert [(f["effect"], f["place"]) for f in found] == [("backlash", "strut 2")]
    low, high = found[0]["parameters"]["gap"]["ci95"]
    assert low < 3e-4 < high


@pytest.mark.slow
def test_a_loop_closes_from_images(tmp_path, capfd):
    recorded(tmp_path, "--images", plan="sobol:12", size="480x384")
    rig("measure", tmp_path / "rec", "--out", tmp_path / "measured")
    holds(verified(tmp_path, capfd, wanted(tmp_path, 4), ("--images",)), ("position",))
