"""Figures of residuals: against covariates, along time and over images, without an effect and with it."""

import numpy as np

from rig.arrays import Floats
from rig.report.pages.plots import Series, panel_row, plot_panel

BINS = 14  # of the covariate, with as many residuals each
BEFORE, AFTER, GREY = 3, 0, -1  # colours of a figure


def residual_scatter_figure(x: Floats, label: str, both: list[Floats], y: str) -> str:
    """Residuals before and after (m,) against a covariate x (m,), and those before against what the effect explains."""
    limit = 1.15 * max(float(np.quantile(np.abs(v), 0.995)) for v in both) + 1e-12
    explained = both[0] - both[1]
    ends = np.array([explained.min(), explained.max()])
    panes = (
        (x, both[0], "without it", BEFORE, label, ()),
        (x, both[1], "with it", AFTER, label, ()),
        (
            explained,
            both[0],
            "without it, against what it explains",
            BEFORE,
            f"explained: {y}",
            (Series(ends, ends, kind="line", colour=GREY),),
        ),
    )
    return panel_row(
        *(
            plot_panel(
                title,
                (below, y),
                [Series(at, np.clip(values, -limit, limit), colour=GREY), _means(at, values, colour), *more],
                limits=(-limit, limit),
                level=0.0,
            )
            for at, values, title, colour, below, more in panes
        )
    )


def _means(x: Floats, values: Floats, colour: int) -> Series:
    """Means of values (m,) over bins of x (m,) with their 95 % intervals."""
    inside = _bins(x)
    return Series(
        np.array([x[b].mean() for b in inside]),
        np.array([values[b].mean() for b in inside]),
        "",
        "rings",
        colour,
        np.array([2 * values[b].std() / np.sqrt(b.sum()) for b in inside]),
    )


def _bins(x: Floats) -> list[Floats]:
    """[(m,) bool] of BINS bins with as many of x (m,) each; fewer where x repeats itself."""
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    return [place == b for b in np.unique(place)]


def residuals_in_time_figure(title: str, t: Floats, values: Floats, y: str) -> str:
    """What is left (n,) at times t (n,) s, its running mean drawn in."""
    order, width = np.argsort(t), max(len(t) // 25, 1)
    ones = np.ones(width) / width
    mean = Series(
        np.convolve(t[order], ones, "valid") / 60,
        np.convolve(values[order], ones, "valid"),
        "running mean",
        "line",
        AFTER,
    )
    return plot_panel(title, ("time, min", y), [Series(t / 60, values, colour=GREY), mean], level=0.0)
