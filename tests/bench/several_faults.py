"""Recordings of the independent truth with one, two or three faults: how many of them a diagnosis names and places.

python -m tests.bench several_faults [--faults N] [--recordings N] [--seed S] [--poses N] [--one-axis]
                                        [--kind hexapod|arm|planar2]

Machines at pose level, poses shuffled; each fault of 4 to 20 standard deviations of the instrument, at one axis or at
all. Faults that need a sensor, an hour or a hurry of their own are drawn with their like alone. `--one-axis` draws all
faults of a recording at the same axis.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.api.diagnose import diagnose
from calib.diagnosis.report.diagnosis_json_entries import FindingEntry
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from rig.recording import recording_folder
from tests.truth import FAULTS, Case, draw, errors, record, rms
from tests.truth.case import _seen
from tests.truth.draw_faults import HURRIED, LOADED, SLOW, FaultRequest, fits
from tests.truth.laws import Law, passed, stood

RECORDINGS = 12
POSES = 120
SEEN, TRIES = 3.0, 200  # standard deviations of a coordinate, RMS, that a fault moves poses by; draws until one does
WHOLE = {"time_offset": "clock", "clock_drift": "clock", "base_expansion": "rig", "vibration": "rig"}  # their places
HEATED = ("thermal_expansion", "base_expansion")  # whose thermometers are logged
NOT_OF_ARMS = (*HURRIED, "vibration")  # arms stand still by the time they are looked at; no frequency is searched for
APART = (frozenset(LOADED), frozenset(SLOW), frozenset(HURRIED))  # each needs its own recording


@dataclass(frozen=True)
class Hidden:
    """A fault that is there. axis : "strut 3" or "joint 3", None at all of them; law : its class' name"""

    effect: str
    axis: str | None
    law: str

    def __str__(self) -> str:
        return f"{self.effect} at {WHOLE.get(self.effect, self.axis or 'all')} ({self.law})"

    def is_at(self, place: str) -> bool:
        """Whether a place of the report is the fault's."""
        if self.effect in WHOLE:
            return place == WHOLE[self.effect]
        if self.effect == "thermal_expansion" and (self.axis or "").startswith("joint"):
            return place in (self.axis, "rig")  # an arm's links share a thermometer
        return self.axis is None or place == self.axis

    def is_named(self, findings: tuple[FindingEntry, ...]) -> bool:
        """Whether one of the findings is the fault."""
        return any(f.effect == self.effect and self.is_at(f.place) for f in findings)

    def is_in_stated_set(self, findings: tuple[FindingEntry, ...]) -> bool:
        """Whether a finding lists the fault among what it cannot be told from."""
        return any(a.effect == self.effect and self.is_at(a.place) for f in findings for a in f.cannot_be_told_from)


def drawn(
    seed: int, faults: int, poses: int = POSES, one_axis: bool = False, kind: str = "hexapod"
) -> tuple[Case, list[Hidden]]:
    """(recording of a machine of a kind with so many faults, what they are), all from a seed."""
    rng = np.random.default_rng([seed, faults, one_axis])
    able = [name for name in FAULTS if fits(name, kind) and not (kind == "arm" and name in NOT_OF_ARMS)]
    names = [str(rng.choice(able))]
    while len(names) < faults:
        name = str(rng.choice(able))
        groups = {index for index, group in enumerate(APART) for one in (*names, name) if one in group}
        if name not in names and len(groups) <= 1:
            names.append(name)
    lead = next((one for one in names if any(one in group for group in APART)), names[0])
    case = draw(seed, lead, "strong", "shuffled", kind, count=poses)
    count, word = case.owner.width, "joint" if kind == "arm" else "strut"
    laws, hidden, axis = [], [], int(rng.integers(count))
    for name in names:
        law = _law(case, name, axis if one_axis else None, rng)
        where = np.flatnonzero(law.axes)
        laws.append(law)
        hidden.append(Hidden(name, f"{word} {where[0] + 1}" if len(where) == 1 else None, type(law).__name__))
    logged = "payload" if set(names) & set(LOADED) else "temperature" if set(names) & set(HEATED) else ""
    case = replace(case, laws=tuple(laws), logged=logged)
    return replace(case, seen=_seen(case, rng)), hidden


def _law(case: Case, name: str, axis: int | None, rng: np.random.Generator) -> Law:
    """A law of a fault, at an axis of this number or at any, that moves the poses of a case by more than their noise
    beyond what constant offsets of its axes do, which its geometry takes up.

    Raises ValueError where none of many does.
    """
    count, plain = case.owner.width, stood(case.machine, case.journey, case.day, ())
    scale = np.repeat(case.sigma, 3)
    offsets = _errors_by_constant_offsets(case, plain) / np.tile(scale, len(plain))[:, None]
    for _ in range(TRIES):
        axes = np.zeros(count)
        if axis is not None or rng.uniform() < 0.5:
            axes[int(rng.integers(count)) if axis is None else axis] = 1.0
        else:
            axes = rng.uniform(0.3, 1.2, count)
        axes *= np.where(np.ptp(case.owner.ranges, axis=1) > 0.5, 2.0, 1.0)  # angles, at half a metre
        size = float(np.exp(rng.uniform(np.log(4), np.log(20)))) * case.sigma[0]
        request = FaultRequest(
            size, axes, case.machine, case.journey, abs(case.day.room[1]), case.mass, case.centre, case.payload, rng
        )
        found = FAULTS[name](request)
        law = found[int(rng.integers(len(found)))]
        whole = errors(stood(case.machine, case.journey, case.day, (law,)), plain) / scale
        absorbed = (offsets @ np.linalg.lstsq(offsets, whole.ravel())[0]).reshape(whole.shape)
        moved, turned = rms((whole - absorbed) * scale)
        if max(moved / case.sigma[0], turned / case.sigma[1]) > SEEN:
            return law
    raise ValueError(f"no {name} of {TRIES} drawn moves the poses by {SEEN:g} times their noise")


def _errors_by_constant_offsets(case: Case, plain: np.ndarray) -> np.ndarray:
    """(6 n, axes) errors of the poses of a case, one below the other, by 1 m or rad more of each axis."""
    values = passed(case.journey, case.journey.looked, case.day, case.machine)
    at, step = values.values[values.at], 1e-6
    return np.stack(
        [errors(case.machine.forward(at + step * one), plain).ravel() / step for one in np.eye(case.owner.width)],
        axis=1,
    )


def rows(
    faults: int = 2,
    recordings: int = RECORDINGS,
    seed: int = 41000,
    poses: int = POSES,
    one_axis: bool = False,
    kind: str = "hexapod",
    report: bool = False,
) -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    start, named, in_sets, each, with_others = time.process_time(), 0, 0, 0, 0
    for number in range(recordings):
        case, hidden = drawn(seed + number, faults, poses, one_axis, kind)
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            found = diagnose(recording_folder.load_recording(record(case, Path(folder) / "rec"))).found
        findings = diagnosis_report(found).findings
        effects = tuple(f for f in findings if f.effect != "unknown")
        hits = [one.is_named(effects) for one in hidden]
        stated = [hit or one.is_in_stated_set(effects) for one, hit in zip(hidden, hits, strict=True)]
        others = [f for f in effects if not any(f.effect == one.effect and one.is_at(f.place) for one in hidden)]
        named, in_sets, each = named + all(hits), in_sets + (all(stated) and not all(hits)), each + sum(hits)
        with_others += len(others) + len(found.left) > 0
        if report:
            verdict = "named" if all(hits) else "in a set" if all(stated) else "MISSED"
            print(
                f"{seed + number} {verdict}: {', '.join(map(str, hidden))} -> "
                + "; ".join(
                    f"{f.effect} at {f.place}" + "".join(f" | {a.effect} at {a.place}" for a in f.cannot_be_told_from)
                    for f in effects
                )
                + "".join(f"; unknown at {u.place} by {u.depends_on}" for u in found.left)
                + f" [{time.process_time() - begun:.0f} s]",
                flush=True,
            )
    what = f"{recordings} recordings of {kind} machines with {faults} fault{'s' * (faults > 1)}"
    yield f"{what}: all named and placed", f"{named} of {recordings}", {1: "97 %", 2: "92 %"}.get(faults, "75 %")
    yield f"{what}: the rest in a stated set", f"{in_sets} of {recordings - named}", ""
    yield f"{what}: faults named", f"{each} of {recordings * faults}", ""
    yield f"{what}: with something else found or unknown", f"{with_others} of {recordings}", ""
    yield "one recording, of one processor", f"{(time.process_time() - start) / recordings:.1f} s", ""


def main(words: list[str]) -> None:
    """Run a campaign of the size that the words of a command line state, and print each recording."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench several_faults")
    parser.add_argument("--faults", type=int, default=2)
    parser.add_argument("--recordings", type=int, default=RECORDINGS)
    parser.add_argument("--seed", type=int, default=41000)
    parser.add_argument("--poses", type=int, default=POSES)
    parser.add_argument("--one-axis", action="store_true")
    parser.add_argument("--kind", choices=("hexapod", "arm", "planar2"), default="hexapod")
    arguments = parser.parse_args(words)
    for figure, reached, wanted in rows(
        arguments.faults,
        arguments.recordings,
        arguments.seed,
        arguments.poses,
        arguments.one_axis,
        arguments.kind,
        report=True,
    ):
        print(f"{figure:78} {reached:>34}   {wanted}", flush=True)
