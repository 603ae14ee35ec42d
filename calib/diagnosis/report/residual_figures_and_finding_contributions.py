"""Figures of residuals, and contributions of findings.

Residuals before and after; contributions of each finding to each pose.

Residuals also against the covariate of an effect; position errors.
"""

from pathlib import Path
from typing import cast

import numpy as np

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C
from calib.diagnosis.engine.forward_and_backward_term_selection import Selection
from calib.diagnosis.engine.problem_interface import Fit
from calib.diagnosis.problems.evidence_interface_and_requested_effects import HeldOutPoses, PoseContributions
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import is_image_only_effect
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import Refinement
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.marker_swap_detection_and_effect_cross_validation import (
    residual_change_column_with_only_effects,
)
from calib.diagnosis.problems.platform.platform_lack_of_fit_excess_scatter_and_covariates import (
    closure_residuals,
    closures_in_metres,
)
from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report.residual_figure_captions import BARS, DOTS, IN_TIME, MAP
from rig.array_and_json_types import Floats, Integers, Json
from rig.effects.framework.effect_base_class import REFERENCE_TEMPERATURE, Effect
from rig.recording.corner_and_pose_csv_tables import write_table
from rig.report.pages.html_and_svg_elements import figures_with_caption_html, svg_figure, svg_text, svg_tooltip
from rig.report.pages.image_plane_and_3d_views import Arrows, image_patch_centres_and_means, image_plane_figure
from rig.report.pages.svg_plots import COLOURS, Series, bar_chart_svg, figures_side_by_side_html, plot_panel_svg

WORST = 24  # poses that are drawn
ROW, START, END = 16.0, 60.0, 392.0  # units of a figure: of a pose; where bars begin and end


def write_finding_contributions_table(path: Path, diagnosis: Diagnosis) -> None:
    """Write a table of the findings' contributions to each pose.

    A column (m) for each finding and for the rest.
    """
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
    """Figure of the findings' contributions at the worst poses.

    It has a stacked bar for each pose.
    """
    frames, names, sizes = evidence.contributions(selection)
    worst = np.argsort(-sizes[:, :-1].sum(axis=1))[:WORST]
    scale = (END - START) / float(sizes[worst].sum(axis=1).max())
    parts = [svg_text(4, 14, "by frame, µm side by side", style="name")]
    for row, pose in enumerate(worst):
        at, y = START, 22 + ROW * row
        parts.append(svg_text(START - 6, y + 12, str(frames[pose]), "end"))
        for which in [*np.argsort(-sizes[pose, :-1]).tolist(), len(names) - 1]:
            wide = float(sizes[pose, which]) * scale
            label = f"{names[which].replace('_', ' ')}: {sizes[pose, which] * 1e6:.1f} µm"
            parts.append(
                f'<rect class="fill {_colour(which, len(names))}" x="{at:.1f}" y="{y:.1f}" '
                f'width="{wide:.1f}" height="{ROW - 3:g}">'
                f"{svg_tooltip(label)}</rect>"
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


def residual_scatter_figure(
    covariate: Floats, covariate_label: str, residuals_before_and_after: list[Floats], residual_label: str
) -> str:
    """Scatter figure of residuals before and after (m,) against a covariate (m,).

    It shows those before also against what the effect explains.
    """
    limit = 1.15 * max(float(np.quantile(np.abs(v), 0.995)) for v in residuals_before_and_after) + 1e-12
    explained = residuals_before_and_after[0] - residuals_before_and_after[1]
    ends = np.array([explained.min(), explained.max()])
    panes = (
        (covariate, residuals_before_and_after[0], "without it", BEFORE, covariate_label, ()),
        (covariate, residuals_before_and_after[1], "with it", AFTER, covariate_label, ()),
        (
            explained,
            residuals_before_and_after[0],
            "without it, against what it explains",
            BEFORE,
            f"explained: {residual_label}",
            (Series(ends, ends, kind="line", colour=GREY),),
        ),
    )
    figures = figures_side_by_side_html(
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
    return figures_with_caption_html(figures, DOTS)


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
    """Figure of residuals (n,) at times t (n,) s.

    It has their running mean.
    """
    order, width = np.argsort(t), max(len(t) // 25, 1)
    ones = np.ones(width) / width
    mean = Series(
        np.convolve(t[order], ones, "valid") / 60,
        np.convolve(values[order], ones, "valid"),
        "running mean",
        "line",
        AFTER,
    )
    series = [Series(t / 60, values, colour=GREY), mean]
    return figures_with_caption_html(plot_panel_svg(title, ("time, min", residual_label), series, level=0.0), IN_TIME)


CELLS = 14  # of a residual map, across the image


def residuals_without_effects(refinement: Refinement, omitted_effects: tuple[int, ...] = ()) -> tuple[Floats, Floats]:
    """Residuals without some admitted effects.

    Returns (closures (F, axes) m, corners (n, 2) px)
    """
    model, k = refinement.model, refinement.point
    retained = [e for i, e in enumerate(k.effects) if i not in set(omitted_effects)]
    if len(retained) == len(k.effects):
        return closure_and_corner_residuals(model)
    done = residual_change_column_with_only_effects(model, retained)
    projected = model.linear.project(done).onto
    grown = [
        (0 if part is None else part[:, 0]) - (cast(Floats, basis) @ projected)[:, 0]
        for part, basis in zip(done.parts, model.linear.columns.parts)
    ]
    return closures_in_metres(model, model.closure_residual + grown[CLOSURES]), _in_pixels(
        model, model.corner_residual + grown[CORNERS]
    )


def closure_and_corner_residuals(model: LinearisedModel) -> tuple[Floats, Floats]:
    """Loop closure residuals and corner residuals of a model as it is.

    Returns (closures (F, axes) m, corners (n, 2) px)
    """
    return closure_residuals(model), _in_pixels(model, model.corner_residual)


def _in_pixels(model: LinearisedModel, image: Floats) -> Floats:
    c = model.corners
    out = np.zeros((len(c.order), 2))
    if len(c.order):
        out[c.order] = np.linalg.solve(c.whiten, c.sigma * image.reshape(-1, 2, 1))[..., 0]
    return out


def effect_residual_figures(refinement: Refinement, effect_index: int) -> str:
    """Figures of the residuals of one admitted effect, without it and with it."""
    k, effect = refinement.point, refinement.point.effects[effect_index]
    (struts_before, image_before), (struts_after, image_after) = (
        residuals_without_effects(refinement, (effect_index,)),
        residuals_without_effects(refinement),
    )
    if not is_image_only_effect(effect):
        x, label, y = _strut_view(effect, k, struts_before, struts_after)
        return residual_scatter_figure(x, label, [v * 1e6 for v in y], "strut, µm")
    own = _own(effect, k)
    draw = {
        "map": lambda: mean_residual_figures_over_camera_image(k, own, (image_before, image_after)),
        "time": lambda: _along_time(k, own, image_before, image_after),
        "scale": lambda: _focal(k, own, image_before, image_after),
        "outward": lambda: _outward(k, own, image_before, image_after),
        "markers": lambda: _bars(effect, k, image_before, image_after),
        "targets": lambda: _bars(effect, k, image_before, image_after),
    }
    if effect.view in draw:
        return draw[effect.view]()
    displacement = image_before[own] - image_after[own]
    size = np.maximum(np.linalg.norm(displacement, axis=1, keepdims=True), 1e-12)
    return residual_scatter_figure(
        size[:, 0],
        "displacement that it causes, px",
        [np.einsum("ni,ni->n", v[own], displacement / size) for v in (image_before, image_after)],
        "residual along it, px",
    )


def _along_time(k: OperatingPoint, own: Integers, before: Floats, after: Floats) -> str:
    """Mean residuals of each picture along the way that the effect moves it most."""
    frame = k.observed.observations.frame[own]
    along = _mean(frame, before[own] - after[own])
    direction = along[np.argmax(np.linalg.norm(along, axis=1))]
    direction = direction / max(np.linalg.norm(direction), 1e-12)
    return residual_scatter_figure(
        k.t[np.unique(frame)] / 60,
        "time, min",
        [_mean(frame, v[own] @ direction) for v in (before, after)],
        "mean of a picture's corners, px",
    )


def _strut_view(effect: Effect, k: OperatingPoint, before: Floats, after: Floats) -> tuple[Floats, str, list[Floats]]:
    """(covariate (m,), its label, [residuals (m,) before, after]) of an effect of the struts."""
    motion = k.motion(tuple(e for e in k.effects if e is not effect))
    covariate, direction = effect.covariate(motion), effect.direction(motion)
    if direction is not None:
        mode = k.swayed(direction)
        size = np.maximum((mode**2).sum(axis=1), 1e-300)
        return (
            covariate.values,
            covariate.label,
            [(mode * v).sum(axis=1) / size * np.sqrt(size.max()) for v in (before, after)],
        )
    at = np.arange(k.axes) if effect.place == "clock" else np.flatnonzero(effect.axes(motion.places) > 0)
    x = covariate.values
    x = np.broadcast_to(x if x.ndim == 2 else x[:, None], before.shape)
    return x[:, at].ravel(), covariate.label, [before[:, at].ravel(), after[:, at].ravel()]


def _own(effect: Effect, k: OperatingPoint) -> Integers:
    """Indices of the corners at an effect's place."""
    o, place = k.observed.observations, effect.site
    if place.kind == "camera":
        return np.flatnonzero(o.camera == [c.name for c in k.design.cameras].index(place.name))
    if place.kind == "marker":
        return np.flatnonzero(k.observed.markers.id[o.marker] == place.number)
    if place.kind == "target":
        return np.flatnonzero(np.array(k.observed.markers.target)[o.marker] == place.name)
    return np.arange(len(o))


def _mean(key: Integers, values: Floats) -> Floats:
    """Means of values (n, ...) by key (n,), in the order of the keys."""
    _, index, count = np.unique(key, return_inverse=True, return_counts=True)
    out = np.zeros((len(count), *values.shape[1:]))
    np.add.at(out, index, values)
    return out / count.reshape(-1, *[1] * (values.ndim - 1))


def _focal(k: OperatingPoint, own: Integers, before: Floats, after: Floats) -> str:
    """Scale of each picture about its centre against temperature."""
    o = k.observed.observations
    matrix = np.stack([c.matrix[:2, 2] for c in k.design.cameras])
    away = o.uv[own] - matrix[o.camera[own]]
    key = o.frame[own] * len(matrix) + o.camera[own]
    keys, first = np.unique(key, return_index=True)
    scale = [
        _mean(key, np.einsum("ni,ni->n", v[own], away)) / np.maximum(_mean(key, (away**2).sum(axis=1)), 1e-12) * 1e6
        for v in (before, after)
    ]
    camera = [c.name for c in k.design.cameras]
    warmth = np.stack([k.logged(f"camera_{name}_temperature_C", "ambient_temperature_C") for name in camera])
    x = warmth[o.camera[own][first], o.frame[own][first]]
    return residual_scatter_figure(
        x, f"temperature, C (dimensions hold at {REFERENCE_TEMPERATURE:g})", scale, "scale of a picture, 1e-6"
    )


def _outward(k: OperatingPoint, own: Integers, before: Floats, after: Floats) -> str:
    """How far corners lie outward of their marker's middle against its size in the image."""
    o = k.observed.observations
    row = k.observed.row[own]
    middle = _mean(row, o.uv[own])
    _, index = np.unique(row, return_inverse=True)
    away = o.uv[own] - middle[index]
    size = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
    values = [_mean(row, np.einsum("ni,ni->n", v[own], away) / size) for v in (before, after)]
    return residual_scatter_figure(
        np.sqrt(2) * _mean(row, size), "side of the marker in the image, px", values, "corners lie outward by, px"
    )


def _bars(effect: Effect, k: OperatingPoint, before: Floats, after: Floats) -> str:
    """Residuals of every marker or target of the same body."""
    o = k.observed.observations
    by_target = effect.view == "targets"
    names = np.array(k.observed.markers.target if by_target else [str(i) for i in k.observed.markers.id])[o.marker]
    labels = sorted(set(names.tolist()), key=lambda n: (len(n), n))
    groups = [
        (text, [float(np.sqrt(np.mean(values[names == n] ** 2))) for n in labels], colour)
        for values, colour, text in ((before, BEFORE, "without it"), (after, AFTER, "with it"))
    ]
    title = f"residuals of every {'cube' if by_target else 'marker'}, RMS"
    return figures_with_caption_html(bar_chart_svg(title, labels, groups, "px", [effect.site.name]), BARS)


def mean_residual_figures_over_camera_image(
    point: OperatingPoint,
    corner_rows: Integers,
    residuals: tuple[Floats, ...],
    titles: tuple[str, ...] = ("without it", "with it"),
) -> str:
    """Figures of mean residuals over one camera's image.

    One for each of several residuals (n, 2) px.
    """
    o = point.observed.observations
    camera = point.design.cameras[o.camera[corner_rows[0]]]
    cell = camera.width / CELLS
    drawn = [image_patch_centres_and_means(o.uv[corner_rows], values[corner_rows], cell) for values in residuals]
    longest = max(float(np.linalg.norm(drawn[0][1], axis=1).max(initial=0)), 1e-9)
    figures = figures_side_by_side_html(
        *(
            image_plane_figure(
                f"{camera.name}, {title}",
                f"longest arrow of both {longest:.3g} px",
                (camera.width, camera.height),
                (Arrows(centre, mean, 1.2 * cell / longest, "px", colour),),
            )
            for (centre, mean), title, colour in zip(drawn, titles, (BEFORE, AFTER))
        )
    )
    return figures_with_caption_html(figures, MAP)


SAME_ANGLE = 0.02  # rad; nearer angles than that share a joint's profile


def position_error_statistics_and_mean_rotation_error(pose_errors: Floats) -> dict[str, float]:
    """Statistics of position errors, and the mean rotation error.

    Mean, RMS, p95, maximum (m) and count; rotation in rad. Of errors of directions (n, 2) all in rad.
    """
    size = np.linalg.norm(pose_errors[:, :3], axis=1)
    unit = "rad" if pose_errors.shape[1] == 2 else "m"
    out = {
        f"mean_{unit}": float(size.mean()),
        f"rms_{unit}": float(np.sqrt((size**2).mean())),
        f"p95_{unit}": float(np.quantile(size, 0.95)),
        f"max_{unit}": float(size.max()),
        "n": len(size),
    }
    return out | (
        {"mean_rad": float(np.linalg.norm(pose_errors[:, 3:], axis=1).mean())} if pose_errors.shape[1] == 6 else {}
    )


def errors_at_and_beyond_fitted_joint_angles(held_out_poses: HeldOutPoses) -> Json:
    """Errors of held-out poses at joint angles that were fitted, and beyond them.

    None where there are none.

    {after_at_fitted_angles, after_beyond}: all joints stood within SAME_ANGLE of an angle that they were fitted at, and
    the rest. No data tell a profile where its joint never stood.
    """
    near = held_out_poses.far <= SAME_ANGLE
    return {
        name: position_error_statistics_and_mean_rotation_error(held_out_poses.after[rows]) if rows.any() else None
        for name, rows in (("after_at_fitted_angles", near), ("after_beyond", ~near))
    }
