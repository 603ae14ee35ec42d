"""Figures of a certificate, as SVG drawn into its page."""

import numpy as np

from calib.certificate.certificate import Certificate
from calib.certificate.certificate_sentences import micrometre_text
from rig.report.pages.svg_elements import round_ticks, svg, text, text_within, tooltip


def error_distribution_figure(c: Certificate) -> str:
    """Share of poses nearer than a length, as measured, with the promise and a tolerance drawn in."""
    lengths = np.sort(np.linalg.norm(c.errors[:, :3], axis=1)) * 1e6
    upper = c.promise.position.upper * 1e6
    lines = [("promise", upper)] + [("tolerance", k.tolerance * 1e6) for k in c.conformity if k.quantity == "position"]
    top = 1.08 * max(lengths[-1], *(value for _, value in lines))
    left, right, high = 44.0, 388.0, 8.0 + 16 * len(lines)
    bottom = high + 154

    def x(value: float) -> float:
        return left + (right - left) * value / top

    def y(part: float) -> float:
        return bottom - (bottom - high) * part

    steps = " ".join(
        f"{x(v):.1f},{y(k / len(lengths)):.1f} {x(v):.1f},{y((k + 1) / len(lengths)):.1f}"
        for k, v in enumerate(lengths)
    )
    parts = [
        f'<path class="axis" d="M{left},{high}V{bottom}H{right}"/>',
        f'<polyline class="line" points="{x(0):.1f},{y(0):.1f} {steps}"/>',
    ]
    parts += [text(left - 6, y(p) + 4, f"{p:.0%}", "end") for p in (0.0, 0.5, 1.0)]
    parts += [text(x(v), bottom + 16, f"{v:g}", "middle") for v in round_ticks(0.0, top)]
    for row, (name, value) in enumerate(lines):
        aside, anchor = (-5, "end") if value > top / 2 else (5, "start")
        parts += [
            f'<path class="mark" d="M{x(value):.1f},{4 + 16 * row}V{bottom}"/>',
            text(x(value) + aside, 14 + 16 * row, f"{name} {value:.1f}", anchor),
        ]
    parts.append(text((left + right) / 2, bottom + 34, "position error as measured, um", "middle"))
    return svg(int(bottom) + 40, f"{len(lengths)} poses: share nearer than a length; promise {upper:.1f} um", parts)


def cell_bound_figures(c: Certificate) -> str:
    """The cells of the volume from above (x, y) and from the side (x, z), each with its bound; where some lie behind
    each other, the worst.
    """
    parts, height, left = [], 0.0, 6.0
    worst = max(cell.promise.position.upper for cell in c.cells)
    boxes = np.array([(cell.low, cell.high) for cell in c.cells])
    bounds = np.array([cell.promise.position.upper for cell in c.cells])
    for a, b in ((0, 1), (0, 2)):
        low, high = np.array(c.volume.low)[[a, b]], np.array(c.volume.high)[[a, b]]
        scale = min(388 / (high[0] - low[0]), 260 / (high[1] - low[1]))
        base = height + 20 + scale * (high[1] - low[1])
        for (x0, y0, x1, y1), bound in visible_rectangles(boxes[:, :, [a, b]], bounds):
            at, up, wide, tall = (
                left + scale * (x0 - low[0]),
                base - scale * (y1 - low[1]),
                scale * (x1 - x0),
                scale * (y1 - y0),
            )
            parts.append(
                f'<rect class="cell" fill-opacity="{0.1 + 0.5 * bound / worst:.2f}" x="{at:.1f}" '
                f'y="{up:.1f}" width="{wide:.1f}" '
                f'height="{tall:.1f}">{tooltip(f"{bound * 1e6:.1f} um")}</rect>'
            )
            parts.append(text_within((at, up, wide, tall), f"{bound * 1e6:.0f}"))
        parts += [
            text(left, height + 14, f"{'xyz'[b]} up, {low[1] * 1e3:.0f} to {high[1] * 1e3:.0f} mm"),
            text(left, base + 16, f"{'xyz'[a]} to the right, {low[0] * 1e3:.0f} to {high[0] * 1e3:.0f} mm"),
        ]
        height = base + 26
    return svg(int(height) + 6, "bounds in um, cell by cell, from above and from the side", parts)


def visible_rectangles(boxes: np.ndarray, values: np.ndarray) -> list[tuple[tuple[float, ...], float]]:
    """What is seen of boxes that lie behind each other: rectangles that do not overlap, each with the greatest value of
    those behind it.

    boxes : (n, 2, 2), low and high corner; values : (n,)
    Returns [((x low, y low, x high, y high), value)]
    """
    xs, ys = np.unique(boxes[:, :, 0]), np.unique(boxes[:, :, 1])
    middle = np.stack(np.meshgrid((xs[1:] + xs[:-1]) / 2, (ys[1:] + ys[:-1]) / 2, indexing="ij"), axis=-1)
    behind = ((middle[:, :, None] > boxes[:, 0]) & (middle[:, :, None] < boxes[:, 1])).all(axis=-1)
    greatest = np.where(behind, values, -np.inf).max(axis=-1)
    out, left = [], np.isfinite(greatest)
    for i, j in np.argwhere(left).tolist():
        if not left[i, j]:
            continue
        same = left & (greatest == greatest[i, j])
        wide = int(np.argmin(np.append(same[i:, j], False)))
        tall = int(np.argmin(np.append(same[i : i + wide, j:].all(axis=0), False)))
        left[i : i + wide, j : j + tall] = False
        out.append((tuple(map(float, (xs[i], ys[j], xs[i + wide], ys[j + tall]))), float(greatest[i, j])))
    return out


def budget_figure(c: Certificate) -> str:
    """U (coverage 95 %) of each contribution to a position, as bars."""
    rows = [row for row in c.budget.rows if row.position is not None]
    top = max([row.position or 0.0 for row in rows] + [1e-12])
    parts = []
    for k, row in enumerate(rows):
        wide = 220 * (row.position or 0.0) / top
        size, style = micrometre_text(row.position or 0.0), "bar" if row.of == "machine" else "measuring"
        parts += [
            text(92, 16 + 22 * k, row.name, "end"),
            f'<rect class="{style}" x="98" y="{5 + 22 * k}" width="{wide:.1f}" height="14">'
            f"{tooltip(f'{row.name}, {row.of}: {size}')}</rect>",
            text(102 + wide, 16 + 22 * k, size),
        ]
    return svg(10 + 22 * len(rows), "contributions to a position's uncertainty, coverage 95 %", parts)
