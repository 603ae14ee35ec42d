"""Pages of the site in headless Chromium: nothing cut off, names and contrast as axe-core asks, whole on paper."""

import functools
import http.server
import threading

import pytest

pytestmark = pytest.mark.slow
PAGES = ("index", "tutorial-simulated", "gallery", "validation", "mathematics", "commands", "dependencies")
PAPER = 718  # px, width of A4 between its margins
LATE = 300  # ms that the theme's own scripts take


class Quiet(http.server.SimpleHTTPRequestHandler):
    """A server of files that says nothing of it."""

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def address(site):
    """Where the site is served: its search needs that."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=site))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 800, 1400])
@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_read_by_everybody(page, width, scheme, address, browser, axe):
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    seen = context.new_page()
    seen.goto(f"{address}/{page}.html")
    seen.wait_for_timeout(LATE)
    assert seen.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    seen.evaluate(axe)
    found = seen.evaluate("""axe.run({resultTypes: ["violations"]}).then(done => done.violations.map(
        v => [v.id, v.nodes[0].html, v.nodes[0].failureSummary]))""")
    context.close()
    assert found == []


@pytest.mark.parametrize("page", PAGES)
def test_a_printed_page_shows_all_of_its_tables_and_commands(page, address, browser):
    seen = browser.new_page(viewport={"width": PAPER, "height": 1000})
    seen.emulate_media(media="print")
    seen.goto(f"{address}/{page}.html")
    cut = seen.evaluate("""[...document.querySelectorAll("table, pre")].filter(t => t.checkVisibility() &&
        t.getBoundingClientRect().right > innerWidth + 1).map(t => t.innerText.slice(0, 80))""")
    seen.close()
    assert cut == []
