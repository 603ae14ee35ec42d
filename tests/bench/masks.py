"""Whether names depend on which wild rows an operator masks: recordings of the independent truth with 5 % of wild rows.

python -m tests.bench masks [--recordings N] [--seed S] [--out FILE.json] [--backwards] [--only NAME]

Each recording is diagnosed without wild rows, and with them under five masks: none, half of them, the other half,
another half, all. Those in FILE.json already are left as they are; a second process may begin at the end.
"""

import argparse
import fcntl
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from calib.api.diagnose import diagnose
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import Report
from docs.make.results import SCHEMA
from rig.errors import RigError
from rig.recording import frame_selection_and_content_hashes, recording_folder
from tests.bench.result_provenance import commit, machine, release
from tests.truth import FAULTS, PLANS, SIGHTS, Case, draw, record
from tests.truth.draw_faults import fits
from tests.truth.wild import spoilt

RECORDINGS, FEW = 40, 3  # in all, and of the benchmark that is run by name
KINDS = ("hexapod", "arm", "hexapod", "planar2", "hexapod", "chain", "arm", "seen")
POSES = {"hexapod": 60, "arm": 80, "planar2": 60, "chain": 80, "seen": 40}  # configurations that are visited
WHOLE = 5  # every so many recordings hide nothing
MASKS = ("none", "half", "the other half", "another half", "all")


@dataclass(frozen=True)
class Hidden:
    """One recording. seed, kind, effect, strength, plan : what is drawn"""

    seed: int
    kind: str
    effect: str
    strength: str
    plan: str

    @property
    def name(self) -> str:
        """The recording's name in a campaign's file."""
        return f"{self.kind}/{self.effect}/{self.strength}/{self.plan}/{self.seed}"

    def case(self) -> Case:
        """The Case, without wild rows."""
        seen = self.kind == "seen"
        return draw(
            self.seed,
            self.effect,
            self.strength,
            self.plan,
            "hexapod" if seen else self.kind,
            POSES[self.kind],
            seen=seen,
        )


def recordings(count: int, seed: int) -> Iterator[Hidden]:
    """Recordings in an order in which any beginning of the list has all kinds: the same for the same seed."""
    rng = np.random.default_rng([seed, 28])
    orders = {
        kind: rng.permutation([name for name in (*FAULTS, *SIGHTS) if _drawn(name, kind)]).tolist() for kind in POSES
    }
    for number in range(count):
        kind, plan = KINDS[number % len(KINDS)], str(rng.choice(PLANS))
        strength = "none" if number % WHOLE == WHOLE - 1 else str(rng.choice(["strong", "weak"], p=[0.75, 0.25]))
        effect = "none" if strength == "none" else orders[kind].pop()
        yield Hidden(1000 * seed + number, kind, effect, strength, plan)


def _drawn(name: str, kind: str) -> bool:
    """Whether a fault is drawn for a kind: of SIGHTS where cameras look alone."""
    return kind == "seen" if name in SIGHTS else fits(name, "hexapod" if kind == "seen" else kind)


def masks(frames: np.ndarray, rng: np.random.Generator) -> dict[str, str]:
    """{name of MASKS: wild frames (k,) that are masked, as --mask takes them}."""
    half = rng.permutation(frames)[: len(frames) // 2]
    another = rng.permutation(frames)[: (len(frames) + 1) // 2]
    parts = dict(zip(MASKS, ([], half, np.setdiff1d(frames, half), another, frames)))
    return {name: ",".join(str(int(frame)) for frame in sorted(part)) for name, part in parts.items()}


def tried(hidden: Hidden, folder: Path) -> dict[str, Any]:
    """The line of a recording, written to a folder and diagnosed."""
    begun, case = time.process_time(), hidden.case()
    bad, frames, laws = spoilt(case, hidden.seed)
    found: dict[str, Any] = {"clean": _diagnosed(recording_folder.load_recording(record(case, folder / "clean")))}
    spoiled = recording_folder.load_recording(record(bad, folder / "wild"))
    for name, mask in masks(frames, np.random.default_rng([hidden.seed, 6])).items():
        found[name] = _diagnosed(
            frame_selection_and_content_hashes.remove_frames(spoiled, mask) if mask else spoiled
        ) | {"mask": mask}
    same, as_clean = counted(found)
    return {
        "recording": hidden.name,
        "kind": hidden.kind,
        "effect": hidden.effect,
        "strength": hidden.strength,
        "plan": hidden.plan,
        "seed": hidden.seed,
        "wild": dict(zip(map(str, frames), laws)),
        "diagnoses": found,
        "same": same,
        "as_clean": as_clean,
        "commit": commit(),
        "seconds": round(time.process_time() - begun, 1),
    }


def counted(found: dict[str, Any]) -> tuple[int, int]:
    """(how many masks give the names that most give, how many those of the clean recording); a refusal has no names,
    and counts as neither.
    """
    named = [found[name]["names"] for name in MASKS if "refused" not in found[name]]
    return max(map(named.count, named), default=0), named.count(found["clean"]["names"])


def _diagnosed(rec: recording_folder.Recording) -> dict[str, Any]:
    """What a diagnosis says: names with places, what has no name, frames that were left out, or why there is none."""
    try:
        diagnosis: Report = diagnose(rec).report
    except RigError as refusal:
        return {"names": ["refused"], "left_out": [], "refused": str(refusal)}
    return {
        "names": sorted(f"{f.effect} {f.place}" for f in diagnosis.findings),
        "unexplained": diagnosis.unexplained.place if diagnosis.unexplained else None,
        "left_out": sorted({one.frame for one in diagnosis.left_out}),
        "crowd": diagnosis.crowd.count if diagnosis.crowd else 0,
    }


def figures(lines: list[dict[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """(figure, reached, wanted) of recordings: over their masks, against themselves without wild rows, and by kind."""
    for kind in ("all", *(kind for kind in POSES if any(line["kind"] == kind for line in lines))):
        some = [line for line in lines if kind in ("all", line["kind"])]
        of, wanted = len(MASKS) * len(some), "195 of 200" if kind == "all" else ""
        yield (
            f"{kind}: diagnoses with the names that most masks give",
            f"{sum(line['same'] for line in some)} of {of}",
            wanted,
        )
        yield (
            f"{kind}: diagnoses with the names of the recording without wild rows",
            f"{sum(line['as_clean'] for line in some)} of {of}",
            wanted,
        )


def main(argv: list[str]) -> None:
    """Run the campaign that argv asks for, and print its figures."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench masks")
    parser.add_argument("--recordings", type=int, default=RECORDINGS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument(
        "--backwards",
        action="store_true",
        help="begin with the last recording, beside a process that begins with the first",
    )
    parser.add_argument("--only", help="recordings with this in their name alone")
    given = parser.parse_args(argv)
    order = [one for one in recordings(given.recordings, given.seed) if not given.only or given.only in one.name]
    lines: list[dict[str, Any]] = []
    for hidden in order[::-1] if given.backwards else order:
        lines = _known(given.out) if given.out else lines
        if any(line["recording"] == hidden.name for line in lines):
            continue
        with tempfile.TemporaryDirectory() as folder:
            line = tried(hidden, Path(folder))
        print(_in_words(line), flush=True)
        lines = _with(given.out, line, given.seed) if given.out else [*lines, line]
    for figure, reached, _ in figures(lines):
        print(f"{figure:80} {reached}")


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted) of the first few recordings."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [tried(hidden, Path(folder) / str(number)) for number, hidden in enumerate(recordings(FEW, 1))]
    yield from list(figures(lines))[:2]


def _known(path: Path) -> list[dict[str, Any]]:
    """The lines of a campaign's file, none where there is no file yet."""
    return json.loads(path.read_text())["recordings"] if path.exists() else []


def _with(path: Path, line: dict[str, Any], seed: int) -> list[dict[str, Any]]:
    """The lines of a campaign's file and one more, written: a kept result like all others, with a line for each
    recording.
    """
    with path.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        lines = [one for one in _known(path) if one["recording"] != line["recording"]] + [line]
        record = {
            "schema": SCHEMA,
            "name": "masks",
            "title": (__doc__ or "").splitlines()[0],
            "seed": seed,
            "command": f"python -m tests.bench masks --recordings {len(lines)} --seed {seed}",
            "version": release(),
            "commit": ", ".join(sorted({one["commit"] for one in lines})),
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "machine": machine(),
            "figures": [dict(zip(("figure", "reached", "wanted"), row)) for row in figures(lines)],
        }
        text = json.dumps(record, indent=1, ensure_ascii=False)[:-2]
        partial_file = path.with_suffix(".part")
        partial_file.write_text(
            text + ',\n "recordings": [\n' + ",\n".join(json.dumps(one) for one in lines) + "]}\n", encoding="utf-8"
        )
        partial_file.replace(path)
    return lines


def _in_words(line: dict[str, Any]) -> str:
    clean, lines = line["diagnoses"]["clean"]["names"], []
    for name in MASKS:
        one = line["diagnoses"][name]
        missed = sorted(
            {int(f) for f in line["wild"]} - set(one["left_out"]) - {int(f) for f in one["mask"].split(",") if f}
        )
        lines += (
            []
            if one["names"] == clean
            else [f"\n    {name}: {', '.join(one['names']) or 'nothing'}; wild rows that stay: {missed}"]
        )
    return (
        f"{line['recording']:55} {line['same']} same, {line['as_clean']} as without wild rows "
        f"({', '.join(clean) or 'nothing'}), "
        f"{line['seconds']:.0f} s{''.join(lines)}"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
