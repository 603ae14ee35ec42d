"""The page of measuring limbs held against vision: whether each axis agrees, over how far it was shown."""

from collections.abc import Sequence
from pathlib import Path

from calib.certify.measuring_limbs import AXES, MOVES, Agreement
from rig.report.pages.html_elements import heading, note, table
from rig.report.pages.page_template import Link, Page, write_page
from rig.report.pages.plots import bar_chart, panel_row
from rig.report.verdict import Evidence, Missing, Verdict, judge_evidence


def limbs_page(
    path: Path | str, name: str, found: Agreement, source: str, withdrawn: str | None, links: Sequence[Link] = ()
) -> None:
    """Write the page. name : of the recording; source : of vision's poses; withdrawn : why the limbs cannot stand for
    vision after all, or None
    """
    columns = (found.bias, found.scatter, found.expected, *found.limits, found.proven_limits, found.tolerance)
    rows = [
        (
            axis,
            *(f"{column[i] * 1e6:.2f}" for column in columns),
            f"{found.moved[i] * 1e3:.1f} {'mm' if i < 3 else 'mrad'}",
            _said(found, i),
        )
        for i, axis in enumerate(AXES)
    ]
    failing = [axis for i, axis in enumerate(AXES) if not found.passed[i]]
    surely, tolerance = found.proven_limits * 1e6, found.tolerance * 1e6
    halves = [
        bar_chart(
            title,
            AXES[part],
            [("surely within", surely[part].tolist(), 0), ("tolerance", tolerance[part].tolist(), -1)],
            unit,
            failing,
        )
        for title, part, unit in (("position", slice(0, 3), "µm"), ("rotation", slice(3, 6), "µrad"))
    ]
    parts = [
        heading("Each axis against its tolerance"),
        note("Of differences, limbs less vision, 95 % lie within; in bold: axes that do not pass."),
        panel_row(*halves),
        heading("In figures"),
        note(f"{found.n} poses, vision's from {source}, each by limbs fitted to other stretches; µm and µrad."),
        table(
            (
                "axis",
                "bias",
                "scatter",
                "expected",
                "lower limit",
                "upper limit",
                "surely within",
                "tolerance",
                "moved over",
                "so it",
            ),
            rows,
        ),
    ]
    steps = ["Let the limbs stand for vision: `--limbs FILE` of measure, calibrate, online and run"]
    if withdrawn is not None or not found.passed.all():
        steps = [
            "Look at the joints of limbs that slipped, or move farther along the axes that are not shown, "
            "and hold them against vision again"
        ]
    write_page(
        path,
        Page("insitu", f"Measuring limbs against vision, {name}", limbs_verdict(found, withdrawn), parts, steps, links),
    )


def limbs_verdict(found: Agreement, withdrawn: str | None) -> Verdict:
    """The verdict on limbs. withdrawn : as for the page"""
    if withdrawn is not None:
        return judge_evidence(
            Evidence(f"{found.n} poses", refuted=(f"the measuring limbs cannot stand for vision: {withdrawn}",))
        )
    if found.passed.all():
        return judge_evidence(
            Evidence(f"the measuring limbs pass on all six axes, over {found.n} poses: they may stand for vision")
        )
    failing = ", ".join(axis for i, axis in enumerate(AXES) if not found.passed[i])
    surely = [axis for i, axis in enumerate(AXES) if found.proven_limits[i] > found.tolerance[i]]
    said = f"the measuring limbs do not pass: {failing}"
    return judge_evidence(
        Evidence(
            said,
            refuted=(f"{', '.join(surely)} surely beyond the tolerance",) if surely else (),
            missing=() if surely else (Missing("that they agree is not shown"),),
        )
    )


def _said(found: Agreement, i: int) -> str:
    if found.passed[i]:
        return "passes"
    return (
        "fails"
        if found.proven_limits[i] > found.tolerance[i]
        else f"is not shown: it must move over {MOVES:g} tolerances"
    )
