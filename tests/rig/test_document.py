"""Pages that commands write: the verdict comes first, nothing leads elsewhere, text stays text, and a figure tells the values it was drawn from."""

import re

import numpy as np
import pytest

from rig.page.document import Link, Page, State, Verdict, text
from rig.page.figure import MOST, Series, bars, panel
from rig.page.parts import table, words
from rig.page.plane import Arrows, Cells, image_plane
from rig.page.scale import around
from rig.page.svg import ticks


def test_a_page_says_its_verdict_first_and_needs_no_network():
    page = text(Page("measure", "Measurement of <rec>", Verdict(State.CHECK, "38 of 40 frames solved"), ["<p>more</p>"],
                     ["Do `rig view REC`"], [Link("all pages", "../index.html")]))
    body = page[page.index("<body>"):]
    assert re.sub("<[^>]*>", "", body).split()[:5] == ["check", "38", "of", "40", "frames"]
    assert body.index("check") < body.index("Measurement of &lt;rec&gt;") < body.index("<code>rig view REC</code>") < body.index("<p>more</p>")
    assert "default-src 'none'" in page and "://" not in page and '<a href="../index.html">all pages</a>' in page


def test_text_is_text_and_commands_are_marked():
    assert words("a <b> & `rig x <y>`") == "a &lt;b&gt; &amp; <code>rig x &lt;y&gt;</code>"
    made = table(("", "name"), [("<i>", 3)])
    assert "<i>" not in made and "<th scope" in made and made.count("<td></td>") == 1 and 'tabindex="0"' in made


def places(svg):
    """(n, 2) places of the dots of a figure, and its scales: [(low, high, start, end, whether log)] of x and y."""
    scales = [(*map(float, said.split()[:4]), said.endswith("log")) for said in re.findall(r'data-[xy]="([^"]*)"', svg)]
    return np.array([[float(v) for v in pair] for pair in re.findall(r"M([-\d.]+) ([-\d.]+)h\.01", svg)]), scales


def values(at, scale):
    """What the page's script reads off places (n,)."""
    low, high, start, end, log = scale
    part = (at - start) / (end - start)
    return low * (high / low) ** part if log else low + (high - low) * part


@pytest.mark.parametrize("log", [False, True])
def test_a_figure_tells_the_values_it_was_drawn_from(log):
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-5, 7, 40), 10 ** rng.uniform(-3, 1, 40)
    at, (across, up) = places(panel("t", ("x", "y"), [Series(x, y)], log=log))
    assert np.allclose(values(at[:, 0], across), x, atol=0.002 * 12)
    assert np.allclose(np.log(values(at[:, 1], up)), np.log(y), atol=0.02) if log else np.allclose(values(at[:, 1], up), y, atol=0.06)


def test_what_is_not_known_is_not_drawn_and_many_are_thinned():
    x = np.arange(5.0)
    at, _ = places(panel("t", ("x", "y"), [Series(x, np.array([1.0, np.nan, 0.0, -2.0, 3.0]))], log=True))
    assert len(at) == 2
    many = np.arange(3.0 * MOST)
    assert len(places(panel("t", ("x", "y"), [Series(many, many)]))[0]) == MOST


def test_ticks_are_round_few_and_within():
    for low, high in ((0, 1), (-3.2, 17.1), (1e-7, 4e-6), (441.3, 523.8), (0, 0.999)):
        found = ticks(low, high)
        assert 2 <= len(found) <= 5 and min(found) >= low - 1e-12 and max(found) <= high + 1e-12
    with pytest.raises(ValueError, match="range"):
        ticks(1.0, 1.0)
    assert around(np.array([2.0, 2.0]), (0, 1)).low < 2 < around(np.zeros(0), (0, 1)).high * 3


def test_bars_and_cells_say_their_values():
    drawn = bars("b", ["one", "two"], [("before", [1.0, np.nan], 0), ("noise", [0.5, 0.5], -1)], "px", ["two"])
    assert 'class="fill grey"' in drawn and 'class="fill c0"' in drawn
    assert "<title>one, before: 1 px</title>" in drawn and 'class="name" x=' in drawn
    plane = image_plane("p", "below", (100, 50), (Cells(np.array([[10.0, 10.0]]), np.array([0.25]), 5.0, "px"),
                                                  Arrows(np.array([[50.0, 25.0]]), np.array([[0.1, 0.0]]), 100.0, "px")))
    start, along = re.search(r'd="M([\d.]+) [\d.]+l([\d.]+) ', plane).groups()
    enlarged = float(re.search(r'data-enlarged="([\d.]+)"', plane)[1])
    assert "<title>0.25 px</title>" in plane and float(along) / enlarged == pytest.approx(0.1, abs=1e-3)
    assert float(start) == pytest.approx(4 + 50.5 * 392 / 100, abs=0.06)
