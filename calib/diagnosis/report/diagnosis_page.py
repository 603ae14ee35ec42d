"""HTML page of a diagnosis.

Verdict, findings with place, size and evidence, actions, figures.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from calib.diagnosis.recording_diagnosis import Diagnosis
from calib.diagnosis.report import diagnosis_sentences_and_table_rows
from calib.diagnosis.report.detectable_size_entries_and_table_rows import detectable_size_row
from calib.diagnosis.report.diagnosis_json_entries import FindingEntry
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import Report, diagnosis_verdict
from calib.report.pose_and_effect_figures import effect_sketch
from rig.effects.catalogue.effect_list import BY_NAME
from rig.recording.recording_folder import Recording
from rig.report.axis_places_with_joint_names import text_with_joint_names
from rig.report.pages.html_and_svg_elements import (
    collapsible_section_html,
    figures_with_caption_html,
    heading_html,
    paragraph_html,
    table_html,
)
from rig.report.pages.image_plane_and_3d_views import view_3d_scripts_if_needed
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.pages.svg_plots import figures_side_by_side_html


class MachineFigures(Protocol):
    """Figures that one kind of machine draws of its diagnosis."""

    def where(self, places: list[str]) -> str:
        """The machine with the places of its findings marked, in their order."""

    def plot(self, finding: FindingEntry) -> str | None:
        """What a finding looks like, without it and with it; None where there is nothing to draw."""

    def in_space(self) -> list[str]:
        """The machine in three dimensions, with what its findings do; nothing where it cannot be drawn."""

    def remaining(self, unknown: list[FindingEntry]) -> list[str]:
        """What is left of each part of the machine, and pictures of what is unknown."""

    def measurement(self) -> list[tuple[str, object]]:
        """[(what, value)] of how it was measured."""


def figures_of_arm_or_platform(diagnosis: Diagnosis, recording: Recording, report: Report) -> MachineFigures:
    """Page figures (MachineFigures) of an arm's or a platform's Diagnosis.

    By what was measured.
    report : its Report
    """
    first = len(diagnosis.measured_findings)
    entries = report.findings[first : first + len(diagnosis.findings)]
    if diagnosis.evidence.family == "joints":
        from calib.diagnosis.report.platform_and_arm_page_figures import ArmFigures

        return ArmFigures(diagnosis, entries)
    from calib.diagnosis.report.platform_and_arm_page_figures import PlatformFigures

    return PlatformFigures(diagnosis, entries, recording)


def write_diagnosis_page(
    path: Path,
    report: Report,
    machine_figures: MachineFigures,
    links: Sequence[Link] = (),
    joint_names: Sequence[str] = (),
) -> None:
    """Write the diagnosis page of a Report.

    One offline HTML file. joint_names : of an arm's joints in other files, which stand behind their numbers in headings
    """
    parts: list[str] = []
    main = report.mattering or report.named
    slight = [f for f in report.named if not any(f is m for m in main)]
    if report.findings:
        parts += [
            heading_html("Where"),
            figures_with_caption_html(
                machine_figures.where([f.place for f in (*main, *report.unknown, *slight)]),
                "The machine in outline, not to a stated scale. Coloured: the places of the findings. Good: nothing is "
                "coloured.",
            ),
        ]
    parts.append(
        paragraph_html(diagnosis_sentences_and_table_rows.held_out_error_sentence(report.fit, bool(report.named)))
    )
    for number, finding in enumerate(main):
        title = (
            diagnosis_sentences_and_table_rows.finding_title(finding)
            + diagnosis_sentences_and_table_rows.finding_size_text(finding)
            + diagnosis_sentences_and_table_rows.assumed_or_seen_before_suffix(finding)
        )
        parts += [
            heading_html(f"{number + 1}. {text_with_joint_names(title, joint_names)}"),
            *_finding(finding, machine_figures),
        ]
    if slight:
        parts += [
            heading_html("Significant but negligible"),
            paragraph_html("These are significant, but held-out data would be predicted as well without them."),
        ]
    for finding in slight:
        title = diagnosis_sentences_and_table_rows.finding_title(
            finding
        ) + diagnosis_sentences_and_table_rows.finding_size_text(finding)
        parts += [
            heading_html(
                text_with_joint_names(title, joint_names)
                + diagnosis_sentences_and_table_rows.assumed_or_seen_before_suffix(finding),
                3,
            ),
            *_slight(finding),
        ]
    shown = machine_figures.in_space()
    parts += [heading_html("In three dimensions"), *shown] if shown else []
    parts += [heading_html("What remains"), *_remaining(report, machine_figures)]
    parts += _suggestions(report)
    if report.covariates:
        parts += [
            heading_html("Correlated covariates"),
            paragraph_html(
                "Share of the residual squares that smooth functions of one covariate explain, beyond what as "
                "many numbers do by chance: "
                "with no finding admitted, and with all findings. Correlated covariates share what "
                "they explain."
            ),
            table_html(*diagnosis_sentences_and_table_rows.covariate_table_heads_and_rows(report.covariates)),
        ]
    if report.remarks:
        parts += [
            heading_html("Present, within tolerance"),
            paragraph_html(
                "Significant, but within the tolerance of parts and instruments: nothing to be done about it."
            ),
            table_html(
                ("what", "size", "reason"), [diagnosis_sentences_and_table_rows.remark_row(r) for r in report.remarks]
            ),
        ]
    parts += _left_out(report)
    parts += [
        heading_html("Hypotheses tested"),
        *_tested_hypotheses(report),
        *_detectable(report),
        heading_html("The measurement"),
        table_html(("what", "value"), _measurement(report, machine_figures)),
    ]
    verdict = diagnosis_verdict(report)
    write_page(
        path,
        Page(
            "diagnose",
            f"Diagnosis of {report.recording}",
            verdict,
            parts,
            verdict.next,
            links,
            view_3d_scripts_if_needed(parts),
        ),
    )


def _finding(finding: FindingEntry, machine_figures: MachineFigures) -> list[str]:
    plot, sure = machine_figures.plot(finding), diagnosis_sentences_and_table_rows.evidence_sentence(finding)
    parts = [] if plot is None else [plot]
    parts.append(
        table_html(("parameter", "value", "95 % interval"), diagnosis_sentences_and_table_rows.parameter_rows(finding))
    )
    parts += [paragraph_html(sure)] if sure else []
    parts += (
        [paragraph_html(diagnosis_sentences_and_table_rows.as_sentence(finding.unusual))] if finding.unusual else []
    )
    parts += [paragraph_html(f"What to do: {finding.action}")] if finding.action else []
    return parts + _alternatives(finding) + _sketched(finding.effect)


def _sketched(name: str) -> list[str]:
    """What an effect of the catalogue does, as the catalogue shows it; nothing of one that is not in it."""
    if name not in BY_NAME:
        return []
    sketch, caption = effect_sketch(BY_NAME[name]), f"What {BY_NAME[name].label()} does"
    return [
        collapsible_section_html(
            caption,
            figures_with_caption_html(
                figures_side_by_side_html(*sketch.figures),
                f"From the catalogue of effects: {sketch.words}. Not of this machine: compare its shape with the "
                "figure above. Good evidence: both look alike.",
            ),
        )
    ]


def _slight(finding: FindingEntry) -> list[str]:
    action = [paragraph_html(f"What to do: {finding.action}")] if finding.action else []
    return [
        paragraph_html(diagnosis_sentences_and_table_rows.evidence_sentence(finding)),
        *action,
        *_alternatives(finding),
    ]


def _alternatives(finding: FindingEntry) -> list[str]:
    others = finding.cannot_be_told_from
    if others:
        return [
            paragraph_html("Alternatives that this recording does not exclude, and an experiment to distinguish them:"),
            table_html(
                ("effect", "place", "worse by", "experiment"),
                [(a.effect.replace("_", " "), a.place, f"{a.delta_bic:.1f}", a.experiment) for a in others],
            ),
        ]
    return (
        [paragraph_html("No other catalogued effect explains it as well.")]
        if finding.evidence.delta_bic is not None
        else []
    )


def _remaining(report: Report, machine_figures: MachineFigures) -> list[str]:
    levels, *pictures = machine_figures.remaining(report.unknown)
    if not report.unknown:
        return [
            levels,
            paragraph_html(
                "What remains resembles noise: no dependence on pose, time, history, image position or a "
                "logged channel was "
                "found."
            ),
            *pictures,
        ]
    rows = [
        (
            f.place,
            diagnosis_sentences_and_table_rows.value_text(
                f.parameters["magnitude"].value, f.parameters["magnitude"].unit
            ),
            ", ".join(f.parameters["depends_on"].value) or "scatters more than its noise",
            diagnosis_sentences_and_table_rows.probability_text(f.evidence.p_value),
        )
        for f in report.unknown
    ]
    return [
        levels,
        paragraph_html(diagnosis_sentences_and_table_rows.unexplained_sentence(report.unknown)),
        table_html(("place", "size (RMS)", "goes with", "chance"), rows),
        *pictures,
    ]


def _left_out(report: Report) -> list[str]:
    """The rows that were left out before anything was searched, each with its reason."""
    if not report.left_out and report.crowd is None:
        return []
    parts = [heading_html("Excluded before the search")]
    parts += (
        []
        if report.crowd is None
        else [
            paragraph_html(
                diagnosis_sentences_and_table_rows.as_sentence(
                    diagnosis_sentences_and_table_rows.outliers_not_excluded_sentence(report.crowd)
                )
            )
        ]
    )
    if report.left_out:
        rows = [diagnosis_sentences_and_table_rows.excluded_outlier_texts(one) for one in report.left_out]
        parts += [
            paragraph_html(
                f"{diagnosis_sentences_and_table_rows.row_count_and_verb_text(len(rows))} far from all that the rest "
                "of the "
                "recording allows, and no neighbour in time or configuration shows the same. The findings do not use "
                "these rows."
            ),
            table_html(("frame", "where", "how far off", "why"), rows),
        ]
    return parts


def _suggestions(report: Report) -> list[str]:
    """The formulas for what has no name."""
    parts = []
    for entry in report.suggestions:
        parts += [
            heading_html(f"A formula for the residual at {entry.place}", 3),
            paragraph_html(diagnosis_sentences_and_table_rows.formula_suggestion_sentences(entry)),
            table_html(
                ("parameter", "value", "95 % interval"),
                diagnosis_sentences_and_table_rows.parameter_rows_of_suggested_formula(entry),
            ),
        ]
    return parts


def _tested_hypotheses(report: Report) -> list[str]:
    paragraphs = [
        paragraph_html(f"{report.asked} hypotheses, an effect at a place each, were tested on the recording.")
    ]
    paragraphs += (
        [paragraph_html(f"Stated by the operator beforehand: {'; '.join(report.said)}.")] if report.said else []
    )
    files = "; ".join(f"{f.file} ({', '.join(f.effects)}; sha256 {f.sha256})" for f in report.own_effects)
    paragraphs += [paragraph_html(f"Effects of the operator's own: {files}.")] if files else []
    if not report.not_asked:
        return [*paragraphs, paragraph_html("The whole catalogue could be tested.")]
    rows = [(s.effect.replace("_", " "), s.reason) for s in report.not_asked]
    return [*paragraphs, collapsible_section_html(f"{len(rows)} could not be", table_html(("effect", "why"), rows))]


def _detectable(report: Report) -> list[str]:
    """How large each effect would have to be to be found."""
    if not report.detectable:
        return []
    heads = ("effect", "size by", "found from, at best", "found from, at worst")
    rows = [detectable_size_row(entry) for entry in report.detectable]
    return [
        heading_html("What this recording would have shown"),
        paragraph_html(
            "The size from which an effect would be found in about half of such recordings, at the place where least "
            "is needed and where most is. An effect half as large acts unseen."
        ),
        collapsible_section_html(f"{len(rows)} effects", table_html(heads, rows)),
    ]


def _measurement(report: Report, machine_figures: MachineFigures) -> list[tuple[str, object]]:
    units = {
        "corner_px": ("corner, per axis", "px"),
        "pose_m": ("pose, position", "m"),
        "pose_rad": ("pose, rotation", "rad"),
        "strut_m": ("strut", "m"),
    }
    rows: list[tuple[str, object]] = [
        (f"noise of a {units[key][0]}", diagnosis_sentences_and_table_rows.value_text(value, units[key][1]))
        for key, value in report.noise.items()
        if value is not None and key in units
    ]
    rows += [
        (
            f"that noise over what is stated, in {kind}",
            diagnosis_sentences_and_table_rows.noise_factor_and_interval_text(factor),
        )
        for kind, factor in report.noise_times.items()
    ]
    return machine_figures.measurement() + rows
