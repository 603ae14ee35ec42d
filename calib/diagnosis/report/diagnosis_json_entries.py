"""Diagnosis JSON entries (diagnosis.json, schema diagnosis/1) as dataclasses, for any machine, in SI units, px."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass

from calib.diagnosis.engine.lack_of_fit_by_smooth_functions import Covariate
from calib.diagnosis.engine.selection_candidates_thresholds_and_outliers import StatedTerms
from calib.diagnosis.problems.evidence_interface_and_requested_effects import Value
from calib.diagnosis.problems.remainder_covariates_temperatures_and_repeats import Suggestion
from rig.effects.texts.effect_file_from_formula import Written
from rig.effects.texts.user_effect_file_loading import Plugin
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
class NotAskedEntry:
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
    """Entries of a user's effect files, in their order: file name, hash and effects."""
    return tuple(
        EffectsFile(plugin.path.name, plugin.sha256, tuple(kind.name for kind in plugin.kinds)) for plugin in plugins
    )


@dataclass(frozen=True, slots=True)
class CovariateEntry:
    """What is left against one covariate. explains : {"struts" | "images" | "joints": ShareEntry}"""

    name: str
    explains: dict[str, ShareEntry]


def covariate_entries(covariates: list[Covariate]) -> tuple[CovariateEntry, ...]:
    """Entries of ranked covariates, in their order."""
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
    """Entries of several recordings' parts; none for one alone."""
    return tuple(RecordingEntry(part.recording.name, part.frames, part.t) for part in parts)


def json_tree(value: object) -> object:
    """JSON tree of dicts and lists; of dataclasses, optional fields that are None or empty are left out."""
    if is_dataclass(value):
        items = {f.name: getattr(value, f.name) for f in fields(value)}
        return {name: json_tree(v) for name, v in items.items() if v is not None}
    if isinstance(value, dict):
        return {name: json_tree(v) for name, v in value.items()}
    return [json_tree(v) for v in value] if isinstance(value, (list, tuple)) else value


def kind_of_statement_beforehand(stated_terms: StatedTerms, effect: str, place: str) -> str | None:
    r"""Kind of statement made beforehand of an effect at a place: assumed, seen before, or None."""
    site = (effect, place)
    return ASSUMED if site in stated_terms.assumed else SEEN_BEFORE if site in stated_terms.before else None
