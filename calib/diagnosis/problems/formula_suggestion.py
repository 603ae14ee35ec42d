"""Suggestion of a formula for an unexplained deviation: its library, its text, its held-out error."""

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.engine.chance_probability import Interval
from calib.diagnosis.engine.formula_library import Library, Quantity
from calib.diagnosis.engine.formula_search import Formula
from rig.effects.framework.effect import Effect
from rig.effects.framework.formula_quantities import POSE, quantities_of_motion
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.texts.effect_file_from_formula import Term, Written

NAME = "suggested"  # of the effect until a person gives it one
# standard errors by which stretches held out must gain, as a name must: what shows in a few of them gains in few
GAIN = 0.5
AGREE = 0.6  # of the parts, that must suggest something by themselves
TURNS = 8.0  # of a sinusoid over a quantity's range, the most that is tried
SPARSE = 14.0  # frames for each turn in time, at least
STILL = 1e-9  # share of its greatest value that a quantity must vary by


@dataclass(frozen=True, slots=True, eq=False)
class Suggestion:
    """place; written : Written; effect : as fitted with all that is free; intervals : {parameter: (value, low, high)}
    at 95 %
    before, after : RMS, unit, on stretches held out whole, without it and by formulas chosen and fitted without them;
        noise : what noise leaves
    gain : standard errors by which the stretches gain; parts : quantities that each part of the recording chose;
        length : by which a description
    of the whole is shorter, as minus twice a logarithm"""

    place: str
    written: Written
    effect: Effect
    intervals: dict[str, Interval]
    before: float
    after: float
    noise: float
    unit: str
    gain: float
    parts: tuple[tuple[str, ...], ...]
    length: float


def library_of_quantities(
    motion: Motion, axis: int | None, directions: int = 1, exclude_axis_quantities: bool = False
) -> Library:
    """Library of the quantities that vary: of one axis by its index, of all alike (None), or of the platform."""
    own = None if axis is None else f"travel of {motion.places[axis]}"
    out = []
    for q in quantities_of_motion(motion, not exclude_axis_quantities):
        values = q.values(motion)
        values = values[:, [axis]] if axis is not None and values.shape[1] > 1 else values
        if q.name == own or np.ptp(values) <= STILL * np.abs(values).max(initial=0.0):
            continue
        turns = 0.0 if not q.waves else min(len(values) / SPARSE, 3 * TURNS) if q.name == "time" else TURNS
        out.append(Quantity(q.name, values, q.powers, turns))
    return Library(tuple(out), directions, exclude_axis_quantities)


def formula_text(formula: Formula, library: Library, axis_word: str, same_for_all_axes: bool) -> Written:
    """Text of a Formula (Written) in the quantities of its Library. axis_word : strut, joint or slide"""
    terms, at = [], 0
    for atom in formula.atoms:
        count, wave, turns = 1, None, 0.0
        if atom.wave is not None:
            swung = library.quantities[atom.wave.quantity]
            count, wave, turns = 2, (swung.name, atom.wave.frequency), atom.wave.frequency * swung.range / (2 * np.pi)
        terms.append(
            Term(
                tuple((library.quantities[i].name, power) for i, power in atom.powers),
                wave,
                None if atom.direction is None else POSE[atom.direction],
                tuple(formula.coefficients[at : at + count].tolist()),
                library.scale(atom),
                turns,
            )
        )
        at += count
    return Written(axis_word, tuple(terms), same_for_all_axes)


def formula_quantities(formula: Formula | None, library: Library) -> tuple[str, ...]:
    """Names of the quantities in a Formula; none for no Formula."""
    return () if formula is None else tuple(library.quantities[i].name for i in sorted(formula.quantities))
