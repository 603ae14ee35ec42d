"""A further effect is one file and one line: simulated, asked for, drawn, said and in the catalogue, for every kind of
machine.
"""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from tests.conftest import ROOT

TOY = '''"""An axis sticks out by a constant that changes sign with the day's half."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Motion, Parameter
from rig.effects.framework.parameters_covariates_and_marker_table import Covariate


@dataclass(frozen=True, slots=True)
class ToyTide(Effect):
    """Deviation height * sin(2 pi t / 600 s)."""

    place: str
    height: float = 0.0
    name: ClassVar = "toy_tide"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (Parameter("height", "m", (-0.1, 0.1), (1e-5, 1e-3), signed=True, joint=((-0.5, 0.5), \
(1e-4, 1e-2))),)
    experiment: ClassVar = "wait for the tide"
    action: ClassVar = "Move the {axis} inland."

    def deviation(self, motion: Motion) -> np.ndarray:
        return self.axes(motion.places) * self.height * np.sin(2 * np.pi * motion.t / 600)[:, None]

    def covariate(self, motion: Motion) -> Covariate:
        return Covariate(motion.t / 600 % 1, "tide, turns")
'''
RIGS = {
    "planar2": '[mechanism]\nkind = "planar2"\nbase_joints = [[0.0, 0.0], [1.0, '
    "0.0]]\nstrut_range = [[0.6, 1.2], [0.6, "
    "1.2]]\n",
    "arm": '[mechanism]\nkind = "arm"\njoints = [[0.0, 0.13, 0.0, 1.5708], [0.0, 0.0, -0.61, 0.0], [0.0, 0.0, '
    "-0.57, 0.0], [0.0, 0.16, 0.0, "
    "1.5708], "
    "[0.0, 0.12, 0.0, -1.5708], [0.0, 0.09, 0.0, 0.0]]\nlimits = [[-2.5, 2.5], [-2.5, 2.5], [-2.5, 2.5], "
    "[-2.5, 2.5], [-2.5, 2.5], [-2.5, "
    "2.5]]\n",
}
INSTRUMENT = '[instrument]\nbase = "{0}"\ntool = "{0}"\nposition_sigma = 2e-5\nrotation_sigma = 1e-4\n'
PLACES = {"hexapod": ("strut 2", "2e-4"), "planar2": ("strut 2", "2e-4"), "arm": ("joint 2", "2e-3")}


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    """The folder of a copy of the project with a toy among its effects: one file, one line."""
    root = tmp_path_factory.mktemp("house")
    for package in ("rig", "vision", "calib", "synthetic"):
        shutil.copytree(ROOT / package, root / package)
    (root / "rig" / "effects" / "catalogue" / "toy_tide.py").write_text(TOY)
    catalogue = root / "rig" / "effects" / "catalogue" / "effect_list.py"
    text = catalogue.read_text()
    line = "from rig.effects.catalogue.toy_tide import ToyTide\nALL: tuple[type[Effect], ...] = (\n    ToyTide,\n"
    assert text.count("ALL: tuple[type[Effect], ...] = (\n") == 1
    catalogue.write_text(text.replace("ALL: tuple[type[Effect], ...] = (\n", line))
    return root


def rig(house, *words):
    """What `rig` of the house writes to its standard output; words : of its command line."""
    code = "import sys; from rig.cli.command_line import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *map(str, words)],
        capture_output=True,
        text=True,
        cwd=house,
        env={**os.environ, "PYTHONPATH": str(house)},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def recorded(house, kind):
    """A recording of a machine of a kind with the toy at its second axis."""
    folder = house / kind
    folder.mkdir(exist_ok=True)
    text = (
        hexapod_layout_rig_toml(0.3)
        if kind == "hexapod"
        else 'schema = "rig/1"\n' + RIGS[kind] + INSTRUMENT.format("free" if kind == "arm" else "rig")
    )
    (folder / "rig.toml").write_text(text)
    place, height = PLACES[kind]
    rig(
        house,
        "simulate",
        folder / "rig.toml",
        "--plan",
        "sobol:100",
        "--effect",
        f"toy_tide:{place}:height={height}",
        "--out",
        folder / "rec",
        "--truth",
        folder / "truth.json",
    )
    return folder


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind == "hexapod" else kind for kind in PLACES]
)
def test_it_is_simulated(house, kind):
    folder = recorded(house, kind)
    truth = json.loads((folder / "truth.json").read_text())
    assert [(e["effect"], e["place"]) for e in truth["effects"]] == [("toy_tide", PLACES[kind][0])]
    assert ((folder / "rec" / "poses.csv").exists()) == (kind != "hexapod") and np.isfinite(truth["poses"]).all()
    shutil.rmtree(folder)


@pytest.mark.slow
def test_it_is_in_the_catalogue(house):
    output = rig(house, "catalogue")
    assert "### toy_tide" in output and "wait for the tide" in output


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hexapod", "planar2", "arm"])
def test_it_is_diagnosed_reported_and_plotted(house, kind):
    folder = recorded(house, kind)
    rig(house, "diagnose", folder / "rec", "--only", "toy_tide", "--out", folder / "found")
    found = json.loads((folder / "found" / "diagnosis.json").read_text())["findings"]
    assert [(f["effect"], f["place"]) for f in found] == [("toy_tide", PLACES[kind][0])]
    height = found[0]["parameters"]["height"]
    assert height["ci95"][0] < float(PLACES[kind][1]) < height["ci95"][1] and height["unit"] == (
        "rad" if kind == "arm" else "m"
    )
    page = (folder / "found" / "diagnosis.html").read_text()
    assert "oy tide" in page and f"Move the {PLACES[kind][0].split()[0]} inland." in page
