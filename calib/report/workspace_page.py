"""The page of a workspace: lost, gained, room, singularities and error bounds over its cells."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.workspace import workspace_figures, workspace_sentences
from calib.workspace.workspace_cells import Workspace
from rig.report.pages.html_elements import heading, note, paragraph, table
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.plots import panel_row
from rig.report.verdict import Evidence, Missing, Verdict, judge_evidence

SINGULAR = 0.02  # of the greatest singular value, below which a place is near a singularity


def workspace_page(
    path: Path | str,
    name: str,
    w: Workspace,
    unit: str,
    room_of: str,
    certified: np.ndarray | None = None,
    links: Sequence[Link] = (),
) -> None:
    """Write the page. name : of the calibration; unit : of an axis, m or rad; room_of : what the map's room is of, in
    words
    certified : (c, 2) m and rad that a certificate promises in each cell, NaN where none does, or None without one"""
    quantities = [
        *((workspace_figures.LOST, workspace_figures.GAINED) if w.lost is not None else ()),
        workspace_figures.POSITION,
        *((workspace_figures.ROTATION,) if w.turns else ()),
        workspace_figures.axis_margin_quantity(unit),
        workspace_figures.SINGULAR,
    ]
    first, *rest = workspace_sentences.workspace_lines(w, unit)
    parts = [
        *(paragraph(f"{line}.") for line in rest),
        note(
            f"Cells of {w.size * 1e3:.3g} mm, those behind each other as one. Poses: all configurations of "
            "the strokes, all axes free of each "
            f"other; what depends on history, temperature and load is not in it. Room: of {room_of}."
        ),
    ]
    parts.append(
        panel_row(*("<div>" + "".join(workspace_figures.titled_cells_html(w, q)) + "</div>" for q in quantities))
    )
    if certified is not None:
        known = np.flatnonzero(np.isfinite(certified[:, 0]))
        rows = [
            (
                *(f"{value * 1e3:.0f}" for value in w.centre[k]),
                f"{certified[k, 0] * 1e6:.1f}",
                "" if np.isnan(certified[k, 1]) else f"{certified[k, 1] * 1e6:.1f}",
                f"{w.bound[k, 0] * 1e6:.1f}",
            )
            for k in known
        ]
        parts += [
            heading("What the certificate promises"),
            note(
                "From poses held out, in the cells whose middle lies in its volume; beside it the "
                "bound by the calibration's own covariance."
            ),
            table(("x, mm", "y, mm", "z, mm", "position, um", "rotation, urad", "bound, um"), rows),
        ]
    write_page(
        path,
        Page(
            "workspace",
            f"Workspace of {name}",
            workspace_verdict(w, first.removeprefix("workspace: ")),
            parts,
            recommended_actions(w),
            links,
        ),
    )


def workspace_verdict(w: Workspace, first: str) -> Verdict:
    """The verdict on a Workspace. first : what it comes to, in words"""
    missing = [Missing("somewhere it comes near a singularity")] if np.nanmin(w.singular) < SINGULAR else []
    missing += [Missing("poses are lost")] if w.lost else []
    return judge_evidence(Evidence(first, missing=tuple(missing)))


def recommended_actions(w: Workspace) -> list[str]:
    """What an owner does next with a map of the workspace."""
    lost = (
        [
            "Keep wanted poses out of the cells where some are lost: `rig correct` refuses those that the "
            "machine cannot reach"
        ]
        if w.lost
        else []
    )
    return [
        *lost,
        "Where the bound is greatest, take more poses: `rig plan RIG.toml --for parameters --calibration "
        "calibration.json --out plan.csv`",
    ]
