"""Claims held against an independent truth: machines of tests/truth calibrated through the command line, then driven.

python -m tests.bench truth [--machines N] [--seed S] [--ways plain,find,..] [--effects ..] [--strengths ..] [--plans
..] [--out FILE.json]

N machines go round the ways, effects, strengths and plans; the same seed is the same machine. Those in FILE.json
already are left as they are.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from docs.make.results import SCHEMA
from tests.bench.result_provenance import machine, release
from tests.bench.truth_summary import figures_in_words
from tests.bench.truth_trial import WAYS, Trial, tried
from tests.truth import FAULTS, PLANS, SIGHTS, STRENGTHS
from tests.truth.draw_faults import HURRIED, fits

NAMES = ("none", *FAULTS, *SIGHTS)


def trials(
    machines: int, seed: int, ways: list[str], effects: list[str], strengths: list[str], plans: list[str]
) -> Iterator[Trial]:
    """Trials in an order in which any beginning of the list is balanced: a draw of every one, from the seed."""
    for number in range(machines):
        rng = np.random.default_rng([seed, number])
        method = ways[number % len(ways)]
        kind = WAYS[method].kind
        finds = "--find" in WAYS[method].options  # whose commands in time wait at every pose
        known = [
            name
            for name in effects
            if fits(name, kind) and (WAYS[method].seen or name not in SIGHTS) and not (finds and name in HURRIED)
        ]
        effect = known[(number // len(ways) + 3 * (number % len(ways))) % len(known)]
        strength = "none" if effect == "none" else str(rng.choice(strengths))
        effect = "none" if strength == "none" else effect
        yield Trial(seed * 100000 + number, method, effect, strength, str(rng.choice(plans)))


def main(argv: list[str]) -> None:
    """Run the campaign that argv asks for, and print its summary."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench truth")
    parser.add_argument("--machines", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    for name, known in (("ways", tuple(WAYS)), ("effects", NAMES), ("strengths", STRENGTHS), ("plans", PLANS)):
        parser.add_argument(f"--{name}", type=lambda text, known=known: _known(text, known), default=list(known))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--seconds", type=float, default=np.inf, help="no machine is begun after so long")
    given = parser.parse_args(argv)
    lines = json.loads(given.out.read_text())["machines"] if given.out and given.out.exists() else []
    done, end = {line["machine"] for line in lines}, time.monotonic() + given.seconds
    for trial in trials(given.machines, given.seed, given.ways, given.effects, given.strengths, given.plans):
        if trial.name in done or time.monotonic() > end:
            continue
        with tempfile.TemporaryDirectory() as folder:
            lines.append(tried(trial, Path(folder)))
        print(_in_words(lines[-1]), flush=True)
        if given.out:
            _write(given.out, lines, "python -m tests.bench truth " + " ".join(_what(argv)), given.seed)
    for figure, reached, _ in figures_in_words(lines):
        print(f"{figure:60} {reached}")


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted) of twenty machines, plain."""
    with tempfile.TemporaryDirectory() as folder:
        lines = [
            tried(trial, Path(folder) / trial.name)
            for trial in trials(20, 1, ["plain"], list(NAMES), list(STRENGTHS), list(PLANS))
        ]
    yield from figures_in_words(lines)[:4]


def _what(argv: list[str]) -> list[str]:
    """The words of argv that say what is done: neither where it is written nor how long it may take."""
    left = [word for k, word in enumerate(argv) if not {word, *argv[max(k - 1, 0) : k]} & {"--out", "--seconds"}]
    return [word for word in left if not word.startswith(("--out=", "--seconds="))]


def _known(text: str, known: tuple[str, ...]) -> list[str]:
    names = text.split(",")
    for name in names:
        if name not in known:
            raise argparse.ArgumentTypeError(f"{name!r} is none of {', '.join(known)}")
    return names


def _write(path: Path, lines: list[dict[str, Any]], command: str, seed: int) -> None:
    """Write the campaign's file: a kept result like all others, with every machine besides, a line each."""
    record = {
        "schema": SCHEMA,
        "name": "truth",
        "title": (__doc__ or "").splitlines()[0],
        "command": command,
        "seed": seed,
        "version": release(),
        "commit": ", ".join(sorted({line["commit"] for line in lines})),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine(),
        "figures": [dict(zip(("figure", "reached", "wanted"), row)) for row in figures_in_words(lines)],
    }
    text = json.dumps(record, indent=1, ensure_ascii=False)[:-2]
    partial_file = path.with_suffix(".part")
    partial_file.write_text(
        text + ',\n "machines": [\n' + ",\n".join(json.dumps(line) for line in lines) + "]}\n", encoding="utf-8"
    )
    partial_file.replace(path)


def _in_words(line: dict[str, Any]) -> str:
    if "refused" in line:
        return f"{line['machine']:60} refused: {line['refused'][:150]}"
    middle, low, high = (x * 1e6 for x in line["claim"])
    inside = "     " if line["covered"] else "LESS " if line["true"] < line["claim"][1] else "MORE "
    return (
        f"{line['machine']:60} {inside} {line['state']:5} true {line['true'] * 1e6:8.2f} um, claim {middle:8.2f} "
        f"({low:.2f} to {high:.2f}), "
        f"noise {line['sigma']:.2g}, size {line['size'] * 1e6:.1f}, {line['seconds']:.1f} s"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
