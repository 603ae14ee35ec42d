"""What a workspace comes to, in words."""

import numpy as np

from calib.workspace.workspace_cells import SHORT, Workspace
from rig.effects.framework.covariate import DRAWN
from rig.formats.number_rounding import round_to_digits


def workspace_lines(w: Workspace, unit: str) -> list[str]:
    """Lines on a Workspace: lost and gained, the room, singularities, the bound. unit : of the axes, m, rad or rad or
    m.
    """
    first = (
        SHORT
        if w.lost is None or w.gained is None
        else (
            f"{w.lost * 100:.2f} % of the poses that the owner's model reaches are lost, "
            f"{w.gained * 100:.2f} % of those that the corrected machine "
            f"reaches are gained ({w.drawn} configurations of each, all over the strokes, all axes free of each other)"
        )
    )
    known, inner = np.isfinite(w.bound[:, 0]), w.room > 0
    turned = f" and {_span(w.bound[known, 1] * 1e6)} urad" if w.turns else ""
    out = [
        f"workspace: {first}",
        f"{known.sum()} cells of {w.size * 1e3:.3g} mm: error bound (k = 2) {_span(w.bound[known, 0] * 1e6)} "
        f"um{turned}; "
        f"singular values from {np.nanmin(w.singular):.3f} of the greatest",
    ]
    if inner.any():
        scale, shown = DRAWN.get(unit, (1.0, unit))
        out.append(f"{inner.sum()} cells have room to all limits, up to {np.nanmax(w.room) * scale:.4g} {shown}")
    return out


def _span(values: np.ndarray) -> str:
    low, high = round_to_digits(values.min()), round_to_digits(values.max())
    return low if low == high else f"{low} to {high}"


def certified_line(certified: np.ndarray) -> str:
    """A line on what a certificate promises in the cells. certified : (c, 2) m and rad as `certified` gives it."""
    known = np.isfinite(certified[:, 0])
    if not known.any():
        return "the certificate's volume holds the middle of no cell"
    turns = certified[known & np.isfinite(certified[:, 1]), 1]
    return f"certified in {known.sum()} cells: position {_span(certified[known, 0] * 1e6)} um" + (
        f", rotation {_span(turns * 1e6)} urad" if len(turns) else "; no rotation was measured"
    )
