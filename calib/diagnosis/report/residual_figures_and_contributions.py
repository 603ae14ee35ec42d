"""Figures of residuals before and after for the report, and the table of what each finding contributes to each pose."""

from pathlib import Path

import numpy as np

from calib.diagnosis.engine.problem_interface import Fit
from calib.diagnosis.engine.selection_candidates_thresholds_and_outliers import C
from calib.diagnosis.engine.term_selection import Selection
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    HeldOutPoses,
    NestedSelection,
    PoseContributions,
    RegionValidation,
    RepeatedCommands,
    ScatterSize,
    WeighedPoses,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from rig.array_and_json_types import Floats, Json
from rig.model import mechanisms
from rig.recording.recording_tables import write_table
from rig.report.pages.page_templates_and_elements import note_html, svg_figure, svg_text, svg_tooltip, table_html
from rig.report.pages.plots import COLOURS, Series, panel_row_html, plot_panel_svg

WORST = 24  # poses that are drawn
ROW, START, END = 16.0, 60.0, 392.0  # units of a figure: of a pose; where bars begin and end


def write_contributions(path: Path, diagnosis: Diagnosis) -> None:
    """Write a table of contributions: a row for each pose, a column (m) for each finding and for the rest."""
    if not isinstance(diagnosis.evidence, PoseContributions):
        return
    frames, names, sizes = diagnosis.evidence.contributions(diagnosis.selection)
    columns = [name.replace(" ", "_") for name in names]
    columns = [
        f"{name}_{columns[:i].count(name) + 1}" if name in columns[:i] else name for i, name in enumerate(columns)
    ]
    write_table(
        path,
        ("frame", *columns),
        [",".join([str(frame), *(f"{v:.9f}" for v in row)]) for frame, row in zip(frames, sizes)],
    )


def worst_pose_contribution_figure(evidence: PoseContributions[Fit, C], selection: Selection[Fit, C]) -> str:
    """Figure of the findings' contributions at the worst poses, a stacked bar for each pose."""
    frames, names, sizes = evidence.contributions(selection)
    worst = np.argsort(-sizes[:, :-1].sum(axis=1))[:WORST]
    scale = (END - START) / float(sizes[worst].sum(axis=1).max())
    parts = [svg_text(4, 14, "by frame, µm side by side", style="name")]
    for row, pose in enumerate(worst):
        at, y = START, 22 + ROW * row
        parts.append(svg_text(START - 6, y + 12, str(frames[pose]), "end"))
        for which in [*np.argsort(-sizes[pose, :-1]).tolist(), len(names) - 1]:
            wide = float(sizes[pose, which]) * scale
            said = f"{names[which].replace('_', ' ')}: {sizes[pose, which] * 1e6:.1f} µm"
            parts.append(
                f'<rect class="fill {_colour(which, len(names))}" x="{at:.1f}" y="{y:.1f}" '
                f'width="{wide:.1f}" height="{ROW - 3:g}">'
                f"{svg_tooltip(said)}</rect>"
            )
            at += wide
    for k, name in enumerate(names):
        y = 30 + ROW * (len(worst) + k)
        parts += [
            f'<rect class="fill {_colour(k, len(names))}" x="{START:g}" y="{y:.1f}" width="10" height="10"/>',
            svg_text(START + 16, y + 10, name.replace("_", " ")),
        ]
    return svg_figure(
        int(40 + ROW * (len(worst) + len(names))), "contribution of each finding to the most affected poses", parts
    )


def _colour(which: int, count: int) -> str:
    return "grey" if which == count - 1 else f"c{which % COLOURS}"


BINS = 14  # of the covariate, with as many residuals each
BEFORE, AFTER, GREY = 3, 0, -1  # colours of a figure
SCALES, UNITS = {"m": 1e6}, {"m": "µm"}  # in which misfits are shown
SAME_ANGLE = 0.02  # rad; nearer angles than that share a joint's profile


def residual_scatter_figure(
    x: Floats, covariate_label: str, residuals_before_and_after: list[Floats], residual_label: str
) -> str:
    """Residuals before and after (m,) against a covariate x (m,), and those before against what the effect explains."""
    limit = 1.15 * max(float(np.quantile(np.abs(v), 0.995)) for v in residuals_before_and_after) + 1e-12
    explained = residuals_before_and_after[0] - residuals_before_and_after[1]
    ends = np.array([explained.min(), explained.max()])
    panes = (
        (x, residuals_before_and_after[0], "without it", BEFORE, covariate_label, ()),
        (x, residuals_before_and_after[1], "with it", AFTER, covariate_label, ()),
        (
            explained,
            residuals_before_and_after[0],
            "without it, against what it explains",
            BEFORE,
            f"explained: {residual_label}",
            (Series(ends, ends, kind="line", colour=GREY),),
        ),
    )
    return panel_row_html(
        *(
            plot_panel_svg(
                title,
                (below, residual_label),
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


def residuals_in_time_figure(title: str, t: Floats, values: Floats, residual_label: str) -> str:
    """Figure of residuals (n,) at times t (n,) s, with their running mean."""
    order, width = np.argsort(t), max(len(t) // 25, 1)
    ones = np.ones(width) / width
    mean = Series(
        np.convolve(t[order], ones, "valid") / 60,
        np.convolve(values[order], ones, "valid"),
        "running mean",
        "line",
        AFTER,
    )
    return plot_panel_svg(title, ("time, min", residual_label), [Series(t / 60, values, colour=GREY), mean], level=0.0)


def held_out_entries(diagnosis: Diagnosis) -> Json:
    """Entries of diagnosis.json {key: tree} on held-out data: time stretches, travel regions and repeats."""
    out: Json = {}
    if isinstance(diagnosis.evidence, ScatterSize):
        out["scatter_beyond_stated_m"] = diagnosis.evidence.scatter_beyond_stated(diagnosis.selection)[0]
    if isinstance(diagnosis.evidence, NestedSelection):
        out["held_out"] = [
            {
                "stretches": h.stretches,
                "before": position_error_statistics(h.before),
                "after": position_error_statistics(h.after),
                **errors_at_and_beyond_fitted_angles(h),
                "chosen": [list(n) for n in h.names],
            }
            for h in diagnosis.held
        ]
    if isinstance(diagnosis.evidence, RegionValidation):
        out["held_out_by_region"] = held_out_region_gains(diagnosis)
    if isinstance(diagnosis.evidence, RepeatedCommands):
        out["repeats"] = repeatability_entry(diagnosis)
    if isinstance(diagnosis.evidence, WeighedPoses):
        out["set_aside"] = diagnosis.evidence.frames_set_aside(diagnosis.selection)
    return out


def repeatability_entry(diagnosis: Diagnosis) -> Json | None:
    """Entry on how well poses repeat; None where too few commands were repeated."""
    again = diagnosis.repeats
    if again is None:
        return None
    return {
        "pairs": again.pairs,
        "mean_m": again.mean,
        "rms_m": again.rms,
        "mean_rad": again.mean_rad,
        "remainder_that_repeats": again.recurring_share,
    }


def held_out_region_gains(diagnosis: Diagnosis) -> list[Json]:
    """Gains by each finding where whole regions of an axis' travel are held out: misfit before and after,
    m, and standard errors.
    """
    if diagnosis.design is None:
        return []
    places = mechanisms.axis_place_texts(diagnosis.design.mechanism)
    return [
        {
            "joint": j + 1,
            "place": places[j],
            "findings": [
                {"heldout_before": v.before, "heldout_after": v.after, "gain_sigma": v.gain, "unit": v.unit}
                for v in row
            ],
        }
        for j, row in enumerate(diagnosis.regions)
    ]


def position_error_statistics(pose_errors: Floats) -> dict[str, float]:
    """Statistics of position errors (mean, RMS, p95, maximum, count), m, and the mean rotation error, rad."""
    size = np.linalg.norm(pose_errors[:, :3], axis=1)
    out = {
        "mean_m": float(size.mean()),
        "rms_m": float(np.sqrt((size**2).mean())),
        "p95_m": float(np.quantile(size, 0.95)),
        "max_m": float(size.max()),
        "n": len(size),
    }
    return out | (
        {"mean_rad": float(np.linalg.norm(pose_errors[:, 3:], axis=1).mean())} if pose_errors.shape[1] == 6 else {}
    )


def errors_at_and_beyond_fitted_angles(held_out_poses: HeldOutPoses) -> Json:
    """Errors {after_at_fitted_angles, after_beyond} of held-out poses all of whose joints stood within SAME_ANGLE of
    an angle that they were fitted at, and of the rest; None where there are none. No data tell a profile where its
    joint never stood."""
    near = held_out_poses.far <= SAME_ANGLE
    return {
        name: position_error_statistics(held_out_poses.after[rows]) if rows.any() else None
        for name, rows in (("after_at_fitted_angles", near), ("after_beyond", ~near))
    }


def repeatability_rows(diagnosis: Diagnosis) -> list[tuple[str, object]]:
    """Table rows [(what, value)] on how well poses repeat; none where too few commands were repeated."""
    if diagnosis.repeats is None:
        return []
    text = f"{diagnosis.repeats.mean * 1e6:.1f} µm ({diagnosis.repeats.pairs} pairs)"
    return [("repeatability of the same command", text)]


def held_out_gain_table(diagnosis: Diagnosis) -> str:
    """Table of the fall of the held-out misfit by each finding, with stretches of time and regions of each axis' travel
    held out.
    """
    rows, terms = [], diagnosis.selection.problem.terms(diagnosis.selection.fit)
    for i, finding in enumerate(diagnosis.findings):
        candidate = terms[finding.number]
        found = [diagnosis.cross_validations[i], *(row[i] for row in diagnosis.regions)]
        scale = SCALES.get(found[0].unit, 1.0)
        rows.append(
            [
                f"{candidate.name.replace('_', ' ')} at {candidate.place}",
                *(f"{(v.before - v.after) * scale:+.{1 if scale > 1 else 4}f}" for v in found),
            ]
        )
    places = [] if diagnosis.design is None else mechanisms.axis_place_texts(diagnosis.design.mechanism)
    units = " or ".join(dict.fromkeys(UNITS.get(v.unit, v.unit) for v in diagnosis.cross_validations))
    said = note_html(
        f"{units}, RMS along one axis, by which held-out data are predicted better with it than without. A curve of "
        "an axis' own position is undetermined where that axis was never recorded: there, its gain by that axis' own "
        "regions may be negative."
    )
    return table_html(("finding", "held out: time", *places[: len(diagnosis.regions)]), rows) + said
