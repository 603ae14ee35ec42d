"""HTML pages of on-line learning, and of measuring limbs compared with vision."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.certification.calibration_evidence_verdict_and_claim_check import ALONE, OfCalibrations
from calib.certification.measuring_limb_calibration_slips_and_vision_agreement import AXES, MOVES, Agreement
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds, confound_sentences
from rig.array_and_json_types import Floats, Integers
from rig.formats.numbers_and_units import count_text
from rig.report.pages.html_and_svg_elements import (
    figures_with_caption_html,
    heading_html,
    list_html,
    note_html,
    paragraph_html,
    section_html,
    table_html,
)
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import Series, bar_chart_svg, figures_side_by_side_html, plot_panel_svg
from rig.report.verdict_refutations_and_result_display import AGREES, Evidence, MissingEvidence, Verdict, judge_evidence

MANY = 6  # changes beyond which they are not believed to be steps
ASK = "Determine the effects on the struts or the measurement: `rig diagnose REC --out found`"


@dataclass(frozen=True, slots=True, eq=False)
class OnlineResult:
    """What poses taught. frames : (n,) their numbers; innovations : (n, k) whitened, N(0, I) where nothing is wrong;
    source : of the poses
    change_lines : a line for each change; dropped : numbers of frames left out; known : to how much parameters
    are known, or None; moved : by how much they moved; each a sentence without its full stop
    returning : struts that go back and forth, a sentence each; confounds : of the recording, or None
    calibrations : OfCalibrations made from it: what they leave out, these poses teach no better"""

    frames: Integers
    innovations: Floats
    source: str
    change_lines: Sequence[str]
    dropped: Sequence[int]
    known: str | None
    moved: str
    returning: Sequence[str] = ()
    confounds: Confounds | None = None
    calibrations: OfCalibrations = ALONE


def write_online_page(path: Path | str, name: str, result: OnlineResult, links: Sequence[Link] = ()) -> None:
    """Write the HTML page of on-line learning from a recording."""
    sizes = np.sqrt((result.innovations**2).mean(axis=1))
    innovation = plot_panel_svg(
        "innovation", ("frame", "standard deviations"), [Series(result.frames, sizes)], log=True, level=1.0
    )
    parts = [
        heading_html("Innovation of each pose"),
        figures_with_caption_html(
            figures_side_by_side_html(innovation),
            "Deviation from the prediction by previous poses, in standard deviations, RMS over its coordinates. Good: "
            "a fall to the line at 1, where nothing remains to be learnt. Bad: a sudden rise; something jumped.",
        ),
        paragraph_html(
            f"{count_text(len(result.frames), 'pose')} from {result.source}, learnt one at a time. "
            f"{result.moved[0].upper()}{result.moved[1:]}."
        ),
        *section_html("What jumped", [list_html(result.change_lines)] if result.change_lines else []),
    ]
    if result.dropped:
        parts += [
            heading_html("Left out"),
            paragraph_html(f"Frames {', '.join(map(str, result.dropped))}: their poses agree with no other."),
        ]
    verdict = online_verdict(result)
    write_page(path, Page("online", f"Learning from {name}", verdict, parts, verdict.next, links))


def online_verdict(result: OnlineResult) -> Verdict:
    """Verdict on on-line learning."""
    last = result.innovations[-max(len(result.innovations) // 4, 1) :]
    off = float(np.sqrt(np.mean(last**2)))
    known = "" if result.known is None else f"; {result.known}"
    changes = (
        f"{len(result.change_lines)} change{'s' * (len(result.change_lines) != 1)}"
        if result.change_lines
        else "nothing jumped"
    )
    why = f"{changes}, the last poses off the prediction by {off:.2f} standard deviations{known}"
    unexplained = [*result.returning, *result.calibrations.unexplained]
    if len(result.change_lines) > MANY:
        unexplained.append("these are too many steps: an effect outside the geometry is present")
    if off > AGREES:
        unexplained.append(f"the last poses are {off:.3g} times the expected deviation")
    missing = [MissingEvidence("something jumped", _recommended_actions(result)[0])] if result.change_lines else []
    missing += [MissingEvidence("poses were excluded")] if result.dropped else []
    return judge_evidence(
        Evidence(
            why,
            tuple(_recommended_actions(result)),
            unexplained=tuple(unexplained),
            confounds=confound_sentences(result.confounds),
            missing=tuple(missing),
            refuted=result.calibrations.refuted,
            look=ASK,
        )
    )


def _recommended_actions(learnt: OnlineResult) -> list[str]:
    """What an owner does next with what was learnt."""
    if len(learnt.change_lines) > MANY or learnt.returning:
        return [ASK]
    if learnt.change_lines:
        return [
            "Check the struts named below for missed steps or a slipped joint, cameras and base for a "
            "displacement; home, and record again"
        ]
    return ["Continue with the next recording and the same `--state`"]


def write_measuring_limbs_page(
    path: Path | str,
    name: str,
    agreement: Agreement,
    source: str,
    withdrawal_reason: str | None,
    links: Sequence[Link] = (),
) -> None:
    """Write the HTML page of measuring limbs compared with vision.

    name : of the recording; source : of vision's poses; withdrawal_reason : why the limbs cannot stand for vision after
    all, or None
    """
    columns = (
        agreement.bias,
        agreement.scatter,
        agreement.expected,
        *agreement.limits,
        agreement.proven_limits,
        agreement.tolerance,
    )
    rows = [
        (
            axis,
            *(f"{column[i] * 1e6:.2f}" for column in columns),
            f"{agreement.moved[i] * 1e3:.1f} {'mm' if i < 3 else 'mrad'}",
            _result_text(agreement, i),
        )
        for i, axis in enumerate(AXES)
    ]
    failing = [axis for i, axis in enumerate(AXES) if not agreement.passed[i]]
    surely, tolerance = agreement.proven_limits * 1e6, agreement.tolerance * 1e6
    halves = [
        bar_chart_svg(
            title,
            AXES[part],
            [("surely within", surely[part].tolist(), 0), ("tolerance", tolerance[part].tolist(), -1)],
            unit,
            failing,
        )
        for title, part, unit in (("position", slice(0, 3), "µm"), ("rotation", slice(3, 6), "µrad"))
    ]
    parts = [
        heading_html("Agreement of each axis with its tolerance"),
        figures_with_caption_html(
            figures_side_by_side_html(*halves),
            "95 % of the differences, limbs minus vision, lie within these limits (µm, µrad), beside the tolerance. "
            "Good: every bar is shorter than its tolerance. Bad: longer bars; names of such axes are bold.",
        ),
        heading_html("In figures"),
        note_html(
            f"{count_text(agreement.n, 'pose')}, vision's from {source}, each by limbs fitted to "
            f"other stretches; µm and µrad."
        ),
        table_html(
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
    steps = ["Use the limbs in place of vision: `--limbs FILE` of measure, calibrate, online and run"]
    if withdrawal_reason is not None or not agreement.passed.all():
        steps = [
            "Check the joints of limbs that slipped, or move farther along the axes that are not shown, "
            "and compare them with vision again"
        ]
    write_page(
        path,
        Page(
            "insitu",
            f"Measuring limbs against vision, {name}",
            measuring_limbs_verdict(agreement, withdrawal_reason),
            parts,
            steps,
            links,
        ),
    )


def measuring_limbs_verdict(agreement: Agreement, withdrawal_reason: str | None) -> Verdict:
    """Verdict on measuring limbs.

    withdrawal_reason : as for the page
    """
    if withdrawal_reason is not None:
        return judge_evidence(
            Evidence(
                f"{count_text(agreement.n, 'pose')}",
                refuted=(f"the measuring limbs cannot replace vision: {withdrawal_reason}",),
            )
        )
    if agreement.passed.all():
        return judge_evidence(
            Evidence(
                f"the measuring limbs pass on all six axes, over {count_text(agreement.n, 'pose')}: "
                f"they may replace vision"
            )
        )
    failing = ", ".join(axis for i, axis in enumerate(AXES) if not agreement.passed[i])
    surely = [axis for i, axis in enumerate(AXES) if agreement.proven_limits[i] > agreement.tolerance[i]]
    message = f"the measuring limbs do not pass: {failing}"
    return judge_evidence(
        Evidence(
            message,
            refuted=(f"{', '.join(surely)} certainly beyond the tolerance",) if surely else (),
            missing=() if surely else (MissingEvidence("their agreement is not shown"),),
        )
    )


def _result_text(found: Agreement, i: int) -> str:
    if found.passed[i]:
        return "passes"
    return (
        "fails"
        if found.proven_limits[i] > found.tolerance[i]
        else f"is not shown: it must move over {MOVES:g} tolerances"
    )
