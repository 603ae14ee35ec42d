"""HTML pages of a recording and of a plan.

Their poses in a 3-D scene, and effects on them.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from calib.report.pose_and_effect_figures import (
    pose_coverage_figures,
    pose_displacements_by_effect_at_several_sizes,
    rig_scene,
)
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.errors import RigError
from rig.formats.numbers_and_units import count_text
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.pose import pose_difference, pose_to_vector
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import figures_with_caption_html, heading_html, list_html
from rig.report.pages.image_plane_and_3d_views import DrawnEffect as Played
from rig.report.pages.image_plane_and_3d_views import view_3d_html, view_3d_scripts_if_needed
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import Series, figures_side_by_side_html, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import Evidence, MissingEvidence, State, Verdict, judge_evidence


def write_recording_page(
    path: Path | str, recording: Recording, effects: Sequence[Effect] = (), links: Sequence[Link] = ()
) -> None:
    """Write the HTML page of a recording.

    Its poses, its commands or both.
    effects : to be tried on it, each by itself
    Raises RigError for a recording with neither, for effects on one without commands, and as their models do
    """
    design, poses, values = recording.design, recording.poses, None
    errors: dict[str, Floats] = {}
    tried: list[Played | None] = []
    if recording.commands is not None:
        frames, t, values = recording.commanded()
        T = mechanisms.kinematics_of(design.mechanism).forward(values, design.mechanism)
        tried = [
            pose_displacements_by_effect_at_several_sizes(
                design, recording.commands, t, (effect,), 0, recording.sensors
            )
            for effect in effects
        ]
        if poses is not None:
            at, by_model = np.searchsorted(frames, poses.frame), T
            frames, values, T = frames[at], values[at], poses.T_base_platform
            errors = {"the model in rig.toml, from what was measured": pose_difference(T, by_model[at])}
            tried = [one and replace(one, shifts=one.shifts[:, at]) for one in tried]
    elif poses is None:
        raise RigError(
            f"{recording.folder} has neither poses.csv nor commands.csv, so no pose can be shown; `rig "
            "measure` finds poses"
        )
    elif effects:
        raise RigError(f"{recording.folder} has no commands.csv, but effects act on commands")
    else:
        frames, T = poses.frame, poses.T_base_platform
    still = [
        f"{effect.label()} at {effect.place} does not move the platform: it acts on the images"
        for effect, one in zip(effects, tried)
        if one is None
    ]
    shown = rig_scene(design, frames, T, values, errors, tuple(one for one in tried if one is not None))
    parts = [
        *view_3d_html(shown),
        *([list_html(still)] if still else []),
        heading_html("Positions"),
        pose_coverage_figures(pose_to_vector(T)),
    ]
    title = f"{recording.name} in three dimensions"
    write_page(
        path,
        Page(
            "view",
            title,
            _recording_verdict(recording, frames, errors),
            parts,
            _recommended_actions(recording),
            links,
            view_3d_scripts_if_needed(parts),
        ),
    )


def _recording_verdict(recording: Recording, frames: Integers, errors: dict[str, Floats]) -> Verdict:
    """The verdict on what is shown. frames : (n,) numbers; errors : of its poses, tangents (n, 6) m and rad"""
    if recording.poses is None:
        return judge_evidence(
            Evidence(
                f"{count_text(len(frames), 'pose')} as rig.toml and the commands have them",
                missing=(MissingEvidence("nothing was measured"),),
            )
        )
    if not errors:
        return judge_evidence(
            Evidence(f"{count_text(len(frames), 'pose')} as measured; there are no commands to compare them with")
        )
    far = np.linalg.norm(next(iter(errors.values()))[:, :3], axis=1)
    rms = float(np.sqrt(np.mean(far[np.isfinite(far)] ** 2))) if np.isfinite(far).any() else np.nan
    return judge_evidence(
        Evidence(
            f"{count_text(len(frames), 'pose')} as measured; the model in rig.toml is off by {rms * 1e3:.3f} mm RMS"
        )
    )


def _recommended_actions(recording: Recording) -> list[str]:
    """What an owner does next."""
    if recording.poses is None:
        return ["Measure the poses: `rig measure REC --out measured`"]
    if recording.commands is None:
        return []
    return [
        "Calibrate: `rig calibrate REC --out calibration.json`",
        "Determine the unmodelled effects: `rig diagnose REC --out found`",
    ]


class PlanFigures(Protocol):
    """A plan. design; values : (n, axes) m or rad in their order; verdict : on it
    visibility_lines : on what it makes visible
    """

    @property
    def design(self) -> Design:
        """The rig that is planned for."""

    @property
    def values(self) -> Floats:
        """(n, axes) m or rad, in their order."""

    @property
    def verdict(self) -> Verdict:
        """The verdict on it."""

    @property
    def visibility_lines(self) -> Sequence[str]:
        """Lines on what it makes visible."""


def write_plan_page(path: Path | str, file: str, plan_result: PlanFigures, links: Sequence[Link] = ()) -> None:
    """Write the HTML page of a plan in a file.

    Raises as forward kinematics does
    """
    if not len(plan_result.values):
        write_page(path, Page("plan", f"No plan {file}", plan_result.verdict, [], [], links))
        return
    mechanism, n = plan_result.design.mechanism, np.arange(len(plan_result.values))
    T = mechanisms.kinematics_of(mechanism).forward(plan_result.values, mechanism)
    units = mechanisms.axis_units(mechanism)
    scales = [(1e3, "mm") if unit == "m" else (180 / np.pi, "degrees") for unit in units]
    axes = figures_side_by_side_html(
        *(
            plot_panel_svg(name, ("configuration", unit), [Series(n, plan_result.values[:, i] * scale)])
            for i, (name, (scale, unit)) in enumerate(zip(mechanisms.axis_place_texts(mechanism), scales))
        )
    )
    figures = (
        [heading_html("In figures"), list_html(filter(None, plan_result.visibility_lines))]
        if any(plan_result.visibility_lines)
        else []
    )
    parts = [
        heading_html("In three dimensions"),
        *view_3d_html(rig_scene(plan_result.design, n, T, plan_result.values)),
        heading_html("Positions"),
        pose_coverage_figures(pose_to_vector(T)),
        heading_html("Axis by axis"),
        figures_with_caption_html(
            axes,
            "What each axis is commanded (mm or degrees), configuration by configuration. Good: every axis uses its "
            "whole range, from both directions. Bad: an axis that hardly moves; its errors stay unknown.",
        ),
        *figures,
    ]
    steps = [
        f"Drive it: `rig run RIG.toml --plan commands:{file} --out REC`",
        f"Or simulate it first: `rig simulate RIG.toml --plan commands:{file} --out REC`",
    ]
    write_page(
        path,
        Page(
            "plan",
            f"Plan {file}",
            plan_result.verdict,
            parts,
            steps if plan_result.verdict.state != State.BAD else [],
            links,
            view_3d_scripts_if_needed(parts),
        ),
    )
