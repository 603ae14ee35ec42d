"""Why a machine is not where its model says.

In five lines, from its data, by calibration and diagnosis.
"""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from calib.api.calibrate import CalibrateOptions, CalibrationResult, calibrate
from calib.api.diagnose import DiagnoseOptions, DiagnosisResult, diagnose
from calib.api.next_experiment import NextExperiment
from calib.api.options_and_imported_data_of_why import (
    WhyOptions,
    recording_and_whether_noise_is_assumed,
    require_existing_data_path,
)
from calib.certification.calibration_dataclass_and_claim_sentences import ratio_interval_text
from calib.certification.held_out_pose_error_statistics import Figures, HeldOut
from calib.certification.platform_certification import Progress, ignore_progress
from calib.diagnosis.report.diagnosis_json_entries import FindingEntry
from calib.diagnosis.report.diagnosis_sentences_and_table_rows import finding_size_text, finding_title
from calib.files.calibration_file import save
from calib.models.arm.arm_certification import CertifiedArm
from calib.samples.position_confounds_and_poses_on_one_clock import confound_sentences
from rig.array_and_json_types import Json
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import require_single_hand_mechanism
from rig.model.pose import direction_difference
from rig.recording.recording_folder import Recording
from rig.report.axis_places_with_joint_names import text_with_joint_names
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import WORST, Verdict, result_html
from vision.checks.severe_mistake_refusal_and_cube_placement_remarks import Notice, ignore_notice

QUESTIONS = ("how wrong", "why", "how sure", "what to do", "measure next")
MENTIONED = 3  # findings in a line
NOTHING_STATED = WhyOptions()  # data that state their machine themselves
SAME = 1e-9  # rad or m; commands so near are one configuration
SHARE = 0.01  # of the mean square error, from which on the geometry is part of why


@dataclass(frozen=True, slots=True)
class RepeatedConfigurations:
    """Configurations that were visited more than once. count : of them; position : m, rotation : rad, RMS distance of
    their poses from their mean, None of what was not measured
    """

    count: int
    position: float | None
    rotation: float | None

    def __str__(self) -> str:
        sizes = [
            text(value) for value, text in ((self.position, _length), (self.rotation, _angle)) if value is not None
        ]
        if not sizes:
            return f"repeatability unknown: lengths alone were measured of {self.count} repeated configurations"
        return f"repeatability {' and '.join(sizes)} RMS over {self.count} repeated configurations"


@dataclass(frozen=True, slots=True, eq=False)
class WhyResult:
    """recording; calibrated : its calibration; diagnosed : its diagnosis; next : the experiment that tells more, None
    where none can be foretold, and then why in no_next; repeats : RepeatedConfigurations, None without
    geometry : HeldOut of the geometry alone, None where it was not worked out apart; noise_is_assumed : whether nobody
    stated the poses' noise
    """

    recording: Recording
    calibrated: CalibrationResult
    diagnosed: DiagnosisResult
    next: NextExperiment | None
    no_next: str
    repeats: RepeatedConfigurations | None
    geometry: HeldOut | None
    noise_is_assumed: bool

    @property
    def verdict(self) -> Verdict:
        """The worse one of the verdicts on the calibration and on the diagnosis."""
        return min((self.calibrated.verdict, self.diagnosed.verdict), key=lambda one: WORST.index(one.state))

    def answers(self) -> dict[str, str]:
        """{question: answer} of QUESTIONS, a line each."""
        answers = self._how_wrong(), self._why(), self._how_sure(), self._to_do(), self._measure()
        names = self.recording.design.joint_names
        return {question: text_with_joint_names(answer, names) for question, answer in zip(QUESTIONS, answers)}

    def lines(self) -> list[str]:
        """The five lines."""
        return [f"{question}: {answer}" for question, answer in self.answers().items()]

    def __str__(self) -> str:
        return self.lines()[0]

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines()[1:])

    def tree(self) -> Json:
        """What `rig why --json` prints."""
        held = self.calibrated.calibration.held_out
        return {
            "schema": "why/1",
            "verdict": self.verdict.tree(),
            "unit": {"position": "m", "rotation": "rad"},
            "answers": self.answers(),
            "held_out": held and asdict(held),
            "geometry_alone": self.geometry and asdict(self.geometry),
            "repeatability": self.repeats and asdict(self.repeats),
            "noise_is_assumed": self.noise_is_assumed,
            "findings": [
                {"effect": one.effect, "place": one.place, "matters": one.matters}
                for one in self.diagnosed.report.findings
            ],
            "next": self.next and self.next.tree(),
        }

    def _how_wrong(self) -> str:
        held = self.calibrated.calibration.held_out
        if held is None:
            return "unknown: too few distinct configurations were measured to hold any out"
        return f"the stated model is off by {_size(held.before)}, on {held.before.n} poses that were held out" + (
            " (where the instrument stands and what it sees are fitted)" if self._is_placed else ""
        )

    @property
    def _is_placed(self) -> bool:
        instrument = self.calibrated.sampled.instrument
        return instrument is not None and "free" in (instrument.base, instrument.tool)

    def _why(self) -> str:
        report, held = self.diagnosed.report, self.calibrated.calibration.held_out
        parts: list[str] = []
        known = _share(held.before, (self.geometry or held).after) if held is not None else 0.0
        if self.geometry is not None and held is not None and known > SHARE:
            parts.append(
                f"the geometry differs from the stated one ({known:.1%} of the mean square error: "
                f"{_size(held.before, False)} -> {_size(self.geometry.after, False)})"
            )
        elif held is not None and known > SHARE and not report.mattering:
            parts.append(f"the geometry differs from the stated one ({known:.1%} of the mean square error)")
        parts += _effect_texts(report.mattering)
        places = list(dict.fromkeys(one.place for one in report.unknown))
        if not places and report.unexplained is not None:
            places = [report.unexplained.place]
        if places:
            more = f" and {len(places) - MENTIONED} more" if len(places) > MENTIONED else ""
            parts.append(f"nothing we know explains the rest (at {_joined_places(places[:MENTIONED])}{more})")
        elif self._noise_excess:
            parts.append(
                f"poses scatter {self._noise_excess} as much as the {self._noise_word} noise: it is larger, or "
                "something moves the machine at random, which these poses do not distinguish"
            )
        elif not parts:
            parts.append("nothing beyond the noise was found")
        return "; ".join(parts)

    @property
    def _noise_word(self) -> str:
        return "assumed" if self.noise_is_assumed else "stated"

    @property
    def _noise_excess(self) -> str:
        """Factors by which poses surely scatter beyond their stated noise, "" for none."""
        factors = self.diagnosed.report.noise_times.items()
        return " and ".join(f"{v.value:.2g} times in {kind}" for kind, v in factors if v.ci95 and v.ci95[0] > 1)

    def _how_sure(self) -> str:
        held, floor = self.calibrated.calibration.held_out, []
        if self.repeats is not None:
            floor.append(str(self.repeats))
        else:
            floor.append("repeatability unknown, as no configuration was visited twice")
        if held is None:
            return "; ".join(["no error could be held out", *floor])
        stated = ", assumed: --position-sigma and --rotation-sigma state it" if self.noise_is_assumed else ""
        noise = held.floor[0] if math.isfinite(held.floor[0]) else held.floor[1]
        unit = _length(noise) if math.isfinite(held.floor[0]) else _angle(noise)
        exceeded = f", which the residuals exceed: {self._noise_excess}" if self._noise_excess else ""
        floor.append(f"{'no floor is known: ' if exceeded else ''}measurement noise {unit}{stated}{exceeded}")
        return (
            f"after calibration {_size(held.after)} on the same held-out poses, {ratio_interval_text(held.ratio)}; "
            f"{'' if exceeded else 'floor: '}{'; '.join(floor)}"
        )

    def _to_do(self) -> str:
        report, verdict = self.diagnosed.report, self.calibrated.verdict
        use = "use corrected commands (`rig correct calibration.json --poses wanted.csv --out commands.csv`)"
        if verdict.state == WORST[0]:
            return f"do not use the calibration yet: {verdict.why}"
        strongest = next((one for one in report.mattering if one.action), None)
        if strongest is None:
            return use
        return f"{finding_title(strongest)}: {(strongest.action or '').removesuffix('.')}; until then {use}"

    def _measure(self) -> str:
        report = self.diagnosed.report
        if self.next is not None and self.next.experiments:
            return str(self.next).removeprefix("next: ")
        confounds = confound_sentences(report.confounds)
        if confounds:
            return f"poses in a balanced order (`rig plan RIG.toml --parts sobol:60 --out plan.csv`): {confounds[0]}"
        if self.next is None and self.no_next:
            return self.no_next
        if report.unknown or report.unexplained is not None:
            depends = report.unexplained.depends_on if report.unexplained is not None else ()
            what = f"what the rest goes with ({', '.join(depends[:MENTIONED])})" if depends else "possible causes"
            return f"record {what}: temperature, load, time, in sensors.csv, or each configuration from both directions"
        return "another recording, by which `rig verify calibration.json REC` holds this against new poses"


def _effect_texts(findings: Sequence[FindingEntry]) -> list[str]:
    """Findings as text, those of one effect at several places together; the first ones alone."""
    of_effect: dict[str, list[FindingEntry]] = {}
    for one in findings:
        of_effect.setdefault(one.effect, []).append(one)
    out = []
    for effect, ones in of_effect.items():
        places = _joined_places([one.place for one in ones])
        among = f", the strongest{finding_size_text(ones[0])}" if len(ones) > 1 else finding_size_text(ones[0])
        others = dict.fromkeys(
            f"{o.effect.replace('_', ' ')} at {o.place}" for one in ones for o in one.cannot_be_told_from
        )
        alike = f" (or {', '.join(list(others)[:MENTIONED])}: these data cannot separate them)" if others else ""
        out.append(f"{effect.replace('_', ' ')} at {places}{among}{alike}")
    more = len(out) - MENTIONED
    return [*out[:MENTIONED], *([f"{more} more effects"] if more > 0 else [])]


def _joined_places(places: Sequence[str]) -> str:
    """Places as text, those of one kind by their numbers: "joints 1, 2"."""
    numbers: dict[str, list[int]] = {}
    for place in dict.fromkeys(places):
        word, _, number = place.rpartition(" ")
        numbers.setdefault(word if number.isdecimal() else place, []).extend(
            [int(number)] if number.isdecimal() else []
        )
    return ", ".join(
        f"{word}{'s' if len(found) > 1 else ''} {', '.join(map(str, sorted(found)))}" if found else word
        for word, found in numbers.items()
    )


def _share(before: Figures, after: Figures) -> float:
    """Share of a mean square error that is gone."""
    k = 0 if math.isfinite(before.position[0]) else 1
    first, then = ((one.position, one.rotation)[k][0] for one in (before, after))
    return max(0.0, 1 - (then / first) ** 2) if first else 0.0


def _size(figures: Figures, whole: bool = True) -> str:
    """Mean and 95 % of an error, in mm and degrees."""
    parts: list[str] = []
    for name, values, mean, text in (
        ("position", figures.position, figures.mean[0], _length),
        ("rotation", figures.rotation, figures.mean[1], _angle),
    ):
        if math.isfinite(values[0]) and values[0] > 0:
            if not whole:
                return text(values[0]) + " RMS"
            parts.append(f"{text(mean)} on average, 95 % within {text(values[1])}" + (f" ({name})" if parts else ""))
    return "; ".join(parts)


def _length(value: float) -> str:
    return f"{value * 1e3:.3g} mm"


def _angle(value: float) -> str:
    return f"{math.degrees(value):.2g} degrees"


def why(
    data: Path,
    options: WhyOptions = NOTHING_STATED,
    folder: Path | None = None,
    progress: Progress | None = None,
    notice: Notice = ignore_notice,
    links: Sequence[Link] = (),
) -> WhyResult:
    """Why a machine is not where its model says (WhyResult), from its data.

    A recording's folder, a table of joint values and poses, a bag, or a folder of such.
    folder : gets the imported recording, calibration.json, diagnosis.json and diagnosis.html; None to keep nothing
    progress : called with (label, done, of), or None; notice : called with lines on what was read and is unlikely
    links : of the page
    Raises FileError for data that cannot be read, RigError without a model of the machine, for data where nothing was
        commanded and for data whose results would mean nothing, NotEnoughData without poses
    """
    require_existing_data_path(data)
    with tempfile.TemporaryDirectory(prefix="rig-why-") as scratch:
        results = Path(scratch) if folder is None else folder
        recording, assumed = recording_and_whether_noise_is_assumed(data, options, results, notice)
        require_single_hand_mechanism(recording.design.mechanism, "rig why answers")
        _require_commands(recording, data)
        diagnosed = diagnose(recording, DiagnoseOptions(anyway=options.anyway), progress, notice)
        diagnosis = results / "diagnosis"
        diagnosis.mkdir()
        diagnosed.write(diagnosis)
        diagnosed.write_page(results / "diagnosis.html", links)
        with_findings = bool(diagnosed.report.findings) and not recording.design.mechanism.bodies
        calibrating = CalibrateOptions(
            diagnosis=diagnosis if with_findings else None, quick=not with_findings, anyway=options.anyway
        )
        calibrated = calibrate(recording, calibrating, progress)
        save(results / "calibration.json", calibrated.calibration)
        try:
            following, problem = diagnosed.next_experiment(progress=progress or ignore_progress), ""
        except RigError as error:  # a machine of which no plan can be foretold
            following, problem = None, f"no plan can be predicted: {error}"
    geometry = calibrated.done.geometry if isinstance(calibrated.done, CertifiedArm) else None
    return WhyResult(recording, calibrated, diagnosed, following, problem, _repeats(calibrated), geometry, assumed)


def _require_commands(recording: Recording, data: Path) -> None:
    """Raise RigError for a recording of which nobody commanded anything."""
    if not recording.design.mechanism.axes:
        cameras, seen = len(recording.design.cameras), len(recording.exposures.times()[0])
        raise RigError(
            f'{data} is a recording of kind "{recording.design.mechanism.kind}": {cameras} '
            f"camera{'s' if cameras != 1 else ''} watched a body in {seen} frames that nothing commanded, so that no "
            f"command can be wrong. `rig measure {data} --out DIR` gives its poses, `rig diagnose {data} --out DIR` "
            "what cameras and targets leave out"
        )
    if recording.commands is None:
        raise RigError(f"{data}: there is no commands.csv, so nothing was commanded and nothing can be wrong")


def _repeats(calibrated: CalibrationResult) -> RepeatedConfigurations | None:
    """RepeatedConfigurations of a recording, by what was commanded; None where none was visited twice."""
    samples = calibrated.sampled.samples
    _, label, size = np.unique(np.round(samples.commanded / SAME), axis=0, return_inverse=True, return_counts=True)
    label = label.reshape(-1)
    repeated = size[label] > 1
    if not repeated.any():
        return None
    T, p = samples.T_base_platform, samples.T_base_platform.translation
    squares = np.zeros(2)
    free = 0
    for k in np.flatnonzero(size > 1):
        rows = np.flatnonzero(label == k)
        squares[0] += ((p[rows] - p[rows].mean(axis=0)) ** 2).sum()
        if samples.measured == "direction":
            squares[1] += (
                direction_difference(T[np.repeat(rows, len(rows))], T[np.tile(rows, len(rows))]) ** 2
            ).sum() / (2 * len(rows))
        else:
            squares[1] += ((T[rows].rotation.mean().inv() * T[rows].rotation).magnitude() ** 2).sum()
        free += len(rows) - 1
    position, rotation = np.sqrt(squares / free).tolist()
    return RepeatedConfigurations(
        int((size > 1).sum()),
        position if samples.measured in ("pose", "position") else None,
        rotation if samples.measured in ("pose", "orientation", "direction") else None,
    )
