"""HTML page of a certificate.

What is promised, on whose scale, what that rests on, and figures.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calib.certificate import certificate_sentences_and_quantity_texts
from calib.certificate.certificate_computation_verdict_and_provenance import Certificate, certificate_verdict
from calib.certificate.certificate_sentences_and_quantity_texts import micrometre_text
from calib.certification.iso230_and_iso9283_tests import FEWEST
from calib.report.platform_and_lens_calibration_pages import rows_of_nested_dict
from rig.array_and_json_types import Floats
from rig.report.pages.html_and_svg_elements import (
    collapsible_section_html,
    figures_with_caption_html,
    heading_html,
    note_html,
    paragraph_html,
    round_ticks,
    svg_figure,
    svg_text,
    svg_text_or_empty_if_too_large,
    svg_tooltip,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page


def _error_distribution_figure(certificate: Certificate) -> str:
    """Share of poses nearer than a length, as measured, with the promise and a tolerance drawn in."""
    lengths = np.sort(np.linalg.norm(certificate.errors[:, :3], axis=1)) * 1e6
    upper = certificate.promise.position.upper * 1e6
    lines = [("promise", upper)] + [
        ("tolerance", k.tolerance * 1e6) for k in certificate.conformity if k.quantity == "position"
    ]
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
    parts += [svg_text(left - 6, y(p) + 4, f"{p:.0%}", "end") for p in (0.0, 0.5, 1.0)]
    parts += [svg_text(x(v), bottom + 16, f"{v:g}", "middle") for v in round_ticks(0.0, top)]
    for row, (name, value) in enumerate(lines):
        aside, anchor = (-5, "end") if value > top / 2 else (5, "start")
        parts += [
            f'<path class="mark" d="M{x(value):.1f},{4 + 16 * row}V{bottom}"/>',
            svg_text(x(value) + aside, 14 + 16 * row, f"{name} {value:.1f} um", anchor),
        ]
    parts.append(svg_text((left + right) / 2, bottom + 34, "measured position error, um", "middle"))
    return svg_figure(
        int(bottom) + 40, f"{len(lengths)} poses: share nearer than a length; promise {upper:.1f} um", parts
    )


def _cell_bound_figures(certificate: Certificate) -> str:
    """The cells of the volume from above (x, y) and from the side (x, z), each with its bound; where some lie behind
    each other, the worst.
    """
    parts, height, left = [], 0.0, 6.0
    worst = max(cell.promise.position.upper for cell in certificate.cells)
    boxes = np.array([(cell.low, cell.high) for cell in certificate.cells])
    bounds = np.array([cell.promise.position.upper for cell in certificate.cells])
    for a, b in ((0, 1), (0, 2)):
        low, high = np.array(certificate.volume.low)[[a, b]], np.array(certificate.volume.high)[[a, b]]
        scale = min(388 / (high[0] - low[0]), 260 / (high[1] - low[1]))
        base = height + 20 + scale * (high[1] - low[1])
        for (x0, y0, x1, y1), bound in disjoint_rectangles_of_greatest_value(boxes[:, :, [a, b]], bounds):
            at, up, wide, tall = (
                left + scale * (x0 - low[0]),
                base - scale * (y1 - low[1]),
                scale * (x1 - x0),
                scale * (y1 - y0),
            )
            parts.append(
                f'<rect class="cell" fill-opacity="{0.1 + 0.5 * bound / worst:.2f}" x="{at:.1f}" '
                f'y="{up:.1f}" width="{wide:.1f}" '
                f'height="{tall:.1f}">{svg_tooltip(f"{bound * 1e6:.1f} um")}</rect>'
            )
            parts.append(svg_text_or_empty_if_too_large((at, up, wide, tall), f"{bound * 1e6:.0f}"))
        parts += [
            svg_text(left, height + 14, f"{'xyz'[b]} up, {low[1] * 1e3:.0f} to {high[1] * 1e3:.0f} mm"),
            svg_text(left, base + 16, f"{'xyz'[a]} to the right, {low[0] * 1e3:.0f} to {high[0] * 1e3:.0f} mm"),
        ]
        height = base + 26
    return svg_figure(int(height) + 6, "bounds per cell in um, from above and from the side", parts)


def disjoint_rectangles_of_greatest_value(boxes: Floats, values: Floats) -> list[tuple[tuple[float, ...], float]]:
    """Disjoint rectangles that cover projected boxes, each with the greatest value of the boxes over it.

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


def _budget_figure(certificate: Certificate) -> str:
    """U (coverage 95 %) of each contribution to a position, as bars."""
    rows = [row for row in certificate.budget.rows if row.position is not None]
    top = max([row.position or 0.0 for row in rows] + [1e-12])
    parts = []
    for k, row in enumerate(rows):
        wide = 220 * (row.position or 0.0) / top
        size, style = micrometre_text(row.position or 0.0), "bar" if row.of == "machine" else "measuring"
        parts += [
            svg_text(92, 16 + 22 * k, row.name, "end"),
            f'<rect class="{style}" x="98" y="{5 + 22 * k}" width="{wide:.1f}" height="14">'
            f"{svg_tooltip(f'{row.name}, {row.of}: {size}')}</rect>",
            svg_text(102 + wide, 16 + 22 * k, size),
        ]
    return svg_figure(10 + 22 * len(rows), "contributions to the uncertainty of a position, coverage 95 %", parts)


NOT_KNOWN = "not known"


def write_certificate_page(path: Path, certificate: Certificate, links: Sequence[Link] = ()) -> None:
    """Write a certificate's HTML page.

    One file, usable offline.
    """
    parts = [
        *_promise(certificate),
        *_against(certificate),
        *_cells(certificate),
        *_floor(certificate),
        *_standards(certificate),
        *_budget(certificate),
        *_conditions(certificate),
        *_origin(certificate),
    ]
    verdict = certificate_verdict(certificate)
    write_page(
        path,
        Page(
            "certify",
            f"Certificate of {certificate.machine}, {certificate.provenance['created'][:10]}",
            verdict,
            parts,
            verdict.next,
            links,
        ),
    )


def _promise(c: Certificate) -> list[str]:
    lines = (
        certificate_sentences_and_quantity_texts.length_scale_line(c),
        certificate_sentences_and_quantity_texts.promise_line(c),
        certificate_sentences_and_quantity_texts.measured_volume_line(c),
        *certificate_sentences_and_quantity_texts.promise_basis_lines(c),
    )
    caption = (
        "Share of the held-out poses whose measured position error (µm) is no larger; dashed: the promise. Good: the "
        "curve reaches 100 % left of the dashed lines. Bad: it crosses one, or has a long tail."
    )
    return [figures_with_caption_html(_error_distribution_figure(c), caption), *map(paragraph_html, lines)]


def _against(c: Certificate) -> list[str]:
    if not c.conformity:
        return []
    return [
        heading_html("Against the tolerance"),
        *map(paragraph_html, certificate_sentences_and_quantity_texts.conformity_lines(c)),
        note_html(
            "One joint decision is made on all tolerances, from limits of 97.5 % confidence (guard bands, JCGM "
            "106): it is wrong in 2.5 % of "
            "cases at the most. A position is accepted only where the scale is certified."
        ),
    ]


def _cells(c: Certificate) -> list[str]:
    if not c.cells:
        return []
    rows = [
        (
            *(f"{low * 1e3:.0f} to {high * 1e3:.0f}" for low, high in zip(cell.low, cell.high)),
            f"{cell.promise.position.upper * 1e6:.1f}",
            "" if cell.promise.rotation is None else f"{cell.promise.rotation.upper * 1e6:.1f}",
            cell.promise.n,
        )
        for cell in c.cells
    ]
    return [
        heading_html("By part of the volume"),
        figures_with_caption_html(
            _cell_bound_figures(c),
            "The same promise, position in um, for boxes of the volume, each from its own poses, with the stated "
            "confidence for each. Good: alike everywhere. Bad: a dark box; there the machine is worse.",
        ),
        table_html(("x, mm", "y, mm", "z, mm", "position, um", "rotation, urad", "N"), rows),
    ]


def _floor(c: Certificate) -> list[str]:
    rows = [
        (
            name,
            f"{f.position[0] * 1e6:.1f}",
            f"{f.position[1] * 1e6:.1f}",
            f"{f.position[2] * 1e6:.1f}",
            *(f"{value * 1e6:.1f}" if value == value else "" for value in f.rotation),
        )
        for name, f in (("nominal model", c.before), ("calibrated", c.after))
    ]
    return [
        heading_html("Before and after"),
        paragraph_html(f"The same {c.after.n} held-out poses, as measured."),
        table_html(("", "RMS, um", "95 %, um", "max, um", "RMS, urad", "95 %, urad", "max, urad"), rows),
    ]


def _standards(c: Certificate) -> list[str]:
    parts = [
        heading_html("ISO 9283: pose accuracy AP and repeatability RP"),
        paragraph_html(certificate_sentences_and_quantity_texts.iso9283_line(c)),
    ]
    if c.iso9283.repeated:
        rows = [
            (
                " ".join(f"{value * 1e3:.1f}" for value in row.place),
                row.visits,
                row.approaches,
                f"{row.AP * 1e6:.1f}",
                f"{row.RP * 1e6:.1f}",
                *(
                    "" if part is None else " ".join(f"{value * 1e6:.1f}" for value in part)
                    for part in (row.AP_axes, row.RP_axes)
                ),
            )
            for row in c.iso9283.repeated
        ]
        parts.append(
            table_html(
                (
                    "pose at, mm",
                    "visits",
                    "approaches",
                    "AP, um",
                    "RP, um",
                    "AP about x y z, urad",
                    "RP about x y z, urad",
                ),
                rows,
            )
        )
        parts.append(
            note_html(
                f"Poses visited {FEWEST} times or more; where approached from several sides, RP includes reversal."
            )
        )
    parts.append(heading_html("ISO 230-2: individual axes"))
    if not c.iso230:
        return [
            *parts,
            paragraph_html("No axis was moved alone to one position from both sides: use a plan with ladder."),
        ]
    unit = "um" if c.iso230[0].unit == "m" else "urad"
    rows = [
        (
            a.axis,
            *(
                f"{value * 1e6:.1f}" if value is not None else ""
                for _, value in certificate_sentences_and_quantity_texts.iso230_symbol_values(a)
            ),
            f"{a.u * 1e6:.1f}",
            a.positions,
            a.cycles,
            "yes" if a.formal else "no",
        )
        for a in c.iso230
    ]
    names = [name for name, _ in certificate_sentences_and_quantity_texts.iso230_symbol_values(c.iso230[0])]
    return [
        *parts,
        table_html(
            ("axis", *names, "u of one reading", "positions", "cycles", "number required by the standard"), rows
        ),
        note_html(
            f"In {unit}. B reversal, M range of the mean deviations, E systematic deviation, R "
            "repeatability, A accuracy; with an arrow, of "
            "positions approached in that direction only."
        ),
    ]


def _budget(c: Certificate) -> list[str]:
    rows = [
        (
            row.name,
            row.of,
            NOT_KNOWN if row.position is None else f"{row.position * 1e6:.2f}",
            "" if row.rotation is None else f"{row.rotation * 1e6:.2f}",
            certificate_sentences_and_quantity_texts.coverage_factor_text(row),
            row.kind,
            row.source,
        )
        for row in c.budget.rows
    ]
    lines = [
        f"Commanded pose: {certificate_sentences_and_quantity_texts.expanded_uncertainty_text(c.budget.machine)}",
        f"a measured one: {certificate_sentences_and_quantity_texts.expanded_uncertainty_text(c.budget.measuring)}",
    ]
    return [
        heading_html("Uncertainty contributions (U, coverage 95 %)"),
        figures_with_caption_html(
            _budget_figure(c),
            (
                "Contributions to the uncertainty of a position (um), coverage 95 %. Good: no bar exceeds the others "
                "by far. Bad: one long bar; improve that first. An unknown contribution has none."
            ),
        ),
        paragraph_html("; ".join(lines) + ". Unknown contributions are in neither."),
        table_html(("contribution", "to", "position, um", "rotation, urad", "k", "kind", "how"), rows),
        note_html(
            "95 % of the error's lengths lie within U = k u, with u their RMS. k depends on the directions "
            "of the error: 1.61 where three are "
            "alike, 1.96 where there is one. Kind A: by statistics of these data; B: by other knowledge (JCGM 100)."
        ),
    ]


def _conditions(c: Certificate) -> list[str]:
    k = c.conditions
    logged = [
        (name.removesuffix("_C").replace("_", " "), f"{low:.2f} to {high:.2f}" + (" C" if name.endswith("_C") else ""))
        for name, low, high in k.channels
    ]
    rows = [
        *((f"recording {name}", source) for name, source in k.recordings),
        ("poses at rest", k.poses),
        ("configurations, each counted once", k.configurations),
        ("exposures excluded, machine moving", k.moving),
        ("at rest before each exposure", f"{k.rest:g} s at least"),
        ("approach", k.approach),
        ("payload", "not logged" if k.payload is None else f"{k.payload[0]:g} to {k.payload[1]:g} kg"),
        *logged,
        ("warm-up before the first exposure", f"{k.warm_up / 60:.1f} min"),
        ("duration", f"{k.duration / 60:.1f} min"),
        ("measured by", k.instrument),
        ("frame and scale held by", k.frame),
    ]
    if not any("temperature" in name for name, _, _ in k.channels):
        rows.append(("temperature", "not logged"))
    return [heading_html("Conditions"), table_html(("what", "value"), rows)]


def _origin(c: Certificate) -> list[str]:
    return [
        heading_html("Provenance"),
        collapsible_section_html(
            "Hashes, versions, arguments", table_html(("what", "value"), rows_of_nested_dict(c.provenance))
        ),
    ]
