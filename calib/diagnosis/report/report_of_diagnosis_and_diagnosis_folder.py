"""Report of a Diagnosis, entry by entry, and the diagnosis folder: diagnosis.json, and files to simulate by."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from calib.diagnosis.engine.cross_validation_and_chance import CrossValidation
from calib.diagnosis.engine.finding_confirmation_against_alternatives import Finding
from calib.diagnosis.engine.lack_of_fit_by_smooth_functions import LackOfFit, first_of_each_place
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    MeasuredFinding,
    Misfit,
    ScatterSize,
    Value,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report import residual_figures_and_contributions
from calib.diagnosis.report.diagnosis_json_entries import (
    UNKNOWN,
    AlternativeEntry,
    Evidence,
    FindingEntry,
    FitEntry,
    NotAskedEntry,
    RemarkEntry,
    Unexplained,
    covariate_entries,
    effect_file_entries,
    kind_of_statement_beforehand,
    recording_entries,
    suggested_formula_entries,
)
from calib.diagnosis.report.report_data_and_verdict import Report, write_diagnosis_json
from calib.diagnosis.report.residual_figures_and_contributions import held_out_entries
from rig.effects.framework.effect import Effect
from rig.formats import local_and_remote_input_files, machine_json
from rig.formats.local_and_remote_input_files import read_text
from rig.formats.output_files import write_text
from rig.recording.recording_folder import Recording


def diagnosis_report(diagnosis: Diagnosis) -> Report:
    """Report of a Diagnosis."""
    found = [_measured(one) for one in diagnosis.measured_findings]
    found += [_finding(diagnosis, f, proof) for f, proof in zip(diagnosis.findings, diagnosis.cross_validations)]
    fits = {name: _fit_entry(fit) for name, fit in diagnosis.misfits.items()}
    noise = asdict(diagnosis.noise)
    noise_from = noise.pop("source")
    return Report(
        diagnosis.recording,
        diagnosis.origin.shown(0.0),
        noise,
        (*found, *unnamed_finding_entries(diagnosis.left)),
        largest_unexplained(diagnosis),
        fits,
        fits[diagnosis.shown_in],
        tuple(NotAskedEntry(s.effect, s.reason) for s in diagnosis.not_asked),
        tuple(_remark_entries(diagnosis)),
        covariate_entries(diagnosis.covariates),
        diagnosis.options.said,
        recording_entries(diagnosis.parts),
        effect_file_entries(diagnosis.options.own),
        suggested_formula_entries(diagnosis.suggestions),
        more=held_out_entries(diagnosis),
        confounds=diagnosis.confounds,
        noise_from=noise_from,
        left_out=diagnosis.outliers.left_out,
        crowd=diagnosis.outliers.crowd,
        asked=diagnosis.selection.asked,
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
        kind_of_statement_beforehand(d.options.given, candidate.name, place),
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
                remark_reason_sentence(reason),
                min(1.0, f.score.p_value * d.selection.asked),
            )
        )
    out += [
        RemarkEntry(UNKNOWN, str(u.place), _size_of(u), remark_reason_sentence(reason), u.p_value)
        for u, reason in d.tolerable.left
    ]
    return out + [
        RemarkEntry(r.effect, r.place, r.parameters, remark_reason_sentence(r.reason), r.p_value)
        for r in d.tolerable.remarks
    ]


def remark_reason_sentence(reason: str) -> str:
    """Sentence with the reason of a remark."""
    return f"No more than {reason}."


def largest_unexplained(diagnosis: Diagnosis) -> Unexplained | None:
    """Largest unexplained lack of fit of a Diagnosis, else the scatter of poses beyond their stated noise, or N"""
    if diagnosis.left:
        first = diagnosis.left[0]
        return Unexplained(str(first.place), first.magnitude, first.unit, first.depends_on)
    if isinstance(diagnosis.evidence, ScatterSize):
        beyond, unstated = diagnosis.evidence.scatter_beyond_stated(diagnosis.selection)
        return Unexplained("rig", beyond, "m", ()) if unstated else None
    return None


def unnamed_finding_entries(lacks_of_fit: list[LackOfFit]) -> list[FindingEntry]:
    """Entries of findings without a name, one for each place with a lack of fit."""
    return [
        FindingEntry(UNKNOWN, str(u.place), _size_of(u), Evidence(p_value=u.p_value, delta_chi2=u.delta_chi2))
        for u in first_of_each_place(lacks_of_fit)
    ]


def _size_of(left: LackOfFit) -> dict[str, Value]:
    return {"magnitude": Value(left.magnitude, left.unit), "depends_on": Value(list(left.depends_on), "")}


def _fit_entry(fit: Misfit) -> FitEntry:
    return FitEntry(fit.before, fit.after, fit.floor, fit.unit)


def separating_experiment_text(*sites: tuple[type[Effect], str]) -> str:
    """Text on the experiment that would separate two hypotheses, an effect at a place each."""
    names, shown = [kind.name for kind, _ in sites], [kind.experiment_at(place) for kind, place in sites]
    return shown[0] if names[0] == names[1] else "; ".join(f"{name}: {text}" for name, text in zip(names, shown))


def unusual_size_reason(kind: type[Effect], place: str, parameters: dict[str, Value]) -> str | None:
    """Why the size of an effect at a place is hard to believe, or None."""
    return kind.unusual(place, {key: value.value for key, value in parameters.items()})


def write_diagnosis_folder(folder: Path, diagnosis: Diagnosis, recording: Recording, report: Report) -> None:
    """Write the folder of a diagnosis: diagnosis.json and, where a machine was commanded, what to simulate it by:
    machine.json, the recording's own rig.toml, commands, frames and sensors, and what each finding does to each pose
    where that is known.
    report : Report of d"""
    write_diagnosis_json(folder, report)
    if diagnosis.design is None:
        return
    tree = machine_json.machine_dict(diagnosis.design, diagnosis.machine_effects)
    write_text(folder / "machine.json", json.dumps(tree) + "\n")
    copy_recording(folder, recording)
    residual_figures_and_contributions.write_contributions(folder / "contributions.csv", diagnosis)


def copy_recording(folder: Path, recording: Recording) -> None:
    """Copy a recording's own rig.toml, commands, frames and sensors into a folder; of several, the first one's."""
    recording = recording.apart[0].recording
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        if local_and_remote_input_files.exists(recording.folder / name):
            write_text(folder / name, read_text(recording.folder / name))
