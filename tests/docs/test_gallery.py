"""The gallery's scripts run, and print what their page says, but for figures."""

import re

import pytest

from docs.make.gallery import FOLDER, ORDER, PAGE, page, printed, stored

QUICK = ("new_rig", "simulate", "check", "measure")
STATES = {
    "new_rig": 'units = "mm, deg"', "plan": "as precise as evenly spread", "simulate": "backlash at strut 3",
    "check": "lengths are in millimetres", "measure": "10 of 10 frames solved", "calibrate": "good: ",
    "correct": "above its range", "verify": "the claim is kept", "certify": "With 95 % confidence",
    "diagnose": "backlash at strut 3, gap", "watch": "likeliest nut of strut 4", "why": "scale error at joint 2",
}  # fmt: skip
MISS = re.compile(r"(\w+) commands: off by (.*)")


def without_figures(text):
    """A text with # for each number, so that the last digits of another computer do not matter."""
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", text)


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in ORDER])
def test_a_script_prints_what_the_page_says(name):
    now = printed(FOLDER / f"{name}.py")
    assert STATES[name] in now
    assert without_figures(now) == without_figures(stored(PAGE.read_text(encoding="utf-8"))[name])


def test_the_page_shows_every_script_as_it_is_and_all_are_short():
    text = PAGE.read_text(encoding="utf-8")
    assert text == page(stored(text))
    assert sorted(ORDER) == sorted(STATES) == sorted(path.stem for path in FOLDER.glob("*.py"))
    assert max(len((FOLDER / f"{name}.py").read_text().splitlines()) for name in ORDER) < 40
    assert all(STATES[name] in output for name, output in stored(text).items())


def test_the_page_shows_corrected_commands_nearer_the_simulated_truth():
    found = {name: [float(one.split()[0]) for one in rest.split(" mm")[:-1]]
             for name, rest in MISS.findall(stored(PAGE.read_text(encoding="utf-8"))["correct"])}  # fmt: skip
    assert len(found["nominal"]) == 3 and max(found["corrected"]) < 0.1 * min(found["nominal"])
