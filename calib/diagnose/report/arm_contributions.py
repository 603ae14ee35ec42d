"""What each finding does in each pose: a file with all of them, and a picture of the poses that suffer most."""

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from calib.diagnose.problems.arm.diagnose import ArmDiagnosis
from rig.writing import write_table

WORST = 24  # poses that are drawn
LEFT = "what remains"
COLOURS = "tab20"


def contributions(d: ArmDiagnosis) -> tuple[list[str], np.ndarray]:
    """("effect place" .., "what remains"; (n, findings + 1) m) by how much each finding displaces the target in each pose, alone, and what
    they leave; in the order of the diagnosis."""
    names, sizes = [], []
    for finding in d.findings:
        term = d.fit.terms[finding.number]
        moved = d.fit.part(finding.number)
        if term.candidate.joint is not None:
            moved = np.linalg.norm(d.arms.joints[:, :3, term.candidate.joint], axis=1) * np.abs(moved)
        names.append(f"{term.candidate.name} {term.candidate.place}")
        sizes.append(moved)
    return [*names, LEFT], np.stack([*sizes, np.linalg.norm(d.fit.left[:, :3], axis=1)], axis=1)


def write(path: Path, d: ArmDiagnosis) -> None:
    """Write a table with a row for each pose and a column, m, for each finding and for what remains."""
    names, sizes = contributions(d)
    columns = [name.replace(" ", "_") for name in names]
    columns = [f"{name}_{columns[:i].count(name) + 1}" if name in columns[:i] else name for i, name in enumerate(columns)]
    write_table(path, ("frame", *columns), [",".join([str(frame), *(f"{v:.9f}" for v in row)]) for frame, row in zip(d.arms.frame, sizes)])


def picture(d: ArmDiagnosis) -> Figure:
    """Figure of the poses that suffer most: for each a bar, made of one for each finding, the biggest first, and of what remains."""
    names, sizes = contributions(d)
    worst = np.argsort(-sizes[:, :-1].sum(axis=1))[:WORST]
    figure = Figure(figsize=(11, 0.9 + 0.24 * len(worst)), layout="constrained")
    axes = figure.subplots()
    order, start = np.argsort(-sizes[worst, :-1], axis=1), np.zeros(len(worst))
    order = np.column_stack([order, np.full(len(worst), len(names) - 1)])
    labelled: set[int] = set()
    for rank in range(len(names)):
        for row, pose in enumerate(worst):
            which = int(order[row, rank])
            axes.barh(row, sizes[pose, which] * 1e6, left=start[row], height=0.8, color=_colour(which, len(names)),
                      label=None if which in labelled else names[which].replace("_", " "))
            labelled.add(which)
            start[row] += sizes[pose, which] * 1e6
    axes.set_yticks(range(len(worst)), [str(frame) for frame in d.arms.frame[worst]], fontsize=7)
    axes.invert_yaxis()
    axes.set(xlabel="µm, one beside the other", ylabel="frame")
    axes.legend(fontsize=7, loc="lower right")
    return figure


def _colour(which: int, count: int) -> str | tuple[float, ...]:
    return "0.75" if which == count - 1 else colormaps[COLOURS](which % 20)
