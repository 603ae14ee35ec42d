"""Figure of a posture's force polytope and ellipsoid in three planes, with the wanted force."""

from io import BytesIO

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

from rig.arrays import Floats

PLANES = ((0, 1), (0, 2), (1, 2))
NAMES = ("fx", "fy", "fz")
ROUND = 181  # points of an ellipse


def force_polytope_svg(A: Floats, limits: Floats, corners: Floats, wanted: Floats) -> str:
    """SVG of the force polytope, corners (k, 3) N, and ellipsoid of A (n, 3) m with torque limits (n,) N m.
    wanted : (3,) N
    """
    figure = Figure(figsize=(11, 3.9), layout="constrained")
    shape = np.linalg.inv((A / limits[:, None]).T @ (A / limits[:, None]))  # |torques over their limits| = 1
    for axes, plane in zip(figure.subplots(1, 3), PLANES):
        flat = corners[:, plane]
        around = flat[ConvexHull(flat).vertices]
        axes.fill(
            *around.T, facecolor="tab:blue", alpha=0.15, edgecolor="tab:blue", label="every torque within its limit"
        )
        angle = np.linspace(0, 2 * np.pi, ROUND)
        ellipse = np.linalg.cholesky(shape[np.ix_(plane, plane)]) @ np.stack([np.cos(angle), np.sin(angle)])
        axes.plot(*ellipse, color="tab:green", lw=1.2, label="torques together as large as one limit")
        axes.plot(
            [0, wanted[plane[0]]], [0, wanted[plane[1]]], color="tab:red", marker="o", markevery=[1], label="wanted"
        )
        axes.plot(0, 0, "k+")
        axes.set(xlabel=f"{NAMES[plane[0]]}, N", ylabel=f"{NAMES[plane[1]]}, N")
        axes.set_aspect("equal")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    out = BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "rig"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue().decode()
