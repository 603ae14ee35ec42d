"""Sketches of effects: every one has one, its own model draws it, and the document keeps them current."""

import re
from dataclasses import dataclass
from typing import ClassVar
from xml.etree import ElementTree

import numpy as np
import pytest

from calib.report.pose_and_effect_figures import effect_sketch
from rig.cli.command_line import main
from rig.effects.catalogue.backlash import Backlash
from rig.effects.catalogue.effect_list import ALL
from rig.effects.catalogue.scale_error import ScaleError
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.parameters_covariates_and_marker_table import Parameter
from rig.effects.sketches.motion_effect_sketches import Sketch
from rig.errors import RigError
from rig.report.pages.page_templates_and_index_page import standalone_svg
from tests.conftest import ROOT

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
WITHOUT_SIZE = {"marker_swap"}  # faces are exchanged or they are not
DOCUMENTS = ROOT / "docs"


@pytest.fixture(scope="module")
def sketches():
    return {kind.name: (effect_sketch(kind), effect_sketch(kind, 0.5)) for kind in ALL}


def picture(sketch: Sketch) -> str:
    return standalone_svg("what it does", sketch.words, sketch.figures)


def plotted(figure: str) -> np.ndarray:
    """(n, 2) values of a figure's dots."""
    (low, high, start, end), (bottom, top, below, above) = (
        map(float, re.search(rf'data-{axis}="([^"]*)"', figure)[1].split()) for axis in "xy"
    )
    at = np.array(
        re.search(r'class="dots c1 valued" d="([^"]*)"', figure)[1]
        .replace("h.01", "")
        .removeprefix("M")
        .replace("M", " ")
        .split(),
        float,
    )
    x, y = at.reshape(-1, 2).T
    return np.stack(
        [low + (high - low) * (x - start) / (end - start), bottom + (top - bottom) * (y - below) / (above - below)],
        axis=1,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", [kind.name for kind in ALL])
def test_every_effect_has_a_sketch_that_follows_its_size(name, sketches):
    whole, half = sketches[name]
    root = ElementTree.fromstring(picture(whole))
    assert root.tag.endswith("svg") and "prefers-color-scheme: dark" in picture(whole) and len(picture(whole)) < 30_000
    drawn_lines = {
        path.get("d")
        for path in root.iter("{http://www.w3.org/2000/svg}path")
        if "c1" in (path.get("class") or "").split()
    }
    assert any(len(d) > 20 for d in drawn_lines), name
    assert (picture(whole) == picture(half)) is (name in WITHOUT_SIZE)


@pytest.mark.parametrize("factor", [1.0, 0.25])
def test_what_is_drawn_is_what_the_model_says(factor):
    commanded = plotted(
        effect_sketch(ScaleError, factor).figures[1]
    )  # µm over mm: a scale of 1e-3 is one over the other
    assert len(commanded) > 300 and np.ptp(commanded[:, 0]) == pytest.approx(40, abs=0.5)
    np.testing.assert_allclose(commanded[:, 1], factor * commanded[:, 0], atol=0.2 * factor)
    steps = plotted(effect_sketch(Backlash, factor).figures[1])
    far = steps[np.abs(steps[:, 0]) > 1]  # beyond a gap of 0.2 mm
    np.testing.assert_allclose(far[:, 1], -np.sign(far[:, 0]) * 100 * factor, atol=1.5)


@dataclass(frozen=True, slots=True)
class Curved(Effect):
    """Deviation bend * q^2."""

    place: str
    bend: float = 0.0
    name: ClassVar = "curved"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (Parameter("bend", "1/m", (-10, 10), (0.01, 0.5)),)

    def deviation(self, motion):
        return self.axes(motion.places) * self.bend * motion.stroke**2


def test_an_effect_that_nobody_knew_has_one_too():
    sketch = effect_sketch(Curved)
    assert sketch.words == "strut 3, bend 0.5 1/m"
    np.testing.assert_allclose(plotted(sketch.figures[1])[:, 1].max(), 0.5 * 0.02**2 * 1e6, rtol=0.02)


class Elsewhere(Curved):
    """The same where no hexapod can have it."""

    def needs(self, motion):
        return "takes an arm"


def test_one_that_the_rig_of_sketches_cannot_have_says_why():
    with pytest.raises(RigError, match="curved takes an arm"):
        effect_sketch(Elsewhere)


def test_the_document_of_the_catalogue_is_current(tmp_path):
    assert main(["catalogue", "--out", str(tmp_path / "effects.md")]) == 0
    remedy = "make docs, or rig effects document --force --out docs/effects.md"
    assert (DOCUMENTS / "effects.md").read_text(encoding="utf-8") == (tmp_path / "effects.md").read_text(
        encoding="utf-8"
    ), remedy
    made, committed = (
        {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.svg")}
        for folder in (tmp_path / "effects", DOCUMENTS / "effects")
    )
    assert set(made) == set(committed) == {f"{kind.name}.svg" for kind in ALL}, remedy
    for name, text in made.items():  # other computers round otherwise
        assert NUMBER.sub("#", text) == NUMBER.sub("#", committed[name]), (name, remedy)
        np.testing.assert_allclose(
            *(np.array(NUMBER.findall(one), float) for one in (text, committed[name])),
            atol=0.2,
            rtol=1e-3,
            err_msg=remedy,
        )
    assert sum(map(len, committed.values())) < 1e6
