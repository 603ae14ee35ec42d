"""What physics was left out: recordings whose truth is known, real ones, held-out misfit and time."""

import json
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from synthetic.blind_diagnosis_score import score_case
from tests.cli import RIG
from tests.conftest import SHARED

KNOWN = ("open-quiet", "first-light", "open-backlash", "open-camera-drift", "open-compliance", "open-lens", "open-two")
REAL = ("tumbling-block", "arm-1")
UNIT = {"m": (1e6, "um"), "px": (1, "px")}


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    for name in (*KNOWN, *REAL):
        if not (SHARED / "recordings" / name).is_dir():
            continue
        with tempfile.TemporaryDirectory() as folder:
            start = time.monotonic()
            done = subprocess.run(
                [*RIG, "diagnose", SHARED / "recordings" / name, "--out", folder], capture_output=True, text=True
            )
            seconds = time.monotonic() - start
            if done.returncode:
                yield f"{name}: diagnosed", done.stderr.strip().splitlines()[-1], "without an error"
                continue
            path = Path(folder) / "diagnosis.json"
            tree = json.loads(path.read_text())
            if name in KNOWN:
                yield from _known(name, path)
        for finding in tree["findings"] if name in REAL else ():
            yield f"{name}: found", f"{finding['effect']} at {finding['place']}", "reported"
        fit = tree["fit"]
        scale, unit = UNIT[fit["unit"]]
        before, after, floor = (fit[key] * scale for key in ("heldout_before", "heldout_after", "noise_floor"))
        yield (
            f"{name}: held out before, after, noise floor; ratio",
            f"{before:.4g}, {after:.4g}, {floor:.4g} {unit}; {after / floor:.3f}",
            "<= 1.05" if name in KNOWN else "reported",
        )
        yield f"{name}: time, whole command, this machine as loaded as it is", f"{seconds:.0f} s", "<= 60 s"


def _known(name, path):
    truth = json.loads((SHARED / "truth" / f"{name}.json").read_text())
    hidden = truth["effects"] if isinstance(truth["effects"], list) else []
    with tempfile.NamedTemporaryFile("w", suffix=".json") as whole:
        json.dump({"effects": hidden, "strengths": [0.0] * len(hidden), "kind": "nothing", "disturbance": None}, whole)
        whole.flush()
        found = score_case(0, Path(whole.name), path)
    wanted = [(h.effect, h.place) for h in found.hidden]
    named = [(f.effect, f.place) for f in found.found]
    yield (
        f"{name}: effect and place",
        ", ".join(map(" ".join, named)) or "nothing",
        ", ".join(map(" ".join, wanted)) or "nothing",
    )
    for h in found.hidden:
        f = found.match(h)
        for parameter, true in h.parameters.items():
            value, interval = f.parameters.get(parameter, (None, None)) if f is not None else (None, None)
            if interval is not None and not isinstance(value, list):
                yield (
                    f"{name}: {h.effect}'s {parameter}",
                    f"{value:.4g} ({interval[0]:.4g} to {interval[1]:.4g})",
                    f"{true:.4g}",
                )
