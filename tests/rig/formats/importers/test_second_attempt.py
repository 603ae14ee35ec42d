"""An import of somebody's own data: the first attempt names all that is unclear, the second is right, and measures."""

import csv
import re
import shlex
import shutil
from decimal import Decimal

import numpy as np
import pytest

from rig.formats.importers.foreign_csv_dialect_detection import read_foreign_table_header_and_cells
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.formats.importers.foreign_pose_table import POSITION, VECTOR
from rig.formats.importers.foreign_table_column_search_and_completion import (
    TIME,
    accepted_header_names_of_axes,
    column_indices_by_headers,
)
from rig.formats.importers.foreign_table_units_and_timestamps import UnclearInput
from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process
from tests.conftest import BENCH
from tests.rig.formats.importers.foreign import EPOCH

FRAMES = 8
FOLDERS = {"cam0": "links", "cam1": "mitte", "cam2": "rechts"}
AHEAD = 37  # s, that the cameras' clock is


def decimal_comma(value):
    return f"{value:f}".replace(".", ",")


def own_data(folder):
    """Bench frames in mm with semicolons and decimal commas, epoch seconds, IMG_0001.png in every camera's folder, and
    a rig.toml without lenses whose cameras are 20 cm off.
    """
    with open(BENCH / "fit" / "frames.csv") as file:
        rows = [row for row in csv.DictReader(file) if int(row["frame"]) < FRAMES]
    times = {}
    for row in rows:
        name = f"IMG_{int(row['frame']) + 1:04d}.png"
        path = folder / "bilder" / FOLDERS[row["camera"]] / name
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(BENCH / "fit" / row["image"], path)
        times[name] = Decimal(row["t"]) + EPOCH + AHEAD
    lines = [f"{name};{decimal_comma(t)}" for name, t in times.items()]
    (folder / "bilder.csv").write_text("\n".join(["Bilddatei;Uhrstand", *lines]) + "\n")
    end = float(rows[-1]["t"]) + 2.0
    with open(BENCH / "fit" / "commands.csv") as file:
        log = [row for row in list(csv.reader(file))[1:] if float(row[0]) < end]
    lines = [
        ";".join([decimal_comma(Decimal(t) + EPOCH), *(decimal_comma(Decimal(v) * 1000) for v in q)]) for t, *q in log
    ]
    header = "Zaehlerstand;" + ";".join(f"Teleskop {i}" for i in range(1, 7))
    (folder / "log.csv").write_text("\n".join([header, *lines]) + "\n")
    text = (BENCH / "fit" / "rig.toml").read_text()
    text = re.sub(r"distortion = .*", "distortion = [0.0, 0.0, 0.0, 0.0]", text)

    def moved(match):
        x, y = float(match[1]) + 0.12, float(match[2]) - 0.16
        return f"pose = {{ position = [{x}, {y}, {match[3]}]"

    start, end = text.index("[[camera]]"), text.index("[[target]]")
    assert start < end
    cameras, count = re.subn(r"pose = \{ position = \[([^,]+), ([^,]+), ([^\]]+)\]", moved, text[start:end])
    assert count == 3
    (folder / "rig.toml").write_text(text[:start] + cameras + text[end:])


def words(folder):
    tables = ("--commands", folder / "log.csv", "--frames", folder / "bilder.csv")
    return ("import", folder / "bilder", "--rig", folder / "rig.toml", *tables, "--out", folder / "rec")


@pytest.mark.slow
def test_the_first_attempt_names_everything_and_the_second_is_right(tmp_path):
    own_data(tmp_path)
    status, text = run_in_process(*words(tmp_path))
    assert status == 1 and not (tmp_path / "rec").exists()
    assert "no column is t, l1, l2, l3, l4, l5, l6" in text
    assert "t: likely 'Zaehlerstand'" in text and "l6: likely 'Teleskop 6'" in text
    assert "of which camera is it? rig.toml has cam0, cam1, cam2" in text
    assert "bilder.csv: no column is t" in text
    assert "different clocks" in text and "where the commands stand still" in text
    options = shlex.split(text.strip().splitlines()[-1])
    shift = next(float(one.partition("=")[2]) for one in options if one.startswith("images.shift="))
    assert abs(shift + AHEAD) < 2.0
    status, text = run_in_process(*words(tmp_path), *options)
    assert status == 0 and f"imported: {FRAMES} frames, {3 * FRAMES} images of 3 cameras" in text, text
    assert len(re.findall(r"found: camera cam\d: the base markers put it (?:19|20)\d mm", text)) == 3, text
    ours, good = (recording_folder.load_recording(path) for path in (tmp_path / "rec", BENCH / "fit"))
    times = [r.exposures.times()[1][:FRAMES] for r in (ours, good)]
    np.testing.assert_allclose(np.diff(times[0]), np.diff(times[1]), atol=1e-6)
    np.testing.assert_allclose(ours.commands.values, good.commands.values[: len(ours.commands.values)], atol=1e-12)
    status, text = run_in_process("measure", tmp_path / "rec", "--out", tmp_path / "measured")
    assert status == 0 and f"{FRAMES} of {FRAMES} frames solved" in text, text
    assert len(re.findall(r"camera cam\d: (?:19|20)\d\.?\d* mm", text)) == 3, text
    moved = recording_folder.load_recording(tmp_path / "measured").design.cameras
    for camera, true in zip(moved, good.design.cameras):
        assert np.linalg.norm(camera.pose.translation - true.pose.translation) < 0.02


@pytest.mark.parametrize(
    "time, limb",
    [("Zeitpunkt", "Länge {}"), ("Horodatage (s)", "Vérin {} [mm]"), ("Tiempo", "Pierna {}"), ("时间", "支腿{}")],
)
def test_columns_are_known_in_four_more_languages(tmp_path, time, limb):
    path = tmp_path / "log.csv"
    path.write_text(";".join([time, *(limb.format(i) for i in range(1, 7))]) + "\n" + "1;2;3;4;5;6;7\n2;3;4;5;6;7;8\n")
    cells = read_foreign_table_header_and_cells(ForeignTable(path, decimal="point"), "commands")
    axes = [f"l{i}" for i in range(1, 7)]
    found = column_indices_by_headers(cells, "commands", {**TIME, **accepted_header_names_of_axes(axes)}, axes)
    assert found == {"t": 0, **{name: i for i, name in enumerate(axes, 1)}}


@pytest.mark.parametrize("second", ["", "model_"])
def test_columns_that_share_a_prefix_are_known_unless_two_prefixes_can_be_meant(tmp_path, second):
    path = tmp_path / "poses.csv"
    header = ["elbow_x"] + [f"measurement_{name}" for name in ("x", "y", "z", "rx")]
    header += [f"{second}{name}" for name in "xyz"] if second else []
    path.write_text(";".join(header) + "\n" + ";".join("1" for _ in header) + "\n")
    cells = read_foreign_table_header_and_cells(ForeignTable(path, decimal="point"), "poses")
    if second:
        with pytest.raises(UnclearInput, match="x: --set"):
            column_indices_by_headers(cells, "poses", {**POSITION, **VECTOR}, ("x", "y", "z"))
    else:
        found = column_indices_by_headers(cells, "poses", {**POSITION, **VECTOR}, ("x", "y", "z"))
        assert found == {"x": 1, "y": 2, "z": 3, "rx": 4}


def test_a_misspelt_header_is_supposed_and_one_without_resemblance_is_left_open(tmp_path):
    path = tmp_path / "times.csv"
    path.write_text("Zeitpnkt;Foo\n1.5;a\n1.25;b\n")
    cells = read_foreign_table_header_and_cells(ForeignTable(path), "frames")
    with pytest.raises(UnclearInput, match="t: likely 'Zeitpnkt'") as error:
        column_indices_by_headers(cells, "frames", TIME, ("t",))
    assert error.value.settings == ("frames.columns.t=Zeitpnkt",) and error.value.is_decided
    with pytest.raises(UnclearInput, match="image: --set 'frames.columns.image=HEADER'") as error:
        column_indices_by_headers(cells, "frames", {"image": ("picture",)}, ("image",))
    assert error.value.settings == () and not error.value.is_decided


def test_one_image_name_with_two_times_needs_its_camera(tmp_path):
    own_data(tmp_path)
    lines = (tmp_path / "bilder.csv").read_text().splitlines()
    later = lines[1].replace("IMG_0001", "IMG_0002")
    (tmp_path / "bilder.csv").write_text("\n".join([lines[0], later, *lines[1:]]) + "\n")
    status, text = run_in_process(*words(tmp_path), "--set", "frames.columns.t=Uhrstand")
    assert status == 1 and "bilder.csv:4: IMG_0002.png has two times; a column camera" in text


@pytest.mark.parametrize(
    "options, says",
    [
        (("--set", "images.tolerance=0.01"), "images.tolerance groups images by their times"),
        (("--set", "commands.steps_per_mm=100", "--set", "commands.unit=mm"), "commands.steps_per_mm is of lengths in"),
    ],
)
def test_an_option_that_nothing_uses_is_refused(tmp_path, options, says):
    own_data(tmp_path)
    named = ("commands.columns.t=Zaehlerstand", *(f"commands.columns.l{i}=Teleskop {i}" for i in range(1, 7)))
    named += ("frames.columns.t=Uhrstand", "images.shift=-37", *(f"images.cameras.{b}={a}" for a, b in FOLDERS.items()))
    stated = [word for setting in named for word in ("--set", setting)]
    status, text = run_in_process(*words(tmp_path), *stated, *options)
    assert status == 1 and says in text and "leave it out" in text
