"""More measuring limbs than six: the six that tell poses, the others as checks that close as said, a limb that slips
named without vision.
"""

import json
import re

import numpy as np
import pytest

from calib.certification import (
    loop_closure_checks_of_redundant_measuring_limbs,
    measuring_limb_calibration_slips_and_vision_agreement,
)
from calib.online import accepted_measuring_limbs_file, measuring_limb_poses_checked_by_vision
from calib.online.measuring_limb_poses_checked_by_vision import LiveLimbPoses
from rig.cli import command_line
from rig.errors import RigError
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.mechanisms import hexapod
from rig.model.pose import transform_points
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file
from tests.closed_loops import rig

EIGHT = 8


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """(Design with eight limbs, as it truly is, what these read at 60 poses (60, 8) m, with noise)"""
    folder = tmp_path_factory.mktemp("eight")
    (folder / "rig.toml").write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, EIGHT)))
    design = design_from_rig_toml.load_design(folder / "rig.toml")
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(5)).true
    T = hexapod.forward(sobol_configurations(true.mechanism.strut_range, 60, 0.8), true.mechanism)
    m = true.insitu
    read = np.linalg.norm(transform_points(T, m.platform_joints) - m.base_joints, axis=-1) - m.zeros
    return design, true, read + 1e-6 * np.random.default_rng(6).normal(size=read.shape), T


@pytest.fixture(scope="module")
def limbs(machine):
    """Limbs of which six are known as vision would have them, and the checks fitted to their poses."""
    design, true, read, T = machine
    chosen = loop_closure_checks_of_redundant_measuring_limbs.best_six_limbs(design.insitu, design.mechanism.home, T)
    six = measuring_limb_calibration_slips_and_vision_agreement.Limbs(
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(true, chosen),
        1e-14 * np.eye(42),
        np.full(6, 1e-6),
        chosen,
    )
    return measuring_limb_calibration_slips_and_vision_agreement.Limbs(
        six.hexapod,
        six.covariance,
        six.sigma,
        chosen,
        loop_closure_checks_of_redundant_measuring_limbs.fit_redundant_limb_checks(six, design.insitu, read),
    )


def test_checks_close_on_stretches_left_out_by_as_much_as_is_said(machine, limbs):
    design, _, read, _ = machine
    error, sigma = loop_closure_checks_of_redundant_measuring_limbs.held_out_redundant_limb_errors_and_sigma(
        limbs, design.insitu, read
    )
    assert (
        error.shape == (60, EIGHT - 6) and len(set(limbs.chosen.tolist()) | set(limbs.checks.limbs.tolist())) == EIGHT
    )
    assert 0.7 < np.sqrt((error**2 / sigma**2).mean()) < 1.3 and (sigma < 2e-5).all()
    stated = loop_closure_checks_of_redundant_measuring_limbs._closures(
        limbs,
        loop_closure_checks_of_redundant_measuring_limbs.Checks(
            limbs.checks.limbs,
            design.insitu.base_joints[limbs.checks.limbs],
            design.insitu.platform_joints[limbs.checks.limbs],
            np.zeros(EIGHT - 6),
            np.zeros((EIGHT - 6, 7, 7)),
            np.full(EIGHT - 6, 1e-6),
        ),
        read,
    )
    assert np.abs(stated.error).max() > 20 * np.abs(error).max()  # there was something to fit


def test_of_six_limbs_none_is_over_to_be_checked(machine):
    _, true, read, _ = machine
    stated = design_from_rig_toml.design_of_entries(
        toml_entries(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 6)), "rig.toml")
    ).insitu
    six = measuring_limb_calibration_slips_and_vision_agreement.Limbs(
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(true, np.arange(6)),
        1e-14 * np.eye(42),
        np.full(6, 1e-6),
        np.arange(6),
    )
    error, sigma = loop_closure_checks_of_redundant_measuring_limbs.held_out_redundant_limb_errors_and_sigma(
        six, stated, read[:, :6]
    )
    assert error.shape == sigma.shape == (60, 0)


@pytest.mark.parametrize("which", ["chosen", "check"])
def test_a_limb_that_slips_is_named_by_the_others_within_five_poses(machine, limbs, which):
    _, _, read, _ = machine
    assert loop_closure_checks_of_redundant_measuring_limbs.first_unclosed_limb(limbs, read) is None
    limb = int(limbs.chosen[2] if which == "chosen" else limbs.checks.limbs[0])
    slipped = read - 3e-5 * (np.arange(60)[:, None] >= 40) * np.eye(EIGHT)[limb]
    found = loop_closure_checks_of_redundant_measuring_limbs.first_unclosed_limb(limbs, slipped)
    assert 40 <= found.at < 45 and found.limb in (None, limb + 1)
    assert which == "chosen" or found.limb is not None
    assert found.limb is None or abs(found.size - 3e-5) < 1e-5
    source = LiveLimbPoses(accepted_measuring_limbs_file.Accepted(limbs, limbs.hexapod, None, None, {}), 10)
    closed = [source.is_closed(one) for one in slipped[38:44]]
    assert closed[0] is None and closed[1] is None and any(closed) and not source.in_force


def test_fewer_limbs_than_freedoms_are_refused_with_the_reason(tmp_path):
    (tmp_path / "rig.toml").write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 4)))
    design = design_from_rig_toml.load_design(tmp_path / "rig.toml")
    with pytest.raises(
        RigError,
        match="has 4 measuring limbs in .insitu., and a platform has six freedoms: fewer than six lengths determine no",
    ):
        measuring_limb_calibration_slips_and_vision_agreement.hexapod_of_six_limbs(design)
    assert not loop_closure_checks_of_redundant_measuring_limbs.has_six_measuring_limbs(design)


@pytest.mark.slow
def test_eight_limbs_through_the_command_line(tmp_path, capsys):
    """Held against vision, saved, a source of poses; closures reported; one that slips ends it without a look of
    vision's.
    """
    rig("design", "--radius", "0.3", "--limbs", EIGHT, "--out", tmp_path / "rig.toml")
    for name, seed in (("rec", "4"), ("again", "5")):
        drive = ("--machine", tmp_path / "truth.json") if name == "again" else ("--truth", tmp_path / "truth.json")
        rig("simulate", tmp_path / "rig.toml", "--plan", "sobol:60", "--seed", seed, *drive, "--out", tmp_path / name)
    limbs = tmp_path / "limbs.json"
    capsys.readouterr()
    rig("insitu", tmp_path / "rec", "--tolerance", "1e-4", "4e-4", "--out", limbs)
    output = capsys.readouterr().out
    rows = re.findall(r"^m(\d) +\S+ +(\S+) +(\S+)$", output, re.MULTILINE)
    assert "give the pose; the others minus prediction, um:" in output and len(rows) == 2
    assert all(0.3 < float(rms) / float(expected) < 2 for _, rms, expected in rows)
    loaded = accepted_measuring_limbs_file.load_limbs_of_any_verdict(limbs)
    assert (
        sorted([*(loaded.limbs.chosen + 1), *(loaded.limbs.checks.limbs + 1)]) == list(range(1, EIGHT + 1))
        and loaded.verdict == "accepted"
    )
    rig("measure", tmp_path / "again", "--limbs", limbs, "--out", tmp_path / "measured")
    assert "at each of which 2 more limbs close" in capsys.readouterr().out
    assert (
        command_line.main(["closure", str(tmp_path / "again"), "--limbs", str(limbs), "--json"]) == 1
    )  # of struts as stated
    printed = json.loads(capsys.readouterr().out)
    assert len(printed["pose_from"]) == 6 and len(printed["closures"]) == EIGHT
    read = recording_folder.load_recording(tmp_path / "again")
    limb = loaded.limbs.checks.limbs[1] + 1
    text = (tmp_path / "again" / "sensors.csv").read_text().splitlines()
    at, start = text[0].split(",").index(f"m{limb}"), float(read.exposures.times()[1][30]) - 0.5
    rows = [line.split(",") for line in text[1:]]
    for row in rows:
        if float(row[0]) > start:
            row[at] = f"{float(row[at]) - 3e-5:.8f}"
    (tmp_path / "again" / "sensors.csv").write_text("\n".join([text[0], *(",".join(row) for row in rows)]) + "\n")
    assert (
        command_line.main(
            ["measure", str(tmp_path / "again"), "--limbs", str(limbs), "--out", str(tmp_path / "slipped")]
        )
        == 1
    )
    output = capsys.readouterr().err
    assert "The measuring limbs no longer agree with one another: their acceptance is withdrawn" in output
    assert 30 <= int(re.search(r"frame (\d+)", output)[1]) < 35 and f"limb {limb} is longer" in output
    assert accepted_measuring_limbs_file.load_limbs_of_any_verdict(limbs).verdict == "withdrawn"
    rig(
        "insitu",
        tmp_path / "rec",
        "--tolerance",
        "1e-4",
        "4e-4",
        "--use",
        "m1,m2,m3,m4,m5,m6",
        "--out",
        tmp_path / "first.json",
    )
    assert (
        accepted_measuring_limbs_file.load_limbs_of_any_verdict(tmp_path / "first.json").limbs.chosen == np.arange(6)
    ).all()
    assert command_line.main(["insitu", str(tmp_path / "rec"), "--use", "m1,m2,m3,m4,m5,m9"]) == 1
    assert "six different limbs of m1 .. m8" in capsys.readouterr().err
    with pytest.raises(RigError, match="of other limbs than rig.toml states in .insitu.: of 8, not of 6"):
        accepted_measuring_limbs_file.load_accepted_limbs_for_design(tmp_path / "first.json", _with_limbs(tmp_path, 6))
    assert measuring_limb_poses_checked_by_vision.limb_poses(
        read, accepted_measuring_limbs_file.load_limbs_of_any_verdict(tmp_path / "first.json")
    ).lengths.shape == (60, EIGHT)


def _with_limbs(folder, count):
    (folder / "other.toml").write_text(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, count))
    )
    return design_from_rig_toml.load_design(folder / "other.toml")
