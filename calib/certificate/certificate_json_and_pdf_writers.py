"""Writers of a certificate that is computed elsewhere: as certificate.json, and as PDF.

The contents of certificate.json, and A4 pages with the sentences, figures and tables of the HTML page.
"""

import io
import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from calib.certificate import certificate_sentences_and_quantity_texts
from calib.certificate.certificate_computation_verdict_and_provenance import Certificate, certificate_verdict
from calib.certification.calibration_evidence_verdict_and_claim_check import AgainstClaim
from calib.certification.held_out_pose_error_statistics import Figures
from calib.certification.pose_error_promise_and_conformity import Promise
from calib.certification.uncertainty_budget import COVERAGE, Budget
from calib.report.platform_and_lens_calibration_pages import rows_of_nested_dict
from rig.array_and_json_types import Json
from rig.formats.json_toml_and_yaml_loading import nan_to_null
from rig.formats.output_files import write_bytes

SCHEMA = "certificate/1"


def certificate_dict(certificate: Certificate) -> Json:
    """dict of a certificate as certificate.json holds it.

    Null where something was not measured or is not known.
    """
    v = certificate.volume
    out = {
        "schema": SCHEMA,
        "statement": [
            certificate_sentences_and_quantity_texts.length_scale_line(certificate),
            certificate_sentences_and_quantity_texts.promise_line(certificate),
            certificate_sentences_and_quantity_texts.measured_volume_line(certificate),
            *certificate_sentences_and_quantity_texts.promise_basis_lines(certificate),
        ],
        "machine": certificate.machine,
        "promise": _promise_tree(certificate.promise),
        "scale": {
            "certified": certificate.options.scale is not None,
            "relative_standard_uncertainty": certificate.options.scale,
            "source": certificate.options.scale_source,
        },
        "volume": {
            "position_low_m": v.low,
            "position_high_m": v.high,
            "rotation_rad": v.turned,
            "axes": v.axes,
            "commands": v.commands,
        },
        "cells": [
            {"position_low_m": cell.low, "position_high_m": cell.high, "promise": _promise_tree(cell.promise)}
            for cell in certificate.cells
        ],
        "held_out": {"before": _figures(certificate.before), "after": _figures(certificate.after)},
        "repeatability": asdict(certificate.repeatability),
        "iso9283": asdict(certificate.iso9283),
        "iso230": [asdict(axis) for axis in certificate.iso230],
        "conformity": [asdict(k) for k in certificate.conformity],
        "budget": _budget(certificate.budget),
        "conditions": asdict(certificate.conditions),
        "claim": {
            "kept": all(one.found.kept for one in certificate.claims),
            "recordings": [_against_claim(one) for one in certificate.claims],
        }
        if certificate.claims
        else None,
        "verdict": certificate_verdict(certificate).tree(),
        **({"displacement": list(certificate.displacement)} if certificate.displacement else {}),
        **({} if certificate.confounds is None else {"confounds": certificate.confounds.tree()}),
        **certificate.provenance,
    }
    return {name: nan_to_null(value) for name, value in out.items()}


def certificate_text(certificate: Certificate) -> str:
    """JSON text of a certificate, as certificate.json holds it."""
    return json.dumps(certificate_dict(certificate), indent=1, allow_nan=False) + "\n"


def _promise_tree(p: Promise) -> Json:
    return {
        "position_m": p.position.upper,
        "rotation_rad": p.turned,
        "coverage": p.coverage,
        "confidence": p.confidence,
        "n": p.n,
        "position": asdict(p.position),
        "rotation": None if p.rotation is None else asdict(p.rotation),
    }


def _against_claim(one: AgainstClaim) -> Json:
    parts = {
        name: {
            "rms": part.rms,
            "beyond_noise": beyond,
            "claimed": claimed,
            "of_allowed": part.of_allowed,
            "limit": part.limit,
            "kept": part.kept,
        }
        for name, (part, beyond, claimed) in one.parts.items()
    }
    return {
        "recording": one.recording,
        "n": one.found.n,
        "kept": one.found.kept,
        "position": parts.get("position"),
        "rotation": parts.get("rotation"),
        "offset": one.found.offset and asdict(one.found.offset),
    }


def _budget(b: Budget) -> Json:
    return {
        "k": b.machine.k[0],
        "coverage": COVERAGE,
        "rows": [asdict(row) for row in b.rows],
        "machine": [b.machine.position, b.machine.rotation],
        "measuring": [b.measuring.position, b.measuring.rotation],
        "machine_k": b.machine.k,
        "measuring_k": b.measuring.k,
    }


def _figures(f: Figures) -> Json:
    names = ("rms", "p95", "max")
    return {
        "n": f.n,
        "position_m": dict(zip(names, f.position)),
        "rotation_rad": dict(zip(names, f.rotation)),
        "bias": f.bias,
    }


SIZE = (8.27, 11.69)  # inches, A4
LEFT, TOP, LINE, SMALL = 0.09, 0.94, 0.0165, 0.0125
BOTTOM = 0.06
WIDE = 96  # characters of a line


class _Paper:
    """Pages being written from the top down."""

    def __init__(self, pages: PdfPages, title: str) -> None:
        self.pages, self.title, self.number, self.y = pages, title, 0, 0.0
        self.figure: Figure | None = None
        self.turn()

    def turn(self) -> None:
        """Finish this page and begin the next."""
        self.close()
        self.number += 1
        self.figure, self.y = Figure(figsize=SIZE), TOP
        self.figure.text(LEFT, 0.03, f"{self.title}, page {self.number}", fontsize=7, color="grey")

    def close(self) -> None:
        """Finish the last page."""
        if self.figure is not None:
            self.pages.savefig(self.figure)

    def line(self, text: str, size: float = 9.5, bold: bool = False, mono: bool = False) -> None:
        """Write a paragraph, on the next page where it does not fit."""
        for row in textwrap.wrap(text, int(WIDE * 9.5 / size)) if not mono else [text]:
            if self.y < BOTTOM:
                self.turn()
            assert self.figure is not None  # from the first turn on
            self.figure.text(
                LEFT,
                self.y,
                row,
                fontsize=size,
                fontweight="bold" if bold else "normal",
                family="monospace" if mono else None,
            )
            self.y -= (SMALL if mono else LINE) * size / (7 if mono else 9.5)
        if not mono:
            self.y -= 0.004

    def head(self, text: str) -> None:
        """Write a heading."""
        self.y -= 0.01
        self.line(text, 12, bold=True)

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Write rows in columns as wide as what they hold."""
        cells = [[str(cell) for cell in row] for row in (header, *rows)]
        widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
        for row in cells:
            self.line(
                "  ".join(
                    cell.ljust(wide) if k == 0 else cell.rjust(wide) for k, (cell, wide) in enumerate(zip(row, widths))
                ),
                7,
                mono=True,
            )
        self.y -= 0.008

    def drawn(self, high: float) -> tuple[Figure, tuple[float, float, float, float]]:
        """(figure, rectangle) for axes, so high in parts of the page."""
        if self.y - high < BOTTOM:
            self.turn()
        assert self.figure is not None
        self.y -= high
        return self.figure, (LEFT + 0.06, self.y + 0.05, 0.72, high - 0.07)


def write_certificate_pdf(path: Path, certificate: Certificate) -> None:
    """Write a certificate as PDF.

    It is written whole or not at all.
    """
    buffer = io.BytesIO()
    title = f"Certificate of {certificate.machine}, {certificate.provenance['created'][:10]}"
    with PdfPages(buffer, metadata={"Title": title, "CreationDate": None}) as pages:
        paper = _Paper(pages, title)
        _promise(paper, certificate, title)
        _standards(paper, certificate)
        _rest(paper, certificate)
        paper.close()
    write_bytes(path, buffer.getvalue())


def _promise(paper: _Paper, c: Certificate, title: str) -> None:
    paper.line(title, 15, bold=True)
    paper.line(f"certificate {c.provenance['id']}", 7)
    paper.line(certificate_sentences_and_quantity_texts.length_scale_line(c))
    paper.line(certificate_sentences_and_quantity_texts.promise_line(c), 11, bold=True)
    for line in (
        certificate_sentences_and_quantity_texts.measured_volume_line(c),
        *certificate_sentences_and_quantity_texts.promise_basis_lines(c),
    ):
        paper.line(line)
    for line in certificate_sentences_and_quantity_texts.conformity_lines(c):
        paper.line(line, bold=True)
    figure, place = paper.drawn(0.2)
    axes = figure.add_axes(place)
    lengths = np.sort(np.linalg.norm(c.errors[:, :3], axis=1)) * 1e6
    axes.step(lengths, np.arange(1, len(lengths) + 1) / len(lengths), where="post")
    axes.axvline(c.promise.position.upper * 1e6, color="crimson", ls="--", label="promise")
    for k in c.conformity:
        if k.quantity == "position":
            axes.axvline(k.tolerance * 1e6, color="grey", ls=":", label="tolerance")
    axes.set(xlabel="measured position error, um", ylabel="share of poses nearer", xlim=(0, None))
    axes.legend(fontsize=8)
    if c.cells:
        paper.head("By part of the volume")
        paper.table(
            ("x, mm", "y, mm", "z, mm", "position, um", "rotation, urad", "N"),
            [
                (
                    *(f"{low * 1e3:.0f} to {high * 1e3:.0f}" for low, high in zip(cell.low, cell.high)),
                    f"{cell.promise.position.upper * 1e6:.1f}",
                    "" if cell.promise.rotation is None else f"{cell.promise.rotation.upper * 1e6:.1f}",
                    cell.promise.n,
                )
                for cell in c.cells
            ],
        )


def _standards(paper: _Paper, c: Certificate) -> None:
    paper.head("ISO 9283")
    paper.line(certificate_sentences_and_quantity_texts.iso9283_line(c))
    if c.iso9283.repeated:
        paper.table(
            ("pose at, mm", "visits", "AP, um", "RP, um"),
            [
                (
                    " ".join(f"{value * 1e3:.1f}" for value in row.place),
                    row.visits,
                    f"{row.AP * 1e6:.1f}",
                    f"{row.RP * 1e6:.1f}",
                )
                for row in c.iso9283.repeated
            ],
        )
    if c.iso230:
        unit = "um" if c.iso230[0].unit == "m" else "urad"
        paper.head(f"ISO 230-2, {unit}")
        paper.table(
            (
                "axis",
                *(name for name, _ in certificate_sentences_and_quantity_texts.iso230_symbol_values(c.iso230[0])),
                "u",
                "positions",
                "cycles",
            ),
            [
                (
                    a.axis,
                    *(
                        "" if value is None else f"{value * 1e6:.1f}"
                        for _, value in certificate_sentences_and_quantity_texts.iso230_symbol_values(a)
                    ),
                    f"{a.u * 1e6:.1f}",
                    a.positions,
                    a.cycles,
                )
                for a in c.iso230
            ],
        )


def _rest(paper: _Paper, c: Certificate) -> None:
    paper.head("Uncertainty contributions (U, coverage 95 %)")
    paper.table(
        ("contribution", "to", "position, um", "rotation, urad", "k", "kind"),
        [
            (
                row.name,
                row.of,
                "not known" if row.position is None else f"{row.position * 1e6:.2f}",
                "" if row.rotation is None else f"{row.rotation * 1e6:.2f}",
                certificate_sentences_and_quantity_texts.coverage_factor_text(row),
                row.kind,
            )
            for row in c.budget.rows
        ],
    )
    for row in c.budget.rows:
        paper.line(f"{row.name}: {row.source}.", 7.5)
    paper.head("Conditions")
    k = c.conditions
    load = "not logged" if k.payload is None else f"{k.payload[0]:g} to {k.payload[1]:g} kg"
    paper.line(
        f"Recordings: {', '.join(name for name, _ in k.recordings)}. {k.poses} poses at rest, {k.moving} "
        "exposures excluded because the "
        f"machine moved; approach {k.approach}; payload {load}; warm-up "
        f"{k.warm_up / 60:.1f} min; duration {k.duration / 60:.1f} min; measured by {k.instrument}; frame "
        f"and scale held by {k.frame}."
    )
    paper.table(
        ("logged", "least", "greatest"), [(name, f"{low:.2f}", f"{high:.2f}") for name, low, high in k.channels]
    )
    paper.head("Provenance")
    for name, value in rows_of_nested_dict(c.provenance):
        paper.line(f"{name}: {value}", 6.5)
