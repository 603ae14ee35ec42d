"""The verdict on a recording's model by its diagnosis, and what a diagnosis says that a calibration leaves out."""

import json
from collections.abc import Collection
from pathlib import Path

from calib.certification.calibration_evidence import confound_sentences
from calib.diagnosis.problems.measured_evidence import ASSUMED_NOISE
from calib.diagnosis.report import report_sentences
from calib.diagnosis.report.diagnosis_json import UNKNOWN
from calib.diagnosis.report.diagnosis_report import Report, summary_sentence
from rig.formats.output_files import write_text
from rig.report.verdict import Evidence, Missing, Verdict, judge_evidence

ROWS = "Look at the rows that were left out, below: record those configurations once more"
TAKE_IN = "Let the calibration take it in: `rig calibrate REC --diagnosis DIR --out calibration.json`"


def diagnosis_verdict(report: Report) -> Verdict:
    """The verdict of a Report: check where something that matters is left out of the model or has no name, or where a
    calibration made from the recording leaves something unexplained; bad where the recording refutes such a
    calibration."""
    left, rest, steps = unexplained_sentences(report), doubts(report), recommended_actions(report)
    besides = tuple(
        Missing(text, TAKE_IN)
        for text in report.calibrations.unexplained
        if text not in (*left, *(one.text for one in rest))
    )
    said = summary_sentence(report).removesuffix(".")
    return judge_evidence(
        Evidence(
            said[0].lower() + said[1:],
            tuple(steps),
            unexplained=left,
            confounds=confound_sentences(report.confounds),
            missing=(*rest, *besides),
            refuted=report.calibrations.refuted,
            look=TAKE_IN if report.mattering else steps[0],
            named=True,
        )
    )


def unexplained_sentences(report: Report, known_physics: Collection[tuple[str, str]] = ()) -> tuple[str, ...]:
    """Sentences on what a Report leaves unexplained by the model. known_physics : (effect, place) already modelled"""
    named = [
        f"the model leaves out {report_sentences.finding_title(f)}"
        for f in report.mattering
        if (f.effect, f.place) not in known_physics
    ]
    unknown = [
        f"nothing in the catalogue explains what is at {f.place}"
        for f in report.unknown
        if (f.effect, f.place) not in known_physics
    ]
    if (
        not report.unknown
        and report.unexplained is not None
        and (UNKNOWN, report.unexplained.place) not in known_physics
    ):
        unknown = [f"nothing in the catalogue explains what is at {report.unexplained.place}"]
    if report.crowd is not None:
        unknown.append("too many rows agree with no others for any to be left out")
    return tuple(dict.fromkeys([*named, *unknown]))


def doubts(report: Report) -> tuple[Missing, ...]:
    """Doubts of a Report: what it assumes and nobody has shown."""
    missing = []
    if report.noise_from == ASSUMED_NOISE:
        missing.append(Missing("nobody states the noise of the poses, against which anything left out would show"))
    if report.left_out:
        count = len(report.left_out)
        agreeing = f"{count} rows agree with no others and were" if count > 1 else "1 row agrees with no others and was"
        missing.append(Missing(f"{agreeing} left out", ROWS))
    return tuple(missing)


def write_diagnosis_json(folder: Path, report: Report) -> None:
    """Write diagnosis.json into a folder: the Report's tree, its verdict after its schema."""
    tree = report.tree()
    write_text(
        folder / "diagnosis.json",
        json.dumps({"schema": tree["schema"], "verdict": diagnosis_verdict(report).tree(), **tree}, indent=1) + "\n",
    )


def recommended_actions(report: Report) -> list[str]:
    """Recommended actions of a Report: what an owner does next."""
    actions = [
        f"{report_sentences.finding_title(f)[0].upper()}{report_sentences.finding_title(f)[1:]}: "
        f"{f.action}".removesuffix(".")
        for f in report.mattering or report.named
        if f.action
    ]
    if report.named:
        return [*actions, TAKE_IN]
    if report.suggestions:
        return [
            "Have the formula for it asked for, and edit it: `rig effects --new NAME --from DIR`, then `rig "
            "diagnose --effects NAME.py`"
        ]
    if report.findings or report.crowd is not None:
        return ["Look at what it goes with below, and record what may cause it: temperature, load, time"]
    if report.noise_from == ASSUMED_NOISE:
        return [
            "State the noise of the poses, position_sigma and rotation_sigma in [instrument] of rig.toml, "
            "and diagnose again"
        ]
    return ["Nothing: calibrate from this recording, `rig calibrate REC --out calibration.json`"]
