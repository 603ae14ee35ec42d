"""The verdict on a recording's model by its diagnosis; and which calibrations made from that recording a diagnosis speaks against."""

import json
import math
from collections.abc import Iterable
from pathlib import Path

from calib.diagnose.report import words
from calib.diagnose.report.report import Report, summary
from calib.diagnose.report.schema import ASSUMED_NOISE, UNKNOWN, FindingEntry
from rig.files import write_text
from rig.judgement import Evidence, Missing, State, Verdict, judge
from rig.provenance import Marks, shared

LARGEST = 50_000_000  # bytes of a file that is looked into
ROWS = "Look at the rows that were left out, below: record those configurations once more"
TAKE_IN = "Let the calibration take it in: `rig calibrate REC --diagnosis DIR --out calibration.json`"


def judged(report: Report) -> Verdict:
    """The verdict of a Report: check where something that matters is left out of the model or has no name, bad where that refutes a calibration."""
    named = [f"the model leaves out {words.title(f)}" for f in report.mattering]
    unknown = [f"nothing in the catalogue explains what is at {f.place}" for f in report.unknown]
    if not unknown and report.unexplained is not None:
        unknown = [f"nothing in the catalogue explains what is at {report.unexplained.place}"]
    if report.crowd is not None:
        unknown.append("too many rows agree with no others for any to be left out")
    assumed = report.noise_from == ASSUMED_NOISE
    missing = [Missing("nobody states the noise of the poses, against which anything left out would show")] if assumed else []
    if report.left_out:
        count = len(report.left_out)
        agreeing = f"{count} rows agree with no others and were" if count > 1 else "1 row agrees with no others and was"
        missing.append(Missing(f"{agreeing} left out", ROWS))
    steps = to_do(report)
    said = summary(report).removesuffix(".")
    return judge(Evidence(said[0].lower() + said[1:], tuple(steps), unexplained=tuple(dict.fromkeys([*named, *unknown])),
                          missing=tuple(missing), refuted=report.refuted, look=TAKE_IN if named else steps[0], named=True))


def write(folder: Path, report: Report) -> None:
    """Write diagnosis.json into a folder: the Report's tree, its verdict after its schema."""
    tree = report.tree()
    write_text(folder / "diagnosis.json", json.dumps({"schema": tree["schema"], "verdict": judged(report).tree(), **tree}, indent=1) + "\n")


def to_do(report: Report) -> list[str]:
    """What an owner does next with a Report."""
    actions = [f"{words.title(f)[0].upper()}{words.title(f)[1:]}: {f.action}".removesuffix(".") for f in report.mattering or report.named if f.action]
    if report.named:
        return [*actions, TAKE_IN]
    if report.suggestions:
        return ["Have the formula for it asked for, and edit it: `rig effects --new NAME --from DIR`, then `rig diagnose --effects NAME.py`"]
    if report.findings or report.crowd is not None:
        return ["Look at what it goes with below, and record what may cause it: temperature, load, time"]
    if report.noise_from == ASSUMED_NOISE:
        return ["State the noise of the poses, position_sigma and rotation_sigma in [instrument] of rig.toml, and diagnose again"]
    return ["Nothing: calibrate from this recording, `rig calibrate REC --out calibration.json`"]


def against(report: Report, of: Marks, paths: Iterable[Path]) -> list[tuple[Path, State, str]]:
    """[(calibration's file, BAD where it is refuted or CHECK, what was found)] of files made from this recording that know nothing of a finding.

    of : marks of the recording; paths : files that may be calibrations, all else is passed over
    """
    out = []
    for path in paths:
        tree = _calibration(path)
        if tree is None or not shared(of, set(tree["provenance"].get("data", ()))):
            continue
        physics = tree.get("physics") or {}
        known = {(e.get("effect"), e.get("place")) for e in physics.get("effects", ()) if isinstance(e, dict)}
        known |= {(UNKNOWN, e.get("place")) for e in physics.get("unknown", ()) if isinstance(e, dict)}
        left = [f for f in report.mattering if (f.effect, f.place) not in known]
        nameless = [f.place for f in report.unknown if (f.effect, f.place) not in known]
        if left or nameless:
            state, claimed = _beyond(left, tree)
            found = [f"it leaves out {'; '.join(words.title(f) + words.size(f) for f in left)}"] if left else []
            found += [f"nothing in the catalogue explains what is at {', '.join(nameless)}"] if nameless else []
            out.append((path, state, "; ".join(found) + (f", where {claimed * 1e6:.3g} um is claimed" if claimed is not None else "")))
    return out


def _beyond(left: list[FindingEntry], tree: dict) -> tuple[State, float | None]:
    """(BAD where what findings explain is larger than what is claimed and the claim leaves nothing unexplained, that claim m or None).

    A claim that names what it leaves unexplained has that in its interval: a finding then gives it its name, and refutes nothing
    """
    claim = tree.get("claim") or {}
    after = claim.get("after")
    claimed = float(after[0][2]) if after else None
    sizes = [math.sqrt(max(f.evidence.heldout_before**2 - f.evidence.heldout_after**2, 0.0)) for f in left
             if f.evidence.unit == "m" and f.evidence.heldout_before is not None and f.evidence.heldout_after is not None]
    return (State.BAD if not claim.get("unexplained") and claimed is not None and sizes and max(sizes) > claimed else State.CHECK), claimed


def _calibration(path: Path) -> dict | None:
    """The tree of a calibration's file, None of what is none."""
    if path.stat().st_size > LARGEST:
        return None
    try:
        tree = json.loads(path.read_bytes())
    except ValueError:  # another file that ends in .json
        return None
    own = isinstance(tree, dict) and str(tree.get("schema", "")).startswith("calibration/") and isinstance(tree.get("provenance"), dict)
    return tree if own else None
