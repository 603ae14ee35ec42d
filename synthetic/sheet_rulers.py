"""What stands around a net on its sheet: rulers both ways, and a legend of its lines."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

MARGIN, LEFT, FOOT = (
    10.0,
    17.0,
    20.0,
)  # mm: at the edges; at the left, with its ruler; above the lower margin, for ruler, legend and label
RULER = 100  # mm, of each ruler


def usable_area(paper: tuple[float, float]) -> tuple[float, float]:
    """(width, height) mm of a sheet as it lies that are left for what is printed. paper : (width, height) mm"""
    return paper[0] - LEFT - MARGIN, paper[1] - FOOT - 2 * MARGIN


def cut_line_style() -> dict[str, Any]:
    """How a line to cut along is drawn."""
    return {"color": "black", "lw": 0.5, "ls": "-"}


def fold_line_style() -> dict[str, Any]:
    """How a line to fold along is drawn."""
    return {"color": "0.45", "lw": 0.5, "ls": (0, (4, 3))}


def draw_rulers_and_legend(axes: Axes, paper: tuple[float, float], label: str) -> None:
    """Rulers along the foot and up the left side, the legend and the label of a sheet. paper : (width, height) mm"""
    for along in (0, 1):
        start = (LEFT, MARGIN) if along == 0 else (MARGIN, MARGIN + FOOT)
        _ruler(axes, start, along)
    x, y = LEFT + RULER + 6, MARGIN + 2
    for text, style in (("cut", cut_line_style()), ("fold", fold_line_style())):
        axes.plot([x, x + 10], [y, y], **style)
        axes.text(x + 11.5, y, text, fontsize=7, va="center")
        x += 21
    axes.add_patch(Rectangle((x, y - 1.5), 8, 3, fc="0.93", ec="none"))
    axes.text(x + 9.5, y, "glue", fontsize=7, va="center")
    axes.text(LEFT, MARGIN + 13.5, label, fontsize=7)
    axes.text(
        LEFT,
        MARGIN + 9.5,
        f"Both rulers are {RULER} mm long when printed at 100 %; if not, the markers are off by as much: "
        "measure them, or rig check-print.",
        fontsize=6,
    )


def _ruler(axes: Axes, start: tuple[float, float], along: int) -> None:
    """A ruler of whole centimetres from start (mm), to the right (along 0) or upwards (1)."""
    for mm in range(RULER + 1):
        tall = 5 if mm % 10 == 0 else 3.5 if mm % 5 == 0 else 2
        at = (start[0] + mm, start[1]) if along == 0 else (start[0], start[1] + mm)
        axes.plot(*zip(at, (at[0], at[1] + tall) if along == 0 else (at[0] + tall, at[1])), color="black", lw=0.3)
    last = (start[0] + RULER, start[1]) if along == 0 else (start[0], start[1] + RULER)
    axes.plot(*zip(start, last), color="black", lw=0.3)
