"""Functions of covariates, smoothed temperatures, and repeatability of repeated commands.

Logged temperatures are smoothed; repeatability is that of repeated commands.

Covariates are ranked by what they explain of the remainder, with formulas suggested for it; logged temperatures hold a
thermometer's noise; repeats show whether the remainder repeats with the commands, or is noise.
Noise in what an effect follows makes the effect look smaller, and leaves behind what no model explains (Fuller,
Measurement error models, 1987, ch. 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.spatial import cKDTree

from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Interval
from calib.diagnosis.engine.formula_search_for_unexplained_residuals import Formula, Library, Quantity
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.machine_motion_and_play import Motion, Path
from rig.effects.framework.unmodelled_curve_and_formula_quantities import POSE, quantities_of_motion
from rig.effects.texts.effect_file_from_formula import Term, Written
from rig.model.machine_motion_simulation import ABOUT
from rig.recording.recording_folder import Commands, Sensors

DEGREES = (
    1,
    2,
)  # of the plainest courses: a temperature has at least a slope, and a log too short to show it still bounds it
KNOTS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)  # stretches of a cubic spline that are tried beyond these
ROWS = 4  # of the log for each stretch, and beyond what a course takes, at least
ALIKE = 3.0  # standard errors by which what is taken for noise may follow its neighbour
FAR = 8.0  # times its middle size that noise may reach


def smoothed_temperatures_and_errors(sensors: Sensors | None) -> tuple[Sensors | None, dict[str, Floats]]:
    """Sensors with smoothed temperatures, and the error {channel: (n, q) K} of each smoothing coefficient.

    A log that is not smooth with white noise on it stays as it is, and so do all other channels. sensors : Sensors or
    None, for which (None, {}) is returned. Source of the criterion: Schwarz, Annals of Statistics 6, 1978, 461-464; for
    few rows McQuarrie, Statistics and Probability Letters 44, 1999, 79-86
    """
    if sensors is None:
        return None, {}
    edges = [
        0,
        *np.searchsorted(sensors.t, sensors.starts).tolist(),
        len(sensors.t),
    ]  # of the logs, each of one recording
    parts = [slice(a, b) for a, b in zip(edges[:-1], edges[1:])]
    tried = {
        name: [_smooth(sensors.t[part], values[part]) for part in parts]
        for name, values in sensors.channels.items()
        if name.endswith("temperature_C")
    }
    courses = {
        name: _joined(sensors.channels[name], parts, found)
        for name, found in tried.items()
        if any(one is not None for one in found)
    }
    channels = {**sensors.channels, **{name: curve for name, (curve, _) in courses.items()}}
    return replace(sensors, channels=channels), {name: errors for name, (_, errors) in courses.items()}


def _joined(values: Floats, parts: list[slice], found: list[tuple[Floats, Floats] | None]) -> tuple[Floats, Floats]:
    """(curve (n,), errors (n, q)) of a log (n,) in parts, each by itself; a part that is not smoothed stands as it
    is.
    """
    curve, errors = values.astype(float), []
    for part, one in zip(parts, found):
        if one is not None:
            curve[part] = one[0]
            own = np.zeros((len(values), one[1].shape[1]))
            own[part] = one[1]
            errors.append(own)
    return curve, np.concatenate(errors, axis=1)


def _smooth(t: Floats, values: Floats) -> tuple[Floats, Floats] | None:
    """(curve (n,), errors (n, q)) of a log (n,), or None where there is no saying what of it is noise."""
    courses = _courses(t)
    if len(courses) < 2 or (np.diff(t) <= 0).any() or np.ptp(values) == 0:
        return None
    tried = []
    for Q in courses:
        noise = values - Q @ (Q.T @ values)
        tried.append((len(t) * np.log(np.mean(noise**2) + 1e-300) + _price(len(t), Q.shape[1]), noise))
    best = min(range(len(tried)), key=lambda i: tried[i][0])
    noise, Q = tried[best][1], courses[best]
    follows = abs(noise[1:] @ noise[:-1]) > ALIKE / np.sqrt(len(t)) * (noise @ noise)
    wild = np.abs(noise).max() > FAR * np.median(np.abs(noise))
    if follows or wild or best == len(courses) - 1:
        return None
    return values - noise, courses[best + 1] * np.sqrt(noise @ noise / (len(t) - Q.shape[1]))


def _price(rows: int, numbers: int) -> float:
    """Of a course's numbers, as minus twice a logarithm: Schwarz's, corrected for few rows."""
    return rows * np.log(rows) * numbers / (rows - numbers - 2)


def _courses(t: Floats) -> list[Floats]:
    """Orthonormal bases (n, q) of the courses that a log at times (n,) s bears, the plainest first."""
    plain = [
        np.vander((t - t[0]) / max(np.ptp(t), 1e-300), degree + 1) for degree in DEGREES if degree + 1 + ROWS <= len(t)
    ]
    splines = []
    for count in (count for count in KNOTS if count * ROWS + ROWS <= len(t)):
        inner = np.interp(np.linspace(0, len(t) - 1, count + 1)[1:-1], np.arange(len(t)), t)
        splines.append(scipy.interpolate.BSpline.design_matrix(t, np.r_[[t[0]] * 4, inner, [t[-1]] * 4], 3).toarray())
    return [np.linalg.qr(basis)[0] for basis in plain + splines]


SAME = {"rad": 1e-3, "m": 1e-5}  # commands nearer than this in every axis are one command
FEWEST = 12  # pairs


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """pairs : how many; mean, rms : of one position's length about what it repeats; unit : theirs, "m", of directions
    "rad"
    mean_rad : of a rotation, None where not measured
    recurring_share : share of what is left that comes again under the same command, 0..1; p_value : of that share by
        chance"""

    pairs: int
    mean: float
    rms: float
    unit: str
    mean_rad: float | None
    recurring_share: float
    p_value: float


def row_pairs_with_same_command(commands: Floats, units: Sequence[str]) -> Integers:
    """Pairs (p, 2) of rows that repeat one command.

    Rows of commands (n, axes), in units "m" or "rad".
    """
    apart_by = np.array([SAME[unit] for unit in units])
    return np.array(sorted(cKDTree(commands / apart_by).query_pairs(1.0, p=np.inf)), int).reshape(-1, 2)


def repeatability_of_pairs(
    pairs: Integers, poses_of_pairs: tuple[Floats, Floats], residuals_of_pairs: tuple[Floats, Floats], unit: str = "m"
) -> Repeats | None:
    """Repeatability (Repeats) of pairs of poses with one command.

    None for too few. pairs : (p, 2)
    poses_of_pairs : two (p, 6 or 3) m and rad, measured poses of each pair, both less the same; residuals_of_pairs :
        two (p, k) what a model leaves of each; unit : of the first three numbers of a pose, "m" or "rad"

    The difference of two poses under one command holds no model error, so its scatter is pure error; of a residual's
    square, the part that both share is repeatable and not explained.
    """
    if len(pairs) < FEWEST:
        return None
    off = (poses_of_pairs[0] - poses_of_pairs[1]) / np.sqrt(2)
    apart = np.linalg.norm(off[:, :3], axis=1)
    turned = float(np.linalg.norm(off[:, 3:], axis=1).mean()) if off.shape[1] == 6 else None
    one, two = residuals_of_pairs
    product = (one * two).sum(axis=1)
    correlation = float(product.sum() / max(((one**2).sum() + (two**2).sum()) / 2, 1e-300))
    z = float(product.sum() / max(np.sqrt((product**2).sum()), 1e-300))
    return Repeats(
        len(pairs),
        float(apart.mean()),
        float(np.sqrt((apart**2).mean())),
        unit,
        turned,
        max(correlation, 0.0),
        float(scipy.special.ndtr(-z)),
    )


COURSE = 4  # cosines of a covariate that goes on and on
AT_ONCE = 1e-3  # s; a shorter wait counts as so long


def smooth_functions_of_time_and_sensors(t: Floats, sensors: Sensors | None) -> dict[str, Floats]:
    """Smooth functions {covariate: (F, 1, q)} of time and of each sensor, at times (F,) s."""
    order = np.argsort(np.argsort(t)).astype(float)
    out = {"time": time_cosines(t, COURSE), "order": time_cosines(order, COURSE)}
    if sensors is not None:
        logged = {name: np.interp(t, sensors.t, values) for name, values in sensors.channels.items()}
        out |= {name: scaled_powers(series, 2) for name, series in logged.items() if np.ptp(series) > 0}
    return {name: functions[:, None, :] for name, functions in out.items()}


def smooth_functions_of_axis_motion(path: Path, commands: Commands, t: Floats) -> dict[str, Floats]:
    """Smooth functions {covariate: (F, axes or 1, q)} of the axes' motion up to times (F,) s."""
    wait = np.log(np.maximum(path.dwell, AT_ONCE))
    own = {"step": path.last_step, "speed": axis_speeds(commands, t), "way travelled": path.way}
    out = {
        name: np.stack([scaled_powers(column, 2) for column in values.T], axis=1)
        for name, values in own.items()
        if np.ptp(values) > 0
    }
    out["direction"] = path.direction[..., None]
    return {**out, "dwell": scaled_powers(wait, 2)[:, None, :]} if np.ptp(wait) > 0 else out


def separate_weights_for_each_direction(functions: Floats, count: int) -> Floats:
    """Weights (F, count, count q) of the functions, separate for each direction.

    They are the design matrix in which each direction has its own coefficients.
    Functions (F, count or 1, q) become weights (F, count, count q), for `count` directions.
    """
    wide = np.broadcast_to(functions, (len(functions), count, functions.shape[2]))
    return np.einsum("faq,ab->fabq", wide, np.eye(count)).reshape(len(functions), count, -1)


def centred_and_scaled_to_plus_minus_one(x: Floats) -> Floats:
    """x (F,) about its mean, scaled to within plus or minus one."""
    return (x - x.mean()) / max(np.abs(x - x.mean()).max(), 1e-300)


def scaled_powers(x: Floats, highest: int) -> Floats:
    """Powers (F, highest) of a covariate x (F,) scaled to within -1 .. 1, from the first on."""
    return np.stack([centred_and_scaled_to_plus_minus_one(x) ** n for n in range(1, highest + 1)], axis=1)


def time_cosines(t: Floats, count: int) -> Floats:
    """Cosines (F, count) of time.

    The slowest is first.
    """
    s = (t - t[0]) / max(np.ptp(t), 1e-300)
    return np.cos(np.pi * s[:, None] * np.arange(1, count + 1))


def axis_speeds(commands: Commands, t: Floats) -> Floats:
    """Speeds (F, axes) m/s or rad/s of the commanded axes at times (F,) s."""
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
    """Library of the quantities that vary.

    They are of one axis by its index, of all alike (None), or of the platform.
    """
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
    """Text of a Formula (Written) in the quantities of its Library.

    axis_word : strut, joint or slide
    """
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


def formula_quantity_names(formula: Formula | None, library: Library) -> tuple[str, ...]:
    """Names of the quantities in a Formula.

    None for no Formula.
    """
    return () if formula is None else tuple(library.quantities[i].name for i in sorted(formula.quantities))
