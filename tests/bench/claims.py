"""Claims, checks and certificates of machines whose physics was left out: stated errors, limits and verdicts against
the truth of 500 poses.

Machines, noise and physics are those of tests/truth. Each is recorded twice, calibrated from the first recording,
verified and certified by the second, and then driven from pose to pose by corrected commands.
"""

import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.cli.command_line import main as run_rig
from tests import truth
from tests.truth.journey import Journey, journey, middle, spread
from tests.truth.laws import Law, stood
from tests.truth.motion import Motion
from tests.truth.rigid import displaced

FITTED, HELD, DRIVEN = 100, 80, 500  # configurations
SIGMA = (5e-6, 4e-5)  # m and rad, of a tracker, a coordinate
SIDE = 0.05  # of the stroke, the last move to a recorded pose


@dataclass(frozen=True)
class Shifted(Law):
    """Zeros that changed once the first recording was over. size : m or rad"""

    size: float

    def beyond(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        """(n, axes) by which axes stand beyond their commands."""
        return np.broadcast_to(self.size * self.axes, (len(motion.at), len(self.axes)))


@dataclass(frozen=True)
class Sinking(Law):
    """A base that tilts and sinks. size : m, over a day"""

    size: float

    def sway(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        """(n, 6) small motion of the platform."""
        return np.outer(self.size * motion.looked / motion.day.room[4], [0.6, -0.5, 0.6, 1.0, 2.0, -1.0])


@dataclass(frozen=True)
class Omission:
    """kind : of machine; effect : of truth.FAULTS, and its strength; zeros, sinks : m; noise : "stated", "twice",
    "slow" (correlated over some 15 poses) or "heavy" (Student's t of 3); below : approached from below alone; part : of
    the first axis' range that is recorded
    """

    kind: str = "hexapod"
    effect: str = "none"
    strength: str = "none"
    zeros: float = 0.0
    sinks: float = 0.0
    noise: str = "stated"
    below: bool = False
    part: float = 1.0


OMISSIONS = {
    "nothing": Omission(),
    "nothing, arm": Omission("arm"),
    "play, weak": Omission(effect="backlash", strength="weak"),
    "play, arm": Omission("arm", "backlash", "strong"),
    "play, from one side": Omission(effect="backlash", strength="strong", below=True),
    "friction": Omission(effect="hysteresis", strength="strong"),
    "friction, arm": Omission("arm", "hysteresis", "weak"),
    "creep": Omission(effect="creep", strength="strong"),
    "screws, weak": Omission(effect="cyclic_error", strength="weak"),
    "transmission, half recorded": Omission(effect="transmission_error", strength="strong", part=0.5),
    "half recorded": Omission(part=0.5),
    "zeros by 10 um": Omission(zeros=1e-5),
    "zeros by 40 um": Omission(zeros=4e-5),
    "base sinks by 30 um": Omission(sinks=3e-5),
    "noise twice as large": Omission(noise="twice"),
    "noise correlated": Omission(noise="slow"),
    "noise with long tails": Omission(noise="heavy"),
}


def noise_of(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 6) m and rad, of an instrument of an Omission's noise."""
    e = rng.standard_t(3, (count, 6)) / np.sqrt(3) if kind == "heavy" else rng.normal(size=(count, 6))
    for k in range(1, count if kind == "slow" else 0):
        e[k] = np.exp(-1 / 15) * e[k - 1] + np.sqrt(1 - np.exp(-2 / 15)) * e[k]
    return e * np.repeat(SIGMA, 3) * (2.0 if kind == "twice" else 1.0)


def recorded(case: truth.Case, omitted: Omission, count: int, laws: tuple[Any, ...], seed: int, folder: Path) -> Path:
    """Folder of a recording of a case's machine at count configurations."""
    rng = np.random.default_rng([seed, count])
    unit = rng.permutation(spread(case.owner.width, count, rng))
    unit[:, 0] *= omitted.part
    places = middle(case.owner.ranges, unit)
    side = -1.0 if omitted.below else rng.choice([-1.0, 1.0], places.shape)
    before = places + side * SIDE * np.ptp(case.owner.ranges, axis=1)
    stops = np.stack([before, places], axis=1).reshape(2 * count, -1)
    path = journey(stops, case.owner.ranges.mean(axis=1), case.speeds, case.dwell)
    path = Journey(path.t, path.values, path.looked[1::2])
    seen = displaced(stood(case.machine, path, case.day, laws), noise_of(omitted.noise, count, rng))
    return truth.record(replace(case, journey=path, seen=truth.rows_of(seen), logged=""), folder)


def printed(*words: str | Path) -> dict[str, Any]:
    """What a command prints as JSON. Raises RuntimeError where it does not do its work."""
    out, error_output = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error_output):
        status = run_rig([*map(str, words), "--json", "--quiet"])
    if status not in (0, 3):
        raise RuntimeError(f"{words[0]}: {error_output.getvalue()[-300:]}")
    return dict(json.loads(out.getvalue()))


def trial(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """What was stated of a machine, and what is true of it, m and rad."""
    omitted = OMISSIONS[name]
    case = truth.draw(seed, omitted.effect, omitted.strength, "shuffled", omitted.kind, count=FITTED)
    case, rng = replace(case, sigma=SIGMA), np.random.default_rng([seed, 5])
    sign = rng.choice([-1.0, 1.0], case.owner.width)
    laws = (*case.laws, Sinking(sign, omitted.sinks))
    later = (*(law.later() for law in case.laws), Sinking(sign, omitted.sinks), Shifted(sign, omitted.zeros))
    fit, held, made = folder / "fit", folder / "held", folder / "calibration.json"
    calibrated = printed("calibrate", recorded(case, omitted, FITTED, laws, seed, fit), "--out", made)
    verified = printed("verify", made, recorded(case, omitted, HELD, later, seed, held))
    certified = printed("certify", made, held, "--scale-uncertainty", "1e-6", "--out", folder / "certificate.json")
    wanted = truth.wanted(case, DRIVEN)
    truth.write_wanted(wanted, folder / "wanted.csv")
    table = folder / "commands.csv"
    printed("correct", made, "--poses", folder / "wanted.csv", "--out", table, "--skip-unreachable")
    rows = np.genfromtxt(table, delimiter=",", skip_header=1)
    real = truth.drive(replace(case, laws=later), rows[:, 1:])
    error = truth.errors(real, wanted[rows[:, 0].astype(int)])
    sizes = np.stack([np.linalg.norm(error[:, part], axis=1) for part in (slice(3), slice(3, 6))], axis=1)
    limit = np.array([certified["promise"]["position_m"], certified["promise"]["rotation_rad"]])
    states = [one["verdict"]["state"] for one in (calibrated, verified, certified)]
    return {
        "name": name,
        "claim": calibrated["claim"]["after"][0],
        "states": states,
        "limit": float(limit[0]),
        "true": truth.rms(error)[0],
        "within": float((sizes <= limit).all(axis=1).mean()),
    }


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted) of each omission and of all."""
    lines = []
    for number, name in enumerate(OMISSIONS):
        with tempfile.TemporaryDirectory() as folder:
            line = trial(name, 100 + number, Path(folder))
        lines.append(line)
        middle_, low, high = (1e6 * value for value in line["claim"])
        claim = f"{middle_:.1f} ({low:.1f} to {high:.1f}) um claimed, {1e6 * line['true']:.1f} um true"
        limit = f"{line['within']:.1%} within {1e6 * line['limit']:.1f} um"
        print(f"{name:30} {claim:48} {limit:26} {' '.join(line['states'])}", file=sys.stderr, flush=True)
    covered = sum(line["claim"][1] <= line["true"] <= line["claim"][2] for line in lines)
    yield "true position error inside the claim's interval", f"{covered} of {len(lines)}", ""
    for command, k in (("calibrate", 0), ("verify", 1)):
        good = [line for line in lines if line["states"][k] == "good"]
        untrue = sum(line["true"] > line["claim"][2] for line in good)
        yield f"{command}: good, and the truth beyond the interval", f"{untrue} of {len(good)}", ""
    kept = sum(line["within"] >= 0.95 for line in lines)
    yield "certificates whose limit 95 % of the driven poses keep", f"{kept} of {len(lines)}", ""
    doubted = sum("good" not in line["states"][:2] for line in lines if line["within"] < 0.95)
    yield "those whose limit is not kept, with a doubt stated", f"{doubted} of {len(lines) - kept}", "all"
