"""Report of a diagnosis: its content as data, its summary, its verdict, and diagnosis.json written."""

from dataclasses import dataclass, field, fields

from calib.certification.calibration_evidence import ALONE, OfCalibrations
from calib.diagnosis.engine.excluded_outliers import Crowd, LeftOut
from calib.diagnosis.problems.measured_evidence import ASSUMED_NOISE, RESIDUALS, STATED
from calib.diagnosis.report.diagnosis_json import (
    SCHEMA,
    UNKNOWN,
    CovariateEntry,
    EffectsFile,
    FindingEntry,
    FitEntry,
    NotAskedEntry,
    RecordingEntry,
    RemarkEntry,
    SuggestionEntry,
    Unexplained,
    json_tree,
)
from calib.diagnosis.report.report_sentences import (
    as_sentence,
    finding_size_text,
    finding_title,
    many_outliers_sentence,
    stated_beforehand_text,
    value_text,
)
from calib.samples.confounded_conditions import Confounds
from rig.formats.json_tree import Json
from rig.report.pages.html_elements import result_html


@dataclass(frozen=True, slots=True)
class Report:
    """Of one recording, or of several. start_s : s, the recording's start by the owner's clock; noise : {corner_px,
    pose_m, pose_rad, strut_m}
    findings : biggest first; unexplained : the largest of what has no name; not_asked : what the recording cannot show
    fits : {"corners" | "closures" | "poses": FitEntry}; fit : that of the first finding; remarks : what is there and is
        nobody's fault
    covariates : what is left goes with, the one that explained most before first; said : what the operator said
        beforehand, as options
    recordings : where it is several, which; own_effects : files of effects that were asked for besides the catalogue
    suggestions : formulas for what has no name
    more : what one kind of machine has to say besides; confounds : of the recording, None where nothing was commanded
    left_out : rows that agree with no others, left out before anything was searched; crowd : what is far off in too
        many to be left out, or None
    noise_from : "stated"; "residuals" where nobody states a corner's noise and the residuals determine it; "assumed"
    where nobody states the poses' noise
    calibrations : OfCalibrations, of those made from the recording that are beside it
    asked : how many hypotheses, an effect at a place each, were held against the recording"""

    recording: str
    start_s: float
    noise: dict[str, float | None]
    findings: tuple[FindingEntry, ...]
    unexplained: Unexplained | None
    fits: dict[str, FitEntry]
    fit: FitEntry
    not_asked: tuple[NotAskedEntry, ...]
    remarks: tuple[RemarkEntry, ...] = ()
    covariates: tuple[CovariateEntry, ...] = ()
    said: tuple[str, ...] = ()
    recordings: tuple[RecordingEntry, ...] = ()
    own_effects: tuple[EffectsFile, ...] = ()
    suggestions: tuple[SuggestionEntry, ...] = ()
    more: Json = field(default_factory=dict)
    confounds: Confounds | None = None
    noise_from: str = STATED
    left_out: tuple[LeftOut, ...] = ()
    crowd: Crowd | None = None
    calibrations: OfCalibrations = ALONE
    asked: int = 0

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        rows = [(finding_title(f), finding_size_text(f).removeprefix(", "), f.action or "") for f in self.findings]
        return result_html(summary_sentence(self), [], [("what", "size", "what to do"), *rows] if rows else [])

    @property
    def named(self) -> list[FindingEntry]:
        """The findings that have a name."""
        return [f for f in self.findings if f.effect != UNKNOWN]

    @property
    def mattering(self) -> list[FindingEntry]:
        """Of those, the ones that change what was held out."""
        return [f for f in self.named if f.matters]

    @property
    def unknown(self) -> list[FindingEntry]:
        """The findings that have none."""
        return [f for f in self.findings if f.effect == UNKNOWN]

    def tree(self) -> Json:
        """The tree of diagnosis.json, without the verdict."""
        apart = ("more", "confounds", "calibrations", "asked", *(() if self.recordings else ("recordings",)))
        own = {f.name: json_tree(getattr(self, f.name)) for f in fields(self) if f.name not in apart}
        return {
            "schema": SCHEMA,
            **own,
            "unexplained": json_tree(self.unexplained),
            **self.more,
            "crowd": json_tree(self.crowd),
            "confounds": self.confounds and self.confounds.tree(),
        }


def summary_sentence(report: Report) -> str:
    """Summary sentence of a Report: the findings, the biggest first, and what is unexplained."""
    worst, left = report.unexplained, ""
    if worst is not None:
        left = (
            f"something at {worst.place} that nothing in the catalogue explains, "
            f"{value_text(worst.magnitude, worst.unit)}"
        )
        left += f", going with {' and '.join(worst.depends_on)}" if worst.depends_on else ""
    if not report.named:
        return f"There is {left}." if left else _all_clear_sentence(report)
    main = report.mattering or report.named
    said = [f"{finding_title(f)}{finding_size_text(f)}{stated_beforehand_text(f)}" for f in main]
    fewer = len(report.named) - len(main)
    slight = "1 more is significant and changes" if fewer == 1 else f"{fewer} more are significant and change"
    said += [f"{slight} what was held out by next to nothing"] if fewer else []
    text = "; ".join([*said, *([f"besides, {left}"] if left else [])])
    doubtful = [f.effect.replace("_", " ") for f in main if f.cannot_be_told_from]
    text += (
        f". This recording alone cannot tell the {' and the '.join(doubtful)} from everything else: see there"
        if doubtful
        else ""
    )
    return as_sentence(text)


def _all_clear_sentence(report: Report) -> str:
    """What it is worth that nothing was found: nothing, where nobody states the noise."""
    if report.crowd is not None:
        return f"Nothing in the catalogue was found, and {many_outliers_sentence(report.crowd)}."
    if report.noise_from == ASSUMED_NOISE:
        return (
            "Nothing was found, which proves nothing: nobody states the noise of the poses, and what is left "
            "of them was taken for it. State it: "
            "position_sigma and rotation_sigma in [instrument] of rig.toml."
        )
    whence = (
        ", which what is left of the corners determines: nobody states it" if report.noise_from == RESIDUALS else ""
    )
    return f"Nothing is left out: the recording and the model of the rig agree within the noise{whence}."
