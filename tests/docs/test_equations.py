"""The equations are numbered once, one after the other, and what the code refers to is there."""

import re

from tests.conftest import ROOT

NAME = "docs/mathematics.md"
NUMBERS = re.compile(re.escape(NAME) + r"((?:(?:,\s*|\s+and\s+|\s+to\s+|\s+)\(\d+\))+)")


def equations() -> list[int]:
    return [int(number) for number in re.findall(r"\\tag\{(\d+)\}", (ROOT / NAME).read_text())]


def referred(text: str) -> set[int]:
    return {int(number) for group in NUMBERS.findall(text) for number in re.findall(r"\((\d+)\)", group)}


def test_equations_are_numbered_one_after_the_other():
    assert equations() == list(range(1, len(equations()) + 1)) and equations()


def test_every_equation_that_code_refers_to_exists():
    known, seen = set(equations()), set()
    for package in ("rig", "vision", "calib", "synthetic"):
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text()
            assert len(NUMBERS.findall(text)) == text.count(NAME), (
                f"{path}: refers to the mathematics, but to no equation"
            )
            assert referred(text) <= known, f"{path}: there is no equation {sorted(referred(text) - known)}"
            seen |= referred(text)
    assert {6, 7, 8, 19, 20, 21, 22, 23} <= seen


def test_the_document_refers_to_its_own_equations_alone():
    text = re.sub(r"\$.*?\$", "", (ROOT / NAME).read_text(), flags=re.DOTALL)
    assert {int(number) for number in re.findall(r"(?<=[\s(])\((\d{1,2})\)", text)} <= set(equations())


def test_a_symbol_has_one_meaning():
    table = (ROOT / NAME).read_text().split("## Symbols")[1].split("\n## ")[0]
    symbols = [
        symbol
        for line in table.splitlines()
        if line.startswith("| $")
        for symbol in re.findall(r"\$(.+?)\$", line.split(" | ")[0])
    ]
    assert len(symbols) > 30 and len(symbols) == len(set(symbols))


def test_every_source_is_cited_by_its_number():
    text, sources = (ROOT / NAME).read_text().split("## Sources")
    numbers = [int(number) for number in re.findall(r"^\[(\d+)\] ", sources, flags=re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert {int(number) for number in re.findall(r"\[(\d+)\]", re.sub(r"\$.*?\$", "", text, flags=re.DOTALL))} == set(
        numbers
    )
    assert not re.findall(r"\b(?:19|20)\d\d\b", re.sub(r"\$.*?\$", "", text, flags=re.DOTALL)), (
        "years stand with the sources"
    )
