"""Diagnosis JSON entries as dataclasses.

Of diagnosis.json, schema diagnosis/1, in SI units and px, made of a Diagnosis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import StatedTerms
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import CrossValidation
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import (
    Covariate,
    LackOfFit,
    first_lack_of_fit_of_each_place,
)
from calib.diagnosis.engine.term_confirmation_against_alternative_candidates import Finding
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import Suggestion
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    MeasuredFinding,
    Misfit,
    ScatterSize,
    Value,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from rig.effects.catalogue.effect_list import Plugin
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_file_from_formula import Written
from rig.recording.recording_folder import RecordingPart

SCHEMA = "diagnosis/1"
NOTHING = 0.2  # of the misfit held out, added in squares, that a finding must take away to be more than significant
ASSUMED, SEEN_BEFORE = "assumed", "seen before"
UNKNOWN = "unknown"  # name of a finding that no catalogued effect explains


@dataclass(frozen=True, slots=True)
class Evidence:
    """How sure a finding is; heldout_before, heldout_after : RMS in unit, of stretches held out, without it and with it
    gain_sigma : standard errors by which they gain; delta_chi2 : of what has no name"""

    delta_bic: float | None = None
    p_value: float | None = None
    heldout_before: float | None = None
    heldout_after: float | None = None
    unit: str | None = None
    gain_sigma: float | None = None
    delta_chi2: float | None = None


@dataclass(frozen=True, slots=True)
class AlternativeEntry:
    """Another effect that explains as much; delta_bic : by how much less likely it is; order : of a sinusoid;
    experiment : what would tell them.
    """

    effect: str
    place: str
    delta_bic: float
    cosine: float
    experiment: str
    order: float | None = None


@dataclass(frozen=True, slots=True)
class FindingEntry:
    """One effect at one place. parameters : {name: Value}; action : what an owner can do about it; unusual : why its
    size is hard to believe
    said : "assumed" where the operator took it to be there, "seen before" where the search began with it, else None"""

    effect: str
    place: str
    parameters: dict[str, Value]
    evidence: Evidence = field(default_factory=Evidence)
    cannot_be_told_from: tuple[AlternativeEntry, ...] = ()
    action: str | None = None
    said: str | None = None
    unusual: str | None = None

    @property
    def matters(self) -> bool:
        """Whether it changes what was held out by more than next to nothing; what is assumed or was found before all
        else always does.
        """
        before, after = self.evidence.heldout_before, self.evidence.heldout_after
        return self.said == ASSUMED or before is None or after is None or before**2 - after**2 > (NOTHING * after) ** 2


@dataclass(frozen=True, slots=True)
class RemarkEntry:
    """Something that is there beyond chance and is no finding. parameters : {name: Value}; reason : why, in a sentence;
    p_value : of chance.
    """

    effect: str
    place: str
    parameters: dict[str, Value]
    reason: str
    p_value: float | None = None


@dataclass(frozen=True, slots=True)
class Unexplained:
    """The largest of what no catalogued effect explains. depends_on : names of covariates, none for scatter."""

    place: str
    magnitude: float
    unit: str
    depends_on: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FitEntry:
    """Misfit of stretches held out in one unit, with nothing admitted and with all; noise_floor : what noise alone
    leaves.
    """

    heldout_before: float
    heldout_after: float
    noise_floor: float
    unit: str


@dataclass(frozen=True, slots=True)
class NotTestedEntry:
    """An effect that the recording cannot show, and why."""

    effect: str
    reason: str


@dataclass(frozen=True, slots=True)
class ShareEntry:
    """Share of the squares left that a covariate explains, with nothing admitted and with all; p_value : of chance,
    with all.
    """

    before: float
    after: float
    p_value: float


@dataclass(frozen=True, slots=True)
class SuggestionEntry:
    """A formula for something without a name. formula; where : what its symbols stand for; parameters : {name: Value};
    covariates : their names
    heldout_before, heldout_after : RMS in unit on stretches held out whole, by formulas chosen and fitted without them;
        noise : what noise leaves
    gain_sigma : standard errors by which they gain; parts : covariates that were chosen without each of the stretches;
        model : its terms"""

    place: str
    formula: str
    where: str
    parameters: dict[str, Value]
    covariates: tuple[str, ...]
    heldout_before: float
    heldout_after: float
    noise: float
    unit: str
    gain_sigma: float
    parts: tuple[tuple[str, ...], ...]
    model: Written


def suggested_formula_entries(suggestions: Sequence[Suggestion]) -> tuple[SuggestionEntry, ...]:
    """Entries of suggested formulas, in their order."""
    out = []
    for s in suggestions:
        units = {p.name: p.unit for p in s.effect.parameters_at(s.place)}
        parameters = {name: Value(value, units[name], [low, high]) for name, (value, low, high) in s.intervals.items()}
        out.append(
            SuggestionEntry(
                s.place,
                s.written.text().replace("np.", ""),
                s.written.where(),
                parameters,
                tuple(q.name for q in s.written.quantities),
                s.before,
                s.after,
                s.noise,
                s.unit,
                s.gain,
                s.parts,
                s.written,
            )
        )
    return tuple(out)


@dataclass(frozen=True, slots=True)
class EffectsFile:
    """A file of effects of the operator's own that were asked for besides the catalogue. sha256 : of its bytes;
    effects : their names.
    """

    file: str
    sha256: str
    effects: tuple[str, ...]


def effect_file_entries(plugins: tuple[Plugin, ...]) -> tuple[EffectsFile, ...]:
    """Entries of a user's effect files, in their order.

    File name, hash and effects.
    """
    return tuple(
        EffectsFile(plugin.path.name, plugin.sha256, tuple(kind.name for kind in plugin.kinds)) for plugin in plugins
    )


@dataclass(frozen=True, slots=True)
class CovariateEntry:
    """What is left against one covariate. explains : {"struts" | "images" | "joints": ShareEntry}"""

    name: str
    explains: dict[str, ShareEntry]


def ranked_covariate_entries(covariates: list[Covariate]) -> tuple[CovariateEntry, ...]:
    """Entries of ranked covariates.

    In their order.
    """
    return tuple(
        CovariateEntry(
            c.name,
            {what: ShareEntry(s.share, c.after[what].share, c.after[what].p_value) for what, s in c.before.items()},
        )
        for c in covariates
    )


@dataclass(frozen=True, slots=True)
class RecordingEntry:
    """One of several recordings together. frames, t_s : what is added to its frames' numbers and to its times (s) among
    all
    """

    name: str
    frames: int
    t_s: float


def recording_entries(parts: tuple[RecordingPart, ...]) -> tuple[RecordingEntry, ...]:
    """Entries of several recordings' parts.

    None for one alone.
    """
    return tuple(RecordingEntry(part.recording.name, part.frames, part.t) for part in parts)


def json_tree_of_dataclasses(value: object) -> object:
    """JSON tree of dicts and lists.

    Of dataclasses, optional fields that are None or empty are left out.
    """
    if is_dataclass(value):
        items = {f.name: getattr(value, f.name) for f in fields(value)}
        return {name: json_tree_of_dataclasses(v) for name, v in items.items() if v is not None}
    if isinstance(value, dict):
        return {name: json_tree_of_dataclasses(v) for name, v in value.items()}
    return [json_tree_of_dataclasses(v) for v in value] if isinstance(value, (list, tuple)) else value


def kind_of_prior_statement_on_effect(stated_terms: StatedTerms, effect: str, place: str) -> str | None:
    r"""Kind of statement made beforehand of an effect at a place.

    Assumed, seen before, or None.
    """
    site = (effect, place)
    return ASSUMED if site in stated_terms.assumed else SEEN_BEFORE if site in stated_terms.before else None


def finding_entry_before_search(measured_finding: MeasuredFinding) -> FindingEntry:
    """FindingEntry of a finding that was measured before the search."""
    return FindingEntry(
        measured_finding.kind.name,
        measured_finding.place,
        measured_finding.parameters,
        action=measured_finding.kind.action_at(measured_finding.place),
    )


# Any: candidates, of each kind of machine their own
def finding_entry(diagnosis: Diagnosis, finding: Finding[Any], cross_validation: CrossValidation) -> FindingEntry:
    """FindingEntry of a Finding and how it predicts held-out data."""
    problem, fit, score = diagnosis.selection.problem, diagnosis.selection.fit, finding.score
    candidate = problem.terms(fit)[finding.number]
    kind, place = candidate.kind, candidate.place
    parameters = diagnosis.evidence.parameters(diagnosis.selection, finding, diagnosis.origin)
    evidence = Evidence(
        score.delta_bic(problem.size(fit)),
        min(1.0, score.p_value * diagnosis.selection.candidate_count),
        cross_validation.before,
        cross_validation.after,
        cross_validation.unit,
        cross_validation.gain,
    )
    others = tuple(
        AlternativeEntry(
            other.name,
            other.place,
            a.behind,
            a.cosine,
            text_of_experiment_separating_hypotheses((kind, place), (other.kind, other.place)),
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
        kind_of_prior_statement_on_effect(diagnosis.options.given, candidate.name, place),
        unusual_size_reason(kind, place, parameters),
    )


def negligible_finding_remark_entries(diagnosis: Diagnosis) -> list[RemarkEntry]:
    """Entries of a Diagnosis' remarks on negligible findings.

    What is there beyond chance and does not matter.

    What was fitted, what was left, what tolerances were seen to be.
    """
    terms, out = diagnosis.selection.problem.terms(diagnosis.selection.fit), []
    for f, reason in diagnosis.tolerable.findings:
        out.append(
            RemarkEntry(
                terms[f.number].name,
                terms[f.number].place,
                diagnosis.evidence.parameters(diagnosis.selection, f, diagnosis.origin),
                remark_reason_sentence(reason),
                min(1.0, f.score.p_value * diagnosis.selection.candidate_count),
            )
        )
    out += [
        RemarkEntry(UNKNOWN, str(u.place), _size_of(u), remark_reason_sentence(reason), u.p_value)
        for u, reason in diagnosis.tolerable.left
    ]
    return out + [
        RemarkEntry(r.effect, r.place, r.parameters, remark_reason_sentence(r.reason), r.p_value)
        for r in diagnosis.tolerable.remarks
    ]


def remark_reason_sentence(reason: str) -> str:
    """Sentence with the reason of a remark."""
    return f"No more than {reason}."


def largest_unexplained_part(diagnosis: Diagnosis) -> Unexplained | None:
    """Largest unexplained part of a Diagnosis.

    It is a lack of fit, else the scatter of poses beyond their stated noise, or None.
    """
    if diagnosis.left:
        first = diagnosis.left[0]
        return Unexplained(str(first.place), first.magnitude, first.unit, first.depends_on)
    if isinstance(diagnosis.evidence, ScatterSize):
        beyond, unstated = diagnosis.evidence.scatter_beyond_stated(diagnosis.selection)
        unit = diagnosis.misfits[diagnosis.shown_in].unit
        return Unexplained("rig", beyond, unit, ()) if unstated else None
    return None


def unnamed_finding_entries(lacks_of_fit: list[LackOfFit]) -> list[FindingEntry]:
    """Entries of findings without a name.

    They are one for each place with a lack of fit.
    """
    return [
        FindingEntry(UNKNOWN, str(u.place), _size_of(u), Evidence(p_value=u.p_value, delta_chi2=u.delta_chi2))
        for u in first_lack_of_fit_of_each_place(lacks_of_fit)
    ]


def _size_of(left: LackOfFit) -> dict[str, Value]:
    return {"magnitude": Value(left.magnitude, left.unit), "depends_on": Value(list(left.depends_on), "")}


def misfit_before_and_after_entry(fit: Misfit) -> FitEntry:
    """Entry (FitEntry) of a Misfit before and after.

    Held out, without and with the effects found, and what noise alone leaves.
    """
    return FitEntry(fit.before, fit.after, fit.floor, fit.unit)


def text_of_experiment_separating_hypotheses(*sites: tuple[type[Effect], str]) -> str:
    """Text on the experiment that would separate two hypotheses, an effect at a place each."""
    names, shown = [kind.name for kind, _ in sites], [kind.experiment_at(place) for kind, place in sites]
    return shown[0] if names[0] == names[1] else "; ".join(f"{name}: {text}" for name, text in zip(names, shown))


def unusual_size_reason(kind: type[Effect], place: str, parameters: dict[str, Value]) -> str | None:
    """Reason why the size of an effect at a place is unusual, or None."""
    return kind.unusual(place, {key: value.value for key, value in parameters.items()})
