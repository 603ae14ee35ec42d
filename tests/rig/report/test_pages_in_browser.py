"""Every kind of page in headless Chromium: wide and narrow, light and dark, no error, nothing cut off, names and
contrast as axe-core asks.

It takes Chromium and the extra `browser` (playwright, axe-core-python); RIG_SCREENSHOTS=FOLDER keeps a picture of every
page.
"""

import os
import time
from pathlib import Path

import numpy as np
import pytest

from docs.make import project
from rig.report.pages.run_page_server import PageServer
from tests.rig.report.made_pages import write_made_pages
from tests.rig.report.pages.test_run_page_server import EVENT
from vision.measured_frame_drawings_and_frame_jpegs import encode_jpeg_reduced_to_page_width

pytestmark = pytest.mark.slow
KINDS = (
    "measure",
    "calibrate",
    "diagnose",
    "verify",
    "certify",
    "workspace",
    "online",
    "plan",
    "view",
    "watch",
    "index",
    "insitu",
    "blind",
    "investigate",
    "lens",
    "run",
)
WIDTHS = (400, 800, 1400)
LARGEST, READY = 6e6, 2.0  # bytes of a page, s until it answers
PAPER = 718  # px, width of A4 between its margins
READABLE = 10.5  # px, least height of a figure's letters on a narrow page


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """{kind: path} of pages as the commands write them; of those that take long to come to, as their writers do."""
    at = tmp_path_factory.mktemp("project") / "project"
    pages = project.quick(at)
    return pages | write_made_pages(at)


@pytest.fixture(scope="module")
def served():
    """The address of a run's page."""
    server = PageServer(lambda: None)
    server.show(
        lambda: {**EVENT, "alarms": []},
        {"cam0": lambda: encode_jpeg_reduced_to_page_width(np.full((48, 64), 90, np.uint8))},
    )
    yield server.url
    server.close()


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_is_seen_by_everybody(kind, written, served, browser, axe):
    address = served if kind == "run" else written[kind].as_uri()
    if kind != "run":
        assert written[kind].stat().st_size < LARGEST and f'content="rig {kind}"' in written[kind].read_text()
    ready = []
    for width in WIDTHS:
        for scheme in ("light", "dark"):
            context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
            seen = context.new_page()
            wrong = _listened(seen, kind != "run")
            began = time.monotonic()
            seen.goto(address, wait_until="domcontentloaded" if kind == "run" else "load")
            seen.evaluate("1")
            ready.append(time.monotonic() - began)
            if kind == "run":
                seen.wait_for_selector("#pose td")  # of the first event
            _looked_at(seen, kind, width)
            if os.environ.get("RIG_SCREENSHOTS"):
                seen.screenshot(
                    path=Path(os.environ["RIG_SCREENSHOTS"]) / f"{kind}-{width}-{scheme}.png", full_page=True
                )
            seen.evaluate(axe)
            found = seen.evaluate("""axe.run({resultTypes: ["violations"]}).then(done => done.violations.map(
                v => [v.id, v.nodes[0].html, v.nodes[0].failureSummary]))""")
            assert found == [] and wrong == [], (width, scheme)
            context.close()
    assert min(ready) < READY, ready  # of six: what else the machine does is not the page's


def _listened(seen, offline):
    """What goes wrong in a page from now on. offline : whether asking any network is wrong"""
    wrong = []
    seen.on("console", lambda message: wrong.append(message.text) if message.type in ("error", "warning") else None)
    seen.on("pageerror", lambda error: wrong.append(str(error)))
    seen.on(
        "request", lambda request: wrong.append(request.url) if offline and request.url.startswith("http") else None
    )
    return wrong


def _looked_at(seen, kind, width):
    """Nothing is cut off, the verdict is what is read first, and a figure's letters are as large as letters."""
    assert seen.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0, (kind, width)
    first = seen.evaluate("document.body.innerText.trim().split(/\\s+/)[0].toLowerCase()")
    assert first in ("good", "check", "bad"), (kind, first)
    least = seen.evaluate("""Math.min(99, ...[...document.querySelectorAll("svg.figure")].filter(f => \
f.checkVisibility()).flatMap(f =>
        [...f.querySelectorAll("text")].map(t => parseFloat(getComputedStyle(t).fontSize) * \
f.getBoundingClientRect().width / 400)))""")
    assert least >= READABLE, (kind, width)


def test_the_stop_button_of_a_narrow_page_is_as_high_as_a_thumb(served, browser):
    """44 CSS px, of WCAG 2.5.5."""
    seen = browser.new_page(viewport={"width": 400, "height": 900})
    seen.goto(served, wait_until="domcontentloaded")
    seen.wait_for_selector("#pose td")
    for button in ("#stop", "#ask button", "#reading"):
        assert seen.evaluate(f"document.querySelector('{button}').getBoundingClientRect().height") >= 44, button
    seen.close()


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "run"])
def test_a_printed_page_shows_all_of_its_tables(kind, written, browser):
    """On paper nothing can be scrolled."""
    seen = browser.new_page(viewport={"width": PAPER, "height": 1000})
    seen.emulate_media(media="print")
    seen.goto(written[kind].as_uri())
    cut = seen.evaluate("""[...document.querySelectorAll("table")].filter(t => t.checkVisibility() &&
        t.getBoundingClientRect().right > innerWidth + 1).map(t => t.innerText.slice(0, 80))""")
    assert cut == [] and seen.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    seen.close()


def test_a_view_is_played_and_a_figure_says_its_values(written, browser):
    seen = browser.new_page()
    seen.goto(written["view"].as_uri())
    before = seen.evaluate("document.getElementById('stage-view').toDataURL()")
    for name, value in (("size", "1"), ("much", "3")):
        seen.evaluate(
            f"{{const s = document.getElementById('stage-{name}'); s.value = {value}; s.dispatchEvent(new "
            f"Event('input'))}}"
        )
    assert seen.evaluate("document.getElementById('stage-view').toDataURL()") != before
    assert seen.inner_text("#stage-said") == "gap 800 µm" and seen.inner_text("#stage-times") == "1000 times"
    assert seen.inner_text("#stage-number").startswith("frame 0")
    seen.click("#stage-play")
    end = time.monotonic() + 30
    while (
        int(seen.evaluate("document.getElementById('stage-frame').value")) == 0
    ):  # the page allows no eval, by which playwright would wait
        assert time.monotonic() < end
    seen.goto(written["online"].as_uri())
    place = seen.evaluate("""(() => {const path = document.querySelector(".valued"), f = path.closest("svg");
        f.scrollIntoView({block: "center"});
        const [x, y] = path.getAttribute("d").match(/M([\\d.]+) ([\\d.]+)/).slice(1).map(Number);
        const at = new DOMPoint(x, y).matrixTransform(f.getScreenCTM()); return [at.x, at.y]})()""")
    seen.mouse.move(*place)
    assert seen.inner_text("#told").startswith("frame ") and "standard deviations" in seen.inner_text("#told")
    seen.close()
