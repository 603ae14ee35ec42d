"""Pages that commands write: the verdict comes first, nothing leads elsewhere, text stays text, and a figure tells the
values it was drawn from.
"""

import re

import numpy as np
import pytest

from rig.report.pages.html_and_svg_elements import (
    capitalise_unless_name_or_sign,
    figures_with_caption_html,
    inline_html,
    round_ticks,
    svg_text_or_empty_if_too_large,
    table_html,
    text_width,
    wrap_text,
)
from rig.report.pages.image_plane_and_3d_views import Arrows, Cells, Scene, image_plane_figure, view_3d_html
from rig.report.pages.page_templates_and_index_page import Link, Page, page_html
from rig.report.pages.svg_plots import MOST, RIGHT, Series, axis_scale_of_values, bar_chart_svg, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import State, Verdict


def test_a_page_says_its_verdict_first_and_needs_no_network():
    page = page_html(
        Page(
            "measure",
            "Measurement of <rec>",
            Verdict(State.CHECK, "38 of 40 frames solved"),
            ["<p>more</p>"],
            ["Do `rig view REC`"],
            [Link("all pages", "../index.html")],
        )
    )
    body = page[page.index("<body>") :]
    assert re.sub("<[^>]*>", "", body).split()[:5] == ["check", "38", "of", "40", "frames"]
    assert (
        body.index("check")
        < body.index("Measurement of &lt;rec&gt;")
        < body.index("<code>rig view REC</code>")
        < body.index("<p>more</p>")
    )
    assert "default-src 'none'" in page and "://" not in page and '<a href="../index.html">all pages</a>' in page


def test_text_is_text_and_commands_are_marked():
    assert inline_html("a <b> & `rig x <y>`") == "a &lt;b&gt; &amp; <code>rig x &lt;y&gt;</code>"
    made = table_html(("", "name"), [("<i>", 3)])
    assert "<i>" not in made and "<th scope" in made and made.count("<td></td>") == 1 and 'tabindex="0"' in made


def test_columns_of_text_begin_at_their_left_and_lengths_are_in_micrometres():
    made = table_html(("kind", "size, um", "note"), [("a", "not known", "x"), ("b", 3.5, "y"), ("c", "-2", "")])
    assert made.count('<td class="text">') == 6 and made.count("<td>") == 3 and "size, µm" in made and " um" not in made
    assert (
        inline_html("5 um and 3 urad, `--tolerance 5 um`") == "5 µm and 3 µrad, <code>--tolerance 5 um</code>"
        and inline_html("sum um/m") == "sum µm/m"
    )
    assert inline_html("1 -> 2 +- 3 m/s^2 <= 4, `a -> b`, x-1, p->q") == (
        "1 → 2 ± 3 m/s² ≤ 4, <code>a -&gt; b</code>, x-1, p-&gt;q"
    )
    assert (
        capitalise_unless_name_or_sign("the rest") == "The rest"
        and capitalise_unless_name_or_sign("rx turns") == "Rx turns"
        and capitalise_unless_name_or_sign("3 of") == "3 of"
        and capitalise_unless_name_or_sign("cam0 is") == "cam0 is"
    )


def test_the_headline_is_the_first_clause_and_doubts_follow_as_a_list():
    why = "3 times better (mean 1; most 2) here: 2 -> 1 mm; the model omits <play>; and more"
    page = page_html(Page("verify", "t", Verdict(State.CHECK, why), [figures_with_caption_html("<svg/>", "a um")]))
    assert "</strong> 3 times better (mean 1; most 2) here: 2 → 1 mm.</p>" in page
    assert "<ul><li>The model omits &lt;play&gt;</li><li>And more</li></ul>" in page
    assert '<figure class="plots"><svg/><figcaption>a µm</figcaption></figure>' in page
    alone = page_html(Page("verify", "t", Verdict(State.GOOD, "all is well"), []))
    assert '<div class="doubts">' not in alone and "All is well.</p>" in alone


def test_words_stay_within_their_figure():
    label = "travel since the last reversal (negative: inward), mm"
    lines = wrap_text(label, 14, 340)
    assert " ".join(lines) == label and len(lines) == 2 and all(text_width(line, 14) <= 340 for line in lines)
    drawn = plot_panel_svg("t", (label, "y"), [Series(np.arange(3.0), np.arange(3.0))])
    assert all(f">{line}</text>" in drawn for line in lines) and text_width(lines[0], 14) < RIGHT
    assert (
        "1234" in svg_text_or_empty_if_too_large((0, 0, 60, 20), "1234")
        and svg_text_or_empty_if_too_large((0, 0, 20, 20), "1234")
        == svg_text_or_empty_if_too_large((0, 0, 60, 9), "1234")
        == ""
    )


def test_whole_numbers_have_whole_ticks():
    assert (
        axis_scale_of_values(np.array([1.0]), (0, 1), are_whole_numbers=True).ticks == [1.0]
        and 1.2 in axis_scale_of_values(np.array([1.0]), (0, 1)).ticks
    )
    assert ">1.5</text>" not in plot_panel_svg(
        "t", ("visit", "y"), [Series(np.array([1.0, 2.0]), np.array([0.1, 0.7]))]
    )


def places(svg):
    """(n, 2) places of the dots of a figure, and its scales: [(low, high, start, end, whether log)] of x and y."""
    scales = [
        (*map(float, scale_text.split()[:4]), scale_text.endswith("log"))
        for scale_text in re.findall(r'data-[xy]="([^"]*)"', svg)
    ]
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
    at, (across, up) = places(plot_panel_svg("t", ("x", "y"), [Series(x, y)], log=log))
    assert np.allclose(values(at[:, 0], across), x, atol=0.002 * 12)
    assert (
        np.allclose(np.log(values(at[:, 1], up)), np.log(y), atol=0.02)
        if log
        else np.allclose(values(at[:, 1], up), y, atol=0.06)
    )


def test_what_is_not_known_is_not_drawn_and_many_are_thinned():
    x = np.arange(5.0)
    at, _ = places(plot_panel_svg("t", ("x", "y"), [Series(x, np.array([1.0, np.nan, 0.0, -2.0, 3.0]))], log=True))
    assert len(at) == 2
    many = np.arange(3.0 * MOST)
    assert len(places(plot_panel_svg("t", ("x", "y"), [Series(many, many)]))[0]) == MOST


def test_ticks_are_round_few_and_within():
    for low, high in ((0, 1), (-3.2, 17.1), (1e-7, 4e-6), (441.3, 523.8), (0, 0.999)):
        found = round_ticks(low, high)
        assert 2 <= len(found) <= 5 and min(found) >= low - 1e-12 and max(found) <= high + 1e-12
    with pytest.raises(ValueError, match="range"):
        round_ticks(1.0, 1.0)
    assert (
        axis_scale_of_values(np.array([2.0, 2.0]), (0, 1)).low < 2 < axis_scale_of_values(np.zeros(0), (0, 1)).high * 3
    )


def test_bars_and_cells_say_their_values():
    drawn = bar_chart_svg("b", ["one", "two"], [("before", [1.0, np.nan], 0), ("noise", [0.5, 0.5], -1)], "px", ["two"])
    assert 'class="fill grey"' in drawn and 'class="fill c0"' in drawn
    assert "<title>one, before: 1 px</title>" in drawn and 'class="name" x=' in drawn
    plane = image_plane_figure(
        "p",
        "below",
        (100, 50),
        (
            Cells(np.array([[10.0, 10.0]]), np.array([0.25]), 5.0, "px"),
            Arrows(np.array([[50.0, 25.0]]), np.array([[0.1, 0.0]]), 100.0, "px"),
        ),
    )
    start, along = re.search(r'd="M([\d.]+) [\d.]+l([\d.]+) ', plane).groups()
    enlarged = float(re.search(r'data-enlarged="([\d.]+)"', plane)[1])
    assert "<title>0.25 px</title>" in plane and float(along) / enlarged == pytest.approx(0.1, abs=1e-3)
    edge = image_plane_figure("p", "below", (100, 50), (Cells(np.array([[0.0, 49.0]]), np.array([0.25]), 20.0, "px"),))
    frame, cell = (
        [float(v) for v in re.findall(r' (?:x|y|width|height)="([-\d.]+)"', rect)]
        for rect in re.findall("<rect[^>]*>", edge)
    )
    assert cell[0] >= frame[0] and cell[1] + cell[3] <= frame[1] + frame[3] + 0.1, "a cell at the edge is cut off there"
    assert float(start) == pytest.approx(4 + 50.5 * 392 / 100, abs=0.06)


@pytest.mark.parametrize("machine", ["hexapod", "arm"])
def test_a_view_in_three_dimensions_says_what_is_seen(machine):
    poses, joints = np.zeros((3, 6)), np.arange(18.0).reshape(6, 3)
    face = {"kind": "face", "points": joints[:4]}
    struts = {"base": joints, "platform": joints, "ends": joints, "errors": {"corrected": poses}}
    shown = struts if machine == "hexapod" else {"links": np.zeros((3, 7, 3))}
    page = "".join(view_3d_html(Scene(np.arange(3), poses, [face], [], [0, 0, 0], 1.0, **shown)))
    caption = re.search("<figcaption>(.*)</figcaption>", page)[1]
    assert "at 3 poses" in caption and "squares are the markers" in caption and "pyramids" not in caption
    assert ("the struts" in caption and "at the platform joints" in caption) == (machine == "hexapod")
    assert ("bent line is the arm" in caption and "axes of the measured body" in caption) == (machine == "arm")
