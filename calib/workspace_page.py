"""The page of a workspace: lost, gained, room, singularities and error bounds over its cells."""

import html
from pathlib import Path

import numpy as np

from calib.html_page import page, table
from calib.svg import STYLE
from calib.workspace import drawing, words
from calib.workspace.cells import Workspace


def workspace_page(path: Path | str, name: str, w: Workspace, unit: str, room_of: str, certified: np.ndarray | None = None) -> None:
    """Write the page. name : of the calibration; unit : of an axis, m or rad; room_of : what the map's room is of, in words
    certified : (c, 2) m and rad that a certificate promises in each cell, NaN where none does, or None without one"""
    quantities = [*((drawing.LOST, drawing.GAINED) if w.lost is not None else ()), drawing.POSITION,
                  *((drawing.ROTATION,) if w.turns else ()), drawing.room(unit), drawing.SINGULAR]
    parts = [f"<style>{STYLE}</style>", *(f"<p>{html.escape(line)}.</p>" for line in words.lines(w, unit)),
             f"<p class=note>Cells of {w.size * 1e3:.3g} mm, those behind each other as one. Poses: all configurations of the strokes, all axes free "
             "of each other; what depends on history, temperature and load is not in it. Room: of " + html.escape(room_of) + ".</p>"]
    for q in quantities:
        parts += [f"<h2>{q.name.capitalize()}</h2>", *drawing.titled(w, q)]
    if certified is not None:
        known = np.flatnonzero(np.isfinite(certified[:, 0]))
        rows = [(*(f"{value * 1e3:.0f}" for value in w.centre[k]), f"{certified[k, 0] * 1e6:.1f}",
                 "" if np.isnan(certified[k, 1]) else f"{certified[k, 1] * 1e6:.1f}", f"{w.bound[k, 0] * 1e6:.1f}") for k in known]
        parts += ["<h2>What the certificate promises</h2><p class=note>From poses held out, in the cells whose middle lies in its volume; beside it "
                  "the bound by the calibration's own covariance.</p>",
                  table(("x, mm", "y, mm", "z, mm", "position, um", "rotation, urad", "bound, um"), rows)]
    page(path, f"Workspace of {name}", parts)
