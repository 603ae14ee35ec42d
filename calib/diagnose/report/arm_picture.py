"""The arm in outline, as it stood in the recording, with the joints marked that a diagnosis points at."""

import numpy as np
from matplotlib.figure import Figure

from rig import mechanisms
from rig.design import Arm
from rig.mechanisms import arm as mechanism

GHOSTS = 14  # other configurations, drawn faintly
VIEWS = (((0, 2), "from the side"), ((0, 1), "from above"))
QUIET, MARKED = "0.6", "crimson"


def picture(arm: Arm, q: np.ndarray, moved: dict[int, dict[str, float]]) -> Figure:
    """Figure of an Arm over its configurations q (n, joints) rad or m; moved : {joint: {effect: RMS in rad or, of a slide, m}} of what was found."""
    chain = mechanism.frames(q, arm)[..., :3, 3]
    base = chain[0, 0]
    turn = arm.base.rotation.as_matrix()  # seen in the arm's own base, whatever stands where
    at = (chain - base) @ turn
    typical = int(np.argmin(((q - np.median(q, axis=0)) ** 2).sum(axis=1)))
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    largest = max((max(found.values()) for found in moved.values()), default=1.0)
    *panels, words = figure.subplots(1, len(VIEWS) + 1)
    for axes, ((a, b), title) in zip(panels, VIEWS):
        for k in np.linspace(0, len(q) - 1, GHOSTS).astype(int):
            axes.plot(at[k, :, a], at[k, :, b], color="0.9", lw=1.5, zorder=1)
        points = at[typical]
        axes.plot(points[:, a], points[:, b], color="0.35", lw=4, zorder=2, solid_capstyle="round")
        for j in range(len(arm.joints)):
            size = max(moved[j].values()) / largest if j in moved else 0.0
            axes.plot(points[j, a], points[j, b], "o", ms=8 + 9 * size, color=MARKED if j in moved else QUIET, zorder=3, alpha=0.85)
            axes.annotate(str(j + 1), (points[j, a], points[j, b]), ha="center", va="center", color="white", fontsize=8, zorder=4)
        axes.set(title=title, xlabel="m", ylabel="m")
        axes.set_aspect("equal", adjustable="box")
    places, units = mechanisms.places(arm), mechanisms.units(arm)
    lines = [f"{places[j]}: " + ",\n    ".join(f"{name} {size * 1e3:.3f} m{units[j]}" for name, size in moved[j].items()) for j in sorted(moved)]
    words.text(0, 1, "\n".join(lines) or "nothing was found", transform=words.transAxes, va="top", fontsize=9, color=MARKED if lines else QUIET)
    words.axis("off")
    return figure
