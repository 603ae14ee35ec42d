"""Figures of residuals: before and after against a covariate, and along time."""

import numpy as np
from matplotlib.figure import Figure

BINS = 14  # of the covariate, with as many residuals each
BEFORE, AFTER = "tab:red", "tab:blue"


def scatter(x: np.ndarray, label: str, both: list[np.ndarray], y: str) -> Figure:
    """Figure of residuals before and after (m,) against a covariate x (m,), and of those before against what the effect explains."""
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    limit = 1.15 * max(np.quantile(np.abs(v), 0.995) for v in both) + 1e-12
    panels = ((x, both[0], "without it", BEFORE, label), (x, both[1], "with it", AFTER, label),
              (both[0] - both[1], both[0], "without it, against what it explains", BEFORE, f"explained: {y}"))
    for axes, (at, values, title, colour, below) in zip(figure.subplots(1, 3, sharey=True), panels):
        axes.plot(at, np.clip(values, -limit, limit), ".", ms=3, alpha=0.4, color="grey")
        inside = _bins(at)
        axes.errorbar([at[b].mean() for b in inside], [values[b].mean() for b in inside],
                      [2 * values[b].std() / np.sqrt(b.sum()) for b in inside], fmt="o", ms=4, color=colour, capsize=2)
        axes.axhline(0, color="black", lw=0.6)
        axes.set_xlabel(below, fontsize=8)
        axes.set_title(title, fontsize=10)
        axes.set_ylim(-limit, limit)
    ends = np.array([(both[0] - both[1]).min(), (both[0] - both[1]).max()])
    figure.axes[2].plot(ends, ends, color="black", lw=1, ls="--")
    figure.axes[0].set_ylabel(y)
    return figure


def _bins(x: np.ndarray) -> list[np.ndarray]:
    """[(m,) bool] of BINS bins with as many of x (m,) each; fewer where x repeats itself."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    return [place == b for b in np.unique(place)]


def over_time(t: np.ndarray, values: np.ndarray, y: str) -> Figure:
    """Figure of what is left (n,) at times t (n,) s, its running mean drawn in."""
    order = np.argsort(t)
    figure = Figure(figsize=(11, 2.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(t / 60, values, ".", ms=3, alpha=0.5, color="grey")
    width = max(len(t) // 25, 1)
    axes.plot(np.convolve(t[order], np.ones(width) / width, "valid") / 60, np.convolve(values[order], np.ones(width) / width, "valid"), color=AFTER)
    axes.axhline(0, color="black", lw=0.6)
    axes.set(xlabel="time, min", ylabel=y)
    return figure
