"""The page of a plan: where it goes, and what it will make visible."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.report.pose_figures import coverage
from calib.report.scene_3d import stage
from rig.model import mechanisms
from rig.model.design import Design
from rig.report.verdict import State, Verdict
from rig.report.pages.page_template import Link, Page, write
from rig.report.pages.plots import Series, panel, panels
from rig.report.pages.html_elements import heading, listed
from rig.report.pages.view_3d import scripts, view
from rig.model.pose import vector


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A plan. design; values : (n, axes) m or rad in their order; verdict : on it; said : lines on what it tells"""

    design: Design
    values: np.ndarray
    verdict: Verdict
    said: Sequence[str]


def planned_page(path: Path | str, file: str, p: Planned, links: Sequence[Link] = ()) -> None:
    """Write the page of a plan that is in a file; of one that visits nothing, why. Raises as forward kinematics does"""
    if not len(p.values):
        write(path, Page("plan", f"No plan {file}", p.verdict, [], [], links))
        return
    mechanism, n = p.design.mechanism, np.arange(len(p.values))
    T = mechanisms.of(mechanism).forward(p.values, mechanism)
    units = mechanisms.units(mechanism)
    scales = [(1e3, "mm") if unit == "m" else (180 / np.pi, "degrees") for unit in units]
    axes = panels(*(panel(name, ("configuration", unit), [Series(n, p.values[:, i] * scale)])
                    for i, (name, (scale, unit)) in enumerate(zip(mechanisms.places(mechanism), scales))))
    said = [listed(p.said[1:])] if p.said[1:] else []
    parts = [*said, heading("In three dimensions"), *view(stage(p.design, n, T, p.values)), heading("Where it goes"),
             coverage(vector(T)), heading("Axis by axis"), axes]
    steps = [f"Drive it: `rig run RIG.toml --plan commands:{file} --out REC`",
             f"Or try it first: `rig simulate RIG.toml --plan commands:{file} --out REC`"]
    write(path, Page("plan", f"Plan {file}", p.verdict, parts, steps if p.verdict.state != State.BAD else [], links, scripts(parts)))
