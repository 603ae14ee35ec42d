"""Certificates of 300 fresh rigs at pose level, none to two effects in each: are promises kept, and decisions right?"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rig import design_file, layout
from tests.calib.statement.trials import DECIDE, share_kept, trial, wrong_decisions

RIGS = 300


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(layout.layout(0.3))
        design = design_file.load(path)
    start = time.process_time()
    trials = [trial(design, seed) for seed in range(RIGS)]
    seconds = (time.process_time() - start) / RIGS
    yield f"{RIGS} rigs: promise of position and rotation kept", f"{share_kept(trials):.1%}", "93 to 99 %"
    for k, name in enumerate(("position", "rotation")):
        kept = np.mean([t.kept[k] for t in trials])
        tight = np.median([t.promise[k] / t.true[k] for t in trials if t.effects])
        bare = np.median([t.promise[k] / t.true[k] for t in trials if not t.effects])
        yield f"{name}: kept", f"{kept:.1%}", ""
        yield f"{name}: promise over truth, median, with effects; without, where measuring is worse than the rig", f"{tight:.2f}; {bare:.2f}", ""
    decided = [t for t in trials if t.n >= DECIDE]
    made = sum(verdict in ("conforms", "does not conform") for t in decided for verdict in t.verdict)
    wrong = wrong_decisions(trials)
    yield f"acceptance, {2 * len(decided)} tolerances about the truth: decisions wrong", f"{wrong} ({wrong / (2 * len(decided)):.1%})", "<= 2.5 %"
    yield "of decisions made, wrong; the others cannot be said", f"{wrong} of {made} ({wrong / max(made, 1):.1%})", ""
    yield "one rig, drawn, driven, calibrated and certified, of one processor", f"{seconds:.2f} s", "seconds"
