"""Sixty changes after a quiet week, six kinds of them on ten rigs, and 200 more quiet visits: noticed, named, false
alarms.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.drift.visit_history import History, add_visit_and_judge_change
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.calib.daily_visits import SIX, changed, rig

RIGS, WEEK, QUIET = 10, 7, 20  # rigs; quiet visits before a change; quiet visits of each rig in all, beside those
SOON = 2  # visits after a change by which it is to be noticed


def rows(rigs=RIGS, quiet=QUIET) -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    noticed, named, alarms, looked, judged, missed = 0, 0, 0, 0, 0, []
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        (base / "rig.toml").write_text(hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
        design, text = design_from_rig_toml.load_design(base / "rig.toml"), (base / "rig.toml").read_text()
        for seed in range(rigs):
            one, rng = rig(design, text, seed, base / f"{seed}"), np.random.default_rng([seed, 1])
            history = week = History("")
            for day in range(WEEK + quiet):
                history, verdict = add_visit_and_judge_change(
                    history, one.visit(base / f"{seed}-{day}", rng), one.calibration
                )
                alarms, looked = alarms + verdict.alarm, looked + 1
                week = history if day + 1 == WEEK else week
            for which in SIX:
                change, after = changed(which, one, rng), week
                for k in range(SOON):
                    after, verdict = add_visit_and_judge_change(
                        after, one.visit(base / f"{seed}-{which}-{k}", rng, change), one.calibration
                    )
                    judged += 1
                    if verdict.alarm:
                        break
                noticed += verdict.alarm
                found = verdict.named.name if verdict.alarm and verdict.named else ""
                named += found == change.name
                if found != change.name:
                    missed.append(
                        f"rig {seed}: {change.name} -> {found or 'something' if verdict.alarm else 'nothing'}"
                    )
    cases = rigs * len(SIX)
    yield (
        f"{cases} changes after a quiet week: noticed within two visits",
        f"{noticed} ({noticed / cases:.1%})",
        ">= 95 %",
    )
    yield "named, with its place", f"{named} ({named / cases:.1%})", ">= 90 %"
    yield f"{looked} quiet visits: false alarms", f"{alarms}", "<= 1 in 200"
    yield (
        "one visit, simulated and judged, of one processor",
        f"{(time.process_time() - start) / (looked + judged):.2f} s",
        "seconds",
    )
    for line in missed:
        yield line, "", ""
