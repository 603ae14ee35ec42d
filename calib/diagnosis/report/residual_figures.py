"""Figures of residuals, without effects and with them, and of what was held out beside the search."""

import numpy as np

from calib.diagnosis.problems.measured_evidence import (
    HeldOutPoses,
    NestedSelection,
    RegionValidation,
    RepeatedCommands,
    ScatterSize,
    WeighedPoses,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from rig.arrays import Floats
from rig.formats.json_tree import Json
from rig.model import mechanisms
from rig.report.pages.html_elements import note, table
from rig.report.pages.plots import Series, panel_row, plot_panel

BINS = 14  # of the covariate, with as many residuals each
BEFORE, AFTER, GREY = 3, 0, -1  # colours of a figure
SCALES, UNITS = {"m": 1e6}, {"m": "µm"}  # in which misfits are shown
SAME_ANGLE = 0.02  # rad; nearer angles than that share a joint's profile


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


def held_out_entries(d: Diagnosis) -> Json:
    """{key of diagnosis.json: its tree}, of what the evidence holds out beside the search."""
    out: Json = {}
    if isinstance(d.evidence, ScatterSize):
        out["scatter_beyond_stated_m"] = d.evidence.scatter_beyond_stated(d.selection)[0]
    if isinstance(d.evidence, NestedSelection):
        out["held_out"] = [
            {
                "stretches": h.stretches,
                "before": residual_statistics(h.before),
                "after": residual_statistics(h.after),
                **extrapolation_figures(h),
                "chosen": [list(n) for n in h.names],
            }
            for h in d.held
        ]
    if isinstance(d.evidence, RegionValidation):
        out["held_out_by_region"] = held_out_region_gains(d)
    if isinstance(d.evidence, RepeatedCommands):
        out["repeats"] = repeat_figures(d)
    if isinstance(d.evidence, WeighedPoses):
        out["set_aside"] = d.evidence.frames_set_aside(d.selection)
    return out


def repeat_figures(d: Diagnosis) -> Json | None:
    """How well poses repeat; None where too few commands were given twice."""
    again = d.repeats
    if again is None:
        return None
    return {
        "pairs": again.pairs,
        "mean_m": again.mean,
        "rms_m": again.rms,
        "mean_rad": again.mean_rad,
        "remainder_that_repeats": again.recurring_share,
    }


def held_out_region_gains(d: Diagnosis) -> list[Json]:
    """For each axis, what each finding brings where whole regions of its travel are held out: misfit before and after,
    m, and standard errors.
    """
    if d.design is None:
        return []
    places = mechanisms.axis_places(d.design.mechanism)
    return [
        {
            "joint": j + 1,
            "place": places[j],
            "findings": [
                {"heldout_before": v.before, "heldout_after": v.after, "gain_sigma": v.gain, "unit": v.unit}
                for v in row
            ],
        }
        for j, row in enumerate(d.regions)
    ]


def residual_statistics(left: Floats) -> dict[str, float]:
    """{mean_m, rms_m, p95_m, max_m, n} of position errors in m and, where measured, the mean rotation error in rad."""
    size = np.linalg.norm(left[:, :3], axis=1)
    out = {
        "mean_m": float(size.mean()),
        "rms_m": float(np.sqrt((size**2).mean())),
        "p95_m": float(np.quantile(size, 0.95)),
        "max_m": float(size.max()),
        "n": len(size),
    }
    return out | ({"mean_rad": float(np.linalg.norm(left[:, 3:], axis=1).mean())} if left.shape[1] == 6 else {})


def extrapolation_figures(held: HeldOutPoses) -> Json:
    """{after_at_fitted_angles, after_beyond}: figures of held-out poses all of whose joints stood within SAME_ANGLE of
    an angle that they were fitted at, and of the rest; None where there are none. No data tell a profile where its
    joint never stood."""
    near = held.far <= SAME_ANGLE
    return {
        name: residual_statistics(held.after[rows]) if rows.any() else None
        for name, rows in (("after_at_fitted_angles", near), ("after_beyond", ~near))
    }


def repeat_rows(d: Diagnosis) -> list[tuple[str, object]]:
    """[(what, value)] of how well poses repeat; nothing where too few commands were given twice."""
    if d.repeats is None:
        return []
    text = f"{d.repeats.mean * 1e6:.1f} µm ({d.repeats.pairs} pairs)"
    return [("the same command given again comes back within", text)]


def held_out_gain_table(d: Diagnosis) -> str:
    """Table of the fall of the held-out misfit by each finding, with stretches of time and regions of each axis' travel
    held out.
    """
    rows, terms = [], d.selection.problem.terms(d.selection.fit)
    for i, finding in enumerate(d.findings):
        candidate = terms[finding.number]
        found = [d.cross_validations[i], *(row[i] for row in d.regions)]
        scale = SCALES.get(found[0].unit, 1.0)
        rows.append(
            [
                f"{candidate.name.replace('_', ' ')} at {candidate.place}",
                *(f"{(v.before - v.after) * scale:+.{1 if scale > 1 else 4}f}" for v in found),
            ]
        )
    places = [] if d.design is None else mechanisms.axis_places(d.design.mechanism)
    units = " or ".join(dict.fromkeys(UNITS.get(v.unit, v.unit) for v in d.cross_validations))
    said = note(
        f"{units}, RMS along one axis, by which what was held out is predicted better with it than without. A curve of "
        "an axis' own position is not told where that axis never stood: there, what it brings by that axis' own "
        "regions may be a loss."
    )
    return table(("finding", "held out: time", *places[: len(d.regions)]), rows) + said
