"""One machine of the campaign of truth: recorded, calibrated and corrected through the command line, driven, and
compared.
"""

import contextlib
import io
import json
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from rig.cli import command_line
from tests.bench.result_provenance import commit
from tests.truth import (
    SIGHTS,
    Case,
    draw,
    drive,
    drive_in_time,
    errors,
    record,
    recorded_anew,
    rms,
    wanted,
    write_sensors,
    write_wanted,
)

POSES = 500  # driven to: their RMS is good to some 2 %
TIMED = 80  # driven to in time, where the calibration knows physics
HELD = 6.0  # s beyond the longest move that each pose in time is given


@dataclass(frozen=True)
class CalibrationMethod:
    """kind : of machine; options : of `rig calibrate`; first : options of a calibration on whose top it stands, None
    without
    seen : whether cameras look, in place of an instrument"""

    kind: str = "hexapod"
    options: tuple[str, ...] = ()
    first: tuple[str, ...] | None = None
    seen: bool = False


WAYS = {
    "plain": CalibrationMethod(),
    "find": CalibrationMethod(options=("--find",)),
    "radial": CalibrationMethod(options=("--extend", "radial")),
    "alone": CalibrationMethod(options=("--extend", "radial", "--alone")),
    "auto": CalibrationMethod(options=("--extend", "auto")),
    "onto": CalibrationMethod(options=("--extend", "radial"), first=()),
    "arm": CalibrationMethod("arm"),
    "arm-auto": CalibrationMethod("arm", ("--extend", "auto")),
    "chain": CalibrationMethod("chain"),
    "planar2": CalibrationMethod("planar2"),
    "seen": CalibrationMethod(seen=True),
    "seen-find": CalibrationMethod(options=("--find",), seen=True),
}


@dataclass(frozen=True)
class Trial:
    """seed, way, effect, strength, plan : what is drawn and what is done with it."""

    seed: int
    method: str
    effect: str
    strength: str
    plan: str

    @property
    def name(self) -> str:
        """The machine's name in a campaign's file."""
        return f"{self.method}/{self.effect}/{self.strength}/{self.plan}/{self.seed}"


@cache
def judged() -> str:
    """The commit that is judged, as it was when the first machine was."""
    return commit()


def tried(trial: Trial, folder: Path) -> dict[str, Any]:
    """The line of a trial, run in a folder; with `refused` where a command did not do its work."""
    begun, method = time.process_time(), WAYS[trial.method]
    case = draw(trial.seed, trial.effect, trial.strength, trial.plan, method.kind, seen=method.seen)
    line = {
        "machine": trial.name,
        "way": trial.method,
        "effect": trial.effect,
        "strength": trial.strength,
        "plan": trial.plan,
        "seed": trial.seed,
        "law": _law(case),
        "n_poses": len(case.journey.looked),
        "sigma": case.sigma[0] if case.camera_set is None else case.camera_set.sigma,
        "size": case.size,
        "commit": judged(),
    }
    try:
        calibration, state = _calibrated(case, method, folder)
        line |= {"state": state} | _driven(case, calibration, folder)
    except Refused as refusal:
        line["refused"] = str(refusal)
    return line | {"seconds": round(time.process_time() - begun, 2)}


class Refused(Exception):
    """A command that ended with another status than 0, and its last words."""


def _law(case: Case) -> str | None:
    """The name of the law of a case's fault, of seeing or of moving."""
    if case.laws:
        return type(case.laws[0]).__name__
    return type(case.camera_set.fault).__name__ if case.camera_set is not None and case.effect in SIGHTS else None


def _rig(*words: str | Path) -> str:
    """What a command prints on the standard output. Raises Refused."""
    out, error_output = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error_output):
        status = command_line.main([*map(str, words), "--quiet"])
    if status:
        raise Refused(f"{words[0]}: {' '.join((out.getvalue() + error_output.getvalue()).split())[-300:]}")
    return out.getvalue()


def _calibrated(case: Case, method: CalibrationMethod, folder: Path) -> tuple[Path, str]:
    """(calibration.json, its verdict) of a case recorded in a folder."""
    made = folder / "calibration.json"
    options = list(method.options)
    if method.first is not None:
        _rig("calibrate", record(case, folder / "first"), *method.first, "--out", folder / "first.json")
        case, options = recorded_anew(case, case.plan), [*options, "--onto", str(folder / "first.json")]
    result = json.loads(_rig("calibrate", record(case, folder / "recording"), *options, "--out", made, "--json"))
    return made, result["verdict"]["state"]


def _driven(case: Case, calibration: Path, folder: Path) -> dict[str, Any]:
    """What a calibration claims, and what comes of its commands."""
    stored = json.loads(calibration.read_text())
    claim = stored["claim"]["after"]
    if claim is None:
        raise Refused(f"no factor is claimed: {stored['claim']['reason']}")
    poses = wanted(case, POSES)
    error, covariance = (
        _in_time(case, calibration, poses, folder)
        if "physics" in stored
        else _at_rest(case, calibration, poses, folder)
    )
    true = rms(error)
    return {
        "true": true[0],
        "true_rad": true[1],
        "claim": claim[0],
        "claim_rad": claim[1],
        "covered": claim[0][1] <= true[0] <= claim[0][2],
        "covered_rotation": claim[1][1] <= true[1] <= claim[1][2] or case.kind == "planar2",
        "driven": len(error),
        "unexplained": len(stored["claim"].get("unexplained", ())),
        "ellipsoids": _inside(error, covariance, case.kind),
    }


def _at_rest(case: Case, calibration: Path, poses: np.ndarray, folder: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """(errors (n, 6), covariance (n, 6, 6) or None) of poses come to in the recording's own pace."""
    write_wanted(poses, folder / "wanted.csv")
    _rig(
        "correct", calibration, "--poses", folder / "wanted.csv", "--out", folder / "commands.csv", "--skip-unreachable"
    )
    rows = _rows(folder / "commands.csv")
    return errors(drive(case, rows[:, 1:]), poses[rows[:, 0].astype(int)]), _covariance(folder / "commands.poses.csv")


def _in_time(case: Case, calibration: Path, poses: np.ndarray, folder: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """The same for a calibration that knows physics: commands with times and the sensors' log, day after day as long as
    the recorded one.
    """
    longest = float((0.8 * np.ptp(case.owner.ranges, axis=1) / case.speeds).max())
    every = 2 * longest + case.dwell + HELD
    room = max(int((case.journey.t[-1] - 1) / every), 1)
    found, stated = [], []
    for start in range(0, min(TIMED, len(poses)), room):
        part = poses[start : min(start + room, TIMED)]
        day = folder / f"day{start}"
        day.mkdir()
        t = 1 + every * np.arange(1, len(part) + 1)
        write_wanted(part, day / "wanted.csv", t)
        log = []
        if case.logged:
            write_sensors(case, day / "sensors.csv", max(t[-1], case.journey.t[-1]) + 10)
            log = ["--sensors", day / "sensors.csv"]
        _rig(
            "correct",
            calibration,
            "--poses",
            day / "wanted.csv",
            *log,
            "--out",
            day / "commands.csv",
            "--skip-unreachable",
        )
        rows = _rows(day / "commands.csv")
        held = np.isfinite(rows[:, 0])
        part, looked = part[rows[held, 0].astype(int)], t[rows[held, 0].astype(int)]
        found.append(errors(drive_in_time(case, rows[:, 1], rows[:, 2:], looked), part))
        stated.append(_covariance(day / "commands.poses.csv"))
    return np.concatenate(found), np.concatenate(stated) if all(s is not None for s in stated) else None


def _rows(path: Path) -> np.ndarray:
    return np.atleast_2d(np.genfromtxt(path, delimiter=",", skip_header=1))


def _covariance(path: Path) -> np.ndarray | None:
    """(n, 6, 6) of a table of poses, None where there is none."""
    if not path.exists():
        return None
    rows = np.atleast_2d(np.genfromtxt(path, delimiter=",", names=True))[0]
    upper = np.stack([rows[f"c{i}{j}"] for i in range(6) for j in range(i, 6)], axis=-1)
    out = np.zeros((len(upper), 6, 6))
    i, j = np.triu_indices(6)
    out[:, i, j] = out[:, j, i] = upper
    return out


def _inside(error: np.ndarray, covariance: np.ndarray | None, kind: str) -> list[int] | None:
    """[within the ellipsoids of the whole pose, of the position alone, of how many]; of a hinge its two coordinates
    count as both.
    """
    if covariance is None:
        return None
    out = []
    for axes in ((0, 1),) * 2 if kind == "planar2" else (range(6), range(3)):
        part = np.ix_(range(len(error)), axes, axes)
        square = np.einsum(
            "ni,ni->n", error[:, list(axes)], np.linalg.solve(covariance[part], error[:, list(axes), None])[..., 0]
        )
        out.append(int((square <= chi2.ppf(0.95, len(axes))).sum()))
    return [*out, len(error)]
