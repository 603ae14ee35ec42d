"""A diagnosis as a page that an owner can act on: verdict, where, what it looks like, how sure, what to do, what else, what remains."""

import html
from pathlib import Path
from typing import Any, Protocol

from matplotlib.figure import Figure

from calib.diagnose.report import words
from calib.diagnose.report.schema import FindingEntry, Report
from calib.html_page import page, table

Part = str | Figure
DOTS = ("<p class=note>Dots are residuals, circles means of as many dots each with their 95 % interval. Without it: the best that calibration can "
        "do alone, which swallows part of it.</p>")


class View(Protocol):
    """What one kind of machine draws of its diagnosis."""

    @property
    def asked(self) -> int:
        """How many hypotheses were held against the recording."""

    def where(self, places: list[str]) -> Figure:
        """The machine with the places of its findings marked, in their order."""

    def plot(self, finding: FindingEntry) -> Figure | None:
        """What a finding looks like, without it and with it; None where there is nothing to draw."""

    def remaining(self, unknown: list[FindingEntry]) -> list[Part]:
        """What is left of each part of the machine, and pictures of what is unknown."""

    def measurement(self) -> list[tuple[str, Any]]:
        """[(what, value)] of how it was measured."""


def diagnosis_page(path: Path, report: Report, view: View) -> None:
    """Write the page of a Report: offline, one file, figures in micrometres, microradians and pixels."""
    parts: list[Part] = [f"<p style='font-size:1.15em'><b>{words.verdict(report)}</b></p>",
                         f"<p>{words.held_out(report.fit, bool(report.named))}</p>"]
    main = report.mattering or report.named
    slight = [f for f in report.named if not any(f is m for m in main)]
    if report.findings:
        parts += ["<h2>Where</h2>", view.where([f.place for f in (*main, *report.unknown, *slight)])]
    for number, finding in enumerate(main):
        title = words.title(finding) + html.escape(words.size(finding)) + words.beforehand(finding)
        parts += [f"<h2>{number + 1}. {title}</h2>", *_finding(finding, view)]
    if slight:
        parts += ["<h2>Significant, and of little account</h2>",
                  "<p>These are there beyond chance; without them, what was held out would be predicted as well.</p>"]
    for finding in slight:
        parts += [f"<h3>{words.title(finding)}{html.escape(words.size(finding))}{words.beforehand(finding)}</h3>", *_slight(finding)]
    parts += ["<h2>What remains</h2>", *_remaining(report, view)]
    if report.covariates:
        parts += ["<h2>What it goes with</h2>",
                  "<p>Share of the squares left that smooth functions of one covariate explain, beyond what as many numbers do by chance: with "
                  "nothing admitted, and with all that was found. Covariates that go together share what they explain.</p>",
                  table(*words.covariate_table(report.covariates))]
    if report.remarks:
        parts += ["<h2>There, and nobody's fault</h2>",
                  "<p>Beyond chance, and no more than parts and instruments may do on their own: nothing to be done about it.</p>",
                  table(("what", "size", "why it is no finding"), [words.remark_row(r) for r in report.remarks])]
    parts += ["<h2>What was asked</h2>", _asked(report, view), "<h2>The measurement</h2>", table(("what", "value"), _measurement(report, view))]
    page(path, f"Diagnosis of {report.recording}", parts)


def _finding(finding: FindingEntry, view: View) -> list[Part]:
    plot, sure = view.plot(finding), words.how_sure(finding)
    parts: list[Part] = [] if plot is None else [plot, DOTS]
    parts.append(table(("parameter", "value", "95 % interval"), words.parameter_rows(finding)))
    parts += [f"<p>{sure}</p>"] if sure else []
    parts += [f"<p>{html.escape(words.sentence(finding.unusual))}</p>"] if finding.unusual else []
    parts += [f"<p>What to do: {html.escape(finding.action)}</p>"] if finding.action else []
    return parts + _alternatives(finding)


def _slight(finding: FindingEntry) -> list[Part]:
    action = [f"<p>What to do: {html.escape(finding.action)}</p>"] if finding.action else []
    return [f"<p>{words.how_sure(finding)}</p>", *action, *_alternatives(finding)]


def _alternatives(finding: FindingEntry) -> list[Part]:
    others = finding.cannot_be_told_from
    if others:
        return ["<p>What else it could be, for all that this recording says, and the experiment that would tell:</p>",
                table(("effect", "place", "worse by", "experiment"),
                      [(a.effect.replace("_", " "), a.place, f"{a.delta_bic:.1f}", a.experiment) for a in others])]
    return ["<p>Nothing else in the catalogue explains it as well.</p>"] if finding.evidence.delta_bic is not None else []


def _remaining(report: Report, view: View) -> list[Part]:
    levels, *pictures = view.remaining(report.unknown)
    if not report.unknown:
        return [levels, "<p>What remains looks like noise: no dependence on pose, time, history, image position or a logged channel was found.</p>",
                *pictures]
    rows = [(f.place, words.number(f.parameters["magnitude"].value, f.parameters["magnitude"].unit),
             ", ".join(f.parameters["depends_on"].value) or "scatters more than its noise", words.chance(f.evidence.p_value)) for f in report.unknown]
    return [levels, "<p>Something remains that nothing in the catalogue explains. A smooth function fits it; it is given no name.</p>",
            table(("place", "size (RMS)", "goes with", "chance"), rows), *pictures]


def _asked(report: Report, view: View) -> str:
    asked = f"<p>{view.asked} hypotheses, an effect at a place each, were held against the recording.</p>"
    asked += f"<p>Said by the operator beforehand: {html.escape('; '.join(report.said))}.</p>" if report.said else ""
    files = "; ".join(f"{f.file} ({', '.join(f.effects)}; sha256 {f.sha256})" for f in report.own_effects)
    asked += f"<p>Effects of the operator's own: {html.escape(files)}.</p>" if files else ""
    if not report.not_asked:
        return asked + "<p>The whole catalogue could be asked for.</p>"
    rows = [(s.effect.replace("_", " "), s.reason) for s in report.not_asked]
    return asked + "<p>These could not be:</p>" + table(("effect", "why"), rows)


def _measurement(report: Report, view: View) -> list[tuple[str, Any]]:
    units = {"corner_px": ("corner, per axis", "px"), "pose_m": ("pose, position", "m"), "pose_rad": ("pose, rotation", "rad"),
             "strut_m": ("strut", "m")}
    return view.measurement() + [(f"noise of a {units[key][0]}", words.number(value, units[key][1]))
                                 for key, value in report.noise.items() if value is not None and key in units]
