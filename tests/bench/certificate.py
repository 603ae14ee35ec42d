"""Certificates of 500 fresh rigs at pose level for each of five cases: are promises, of position and rotation at once,
kept, and decisions right?
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.certification.pose_error_promise_and_conformity import CONFORMS, FAILS
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.calib.certificate.trials import share_of_claims_that_hold, trial, wrong_decisions

RIGS = 500
SIZES = (59, 93, 120)  # held out
CASES = {  # (coverage, confidence), effects, factor of the instrument's noise
    "95/95, play left out, measuring the smaller part": ((0.95, 0.95), ("backlash",), 0.1),
    "90/90, play left out, measuring the smaller part": ((0.9, 0.9), ("backlash",), 0.1),
    "95/95, nothing left out": ((0.95, 0.95), (), 0.1),
    "95/95, none to two effects": ((0.95, 0.95), None, 1.0),
    "90/90, none to two effects": ((0.9, 0.9), None, 1.0),
}


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
        design = design_from_rig_toml.load_design(path)
    for name, (level, kinds, noise) in CASES.items():
        start = time.process_time()
        trials = [trial(design, seed, level, SIZES, kinds, noise) for seed in range(RIGS)]
        seconds = (time.process_time() - start) / RIGS
        yield (
            f"{name}: promise kept by {RIGS} rigs",
            f"{share_of_claims_that_hold(trials):.1%}",
            f"{level[1]:.0%} +- 2 %; above where measuring is the greater part",
        )
        for k, what in enumerate(("position", "rotation")):
            yield (
                f"{what}: promise over truth, median",
                f"{np.median([t.promise[k] / t.true[k] for t in trials]):.2f}",
                "",
            )
        judged = [t for t in trials if t.verdict]
        made = sum(t.verdict in (CONFORMS, FAILS) for t in judged)
        yield (
            f"tolerances about the truth: decisions wrong, of {len(judged)} of which {made} were made",
            f"{wrong_decisions(trials)}",
            "<= 2.5 %",
        )
        yield "one rig, drawn, driven, calibrated and certified, of one processor", f"{seconds:.2f} s", "seconds"
