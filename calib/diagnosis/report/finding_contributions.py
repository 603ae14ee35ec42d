"""Contribution of each finding to each pose's error: a table of all, a figure of the worst."""

from pathlib import Path

import numpy as np

from calib.diagnosis.engine.problem_interface import Fit
from calib.diagnosis.engine.selection_inputs import C
from calib.diagnosis.engine.term_selection import Selection
from calib.diagnosis.problems.evidence_interface import PoseContributions
from calib.diagnosis.recording_diagnosis import Diagnosis
from rig.recording.recording_tables import write_table
from rig.report.pages.html_and_svg_elements import svg_figure, svg_text, svg_tooltip
from rig.report.pages.plots import COLOURS

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
    parts = [svg_text(4, 14, "by frame, µm one beside the other", style="name")]
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
        int(40 + ROW * (len(worst) + len(names))), "what each finding does to the poses that suffer most", parts
    )


def _colour(which: int, count: int) -> str:
    return "grey" if which == count - 1 else f"c{which % COLOURS}"
