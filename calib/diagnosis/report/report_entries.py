"""A Diagnosis of any machine -> its Report, and the folder that states it: diagnosis.json, and what it takes to draw
the recording anew as it was found.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calib.diagnosis.engine.cross_validation import CrossValidation
from calib.diagnosis.engine.finding_confirmation import Finding
from calib.diagnosis.engine.lack_of_fit import LackOfFit, first_of_each_place
from calib.diagnosis.problems.measured_evidence import MeasuredFinding, Misfit, ScatterSize, Value
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report import finding_contributions
from calib.diagnosis.report.diagnosis_json import (
    UNKNOWN,
    AlternativeEntry,
    Evidence,
    FindingEntry,
    FitEntry,
    NotAskedEntry,
    RemarkEntry,
    Unexplained,
    covariate_entries,
    effects_files,
    recording_entries,
    stated_beforehand,
    suggestion_entries,
)
from calib.diagnosis.report.diagnosis_report import Report, write_diagnosis_json
from calib.diagnosis.report.residual_figures import held_out_entries
from rig.effects.framework.effect import Effect
from rig.formats import machine_json, remote_folders
from rig.formats.input_files import read_text
from rig.formats.output_files import write_text
from rig.recording.recording_folder import Recording


def diagnosis_report(d: Diagnosis) -> Report:
    """Report of a Diagnosis."""
    found = [_measured(one) for one in d.measured_findings]
    found += [_finding(d, f, proof) for f, proof in zip(d.findings, d.cross_validations)]
    fits = {name: _fit_entry(fit) for name, fit in d.misfits.items()}
    noise = asdict(d.noise)
    noise_from = noise.pop("source")
    return Report(
        d.recording,
        d.origin.shown(0.0),
        noise,
        (*found, *unnamed_finding_entries(d.left)),
        largest_unexplained(d),
        fits,
        fits[d.shown_in],
        tuple(NotAskedEntry(s.effect, s.reason) for s in d.not_asked),
        tuple(_remark_entries(d)),
        covariate_entries(d.covariates),
        d.options.said,
        recording_entries(d.parts),
        effects_files(d.options.own),
        suggestion_entries(d.suggestions),
        more=held_out_entries(d),
        confounds=d.confounds,
        noise_from=noise_from,
        left_out=d.outliers.left_out,
        crowd=d.outliers.crowd,
        asked=d.selection.asked,
    )


def _measured(one: MeasuredFinding) -> FindingEntry:
    """FindingEntry of what was measured before anything was searched."""
    return FindingEntry(one.kind.name, one.place, one.parameters, action=one.kind.action_at(one.place))


# Any: candidates, of each kind of machine their own
def _finding(d: Diagnosis, finding: Finding[Any], proof: CrossValidation) -> FindingEntry:
    problem, fit, score = d.selection.problem, d.selection.fit, finding.score
    candidate = problem.terms(fit)[finding.number]
    kind, place = candidate.kind, candidate.place
    parameters = d.evidence.parameters(d.selection, finding, d.origin)
    evidence = Evidence(
        score.delta_bic(problem.size(fit)),
        min(1.0, score.p_value * d.selection.asked),
        proof.before,
        proof.after,
        proof.unit,
        proof.gain,
    )
    others = tuple(
        AlternativeEntry(
            other.name,
            other.place,
            a.behind,
            a.cosine,
            separating_experiment_text((kind, place), (other.kind, other.place)),
            a.score.node.get("order"),
        )
        for a, other in ((a, a.score.candidate) for a in finding.alternatives)
    )
    return FindingEntry(
        candidate.name,
        place,
        parameters,
        evidence,
        others,
        kind.action_at(place),
        stated_beforehand(d.options.given, candidate.name, place),
        unusual_size_reason(kind, place, parameters),
    )


def _remark_entries(d: Diagnosis) -> list[RemarkEntry]:
    """What is there beyond chance and does not matter: what was fitted, what was left, what tolerances were seen to
    be.
    """
    terms, out = d.selection.problem.terms(d.selection.fit), []
    for f, reason in d.tolerable.findings:
        out.append(
            RemarkEntry(
                terms[f.number].name,
                terms[f.number].place,
                d.evidence.parameters(d.selection, f, d.origin),
                tolerance_reason_sentence(reason),
                min(1.0, f.score.p_value * d.selection.asked),
            )
        )
    out += [
        RemarkEntry(UNKNOWN, u.place, _size_of(u), tolerance_reason_sentence(reason), u.p_value)
        for u, reason in d.tolerable.left
    ]
    return out + [
        RemarkEntry(r.effect, r.place, r.parameters, tolerance_reason_sentence(r.reason), r.p_value)
        for r in d.tolerable.remarks
    ]


def tolerance_reason_sentence(reason: str) -> str:
    """A remark's reason in a sentence."""
    return f"No more than {reason}."


def largest_unexplained(d: Diagnosis) -> Unexplained | None:
    """The most convincing of what is left, else what poses scatter beyond a statement of their noise, or None."""
    if d.left:
        first = d.left[0]
        return Unexplained(first.place, first.magnitude, first.unit, first.depends_on)
    if isinstance(d.evidence, ScatterSize):
        beyond, unstated = d.evidence.scatter_beyond_stated(d.selection)
        return Unexplained("rig", beyond, "m", ()) if unstated else None
    return None


def unnamed_finding_entries(left: list[LackOfFit]) -> list[FindingEntry]:
    """What is left as findings without a name, one for each place."""
    return [
        FindingEntry(UNKNOWN, u.place, _size_of(u), Evidence(p_value=u.p_value, delta_chi2=u.delta_chi2))
        for u in first_of_each_place(left)
    ]


def _size_of(left: LackOfFit) -> dict[str, Value]:
    return {"magnitude": Value(left.magnitude, left.unit), "depends_on": Value(list(left.depends_on), "")}


def _fit_entry(fit: Misfit) -> FitEntry:
    return FitEntry(fit.before, fit.after, fit.floor, fit.unit)


def separating_experiment_text(*sites: tuple[type[Effect], str]) -> str:
    """What would tell two hypotheses, an effect at a place each, apart, in words."""
    names, shown = [kind.name for kind, _ in sites], [kind.experiment_at(place) for kind, place in sites]
    return shown[0] if names[0] == names[1] else "; ".join(f"{name}: {text}" for name, text in zip(names, shown))


def unusual_size_reason(kind: type[Effect], place: str, parameters: dict[str, Value]) -> str | None:
    """Why the size of an effect at a place is hard to believe, or None."""
    return kind.unusual(place, {key: value.value for key, value in parameters.items()})


def write_diagnosis(folder: Path, d: Diagnosis, recording: Recording, report: Report) -> None:
    """Write diagnosis.json into a folder and, where a machine was commanded, what it takes to simulate it as found:
    machine.json, the recording's own rig.toml, commands, frames and sensors, and what each finding does to each pose
    where that is known.
    report : Report of d"""
    write_diagnosis_json(folder, report)
    if d.design is None:
        return
    tree = machine_json.machine_dict(d.design, d.machine_effects)
    write_text(folder / "machine.json", json.dumps(tree) + "\n")
    copy_recording(folder, recording)
    finding_contributions.write_contributions(folder / "contributions.csv", d)


def copy_recording(folder: Path, recording: Recording) -> None:
    """Copy a recording's own rig.toml, commands, frames and sensors into a folder; of several, the first one's."""
    recording = recording.apart[0].recording
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        if remote_folders.exists(recording.folder / name):
            write_text(folder / name, read_text(recording.folder / name))
