"""Entries, table rows and lines of detectable effect sizes.

They say how large each effect would have to be to be found; entries are of diagnosis.json.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.problems.detectable_effect_sizes import RMS, DetectableSize
from calib.diagnosis.report.diagnosis_sentences_and_table_rows import value_text


@dataclass(frozen=True, slots=True)
class DetectablePlace:
    """A place, and the smallest size that would be found there, None where none within the effect's bounds would."""

    place: str
    size: float | None


@dataclass(frozen=True, slots=True)
class DetectableEntry:
    """How large an effect would have to be to be found, by a parameter, at the place where least is needed and most.

    is_greatest : whether the sizes are the greatest that would be found, as of a stiffness
    """

    effect: str
    parameter: str
    unit: str
    best: DetectablePlace
    worst: DetectablePlace
    is_greatest: bool = False


def detectable_size_entries(sizes: Sequence[DetectableSize]) -> tuple[DetectableEntry, ...]:
    """Entries of detectable effect sizes.

    They are one for each effect and parameter, in their order.
    """
    by: dict[tuple[str, str, str], list[DetectableSize]] = {}
    for one in sizes:
        by.setdefault((one.effect, one.parameter, one.unit), []).append(one)
    out = []
    for name, places in by.items():
        ends = min(places, key=lambda one: one.smallness), max(places, key=lambda one: one.smallness)
        best, worst = (DetectablePlace(e.place, e.size if np.isfinite(e.smallness) else None) for e in ends)
        out.append(DetectableEntry(*name, best, worst, ends[0].is_greatest))
    return tuple(out)


def detectable_size_row(entry: DetectableEntry) -> tuple[str, str, str, str]:
    """Table row of a detectable effect size.

    It says how large an effect would have to be to be found: effect, parameter, at best and at worst.
    """

    def text(one: DetectablePlace) -> str:
        if one.size is None:
            return f"none at {one.place}"
        size = value_text(one.size, entry.unit, digits=2)
        return f"{size} {'or less ' if entry.is_greatest else ''}at {one.place}"

    name = "RMS" if entry.parameter == RMS else entry.parameter.replace("_", " ")
    return entry.effect.replace("_", " "), name, text(entry.best), text(entry.worst)


def detectable_size_line(entry: DetectableEntry) -> str:
    """Line on a detectable effect size.

    It says the same as the table row.
    """
    effect, name, best, worst = detectable_size_row(entry)
    return f"would have shown: {effect}, {name} {best}" + (f", {worst}" if worst != best else "")
