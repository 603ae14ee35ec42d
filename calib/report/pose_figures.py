"""Figures of poses for pages: where they lie, and their errors before and after correction."""

import numpy as np

from rig.report.pages.plots import Series, panel_row, plot_panel


def pose_coverage_figures(vectors: np.ndarray) -> str:
    """Where poses lie: vectors (n, 6) position (m) and rotation vector (rad)."""
    mm = vectors[:, :3] * 1e3
    places = [
        plot_panel(f"seen {seen}", (f"{'xyz'[i]}, mm", f"{'xyz'[j]}, mm"), [Series(mm[:, i], mm[:, j])])
        for seen, i, j in (("from above", 0, 1), ("from the side", 0, 2))
    ]
    turns = [
        Series(np.arange(len(vectors)), np.degrees(vectors[:, 3 + k]), name, colour=k)
        for k, name in enumerate(("rx", "ry", "rz"))
    ]
    return panel_row(*places, plot_panel("how it was turned", ("pose", "rotation vector, degrees"), turns))


def correction_error_figures(before: np.ndarray, after: np.ndarray, frames: np.ndarray) -> str:
    """Errors (n, 6) m and rad before and after correction, frame (n,) by frame; rotations that were not measured are
    nan and left out.
    """
    seen = [
        (part, label)
        for part, label in ((slice(0, 3), "position, mm"), (slice(3, 6), "rotation, mrad"))
        if np.isfinite(after[:, part]).all()
    ]
    return panel_row(
        *(
            plot_panel(
                f"error of {label.partition(',')[0]}",
                ("frame", label),
                [
                    Series(frames, np.linalg.norm(before[:, part], axis=1) * 1e3, "owner's model", colour=1),
                    Series(frames, np.linalg.norm(after[:, part], axis=1) * 1e3, "corrected", colour=0),
                ],
                log=True,
            )
            for part, label in seen
        )
    )
