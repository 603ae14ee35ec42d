"""Visits held against a calibration, one after the other: whether it still holds, and what changed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.certification.calibration import Calibration
from calib.certification.calibration_evidence import calibration_evidence, verify_claim_on_samples
from calib.certification.claim_verification import Verification
from calib.certification.platform_certification import Progress, silent_progress
from calib.drift import change_sentences
from calib.drift.change_evidence import Verdict as ChangeVerdict
from calib.drift.visit_history import History, add_visit
from calib.files.calibration_from_recording import SEED
from calib.report.verification_and_visit_pages import (
    Visit,
    change_alarm_sentence,
    first_visit_sentence,
    last_visit_verdict,
    write_visits_page,
)
from calib.samples.confounded_conditions import Confounds, confounds_of_recordings
from calib.samples.recording_samples import sample_recording
from rig.formats.json_tree import Json
from rig.recording.recording_folder import Recording
from rig.report.pages.html_elements import result_html
from rig.report.pages.page_and_svg_templates import Link
from rig.report.refutations import Refutation
from rig.report.verdict import State, Verdict

MEASURING = ("camera", "target", "instrument")  # kinds of changes of what measures: the calibration itself stands


@dataclass(frozen=True, slots=True, eq=False)
class WatchResult:
    """What visits say. history : with these visits; visits : Visit of each; confounds : of each; entries : of each, as
    JSON has them; verdict : on the calibration by the last
    """

    history: History
    visits: tuple[Visit, ...]
    confounds: tuple[Confounds | None, ...]
    entries: tuple[Json, ...]
    verdict: Verdict

    @property
    def refutation(self) -> tuple[State, str] | None:
        """(BAD or CHECK, sentence) of what the last visit says against the calibration, None where it says nothing."""
        last = self.visits[-1]
        if last.allowed:
            return State.CHECK, first_visit_sentence(last)
        change = last.evidence
        if change.alarm and (change.named is None or change.named.kind not in MEASURING):
            return State.BAD, change_alarm_sentence(change)
        return None

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines())

    def lines(self) -> list[str]:
        """What each visit says."""
        out: list[str] = []
        for visit, confounds in zip(self.visits, self.confounds):
            out += [*visit.lines, *([] if confounds is None else [f"  {confounds.line()}"])]
        return out

    def tree(self) -> Json:
        """What `rig watch --json` prints."""
        return {"schema": "verdict/1", "verdict": self.verdict.tree(), "visits": list(self.entries)}

    def write_page(self, path: Path, name: str, links: Sequence[Link] = ()) -> None:
        """Write the page of it. name : of the calibration"""
        write_visits_page(path, name, self.visits, self.verdict, links)


def watch(
    calibration: Calibration,
    visits: Sequence[Recording],
    history: History,
    refutations: Sequence[Refutation] = (),
    progress: Progress = silent_progress,
) -> WatchResult:
    """WatchResult of visits, small recordings in the order in which they were taken, as `rig watch` makes it.

    history : of the visits before, `History(calibration_digest(path))` where there are none; refutations : what later
    recordings found against the calibration
    Raises ValueError without visits, and what measuring raises
    """
    if not visits:
        raise ValueError("watching takes one visit at least")
    seen: list[Visit] = []
    entries: list[Json] = []
    of_each: list[Confounds | None] = []
    for k, recording in enumerate(visits):
        progress("visits", k, len(visits))
        scale = history.scale()
        history, change = add_visit(history, recording, calibration)
        assert history.reference is not None
        confounds = confounds_of_recordings([recording])
        found = _verified(calibration, recording, change)
        claim = None if found is None else {"kept": not found.refutes, "of_limit": found.of_limit}
        entries.append(_tree(change, history, scale) | {"claim": claim, "confounds": confounds and confounds.tree()})
        visit = Visit(history.visits[-1].name, change, (), scale, found)
        names = [one.name for one in history.visits for _ in range(one.visits)]
        lines = change_sentences.change_verdict_lines(
            change, visit.name, names, history.reference, scale, visit.allowed
        )
        seen.append(replace(visit, lines=lines))
        of_each.append(confounds)
    verdict = last_visit_verdict(seen, calibration_evidence(calibration, refutations))
    return WatchResult(history, tuple(seen), tuple(of_each), tuple(entries), verdict)


def _verified(calibration: Calibration, recording: Recording, change: ChangeVerdict) -> Verification | None:
    """The claim held against a first visit that disagrees with the calibration, as `rig verify` holds it; None of other
    visits.
    """
    if not change.alarm or change.chance is None:
        return None
    samples = calibration.with_physics(recording, sample_recording(recording).samples)
    return verify_claim_on_samples(calibration, samples, np.random.default_rng(SEED))


def _tree(verdict: ChangeVerdict, history: History, scale: float) -> Json:
    """What JSON holds of a visit's verdict."""
    named = verdict.named
    return {
        "visit": history.visits[-1].name,
        "number": history.number,
        "changed": verdict.alarm,
        "log_sum": verdict.log_sum,
        "misfit": {"square": verdict.square, "count": verdict.count, "repeats": scale},
        "named": None if named is None or not verdict.alarm else named.name,
        "suspects": [
            {
                "kind": one.kind,
                "name": one.name,
                "since": one.since + 1,
                "odds": one.odds,
                "value": one.value.tolist(),
                "sigma": one.sigma.tolist(),
            }
            for one in verdict.suspects
            if one.odds > 1e-6
        ],
    }
