"""rig workspace, and plans that avoid what a calibration lost, through the command line."""

import hashlib
import json
from html.parser import HTMLParser

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.machine_correction import Correction
from calib.files import calibration_file
from calib.models.machine_parameters_and_file_entries import calibration_with_workspace
from calib.models.platform.platform_identification import identify_platform
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import are_nominal_poses_out_of_corrected_reach
from rig.cli.command_line import main
from rig.formats import csv_and_parquet_tables_and_time_origin
from synthetic import random_true_machine_and_truth_file
from tests.calib.noisy_samples import sampled
from tests.cli import Links


@pytest.fixture(scope="module")
def calibration_folder(tmp_path_factory, design, rig_text):
    """A folder with rig.toml and the calibration of a rig that is ten times as far off as rigs are; and that
    Calibration.
    """
    base = tmp_path_factory.mktemp("kept")
    (base / "rig.toml").write_text(rig_text)
    samples, _ = sampled(design, 3, 40)
    found = identify_platform(samples, design.mechanism)
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(2), 10.0).true.mechanism
    made = calibration_with_workspace(
        Calibration(
            Correction(design.mechanism, true, (None,) * 6), found.covariance, found.scatter, (), (), None, {"seed": 0}
        )
    )
    calibration_file.save(base / "calibration.json", made)
    return base, made


def certificate(calibration, w):
    """What `rig workspace` reads of a certificate whose volume is the whole and whose one box is the upper half of
    it.
    """
    low, high = w.centre.min(axis=0), w.centre.max(axis=0)
    middle = (low + high) / 2
    return {
        "schema": "certificate/1",
        "inputs_sha256": {"c.json": {"file": hashlib.sha256(calibration.read_bytes()).hexdigest()}},
        "volume": {"position_low_m": low.tolist(), "position_high_m": high.tolist()},
        "promise": {"position_m": 5e-5, "rotation_rad": None},
        "cells": [
            {
                "position_low_m": [*low[:2], middle[2]],
                "position_high_m": high.tolist(),
                "promise": {"position_m": 4e-5, "rotation_rad": 1e-4},
            }
        ],
    }


def test_the_map_is_said_and_written(calibration_folder, tmp_path, capsys):
    base, made = calibration_folder
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(certificate(base / "calibration.json", made.workspace)))
    assert (
        main(["workspace", str(base / "calibration.json"), "--out", str(tmp_path / "map"), "--certificate", str(path)])
        == 0
    )
    output = capsys.readouterr().out
    assert (
        f"{made.workspace.lost * 100:.2f} % of the poses" in output
        and "position 40 to 50 um, rotation 100 urad" in output
    )
    tree = json.loads((tmp_path / "map" / "workspace.json").read_text())
    assert (
        tree["verdict"]["state"] == "check"
        and output.startswith("check: ")
        and "poses are lost" in tree["verdict"]["why"]
    )
    assert (
        tree["schema"] == "workspace/1"
        and tree["lost"] == made.workspace.lost
        and "oriented as home" in tree["room_of"]
    )
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(
        tmp_path / "map" / "workspace.csv", ("x", "y", "z", "lost")
    )
    assert rows.matrix(("lost",)).sum() == made.workspace.lost_in.sum()
    page, links = (tmp_path / "map" / "workspace.html").read_text(), Links()
    links.feed(page)
    assert page.count("<svg") == 6 and "Certified bounds" in page and not links.outside
    HTMLParser().feed(page)


def test_what_is_no_calibration_or_another_ones_certificate_is_refused(calibration_folder, tmp_path, capsys):
    base, made = calibration_folder
    half = tmp_path / "half.json"
    half.write_text((base / "calibration.json").read_text()[:3000])
    other = tmp_path / "certificate.json"
    other.write_text(
        json.dumps({**certificate(base / "calibration.json", made.workspace), "inputs_sha256": {"x": {"file": "0"}}})
    )
    for words, says in (
        (["calibratoin.json"], "no such file"),
        ([str(half)], "cut off"),
        ([str(tmp_path)], str(tmp_path)),
        ([str(base / "calibration.json"), "--out", str(tmp_path / "map.html")], "takes a folder"),
        ([str(base / "calibration.json"), "--certificate", str(other)], "another calibration"),
        ([str(base / "calibration.json"), "--certificate", str(base / "calibration.json")], "is no certificate"),
    ):
        assert main(["workspace", *words]) == 1
        assert says in capsys.readouterr().err
    assert not (tmp_path / "map.html").exists()


def test_a_calibration_of_before_has_its_workspace_worked_out(calibration_folder, tmp_path, capsys):
    base, made = calibration_folder
    tree = json.loads((base / "calibration.json").read_text())
    del tree["workspace"]
    (tmp_path / "old.json").write_text(json.dumps(tree))
    assert main(["workspace", str(tmp_path / "old.json")]) == 0
    output = capsys.readouterr().out
    assert "computed now" in output and f"{made.workspace.lost * 100:.2f} % of the poses" in output


@pytest.mark.parametrize("requested", [["--for", "parameters", "--count", "12"], ["--promise", "12um"]])
def test_plans_avoid_what_was_lost(calibration_folder, tmp_path, requested, capsys):
    base, made = calibration_folder
    out = []
    for given in ([], ["--calibration", str(base / "calibration.json")]):
        assert (
            main(["plan", str(base / "rig.toml"), *requested, *given, "--out", str(tmp_path / "plan.csv"), "--force"])
            == 0
        )
        out.append(
            are_nominal_poses_out_of_corrected_reach(
                made.correction,
                csv_and_parquet_tables_and_time_origin.read_csv_table(tmp_path / "plan.csv", ("frame",)).matrix(
                    made.correction.nominal.axes
                ),
            )
        )
    assert out[0].any() and not out[1].any()  # outermost configurations tell most, and are the first to go
    assert (
        main(
            [
                "plan",
                str(base / "rig.toml"),
                "--separate",
                "backlash:strut3:gap=4e-5",
                "creep:strut3:amount=4e-5",
                "--calibration",
                str(base / "calibration.json"),
                "--out",
                str(tmp_path / "s.csv"),
            ]
        )
        == 1
    )
    assert "--calibration applies to --for and --promise" in capsys.readouterr().err
