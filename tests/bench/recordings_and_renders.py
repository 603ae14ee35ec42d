"""Real recordings, a ray caster's and our own renders beside each other: what a diagnosis finds, what it leaves against
the noise, held out.
"""

import json
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.cli import RIG
from tests.conftest import SHARED

SOURCES = {"tumbling-block": "real images", "arm-1": "real poses", "first-light": "images by a ray caster"}
OWN = {
    "nothing": [],
    "backlash at strut 2, 40 um": ["--effect", "backlash:strut2:gap=40e-6"],
}  # what our own renders hide
PLAN, SEED = "sobol:14,ladder:1,repeat:3", 31
SENSOR = ["--blur", "0.5", "--read-noise", "1"]
UNIT = {"m": (1e6, "um"), "px": (1, "px"), "whitened": (1, "of the noise")}
MOST = 4  # findings told of one recording


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted), one a recording; figures of one are held out: before its findings, after, and
    the noise's own.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for recording, kind in SOURCES.items():
            if (SHARED / "recordings" / recording).is_dir():
                yield f"{recording} ({kind})", _result_text(SHARED / "recordings" / recording, folder / recording), ""
            else:
                yield f"{recording} ({kind})", "skipped", "the shared recordings are not beside the project"
        (folder / "rig.toml").write_text(
            hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, width=640, height=512)
        )
        for number, (hidden, options) in enumerate(OWN.items()):
            drawn = folder / f"own{number}"
            how = ["--plan", PLAN, "--seed", str(SEED), "--images", *SENSOR, *options, "--out", drawn]
            made = subprocess.run([*RIG, "simulate", folder / "rig.toml", *how], capture_output=True, text=True)
            reached = (
                made.stderr.strip().splitlines()[-1]
                if made.returncode
                else _result_text(drawn, folder / f"out{number}")
            )
            yield f"own render (hides {hidden})", reached, ""


def _result_text(recording, out):
    done = subprocess.run([*RIG, "diagnose", recording, "--out", out], capture_output=True, text=True)
    if done.returncode:
        return done.stderr.strip().splitlines()[-1]
    tree = json.loads((out / "diagnosis.json").read_text())
    found = [f"{f['effect']} at {f['place']}" for f in tree["findings"]]
    more = f" and {len(found) - MOST} more" if len(found) > MOST else ""
    scale, unit = UNIT[tree["fit"]["unit"]]
    before, after, noise = (tree["fit"][key] * scale for key in ("heldout_before", "heldout_after", "noise_floor"))
    return (
        f"{', '.join(found[:MOST]) or 'nothing'}{more}; {before:.4g} -> {after:.4g} {unit}, noise {noise:.4g}, "
        f"ratio {after / noise:.2f}"
    )
