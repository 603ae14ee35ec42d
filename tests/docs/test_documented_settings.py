"""What rig.toml may state of controllers, cameras and sensors stands in the pages, key by key."""

import re
from dataclasses import fields
from pathlib import Path

import pytest

from rig.model.design import PROTOCOLS, Camera, Controller, SensorPort

DOCS = Path(__file__).parents[2] / "docs"


def block(page, table):
    """The indented lines that begin with a [table], up to the next one or the first line that is not indented."""
    found = re.search(rf"^    \[+{table}\]+.*\n((?:    (?!\[).*\n)*)", (DOCS / page).read_text(), re.MULTILINE)
    return found[1] if found else ""


@pytest.mark.parametrize(
    "page, table, kind",
    [
        ("controllers.md", "controller", Controller),
        ("operating.md", "camera", Camera),
        ("operating.md", "sensors", SensorPort),
    ],
)
def test_every_key_is_in_the_pages(page, table, kind):
    text = block(page, table)
    assert text and [field.name for field in fields(kind) if not re.search(rf"\b{field.name}\b", text)] == []


def test_no_key_of_a_controller_is_made_up_and_every_protocol_is_told_of():
    text = block("controllers.md", "controller")
    stated = set(re.findall(r"(?:^    |; )(\w+) = ", text, re.MULTILINE))
    assert stated == {field.name for field in fields(Controller)} and all(
        re.search(rf"\b{name}\b", text) for name in PROTOCOLS
    )
