"""Twenty images of each camera, millimetres, semicolons, milliseconds since 1970: imported, checked, measured,
calibrated.
"""

import csv
import shutil
from decimal import Decimal
from types import SimpleNamespace

import numpy as np
import pytest

from rig.formats.importers.foreign_table_column_search_and_completion import (
    accepted_header_names_of_axes,
    column_indices_by_headers,
)
from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process
from tests.conftest import BENCH
from tests.rig.formats.importers.foreign import EPOCH


def theirs(folder):
    """The bench's recording as somebody else has it."""
    with open(BENCH / "fit" / "frames.csv") as file:
        for row in csv.DictReader(file):
            name = folder / "pictures" / f"{row['camera']}_{(Decimal(row['t']) + EPOCH) * 1000:.0f}.png"
            name.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(BENCH / "fit" / row["image"], name)
    with open(BENCH / "fit" / "commands.csv") as file:
        rows = list(csv.reader(file))[1:]
    lines = ["# controller log", "Time [ms];" + ";".join(f"L{i} [mm]" for i in range(1, 7))]
    lines += [
        ";".join([f"{(Decimal(t) + EPOCH) * 1000:.0f}", *(str(Decimal(v) * 1000).replace(".", ",") for v in q)])
        for t, *q in rows
    ]
    (folder / "log.csv").write_text("\n".join(lines), encoding="utf-8-sig")


@pytest.mark.slow
def test_twenty_images_become_a_calibration(tmp_path):
    theirs(tmp_path)
    status, text = run_in_process(
        "import",
        tmp_path / "pictures",
        "--rig",
        BENCH / "fit" / "rig.toml",
        "--commands",
        tmp_path / "log.csv",
        "--out",
        tmp_path / "rec",
    )
    assert status == 0 and text.startswith("imported: 20 frames, 60 images of 3 cameras, 42 commands"), text
    assert "names of images: times are milliseconds since 1970" in text and "to look at" not in text
    ours, good = recording_folder.load_recording(tmp_path / "rec"), recording_folder.load_recording(BENCH / "fit")
    assert (
        np.abs(ours.exposures.times()[1] - good.exposures.times()[1]).max() < 1e-3
        and ours.exposures.camera == good.exposures.camera
    )
    assert run_in_process("check", tmp_path / "rec") == (0, "nothing wrong or unlikely was found\n")
    status, text = run_in_process("measure", tmp_path / "rec", "--out", tmp_path / "measured")
    assert status == 0 and "20 of 20 frames solved" in text.splitlines()[0], text
    status, text = run_in_process("calibrate", tmp_path / "measured", "--out", tmp_path / "calibration.json")
    assert status == 0 and (tmp_path / "calibration.json").exists(), text
    status, text = run_in_process(
        "certify", tmp_path / "calibration.json", tmp_path / "rec", "--out", tmp_path / "certificate.html"
    )
    assert status == 1 and "20 of 20 frames" in text and "--mask" in text, text


@pytest.mark.slow
def test_twenty_images_become_a_certificate_in_four_commands(tmp_path):
    theirs(tmp_path)
    made = ("--rig", BENCH / "fit" / "rig.toml", "--commands", tmp_path / "log.csv", "--out", tmp_path / "rec")
    assert run_in_process("import", tmp_path / "pictures", *made)[0] == 0
    assert run_in_process("check", tmp_path / "rec")[0] == 0
    held, fitted = "1,4,7,10,13,16", "0,2-3,5-6,8-9,11-12,14-15,17-19"
    status, text = run_in_process("calibrate", tmp_path / "rec", "--mask", held, "--out", tmp_path / "calibration.json")
    assert status == 0 and "from 14 distinct configurations" in text, text
    words = (
        "certify",
        tmp_path / "calibration.json",
        tmp_path / "rec",
        "--coverage",
        "0.6",
        "--confidence",
        "0.9",
        "--out",
        tmp_path / "certificate.html",
    )
    status, text = run_in_process(*words, "--mask", fitted)
    assert status == 0 and "From 6 distinct configurations, none of which was used in fitting" in text, text
    assert "With 90 % confidence, 60 % of poses" in (tmp_path / "certificate.html").read_text()
    status, text = run_in_process(*words, "--mask", "0-12", "--force")
    assert status == 1 and "5 of 7 frames" in text and "took part in fitting" in text, text


def test_a_log_that_is_cut_off_names_its_last_line(tmp_path):
    theirs(tmp_path)
    lines = (tmp_path / "log.csv").read_text(encoding="utf-8-sig").splitlines()
    (tmp_path / "log.csv").write_text("\n".join([*lines[:9], lines[9][:30]]))
    status, text = run_in_process(
        "import",
        tmp_path / "pictures",
        "--rig",
        BENCH / "fit" / "rig.toml",
        "--commands",
        tmp_path / "log.csv",
        "--out",
        tmp_path / "rec",
    )
    assert status == 1 and "log.csv:10: its last line is not like the 7 before it" in text and "cut off" in text, text


def test_a_header_that_is_not_known_is_asked_for(tmp_path):
    theirs(tmp_path)
    log = (tmp_path / "log.csv").read_text(encoding="utf-8-sig")
    words = (
        "import",
        tmp_path / "pictures",
        "--rig",
        BENCH / "fit" / "rig.toml",
        "--commands",
        tmp_path / "log.csv",
        "--out",
        tmp_path / "rec",
    )
    (tmp_path / "log.csv").write_text(log.replace("Time [ms]", "Tick [ms]"))
    status, text = run_in_process(*words)
    assert status == 1 and "--set 'commands.columns.t=Tick [ms]'" in text, text
    (tmp_path / "log.csv").write_text(log.replace("Time [ms]", "Zeitstempel (ms)"))
    assert run_in_process(*words)[0] == 0


@pytest.mark.parametrize("header, values", [("temp", "20 20 19"), ("load", "20 21 22"), ("step", "0 1 2")])
def test_a_column_beside_the_commands_is_not_taken_for_a_time(tmp_path, header, values):
    names = [f"l{i + 1}" for i in range(6)]
    header_row, columns = ("frame", *names, header), [*(["0.45"] * 3 for _ in range(7)), values.split()]
    table = SimpleNamespace(columns=())
    cells = SimpleNamespace(table=table, header=header_row, path=tmp_path, column=lambda at: columns[at])
    known = {"t": ("time", "temps"), **accepted_header_names_of_axes(names)}
    assert set(column_indices_by_headers(cells, "commands", known, names)) == set(names)
