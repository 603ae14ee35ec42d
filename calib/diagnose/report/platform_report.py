"""Report of a platform's diagnosis, and the files that simulate the platform as diagnosed."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from calib.diagnose.engine.chance_probability import Z95
from calib.diagnose.engine.cross_validation import CrossValidation
from calib.diagnose.engine.lack_of_fit import LackOfFit, first_of_each_place
from calib.diagnose.engine.term_selection import Finding
from calib.diagnose.problems.platform.platform_diagnosis import PlatformDiagnosis
from calib.diagnose.problems.platform.simultaneous_refinement import Refined
from calib.diagnose.problems.platform.tolerance_columns import SignificantTolerance
from calib.diagnose.report.diagnosis_json import (
    ASSUMED_NOISE,
    RESIDUALS,
    STATED,
    UNKNOWN,
    AlternativeEntry,
    Evidence,
    FindingEntry,
    FitEntry,
    NotAskedEntry,
    RemarkEntry,
    Unexplained,
    Value,
    bounded_value,
    covariate_entries,
    effects_files,
    recording_entries,
    stated_beforehand,
    suggestion_entries,
)
from calib.diagnose.report.diagnosis_report import Report
from calib.diagnose.report.diagnosis_verdict import write_diagnosis_json
from rig.effects.catalogue.face_misplacement import FaceMisplacement
from rig.effects.catalogue.marker_swap import MarkerSwap
from rig.effects.framework.effect import Effect
from rig.formats import machine_json, remote_folders
from rig.formats.input_files import read_text
from rig.formats.output_files import write_text
from rig.recording.recording_folder import Recording
from rig.recording.time_origin import Origin
from vision.bundle.marker_displacements import Move


def platform_report(diagnosis: PlatformDiagnosis) -> Report:
    """Report of a platform's diagnosis."""
    found = [_swapped(effect) for effect in diagnosis.swapped] + [_moved(move) for move in diagnosis.moved]
    found += [
        _finding(diagnosis, f, proof) for f, proof in zip(diagnosis.selection.findings, diagnosis.cross_validations)
    ]
    fits = {name: _fit_entry(fit) for name, fit in diagnosis.fits.items()}
    return Report(
        diagnosis.recording,
        diagnosis.origin.shown(0.0),
        _noise_entry(asdict(diagnosis.noise)),
        (*found, *unnamed_finding_entries(diagnosis.left)),
        largest_unexplained(diagnosis.left),
        fits,
        _fit_entry(diagnosis.fit),
        tuple(NotAskedEntry(s.effect, s.reason) for s in diagnosis.not_asked),
        tuple(_remark_entries(diagnosis)),
        covariate_entries(diagnosis.covariates),
        diagnosis.said,
        recording_entries(diagnosis.parts),
        effects_files(diagnosis.own),
        suggestion_entries(diagnosis.suggestions),
        confounds=diagnosis.confounds,
        noise_from=_noise_source(diagnosis),
        left_out=diagnosis.wild.left_out,
        crowd=diagnosis.wild.crowd,
    )


def _noise_source(d: PlatformDiagnosis) -> str:
    """Whence the noise comes that all is judged by."""
    k = d.selection.fit.refined.point
    if k.seen is None:
        return ASSUMED_NOISE if k.assumed else STATED
    return RESIDUALS if k.seen.stated is None else STATED


def _remark_entries(d: PlatformDiagnosis) -> list[RemarkEntry]:
    """What is there beyond chance and does not matter: what was fitted, what was left, what tolerances were seen to
    be.
    """
    refined, out = d.selection.fit.refined, []
    for f, reason in d.remarks.findings:
        effect = refined.point.effects[f.number]
        out.append(
            RemarkEntry(
                effect.name,
                effect.place,
                _parameters(refined, f.number, effect, d.origin),
                _tolerance_reason_sentence(reason),
                min(1.0, f.score.p_value * d.selection.asked),
            )
        )
    out += [
        RemarkEntry(UNKNOWN, u.place, _size_of(u), _tolerance_reason_sentence(reason), u.p_value)
        for u, reason in d.remarks.left
    ]
    return out + [_within(s) for s in d.remarks.sites]


def _tolerance_reason_sentence(reason: str) -> str:
    """A remark's reason in a sentence."""
    return f"No more than {reason}."


def _within(slight: SignificantTolerance) -> RemarkEntry:
    """RemarkEntry of what a tolerance was seen to be."""
    parameters, at, ends = {}, 0, Z95 * slight.sigma
    for name, unit, count in slight.site.parameters:
        rows = slice(at, at + count)
        low, value, high = ((slight.values + s * ends)[rows].tolist() for s in (-1, 0, 1))
        parameters[name] = Value(value, unit, [low, high]) if count > 1 else Value(value[0], unit, [low[0], high[0]])
        at += count
    return RemarkEntry(
        slight.site.effect,
        slight.site.place,
        parameters,
        _tolerance_reason_sentence(slight.site.tolerance.reason),
        slight.p_value,
    )


def _noise_entry(figures: dict[str, float | None]) -> dict[str, float | None]:
    """The noise as diagnosis.json has it: a strut's alone is left out where there is none."""
    return {name: value for name, value in figures.items() if value is not None or name != "strut_m"}


def largest_unexplained(left: list[LackOfFit]) -> Unexplained | None:
    """The largest, most significant unexplained deviation, or None."""
    return Unexplained(left[0].place, left[0].magnitude, left[0].unit, left[0].depends_on) if left else None


def unnamed_finding_entries(left: list[LackOfFit]) -> list[FindingEntry]:
    """Entries of unnamed findings, one for each place at which something is unexplained."""
    return [
        FindingEntry(UNKNOWN, u.place, _size_of(u), Evidence(p_value=u.p_value, delta_chi2=u.delta_chi2))
        for u in first_of_each_place(left)
    ]


def _size_of(left: LackOfFit) -> dict[str, Value]:
    return {"magnitude": Value(left.magnitude, left.unit), "depends_on": Value(list(left.depends_on), "")}


def _fit_entry(fit: CrossValidation) -> FitEntry:
    """FitEntry of the cross-validation of all findings together."""
    return FitEntry(fit.before, fit.after, fit.floor, fit.unit)


def separating_experiment_text(*sites: tuple[type[Effect], str]) -> str:
    """Text of the experiment that would separate two hypotheses, an effect at a place each."""
    names, shown = [kind.name for kind, _ in sites], [kind.experiment_at(place) for kind, place in sites]
    return shown[0] if names[0] == names[1] else "; ".join(f"{name}: {text}" for name, text in zip(names, shown))


def unusual_size_reason(kind: type[Effect], place: str, parameters: dict[str, Value]) -> str | None:
    """Reason why the size of an effect at a place is unusual, or None."""
    return kind.unusual(place, {key: value.value for key, value in parameters.items()})


def _swapped(effect: MarkerSwap) -> FindingEntry:
    parameters = {name: Value(value, "") for name, value in effect.values().items()}
    return FindingEntry(effect.name, effect.place, parameters, action=effect.action_at(effect.place))


def _moved(move: Move) -> FindingEntry:
    ends = np.stack([move.by, move.by - move.ci95, move.by + move.ci95])
    parameters = {
        p.name: Value(part[0].tolist(), p.unit, part[1:].tolist())
        for p, part in zip(FaceMisplacement.parameters, (ends[:, :3], ends[:, 3:]))
    }
    return FindingEntry(FaceMisplacement.name, move.name, parameters, action=FaceMisplacement.action_at(move.name))


def _finding(d: PlatformDiagnosis, finding: Finding, proof: CrossValidation) -> FindingEntry:
    refined, score = d.selection.fit.refined, finding.score
    effect = refined.point.effects[finding.number]
    evidence = Evidence(
        score.delta_bic(refined.model.size),
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
            separating_experiment_text((type(effect), effect.place), (other.kind, other.place)),
        )
        for a, other in ((a, a.score.candidate) for a in finding.alternatives)
    )
    parameters = _parameters(refined, finding.number, effect, d.origin)
    return FindingEntry(
        effect.name,
        effect.place,
        parameters,
        evidence,
        others,
        effect.action_at(effect.place),
        stated_beforehand(d.given, effect.name, effect.place),
        unusual_size_reason(type(effect), effect.place, parameters),
    )


def _parameters(refined: Refined, number: int, effect: Effect, origin: Origin) -> dict[str, Value]:
    known, bound = {p.name: p for p in effect.parameters_at(effect.place)}, refined.at_bounds(number)
    out = {
        name: Value(value, known[name].unit, [low, high])
        if isinstance(value, list)
        else bounded_value(value, known[name].unit, (low, high), known[name].bounds, bound.get(name))
        for name, (value, low, high) in refined.intervals(number).items()
    }
    for p in effect.parameters:
        if p.role in ("moment", "choice") and p.size == 1 and np.isfinite(getattr(effect, p.name)):
            value = getattr(effect, p.name)
            out[p.name] = Value(value, p.unit) if p.role == "choice" else moment_text(refined.point.t, value, origin)
    return out


def moment_text(t: np.ndarray, value: float, origin: Origin, likely: tuple[float, float] | None = None) -> Value:
    """Value of a moment (s from the start) as text, by the owner's clock, with the frames between which it lies.

    likely : (earliest, latest) s, where it may lie between other frames as well
    """
    low, high = (np.clip(np.searchsorted(t, v), 1, len(t) - 1) for v in likely or (value, value))
    return Value(origin.shown(value), "s", [origin.shown(t[low - 1]), origin.shown(t[high])])


def write_platform_diagnosis(folder: Path, diagnosis: PlatformDiagnosis, recording: Recording, report: Report) -> None:
    """Write diagnosis.json into a folder and, where a machine was commanded, what it takes to simulate it as found:
    machine.json and the recording's own rig.toml, commands, frames and sensors.
    report : Report of d"""
    write_diagnosis_json(folder, report)
    k = diagnosis.selection.fit.refined.point
    if not k.axes:
        return
    tree = machine_json.machine_dict(k.design, (*diagnosis.swapped, *diagnosis.effects))
    write_text(folder / "machine.json", json.dumps(tree) + "\n")
    copy_recording(folder, recording)


def copy_recording(folder: Path, recording: Recording) -> None:
    """Copy a recording's rig.toml, commands, frames and sensors into a folder; of several, the first's."""
    recording = recording.apart[0].recording
    for name in ("rig.toml", "commands.csv", "frames.csv", "sensors.csv"):
        if remote_folders.exists(recording.folder / name):
            write_text(folder / name, read_text(recording.folder / name))
