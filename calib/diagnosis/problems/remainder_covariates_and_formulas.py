"""Covariates ranked by what they explain of the remainder, and formulas suggested for it."""

from dataclasses import dataclass

import numpy as np

from calib.diagnosis.engine.cross_validation_and_chance import Interval
from calib.diagnosis.engine.formula_search import Formula, Library, Quantity
from rig.array_and_json_types import Floats
from rig.effects.framework.effect import Effect
from rig.effects.framework.formula_quantities import POSE, quantities_of_motion
from rig.effects.framework.machine_motion_and_play import Motion, Path
from rig.effects.texts.effect_file_from_formula import Term, Written
from rig.model.motion_simulation import ABOUT
from rig.recording.recording_folder import Commands, Sensors

COURSE = 4  # cosines of a covariate that goes on and on
AT_ONCE = 1e-3  # s; a shorter wait counts as so long


def time_and_sensor_functions(t: Floats, sensors: Sensors | None) -> dict[str, Floats]:
    """{covariate: (F, 1, q) functions} of time and of each sensor, at times (F,) s, alike for all axes and cameras."""
    order = np.argsort(np.argsort(t)).astype(float)
    out = {"time": time_cosines(t, COURSE), "order": time_cosines(order, COURSE)}
    if sensors is not None:
        logged = {name: np.interp(t, sensors.t, values) for name, values in sensors.channels.items()}
        out |= {name: scaled_powers(series, 2) for name, series in logged.items() if np.ptp(series) > 0}
    return {name: functions[:, None, :] for name, functions in out.items()}


def motion_functions(path: Path, commands: Commands, t: Floats) -> dict[str, Floats]:
    """{covariate: (F, axes or 1, q) functions} of the axes' motion up to times (F,) s."""
    wait = np.log(np.maximum(path.dwell, AT_ONCE))
    own = {"step": path.last_step, "speed": axis_speeds(commands, t), "way travelled": path.way}
    out = {
        name: np.stack([scaled_powers(column, 2) for column in values.T], axis=1)
        for name, values in own.items()
        if np.ptp(values) > 0
    }
    out["direction"] = path.direction[..., None]
    return {**out, "dwell": scaled_powers(wait, 2)[:, None, :]} if np.ptp(wait) > 0 else out


def separate_weights(functions: Floats, count: int) -> Floats:
    """(F, count, count q) weights separate for each direction, made of functions (F, count or 1, q)."""
    wide = np.broadcast_to(functions, (len(functions), count, functions.shape[2]))
    return np.einsum("faq,ab->fabq", wide, np.eye(count)).reshape(len(functions), count, -1)


def scaled_to_plus_minus_one(x: Floats) -> Floats:
    """x (F,) about its mean, scaled to within plus or minus one."""
    return (x - x.mean()) / max(np.abs(x - x.mean()).max(), 1e-300)


def scaled_powers(x: Floats, highest: int) -> Floats:
    """(F, highest) powers, from the first on, of a covariate x (F,), scaled to within -1 .. 1."""
    return np.stack([scaled_to_plus_minus_one(x) ** n for n in range(1, highest + 1)], axis=1)


def time_cosines(t: Floats, count: int) -> Floats:
    """(F, count) cosines of time, slowest first."""
    s = (t - t[0]) / max(np.ptp(t), 1e-300)
    return np.cos(np.pi * s[:, None] * np.arange(1, count + 1))


def axis_speeds(commands: Commands, t: Floats) -> Floats:
    """(F, axes) m/s or rad/s, speeds of the commanded axes at times (F,) s."""
    ends = [
        np.stack([np.interp(t + s * ABOUT, commands.t, column) for column in commands.values.T], axis=1)
        for s in (1, -1)
    ]
    return (ends[0] - ends[1]) / (2 * ABOUT)


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
