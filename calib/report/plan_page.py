"""The page of a plan: where it goes, and what it will make visible."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.report.pose_figures import pose_coverage_figures
from calib.report.scene_3d import rig_stage
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.pose import pose_to_vector
from rig.report.pages.html_elements import heading, list_html
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.plots import Series, panel_row, plot_panel
from rig.report.pages.view_3d import view_3d_html, view_scripts
from rig.report.verdict import State, Verdict


@dataclass(frozen=True, slots=True, eq=False)
class PlanResult:
    """A plan. design; values : (n, axes) m or rad in their order; verdict : on it; said : lines on what it tells"""

    design: Design
    values: np.ndarray
    verdict: Verdict
    said: Sequence[str]


def write_plan_page(path: Path | str, file: str, p: PlanResult, links: Sequence[Link] = ()) -> None:
    """Write the page of a plan that is in a file; of one that visits nothing, why. Raises as forward kinematics does"""
    if not len(p.values):
        write_page(path, Page("plan", f"No plan {file}", p.verdict, [], [], links))
        return
    mechanism, n = p.design.mechanism, np.arange(len(p.values))
    T = mechanisms.kinematics_of(mechanism).forward(p.values, mechanism)
    units = mechanisms.axis_units(mechanism)
    scales = [(1e3, "mm") if unit == "m" else (180 / np.pi, "degrees") for unit in units]
    axes = panel_row(
        *(
            plot_panel(name, ("configuration", unit), [Series(n, p.values[:, i] * scale)])
            for i, (name, (scale, unit)) in enumerate(zip(mechanisms.axis_places(mechanism), scales))
        )
    )
    said = [list_html(p.said[1:])] if p.said[1:] else []
    parts = [
        *said,
        heading("In three dimensions"),
        *view_3d_html(rig_stage(p.design, n, T, p.values)),
        heading("Where it goes"),
        pose_coverage_figures(pose_to_vector(T)),
        heading("Axis by axis"),
        axes,
    ]
    steps = [
        f"Drive it: `rig run RIG.toml --plan commands:{file} --out REC`",
        f"Or try it first: `rig simulate RIG.toml --plan commands:{file} --out REC`",
    ]
    write_page(
        path,
        Page(
            "plan",
            f"Plan {file}",
            p.verdict,
            parts,
            steps if p.verdict.state != State.BAD else [],
            links,
            view_scripts(parts),
        ),
    )
