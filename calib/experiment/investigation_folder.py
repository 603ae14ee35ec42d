"""Folder of an investigation: paths of its plans, recordings and diagnoses, and the reading of its looks.

The folder holds, for look n: planN.csv (what was to be done), recN (what was recorded), diagnosisN (what all recordings
so far say, and in its next.json what would tell more). Nothing else is kept, so whatever was interrupted goes on from
what is there.
"""

from dataclasses import dataclass
from pathlib import Path

from calib.diagnosis.report.diagnosis_json import SCHEMA, UNKNOWN
from rig.formats import csv_table, structured_files
from rig.formats.checked_entries import Entries
from rig.report.verdict import State

SETTING_UP = 1.0  # min that a recording takes besides its plan


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """title; odds : share, 0..1."""

    title: str
    odds: float


@dataclass(frozen=True, slots=True)
class Proposed:
    """An experiment that was foretold. plan : its text; minutes; bits : expected; settles : chance that it settles all;
    asks : of an operator.
    """

    plan: str
    exposures: int
    minutes: float
    bits: float
    settles: float
    asks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Look:
    """What all recordings up to number `number` (from 1) say. recording : the last one's name; minutes : that it took
    findings : names with their places; alone : those of them that nothing else explains as well; unknown : what has no
        name, in words
    questions : of each finding that is not alone its hypotheses, the likeliest first; unasked : what cannot be
        foretold, in words
    proposed : experiments, the best first; doubts : what its diagnosis' verdict rests on, where that is not good, a
        sentence each
    """

    number: int
    recording: str
    minutes: float
    findings: tuple[str, ...]
    alone: tuple[str, ...]
    unknown: tuple[str, ...]
    questions: tuple[tuple[Hypothesis, ...], ...]
    unasked: tuple[str, ...]
    proposed: tuple[Proposed, ...]
    doubts: tuple[str, ...] = ()

    @property
    def odds(self) -> dict[str, float]:
        """{title: share} of everything that is still thought of; 1 for a name that is alone."""
        out = dict.fromkeys(self.alone, 1.0)
        for question in self.questions:
            out |= {h.title: max(h.odds, out.get(h.title, 0.0)) for h in question}
        return out


def plan_path(folder: Path, number: int) -> Path:
    """Path of a look's plan in the folder."""
    return folder / f"plan{number}.csv"


def recording_path(folder: Path, number: int) -> Path:
    """Path of a look's recording in the folder."""
    return folder / f"rec{number}"


def diagnosis_path(folder: Path, number: int) -> Path:
    """Path of a look's diagnosis in the folder."""
    return folder / f"diagnosis{number}"


def plan_minutes(plan: Path) -> float:
    """Minutes that a plan takes. Raises FileError for what is no table in time."""
    t = csv_table.read(plan, ("frame", "t")).numbers("t")
    return float(t.max() - t.min()) / 60 + SETTING_UP


def read_looks(folder: Path) -> list[Look]:
    """Looks read from an investigation's folder, in order. Raises FileError for a diagnosis that is cut off."""
    out: list[Look] = []
    while (diagnosis_path(folder, len(out) + 1) / "next.json").exists():
        out.append(_look(folder, len(out) + 1))
    return out


def _look(folder: Path, number: int) -> Look:
    at = diagnosis_path(folder, number)
    found, after = (
        structured_files.load_json(at / "diagnosis.json", "diagnosis", SCHEMA),
        structured_files.load_json(at / "next.json", "list of experiments", "next/1"),
    )
    findings = [f for f in found.tables("findings") if f.text("effect") != UNKNOWN]
    unknown = [f for f in found.tables("findings") if f.text("effect") == UNKNOWN]
    questions = tuple(
        tuple(
            sorted(
                (Hypothesis(h.text("title"), h.number("odds")) for h in q.tables("hypotheses")), key=lambda h: -h.odds
            )
        )
        for q in after.tables("questions")
    )
    doubtful = {q.text("finding") for q in after.tables("questions")}
    proposed = tuple(
        Proposed(
            e.text("plan"),
            e.whole("exposures", 1),
            e.number("minutes"),
            e.number("bits"),
            e.number("settles"),
            e.texts("asks"),
        )
        for e in after.tables("experiments")
    )
    unasked = tuple(text for q in after.tables("questions") for text in q.texts("unasked"))
    verdict = found.table("verdict")
    doubts = () if verdict.text("state") == State.GOOD else verdict.texts("rests_on")
    return Look(
        number,
        recording_path(folder, number).name,
        plan_minutes(plan_path(folder, number)),
        tuple(map(_title, findings)),
        tuple(title for title in map(_title, findings) if title not in doubtful),
        tuple(f"something at {f.text('place')}" + _of(f) for f in unknown),
        questions,
        unasked,
        proposed,
        doubts,
    )


def _title(finding: Entries) -> str:
    return f"{finding.text('effect').replace('_', ' ')} at {finding.text('place')}"


def _of(finding: Entries) -> str:
    """On what something without a name depends, in words."""
    names = finding.table("parameters").table("depends_on").texts("value")
    return f", going with {' and '.join(names)}" if names else ""
