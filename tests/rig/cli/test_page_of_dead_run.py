"""The page of a real run, in headless Chromium: that the run was killed, or hangs, is said within 2 s.

It takes Chromium and the extra `browser` (playwright).
"""

import contextlib
import os
import re
import signal
import time

import pytest

from tests.emulated_run import EmulatedRig, runner

pytestmark = pytest.mark.slow
WITHIN = 2.0  # s from the signal to the word
REPEATS = 3  # of which the best counts: what else the machine does is not the page's

# when the page first shows that the run is dead, s since 1970
WATCH = """() => { globalThis.died = 0; const state = document.getElementById("state");
  const look = () => { if (!globalThis.died && state.textContent === "dead") globalThis.died = Date.now() / 1e3; };
  new MutationObserver(look).observe(state, { childList: true, characterData: true, subtree: true }); }"""


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    made = EmulatedRig(tmp_path_factory.mktemp("dead"))
    yield made.folder / "rig.toml"
    made.close()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hangs"])
def test_the_page_says_dead_within_two_seconds(how, rig, browser, tmp_path):
    times = [_seconds_until_dead(how, rig, browser, tmp_path / str(k)) for k in range(REPEATS)]
    assert min(times) < WITHIN, times


def _seconds_until_dead(how, rig, browser, folder):
    """s from a signal that a run under way gets to the word on its page."""
    folder.mkdir()
    log = folder / "log"
    words = ("--plan", "sobol:40", "--settle", "time:3", "--no-cameras", "--page", "--out", str(folder / "rec"))
    process = runner(["run", str(rig), *words], log)
    seen = browser.new_page()
    try:
        while not (log.exists() and (found := re.search(r"http://127\S+", log.read_text()))):
            assert process.is_alive(), log.read_text()
            process.join(0.02)
        seen.goto(found[0], wait_until="domcontentloaded")
        _wait(lambda: re.search(r"step [1-9]", seen.inner_text("#far")))
        seen.evaluate(WATCH)
        sent = time.time()
        os.kill(process.pid, how)
        _wait(lambda: seen.evaluate("globalThis.died"))
        assert seen.inner_text("#activity").lower() == "dead" and seen.is_disabled("#stop")
        assert "left" not in seen.inner_text("#far") and "rig stop" in seen.inner_text("#phase")
        return seen.evaluate("globalThis.died") - sent
    finally:
        seen.close()
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)
        process.join()


def _wait(happened):
    """Return once it has; the page allows no eval, by which playwright would wait."""
    end = time.monotonic() + 60
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.02)
