"""Sentences and table rows of a Report.

For people, in micrometres, microradians and pixels.
"""

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import Crowd, LeftOut
from calib.diagnosis.problems.evidence_interface_and_requested_effects import ASSUMED_NOISE, RESIDUALS, Value
from calib.diagnosis.report.diagnosis_json_entries import (
    ASSUMED,
    CovariateEntry,
    FindingEntry,
    FitEntry,
    RemarkEntry,
    SuggestionEntry,
)
from rig.formats.numbers_and_units import UNITS, digits_that_distinguish_numbers, number_text

SCALES = {unit: UNITS[unit][0] for unit in ("m", "rad", "1/K", "N/m")}  # one unit for all sizes, so that they compare
LONG_TIME = 1000.0  # s; times from there on, and clocks, are written to a tenth of a second
NOT_DETERMINED = "not determined"
LONG = 4  # numbers of a vector that are written out
CERTAIN = 1e-6  # a chance below which nobody counts
CONVINCING = 10  # of the information criterion
SELDOM = 1e-3  # chance of a finding where there is nothing, from which it is one


def value_text(value: float, unit: str, with_unit: bool = True, digits: int = 3) -> str:
    """Text of a value in its unit.

    It is the unit that people read it in, to so many digits.
    """
    scale, name = SCALES.get(unit, (1, unit))
    text = (
        "unlimited"
        if not np.isfinite(value)
        else f"{value:.1f}"
        if unit == "s" and abs(value) >= LONG_TIME
        else number_text(value * scale, digits)
    )
    return f"{text} {name}".strip() if with_unit else text


def _interval_text(low: float, high: float, unit: str, with_unit: bool = True) -> str:
    """Text such as "39.1 to 41.2 µm", to as many digits as tell its ends apart."""
    digits = digits_that_distinguish_numbers(low, high)
    return f"{value_text(low, unit, False, digits)} to {value_text(high, unit, with_unit, digits)}"


def _ends(p: Value, with_unit: bool = True) -> str:
    """A number's 95 % interval, as far as the data close it."""
    if p.ci95 is None or p.open == "both":
        return NOT_DETERMINED
    low, high = (value_text(end, p.unit, with_unit) for end in p.ci95)
    between = _interval_text(p.ci95[0], p.ci95[1], p.unit, with_unit)
    return f"{low} or more" if p.open == "above" else f"{high} or less" if p.open == "below" else between


def _digits(p: Value) -> int:
    """How many digits a number with a 95 % interval is written to."""
    return 3 if p.ci95 is None or p.open is not None else digits_that_distinguish_numbers(*p.ci95)


def finding_title(finding: FindingEntry | RemarkEntry) -> str:
    """Title of a finding, such as "backlash at strut 4"."""
    return f"{finding.effect.replace('_', ' ')} at {finding.place}"


def finding_size_text(finding: FindingEntry | RemarkEntry) -> str:
    """Text of a finding's size.

    Its first parameter with unit.

    Of a vector its length, of a profile its root mean square; empty where there is none.
    """
    for name, p in finding.parameters.items():
        if isinstance(p.value, (int, float)) and p.ci95 is not None:
            at = "; at the bound of its plausible range" if p.at_bound is not None else ""
            sure = NOT_DETERMINED if p.open == "both" else f"95 %: {_ends(p, False)}"
            return f", {name.replace('_', ' ')} {value_text(p.value, p.unit, digits=_digits(p))} ({sure}{at})"
        if ", " in p.unit and len(p.value) % 3 == 0 and len(p.value):
            thirds = np.reshape(np.asarray(p.value, float), (-1, 3))
            return ", by " + " and ".join(
                value_text(float(np.linalg.norm(v)), u) for v, u in zip(thirds, p.unit.split(", "))
            )
        if name == "profile" and len(p.value):
            return f", {value_text(np.sqrt(np.mean(np.square(p.value))), p.unit)} RMS"
    return ""


def assumed_or_seen_before_suffix(finding: FindingEntry) -> str:
    """Suffix " (assumed)" or " (seen before)" of a finding.

    It is empty for others.
    Of one that the operator stated beforehand.
    """
    return f" ({finding.said})" if finding.said else ""


def as_sentence(text: str) -> str:
    """A text as a sentence, with a capital and a full stop."""
    return text[0].upper() + text[1:] + "."


def excluded_outlier_texts(outlier: LeftOut) -> tuple[str, str, str, str]:
    """Texts on an excluded outlier (a pose or corners).

    They are frame, place, distance and reason, left out of a diagnosis.
    """
    return (
        str(outlier.frame),
        outlier.place,
        f"{value_text(outlier.off, outlier.unit)}, {outlier.times:.0f} times the scatter of the others",
        outlier.reason,
    )


def row_count_and_verb_text(count: int) -> str:
    """Text of a count of rows with its verb, singular or plural."""
    return "1 row is" if count == 1 else f"{count} rows are"


def outliers_not_excluded_sentence(outliers_not_excluded: Crowd) -> str:
    """Sentence on outliers that were not excluded, since they are too many."""
    return (
        f"{outliers_not_excluded.count} of {outliers_not_excluded.of} {outliers_not_excluded.what} are far off all "
        "others: too many to be individual mistakes, so they were not excluded, and the model is incomplete"
    )


def held_out_error_sentence(fit: FitEntry, has_named_findings: bool) -> str:
    """Sentence on the held-out error, on stretches that the fit had not seen."""
    before, after, floor = (
        value_text(value, fit.unit) for value in (fit.heldout_before, fit.heldout_after, fit.noise_floor)
    )
    ratio = f", {fit.heldout_after / fit.noise_floor:.2f} times the noise" if fit.noise_floor else ""
    if not has_named_findings:
        return f"On held-out stretches of the recording, {after} remain{ratio} ({floor})."
    return f"On held-out stretches of the recording, the misfit falls from {before} to {after}{ratio} ({floor})."


def probability_text(p: float | None) -> str:
    """Text of a probability, in words."""
    if p is None:
        return "not known"
    return "below 1 in a million" if p < CERTAIN else f"1 in {1 / p:.0f}"


def evidence_sentence(finding: FindingEntry) -> str:
    """Sentence on the evidence of a finding.

    It is empty where there is none.
    """
    e = finding.evidence
    if (
        e.delta_bic is None
        or e.p_value is None
        or e.heldout_before is None
        or e.heldout_after is None
        or e.unit is None
    ):
        return ""
    errors = f" ({e.gain_sigma:.1f} standard errors)" if e.gain_sigma is not None and np.isfinite(e.gain_sigma) else ""
    lines = [
        f"held out, {value_text(e.heldout_before, e.unit)} without it and "
        f"{value_text(e.heldout_after, e.unit)} with it{errors}",
        f"probability of such a finding without an effect: {probability_text(e.p_value)}",
        f"information criterion better by {e.delta_bic:.0f} ({CONVINCING} is convincing)",
    ]
    if finding.said == ASSUMED:
        shown = e.p_value is not None and e.p_value <= SELDOM and e.delta_bic >= CONVINCING
        lines.append(
            "it was assumed, and this recording "
            + ("shows it independently as well" if shown else "would not have shown it independently")
        )
    return f"How sure: {'; '.join(lines)}."


def unexplained_sentence(unexplained_findings: Sequence[FindingEntry]) -> str:
    """Sentence on what is unexplained: functions that fit it, or scatter that none fits."""
    fitted = [f for f in unexplained_findings if f.parameters["depends_on"].value]
    lines = ["A residual remains that no catalogued effect explains."]
    lines += ["A smooth function fits it; its cause is not identified."] if fitted else []
    lines += (
        [
            "Scatter above the noise may be an unmodelled effect as well as noise that is stated too "
            "small: this recording does not distinguish "
            "which."
        ]
        if len(fitted) < len(unexplained_findings)
        else []
    )
    return " ".join(lines)


def formula_suggestion_sentences(entry: SuggestionEntry) -> str:
    """Sentences on a suggested formula.

    It is in place of a name, and has an error on data that did not choose it.
    """
    before, after, floor = (
        value_text(value, entry.unit) for value in (entry.heldout_before, entry.heldout_after, entry.noise)
    )
    alike = sum(set(part) == set(entry.covariates) for part in entry.parts)
    return (
        f"Deviation {entry.formula}, where {entry.where}. Held out on whole stretches, by formulas chosen "
        f"and fitted without them: {before} "
        f"before, {after} after, {entry.heldout_after / entry.noise:.2f} times the noise ({floor}); {alike} "
        f"of {len(entry.parts)} times the same "
        "covariates were chosen. It is a suggestion, not an identification."
    )


def parameter_rows_of_suggested_formula(entry: SuggestionEntry) -> list[tuple[str, str, str]]:
    """Table rows [(parameter, value, 95 % interval)] of one suggested formula's parameters, with units."""
    return [
        (name, f"{p.value:.4g} {p.unit}", f"{p.ci95[0]:.4g} to {p.ci95[1]:.4g}" if p.ci95 else "")
        for name, p in entry.parameters.items()
    ]


def covariate_table_heads_and_rows(
    covariates: Sequence[CovariateEntry],
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Table (heads, rows) of covariates.

    They are the remainder's, with the shares that they explain.
    Shares of the squares and smallest chance before and after.
    """
    looked_at = list(dict.fromkeys(what for c in covariates for what in c.explains))
    heads = ("goes with", *(f"{what}, {when}" for what in looked_at for when in ("before", "after")), "chance, after")
    rows = []
    for c in covariates:
        shares = [c.explains.get(what) for what in looked_at]
        cells = [text for s in shares for text in ((f"{s.before:.1%}", f"{s.after:.1%}") if s else ("", ""))]
        rows.append((c.name.replace("_", " "), *cells, probability_text(min(s.p_value for s in c.explains.values()))))
    return heads, rows


def remark_row(remark: RemarkEntry) -> tuple[str, str, str]:
    """Table row (what, how large, reason) of a remark."""
    text = finding_size_text(remark).removeprefix(", ")
    unknown = remark.parameters.get("magnitude")
    return finding_title(remark), text or (value_text(unknown.value, unknown.unit) if unknown else ""), remark.reason


def parameter_rows(finding: FindingEntry) -> list[tuple[str, str, str]]:
    """Table rows [(name, value, 95 % interval)] of a finding's parameters.

    Of long vectors the first few that are anything.
    """
    rows = []
    for name, p in finding.parameters.items():
        name = name.replace("_", " ")
        if isinstance(p.value, (int, float)):
            rows.append((name, value_text(p.value, p.unit, digits=_digits(p)), _interval(p)))
            continue
        shown = [i for i, v in enumerate(p.value) if v][: 2 * LONG] if len(p.value) > LONG else range(len(p.value))
        units = p.unit.split(", ") if ", " in p.unit else [p.unit]
        for i in shown:
            own = units[i * len(units) // len(p.value)]
            if isinstance(p.value[i], str):
                rows.append((f"{name} {i + 1}", p.value[i], ""))
                continue
            rows.append(
                (
                    f"{name} {i + 1}",
                    value_text(p.value[i], own),
                    _interval_text(p.ci95[0][i], p.ci95[1][i], own) if p.ci95 else "",
                )
            )
    return rows


def _interval(p: Value) -> str:
    if p.ci95 is None:
        return ""
    text = _ends(p)
    return f"{text}; at its bound" if p.at_bound is not None else text


def finding_line(finding: FindingEntry, max_numbers_per_parameter: int = 6) -> str:
    """Line on a finding.

    It is for a terminal, in SI units.
    max_numbers_per_parameter : numbers of a parameter that are printed; of more, how many there are
    """
    return f"{finding.effect} at {finding.place}: " + ", ".join(
        _printed(name, p, max_numbers_per_parameter) for name, p in finding.parameters.items()
    )


def _printed(name: str, p: Value, few: int) -> str:
    value, unit = p.value, p.unit
    if isinstance(value, (int, float)):
        digits = ".1f" if unit == "s" and abs(value) >= LONG_TIME else ".4g"
        ends = [f"{end:{digits}}" for end in p.ci95] if p.ci95 else []
        message = (
            {
                None: " to ".join(ends),
                "above": f"{ends[0]} or more",
                "below": f"{ends[1]} or less",
                "both": NOT_DETERMINED,
            }[p.open]
            if ends
            else ""
        )
        interval = f" ({message})" if message else ""
        bound = ", at its bound" if p.at_bound is not None else ""
        return f"{name} {value:{digits}} {unit}{interval}{bound}"
    numbers = len(value) and isinstance(value[0], float)
    if numbers and len(value) <= few:
        pairs = zip(value, zip(*p.ci95)) if p.ci95 else ((v, None) for v in value)
        shown = " ".join(f"{v:.3g}" + (f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends else "") for v, ends in pairs)
        return f"{name} {shown} {unit}"
    return f"{name} ({len(value)} numbers)" if numbers else f"{name} {', '.join(map(str, value)) or 'nothing known'}"


def noise_factor_and_interval_text(factor: Value) -> str:
    """Text on one factor of noise over what is stated, with its interval."""
    assert factor.ci95 is not None
    low, high = factor.ci95
    return f"{factor.value:.2f} ({low:.2f} to {high:.2f}) times"


def noise_excess_text(noise_factors: dict[str, Value]) -> str:
    """Text on the factors by which poses scatter more than is stated."""
    each = [f"{noise_factor_and_interval_text(value)} in {kind}" for kind, value in noise_factors.items()]
    return (
        f"the noise of the poses exceeds what is stated: {' and '.join(each)} (or something moves the machine at "
        "random, which these poses do not distinguish)"
    )


def nothing_found_sentence(
    outliers_not_excluded: Crowd | None, noise_source: str, noise_factors: dict[str, Value]
) -> str:
    """Sentence on nothing found.

    It says what it is worth that nothing was found.
    Nothing, where the noise is not stated.
    """
    if outliers_not_excluded is not None:
        return f"No catalogued effect was found, and {outliers_not_excluded_sentence(outliers_not_excluded)}."
    if noise_source == ASSUMED_NOISE:
        return (
            "Nothing was found, which is inconclusive: the noise is not stated, and the residual of the poses "
            "was used instead. State it: "
            "position_sigma and rotation_sigma in [instrument] of rig.toml."
        )
    if noise_factors:
        noise = as_sentence(noise_excess_text(noise_factors))
        return f"{noise} Nothing else is unmodelled: all was tested at that noise."
    whence = ", estimated from the residuals of the corners: not stated" if noise_source == RESIDUALS else ""
    return f"Nothing is unmodelled: the recording and the model of the rig agree within the noise{whence}."
