"""Verdict of a result with its refutations, and display of results.

A verdict is judged from its evidence; refutations, by later recordings, are loaded and added.

Good needs all of it: a held-out error within AGREES of what noise and claim allow, nothing unexplained, and nothing
stated beyond what the design of the recording supports. Bad is what was refuted: by a later recording, by an error
beyond the claim, by the nominal model doing better. All else is to be checked.

A command that refutes a result, or finds what it leaves out, adds an entry to refutations.json in the result's folder.
It is read wherever the file is shown or used. A copy elsewhere carries no entry.

A result displays itself as one line in a console, as HTML in a notebook.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import Field, asdict, dataclass, fields
from enum import StrEnum
from html import escape
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from rig.array_and_json_types import Json
from rig.errors import FileError
from rig.formats.local_and_remote_input_files import require_schema
from rig.formats.output_files import write_text
from rig.formats.output_files.staged_folder_and_manifest import file_sha256_or_empty

AGREES = 1.2  # times what noise and claim allow: up to that a held-out error agrees with them
REFUTES = 1.5  # from there on it refutes them
REFUTED = 3  # exit status of a command that examines an earlier result and finds it refuted
MOST_TEXT = 60  # characters of a text that a one-line repr repeats
MOST_REASONS = 3  # that the first line names

LOOK = "Determine the unmodelled effects: `rig diagnose REC --out found`"
BALANCE = "Record poses in a balanced order and calibrate from those: `rig run RIG.toml --plan sobol:60 --out REC2`"


class State(StrEnum):
    """State of a result: continue, check first, or do not continue."""

    GOOD = "good"
    CHECK = "check"
    BAD = "bad"


WORST = (State.BAD, State.CHECK, State.GOOD)


class Verdict(NamedTuple):
    """state; why : a sentence without its full stop; next : what to do next, the command that would tell more first,
    commands between backticks
    rests_on : what it rests on, a sentence each"""

    state: State
    why: str
    next: tuple[str, ...] = ()
    rests_on: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """The first line of what a command prints."""
        return f"{self.state}: {self.why}"

    def tree(self) -> Json:
        """What JSON holds of it under "verdict"."""
        return {
            "state": str(self.state),
            "why": self.why,
            "next": self.next[0] if self.next else None,
            "rests_on": list(self.rests_on),
        }


class MissingEvidence(NamedTuple):
    """What would have to be known for a result to be good. text : a sentence without its full stop; step : what would
    supply it
    """

    text: str
    step: str = ""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a result is judged by. statement : the result itself, a sentence without its full stop; steps : what to do
    next where it is good

    held_out : held-out error over what noise and claim allow, the greater of position's and rotation's, None where
        nothing was held out
    unexplained, confounds : sentences; missing : MissingEvidence, ..; refuted : sentences, each saying what refuted
        it, when it was and by how much
    look : the step that tells more of what is unexplained; named : whether the statement names what is unexplained, so
        that it is not repeated
    """

    statement: str
    steps: tuple[str, ...] = ()
    held_out: float | None = None
    unexplained: tuple[str, ...] = ()
    confounds: tuple[str, ...] = ()
    missing: tuple[MissingEvidence, ...] = ()
    refuted: tuple[str, ...] = ()
    look: str = LOOK
    named: bool = False


def judge_evidence(evidence: Evidence) -> Verdict:
    """Judge evidence into a Verdict."""
    beyond = (
        [f"held-out error is {evidence.held_out:.3g} times what noise and claim allow"]
        if _beyond(evidence, AGREES)
        else []
    )
    refuted = [*evidence.refuted, *(beyond if _beyond(evidence, REFUTES) else [])]
    shown = () if evidence.named else evidence.unexplained
    doubts = [
        *(beyond if not _beyond(evidence, REFUTES) else []),
        *shown,
        *evidence.confounds,
        *(m.text for m in evidence.missing),
    ]
    steps = [
        *([evidence.look] if refuted or beyond or evidence.unexplained else []),
        *([BALANCE] if evidence.confounds else []),
        *(m.step for m in evidence.missing if m.step),
    ]
    agreed = (
        []
        if evidence.held_out is None or beyond
        else [f"held-out error is {evidence.held_out:.2f} times what noise and claim allow"]
    )
    rests_on = tuple(dict.fromkeys([*refuted, *evidence.unexplained, *doubts, *agreed]))
    if refuted:
        return Verdict(
            State.BAD, _sentence([*refuted, evidence.statement], len(doubts)), tuple(dict.fromkeys(steps)), rests_on
        )
    if doubts or evidence.unexplained:
        return Verdict(
            State.CHECK,
            _sentence([evidence.statement, *doubts[:MOST_REASONS]], len(doubts[MOST_REASONS:])),
            tuple(dict.fromkeys([*steps, *evidence.steps])),
            rests_on,
        )
    return Verdict(State.GOOD, evidence.statement, evidence.steps, rests_on)


def worst_state(states: Sequence[State]) -> State:
    """Worst state of several verdicts.

    CHECK where there is none.
    """
    return next((state for state in WORST if state in states), State.CHECK)


def exit_status(verdict: Verdict) -> int:
    """Exit status by a verdict on an earlier result.

    REFUTED where it is bad, else 0.
    """
    return REFUTED if verdict.state == State.BAD else 0


def _beyond(evidence: Evidence, limit: float) -> bool:
    return evidence.held_out is not None and evidence.held_out > limit


def _sentence(parts: list[str], left: int) -> str:
    return "; ".join(parts) + (f"; and {left} more doubts" if left > 1 else "; and 1 more doubt" if left else "")


NAME = "refutations.json"
SCHEMA = "refutations/1"
FIELDS = ("sha256", "file", "date", "command", "recording", "finding")


@dataclass(frozen=True, slots=True)
class Refutation:
    """sha256, file : of the result, its name; date : ISO 8601; command, recording : that found it, their names;
    finding : what it found, a sentence
    state : "bad" where the result is refuted, "check" where something acts that it leaves out"""

    sha256: str
    file: str
    date: str
    command: str
    recording: str
    finding: str
    state: State = State.BAD

    @property
    def line(self) -> str:
        """The entry as pages and commands show it."""
        verb = "refuted" if self.state == State.BAD else "doubted"
        return f"{verb} on {self.date} by {self.recording} (rig {self.command}): {self.finding}"


def load_refutations(folder: Path) -> tuple[Refutation, ...]:
    """Load the refutations of a folder.

    () where there are none.
    Raises FileError for an invalid file.
    """
    path = folder / NAME
    try:
        tree = json.loads(path.read_bytes().decode("utf-8"))
        require_schema(path, "list of refuted results", tree["schema"], (SCHEMA,))
        return tuple(
            Refutation(**{name: str(row[name]) for name in FIELDS}, state=State(row["state"]))
            for row in tree["refutations"]
        )
    except (FileNotFoundError, NotADirectoryError):
        return ()
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileError(path, f"is not a list of refuted results ({type(error).__name__}: {error})") from None


def refutations_of_file(path: Path) -> tuple[Refutation, ...]:
    """Refutations of a result file.

    By its SHA-256, oldest first.
    Raises FileError as `load_refutations` does.
    """
    known = load_refutations(path.parent)
    own = file_sha256_or_empty(path) if known else ""
    return tuple(one for one in known if one.sha256 == own)


def add_refutation(refutations_file: Path, folder: Path, new_refutation: Refutation) -> None:
    """Add a refutation to those of a folder.

    It replaces one of the same file by the same command and recording.
    refutations_file : where the file waits to be put into the folder as NAME
    """
    retained = [
        one
        for one in load_refutations(folder)
        if (one.sha256, one.command, one.recording)
        != (new_refutation.sha256, new_refutation.command, new_refutation.recording)
    ]
    write_text(
        refutations_file,
        json.dumps({"schema": SCHEMA, "refutations": [asdict(one) for one in (*retained, new_refutation)]}, indent=1)
        + "\n",
    )


class OneLineRepr:
    """Base of results whose repr is one line, the class's name and what str gives; for dataclasses with repr=False."""

    __slots__ = ()

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {str(self).partition(chr(10))[0]}>"


class FieldSummaryRepr(OneLineRepr):
    """Base of dataclasses whose repr is one line of their fields: numbers and short texts, shapes of arrays, counts of
    collections, names of classes."""

    __slots__ = ()
    __dataclass_fields__: ClassVar[dict[str, Field[object]]]

    def __str__(self) -> str:
        return ", ".join(f"{field.name} {_summary(getattr(self, field.name))}" for field in fields(self))


def _summary(value: object) -> str:
    if value is None or isinstance(value, (bool, int, float)) or (isinstance(value, str) and len(value) <= MOST_TEXT):
        return str(value)
    if isinstance(value, np.ndarray):
        return str(value.shape)
    return f"[{len(value)}]" if isinstance(value, (list, tuple, dict, set, frozenset)) else type(value).__name__


def result_html(heading: str, lines: Iterable[str] = (), table: Sequence[Sequence[str]] = ()) -> str:
    """HTML of a result.

    For notebooks. Heading, sentences, a table whose first row is its header; text is escaped.
    """
    parts = [f"<strong>{escape(heading)}</strong>", *(f"<p style='margin:.2em 0'>{escape(line)}</p>" for line in lines)]
    if table:
        head, *rows = table
        body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
        top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
        parts.append(
            f"<div style='overflow-x:auto'><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>"
        )
    return f"<div>{''.join(parts)}</div>"
