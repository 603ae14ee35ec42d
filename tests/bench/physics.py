"""Corrections that know physics: ten kinds, three rigs each, 100 poses driven in time by another seed's temperatures
and loads.

Corner level, no images: each rig is simulated, measured from its corners, diagnosed among all effects of motion,
calibrated with what was found and driven; beside it the same recording calibrated plainly, and the same rig without the
effect.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import Effect
from rig.formats.rig_toml import design_from_rig_toml
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.calib.rigs_with_unmodelled_physics import three_ways

RIGS = 3
# four hours, in which the room changes: one that does not tells nothing of it, and
ROUTE = "sobol:60,ladder:2,payload:10,moving:8,warmup:48"
# 16 exposures in a room that changes by a kelvin tell base expansion to less than four standard errors, which no search
# names
SIZES = {  # place, {parameter: (low, high)} log-uniform between
    "backlash": ("strut", {"gap": (3e-5, 1.5e-4)}),
    "hysteresis": ("strut", {"range": (3e-3, 1.5e-2), "weight": (3e-3, 1e-2)}),
    "thermal_expansion": ("strut", {"coefficient": (1.2e-5, 2.4e-5)}),
    "base_expansion": ("rig", {"coefficient": (3e-5, 1e-4)}),
    "compliance": ("rig", {"stiffness": (1e6, 5e6)}),
    "joint_clearance": ("strut", {"gap": (4e-5, 1.2e-4)}),
    "creep": ("rig", {"fraction": (3e-3, 1e-2), "time_constant": (5, 100)}),
    "cyclic_error": ("strut", {"amplitude": (1e-5, 3e-5), "phase": (0.1, 3)}),
    "screw_coupling": ("rig", {"gain": (0.3, 1)}),
    "transmission_error": ("strut", {}),
}


def effect_of(name, rng) -> Effect:
    """One of a kind of a size that shows, at a place of its own."""
    place, sizes = SIZES[name]
    place = f"strut {rng.integers(1, 7)}" if place == "strut" else place
    values = {key: float(np.exp(rng.uniform(np.log(low), np.log(high)))) for key, (low, high) in sizes.items()}
    if not sizes:
        profile = np.cumsum(rng.normal(size=8))
        profile -= profile.mean()
        values = {"profile": tuple((2.5e-5 * profile / np.sqrt(np.mean(profile**2))).tolist())}
    return BY_NAME[name](place, **values)


def measured(name, rigs=RIGS, route=ROUTE, text=None) -> np.ndarray:
    """(rigs, 3, 2) pose errors m and rad with physics, plain and without the effect, of one kind."""
    out = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3) if text is None else text
        path.write_text(text)
        design = design_from_rig_toml.load_design(path)
        for k in range(rigs):
            seed = 100 * list(SIZES).index(name) + k
            ways = three_ways(
                Path(folder) / str(k), design, text, seed, effect_of(name, np.random.default_rng([seed, 7])), route
            )
            out.append([method.error for method in ways])
            print(
                f"  {name} {k}: {np.round(np.array(out[-1]) * 1e6, 2).tolist()} um, urad, found "
                f"{[f'{e.name} {e.place}' for e in ways[0].found]}, "
                f"stated {ways[0].stated * 1e6:.2f} um",
                file=sys.stderr,
                flush=True,
            )
    return np.array(out)


def rows() -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    for name in SIZES:
        e = measured(name)
        ratio, plain = np.median(e[:, 0] / e[:, 2], axis=0), np.median(e[:, 1] / e[:, 2], axis=0)
        with_physics, without = np.median(e[:, 0, 0]) * 1e6, np.median(e[:, 2, 0]) * 1e6
        yield (
            f"{name}: pose error after over that without it, median of {RIGS} (position, rotation)",
            f"{ratio[0]:.2f}, {ratio[1]:.2f}",
            "<= 1.5",
        )
        yield (
            f"{name}: the same corrected plainly; um with physics / without the effect",
            (f"{plain[0]:.2f}, {plain[1]:.2f}; {with_physics:.1f} / {without:.1f} um"),
            "",
        )
