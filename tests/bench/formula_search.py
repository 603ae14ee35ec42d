"""A formula for what has no name: six laws that the catalogue does not hold, three rigs each; nothing hidden, and what
has a name.

Corner level, no images, whole diagnoses among the whole catalogue. Of each law two and a half to four times the noise
of a strut is seen.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.calib import unlisted_laws
from tests.calib.diagnose_recording import diagnosis_of
from tests.calib.recordings_with_effects import recorded

RIGS, RIGHT, HELD_OUT = 3, 5, 1.2
NAMED = (
    "backlash:strut3:gap=8e-5",
    "screw_coupling:rig:gain=0.6",
    "creep:rig:fraction=5e-3,time_constant=40",
    "transmission_error:strut2:profile=0/2e-5/-2e-5/3e-5/0/2e-5/-3e-5/1e-5",
)


def suggested(found) -> tuple[set[str], float]:
    """Names of the covariates that a diagnosis suggests, and the held-out error over the noise."""
    names = {q.name for s in found.suggestions for q in s.written.quantities}
    return names, max((s.after / s.noise for s in found.suggestions), default=np.nan)


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    right, worst = 0, []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(text := hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3))
        design = design_from_rig_toml.load_design(path)
        for number, law in enumerate(unlisted_laws.LAWS):
            hits, ratios = [], []
            for k in range(RIGS):
                seen = float(np.random.default_rng([9, number, k]).uniform(2e-5, 3.2e-5))
                rec, effect, wanted = unlisted_laws.recorded(
                    Path(folder) / f"law{number}{k}", design, text, number, 10 * number + k, seen
                )
                found = diagnosis_of(rec)
                names, ratio = suggested(found)
                hits.append(names == wanted)
                ratios.append(ratio)
                print(
                    f"  {law} {k}: {effect}; found {[f'{e.name} {e.place}' for e in found.effects]}, left "
                    f"{sorted({str(u.place) for u in found.left})}; "
                    f"suggested {[(s.place, s.written.text()) for s in found.suggestions]}, {ratio:.3f}",
                    file=sys.stderr,
                    flush=True,
                )
            right += sum(hits) * 2 > RIGS
            worst.append(float(np.nanmedian(ratios)) if np.isfinite(ratios).any() else np.inf)
            yield (
                f"{law}: right covariates of {RIGS} rigs; held-out error over the noise, median",
                f"{sum(hits)}; {worst[-1]:.3f}",
                f"<= {HELD_OUT}",
            )
        yield "laws of six with the right covariates in most rigs", str(right), f">= {RIGHT}"
        quiet = [
            len(diagnosis_of(recorded(Path(folder) / f"quiet{k}", design, (), 60 + k, unlisted_laws.PLAN)).suggestions)
            for k in range(RIGS)
        ]
        yield f"nothing hidden: formulas suggested over {RIGS} rigs", str(sum(quiet)), "0"
        named = [
            diagnosis_of(recorded(Path(folder) / f"named{k}", design, (text,), 70 + k, unlisted_laws.PLAN))
            for k, text in enumerate(NAMED)
        ]
        yield (
            f"effects of the catalogue: formulas suggested over {len(NAMED)}, named of them",
            (f"{sum(len(d.suggestions) for d in named)}, {sum(bool(d.effects) for d in named)}"),
            "0",
        )
