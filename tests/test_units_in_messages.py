"""Messages and lines that state a length or an angle in a unit for people name that unit."""

import ast
import re
from pathlib import Path

from tests.docs.document_commands import ROOT

SCALED = re.compile(r"\* 1000(?:000)?\.0\b|\b1000(?:000)?\.0 \*|\bdegrees\(")  # to mm, um, .. as Python writes it back
UNIT = re.compile(r"\b(?:mm|um|µm|mrad|urad|µrad|ms|deg|degrees(?!\()|hours|GB|\w*units?)\b|°")  # or what holds one
WORDS = 2  # of a message at least; what is shorter is a cell, whose heading has the unit
OTHER = {"GO", "WATCH"}  # of a wire


def words_and_values(message: ast.JoinedStr) -> tuple[str, str]:
    """(fixed text, expressions) of a formatted string."""
    text = " ".join(str(part.value) for part in message.values if isinstance(part, ast.Constant))
    values = [ast.unparse(part.value) for part in message.values if isinstance(part, ast.FormattedValue)]
    return text, " ".join(values)


def unitless(source: str) -> list[str]:
    """The formatted strings of a module that scale a value and name no unit."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.JoinedStr):
            continue
        text, values = words_and_values(node)
        words = re.findall(r"[A-Za-z]{2,}", text)
        if (
            SCALED.search(values)
            and len(words) >= WORDS
            and words[0] not in OTHER
            and not UNIT.search(f"{text} {values}")
        ):
            found.append(f"{node.lineno}: {text.strip()}")
    return found


def test_a_scaled_value_without_its_unit_is_found():
    assert unitless('f"the pose is off by {x * 1e3:.3f}"') and unitless('f"it turns by {np.degrees(a):.1f} at joint"')
    assert not unitless('f"the pose is off by {x * 1e3:.3f} mm"') and not unitless('f"{x * 1e3:.3f}"')
    assert not unitless('f"the pose is off by {x * 1e3:.3f} m{unit}"')


def test_messages_name_the_units_of_what_they_scale():
    wrong = {}
    for name in ("rig", "vision", "calib", "synthetic"):
        for path in sorted((ROOT / name).rglob("*.py")):
            wrong[str(path.relative_to(ROOT))] = unitless(path.read_text(encoding="utf-8"))
    assert {path: lines for path, lines in wrong.items() if lines} == {}


def test_the_roots_are_there():
    assert all(Path(ROOT / name).is_dir() for name in ("rig", "vision", "calib", "synthetic"))
