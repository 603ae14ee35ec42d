"""Folders and columns by their owner's words, ISO times alone, an empty image and one that is missing: what is refused
says what helps.
"""

from datetime import UTC, datetime, timedelta
from decimal import Decimal

import cv2
import numpy as np

from rig.formats.rig_toml import design_from_rig_toml
from rig.recording import recording_folder
from tests.calib.checks.test_mistakes import run_in_process

CAMERAS = {"cam0": "Kamera links", "cam1": "Kamera rechts"}
START = datetime(2026, 3, 1, 9, tzinfo=UTC)


def theirs(folder, design, count=4):
    """Images and tables as somebody has them; the last image of cam1 is empty, the second of cam0 is named and not
    there.
    """
    lines = ["Bild;Zeit"]
    for ours, name in CAMERAS.items():
        camera = design.camera(ours)
        (folder / "Bilder Größe A" / name).mkdir(parents=True)
        for k in range(count):
            image = f"{name}/Aufnahme Prüfung {k + 1}.png"
            lines.append(f"{image};{(START + timedelta(seconds=5 * k)).isoformat(timespec='milliseconds')}")
            data = cv2.imencode(".png", np.full((camera.height, camera.width), 40, np.uint8))[1].tobytes()
            if (ours, k) != ("cam0", 1):
                (folder / "Bilder Größe A" / image).write_bytes(b"" if (ours, k) == ("cam1", count - 1) else data)
    (folder / "Bilder.csv").write_text("\n".join(lines), encoding="cp1252")


def test_an_owners_own_words(good, tmp_path):
    theirs(tmp_path, design_from_rig_toml.load_design(good / "rig.toml"))
    made = [
        "import",
        tmp_path / "Bilder Größe A",
        "--rig",
        good / "rig.toml",
        "--frames",
        tmp_path / "Bilder.csv",
        "--out",
        tmp_path / "rec",
    ]
    status, text = run_in_process(*made)
    assert (
        status == 1 and "--set 'images.cameras.Kamera links=cam0' --set 'images.cameras.Kamera rechts=cam1'" in text
    ), text
    made += ["--set", "images.cameras.Kamera links=cam0", "--set", "images.cameras.Kamera rechts=cam1"]
    status, text = run_in_process(*made)
    assert status == 1 and "Aufnahme Prüfung 4.png: is an empty file (--skip-unreadable" in text, text
    status, text = run_in_process(*made, "--skip-unreadable")
    assert status == 0 and "left out: " in text, text
    assert "Bilder.csv names images that are not there, 1 of 8: Kamera links/Aufnahme Prüfung 2.png" in text, text
    found = recording_folder.load_recording(tmp_path / "rec")
    assert list(zip(found.exposures.frame.tolist(), found.exposures.camera)) == [
        (1, "cam0"),
        (1, "cam1"),
        (2, "cam1"),
        (3, "cam0"),
        (3, "cam1"),
        (4, "cam0"),
    ]
    assert found.exposures.times()[1].tolist() == [0.0, 5.0, 10.0, 15.0]


def test_a_shift_of_images_moves_the_times_that_a_table_gives_them(good, tmp_path):
    theirs(tmp_path, design_from_rig_toml.load_design(good / "rig.toml"))
    made = [
        "import",
        tmp_path / "Bilder Größe A",
        "--rig",
        good / "rig.toml",
        "--frames",
        tmp_path / "Bilder.csv",
        "--skip-unreadable",
        "--set",
        "images.cameras.Kamera links=cam0",
        "--set",
        "images.cameras.Kamera rechts=cam1",
    ]
    assert run_in_process(*made, "--out", tmp_path / "as they are")[0] == 0
    for setting in ("images.shift=37.4", "frames.shift=37.4"):
        status, text = run_in_process(*made, "--set", setting, "--out", tmp_path / setting)
        assert status == 0, text
        stated, moved = (
            Decimal((tmp_path / name / "frames.csv").read_text().splitlines()[1].split(",")[1])
            for name in ("as they are", setting)
        )
        assert moved - stated == Decimal("37.4")
    status, text = run_in_process(
        *made, "--set", "images.shift=1", "--set", "frames.shift=2", "--out", tmp_path / "both"
    )
    assert status == 1 and "both move the times of Bilder.csv; state one" in text
