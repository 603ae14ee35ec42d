"""The commands of docs/tour.md on the real arm's table: errors before and after, on poses kept away."""

import csv
import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tests.cli import RIG
from tests.conftest import ROOT, SHARED
from tests.docs.document_commands import commands, words

PAGE = ROOT / "docs" / "tour.md"
JOINTS = (  # as the dataset names them
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
RUN = ("new", "import", "check", "calibrate", "verify")  # commands of the page that need no file of the reader's own


def write_inputs(folder: Path, rows: slice = slice(None)) -> None:
    """Write data.csv as the dataset's own file has it, ur10.toml as the page shows it, and the page's other data."""
    shutil.copytree(SHARED / "recordings/tumbling-block", folder / "tumbling-block")
    shutil.copytree(SHARED / "photos/charuco", folder / "photos")
    read = [np.genfromtxt(SHARED / "recordings/arm-1" / name, delimiter=",", names=True)
            for name in ("commands.csv", "poses.csv", "frames.csv")]  # fmt: skip
    q = np.array([np.interp(read[2]["t"], read[0]["t"], read[0][f"q{k}"]) for k in range(1, 7)]).T
    turns = Rotation.from_rotvec(np.array([read[1][k] for k in ("rx", "ry", "rz")]).T).as_euler("XYZ", degrees=True)
    place = 1e3 * np.array([read[1][k] for k in "xyz"]).T
    with (folder / "data.csv").open("w", newline="") as file:
        writer = csv.writer(file, delimiter=";")
        writer.writerow([*JOINTS, *(f"measurement_{k}" for k in ("x", "y", "z", "rx", "ry", "rz"))])
        for row in np.column_stack([q, place, turns])[rows]:
            writer.writerow([f"{value:.8g}".replace(".", ",") for value in row])
    recipe = re.search(r"^```toml\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert recipe is not None
    (folder / "ur10.toml").write_text(recipe[1])


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    if not SHARED.is_dir():
        yield "the shared recordings are not beside the project", "skipped", ""
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_inputs(folder)
        printed = {}
        for command in commands(PAGE):
            first, *rest = words(command)
            if first in RUN:
                done = subprocess.run([*RIG, first, *rest], cwd=folder, capture_output=True, text=True, check=True)
                printed[first] = done.stdout
        held = json.loads((folder / "calibration.json").read_text())["held_out"]
    geometry = re.search(r"the geometry alone leaves ([\d.]+) mm mean", printed["calibrate"])
    assert geometry is not None
    for model, mean in (
        ("nominal geometry, tracker and probe placed", 1e3 * held["before"]["mean"][0]),
        ("geometry", float(geometry[1])),
        ("geometry and joint profiles", 1e3 * held["after"]["mean"][0]),
    ):
        yield f"poses 0 to 999, whole stretches held out, {model}: mean position error", f"{mean:.2f} mm", ""
    verdict = printed["verify"].splitlines()[0]
    yield "poses 1000 to 1494: position error, RMS", verdict.partition(": ")[2].partition(";")[0], ""
    yield "poses 1000 to 1494: the claim", verdict.split("; ")[1], ""
