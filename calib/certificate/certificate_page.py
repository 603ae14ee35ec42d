"""A certificate as a page: what is promised and on whose scale, then on what it rests."""

from collections.abc import Sequence
from pathlib import Path

from calib.certificate import certificate_figures, certificate_sentences
from calib.certificate.certificate import Certificate
from calib.certificate.certificate_verdict import certificate_verdict
from calib.certify.iso9283 import FEWEST
from calib.report.calibration_page import flattened_rows
from rig.report.pages.html_elements import folding_section, heading, note, paragraph, table
from rig.report.pages.page_template import Link, Page, write_page

NOT_KNOWN = "not known"


def certificate_page(path: Path, c: Certificate, links: Sequence[Link] = ()) -> None:
    """Write the page of a certificate: one file, offline."""
    parts = [
        *_promise(c),
        *_against(c),
        *_cells(c),
        *_floor(c),
        *_standards(c),
        *_budget(c),
        *_conditions(c),
        *_origin(c),
    ]
    verdict = certificate_verdict(c)
    write_page(
        path, Page("certify", f"Certificate of {c.machine} {c.provenance['id']}", verdict, parts, verdict.next, links)
    )


def _promise(c: Certificate) -> list[str]:
    lines = (
        certificate_sentences.scale_line(c),
        certificate_sentences.promise_line(c),
        certificate_sentences.volume_line(c),
        *certificate_sentences.basis_lines(c),
    )
    return [*map(paragraph, lines), certificate_figures.error_distribution_figure(c)]


def _against(c: Certificate) -> list[str]:
    if not c.conformity:
        return []
    return [
        heading("Against the tolerance"),
        *map(paragraph, certificate_sentences.conformity_lines(c)),
        note(
            "One decision is made of all tolerances, from limits of 97.5 % confidence (guard bands, JCGM "
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
        heading("Part by part"),
        certificate_figures.cell_bound_figures(c),
        note(
            "The same promise for boxes of the volume, each by its own poses and with the stated confidence by itself."
        ),
        table(("x, mm", "y, mm", "z, mm", "position, um", "rotation, urad", "N"), rows),
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
        for name, f in (("owner's model", c.before), ("calibrated", c.after))
    ]
    return [
        heading("Before and after"),
        paragraph(f"The same {c.after.n} held-out poses, as measured."),
        table(("", "RMS, um", "95 %, um", "max, um", "RMS, urad", "95 %, urad", "max, urad"), rows),
    ]


def _standards(c: Certificate) -> list[str]:
    parts = [
        heading("ISO 9283: pose accuracy AP and repeatability RP"),
        paragraph(certificate_sentences.iso9283_line(c)),
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
            table(
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
            note(
                f"Poses visited {FEWEST} times or more; where they were come to from several sides, reversal is in RP."
            )
        )
    parts.append(heading("ISO 230-2: each axis by itself"))
    if not c.iso230:
        return [
            *parts,
            paragraph("No axis was moved alone to one position from both sides: a plan with ladder does that."),
        ]
    unit = "um" if c.iso230[0].unit == "m" else "urad"
    rows = [
        (
            a.axis,
            *(
                f"{value * 1e6:.1f}" if value is not None else ""
                for _, value in certificate_sentences.iso230_figures(a)
            ),
            f"{a.u * 1e6:.1f}",
            a.positions,
            a.cycles,
            "yes" if a.formal else "no",
        )
        for a in c.iso230
    ]
    names = [name for name, _ in certificate_sentences.iso230_figures(c.iso230[0])]
    return [
        *parts,
        table(("axis", *names, "u of one reading", "positions", "cycles", "as many as the standard requires"), rows),
        note(
            f"In {unit}. B reversal, M range of the mean deviations, E systematic deviation, R "
            "repeatability, A accuracy; with an arrow, of "
            "positions come to in that direction alone."
        ),
    ]


def _budget(c: Certificate) -> list[str]:
    rows = [
        (
            row.name,
            row.of,
            NOT_KNOWN if row.position is None else f"{row.position * 1e6:.2f}",
            "" if row.rotation is None else f"{row.rotation * 1e6:.2f}",
            certificate_sentences.coverage_factor_text(row),
            row.kind,
            row.source,
        )
        for row in c.budget.rows
    ]
    said = [
        f"A commanded pose: {certificate_sentences.expanded_uncertainty_text(c.budget.machine)}",
        f"a measured one: {certificate_sentences.expanded_uncertainty_text(c.budget.measuring)}",
    ]
    return [
        heading("Where it comes from (U, coverage 95 %)"),
        paragraph("; ".join(said) + ". What is not known is in neither."),
        certificate_figures.budget_figure(c),
        table(("contribution", "to", "position, um", "rotation, urad", "k", "kind", "how"), rows),
        note(
            "95 % of the error's lengths lie within U = k u, with u their RMS. k depends on the directions "
            "of the error: 1.61 where three are "
            "alike, 1.96 where there is one."
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
        ("exposures left out, the machine moving", k.moving),
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
    return [heading("Conditions"), table(("what", "value"), rows)]


def _origin(c: Certificate) -> list[str]:
    return [
        heading("Where this came from"),
        folding_section("Hashes, versions, arguments", table(("what", "value"), flattened_rows(c.provenance))),
    ]
