"""Conditions of a recording that are confounded with position, and its poses on one clock.

Direction, time, temperature or load may be correlated with position.

A cause that is a function of place over the poses recorded is absorbed by a correction that is one: its effect then
looks like geometry, and held-out poses of the same plan agree. Of each axis, a cause is regressed on smooth functions
of the configuration (all axes, the axis' own square and, for a direction, the half of its own stroke); the share of its
variance explained (R^2) is what a correction by place may absorb of it.
Source: Draper and Smith, Applied Regression Analysis, 3rd ed., ch. 5 and 6 (R^2, its adjustment and its distribution by
    chance)
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import cast

import numpy as np
from scipy.special import betainc

from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples, tilt_readings
from calib.samples.exposure_conditions import conditions_of_exposures
from rig.array_and_json_types import Floats, Json
from rig.formats.checked_toml_and_json_entries import Entries
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Arm, Chain, Free
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Parallel
from rig.recording.recording_folder import PAYLOAD, Recording
from vision.clock_offset_drive_lag_and_camera_time_offset_estimation import (
    Clocks,
    clock_offset_and_drive_lag_by_recording,
    recording_with_clock_offset_and_lag_applied,
)

DIRECTION, TIME, LOAD = "direction of approach", "time", "load"
# share of a cause, beyond chance, from which its size is known half as well beside a correction by place as without one
ABSORBED = 0.75
REMEDY = "; record poses in a balanced order, as --plan sobol:N of `rig run` and `rig simulate` visits them"
CHANCE = 1e-3  # probability, over all rows, below which a share is no chance
EVEN = 60.0  # s between configurations of a plan that states no times, long enough for any drift
SPARE = 3  # configurations beyond the functions of place, without which nothing is stated
ONE_SIDED, SEVERAL = 0.9, 5  # share of the poses that an axis came to from one side; of so many at least
ONE_SIDE = "from one side"
VARIES = {TIME: 60.0, LOAD: 1e-6, "temperature": 0.05}  # s, kg, K: range below which a cause counts as constant


@dataclass(frozen=True, slots=True)
class Confound:
    """One cause at one axis. axis : its place in words, "strut 1"; cause : "direction of approach", "time", "load" or a
    channel's name
    share : 0 to 1, of the cause's variance that a smooth function of place explains (R^2); chance : share expected of
        as many poses in random order
    p_value : probability of such a share by chance; adjusted : share beyond chance, 1 - (1 - R^2)(n - 1)/(n - p - 1),
        at least 0"""

    axis: str
    cause: str
    share: float
    chance: float
    p_value: float
    adjusted: float


@dataclass(frozen=True, slots=True)
class Confounds:
    """Of n poses. rows : Confound of every axis and every cause that varied; constant : causes that never varied, of
    which nothing can be estimated, and directions of axes that came from one side to nearly all poses ("direction of
    approach on strut 2"); unjudged : causes for which there are too few poses, and directions that are not known"""

    n: int
    rows: tuple[Confound, ...]
    constant: tuple[str, ...] = ()
    unjudged: tuple[str, ...] = ()

    @property
    def serious(self) -> tuple[Confound, ...]:
        """The rows that the recording's design cannot separate: a function of place beyond chance, by three quarters or
        more.

        The standard error of such a cause's size is twice what it would be without a correction by place (a variance
        inflation of 4).
        """
        limit = CHANCE / max(len(self.rows), 1)
        return tuple(row for row in self.rows if row.adjusted >= ABSORBED and row.p_value < limit)

    @property
    def one_sided(self) -> str:
        """The axes that came to nearly all poses from the same side, in words; "" where there is none. Play is then
        part of each of their zeros, whatever its size.
        """
        start = f"{DIRECTION} on "
        return _numbered([cause.removeprefix(start) for cause in self.constant if cause.startswith(start)])

    def line(self) -> str:
        """The confounds of a recording in one line."""
        if self.serious:
            lines = [
                _sentence(cause, [row for row in self.serious if row.cause == cause])
                for cause in dict.fromkeys(r.cause for r in self.serious)
            ]
            return "; ".join(lines) + REMEDY
        if not self.rows:
            return f"confounds with place: none can be estimated from {self.n} poses"
        greatest = max(self.rows, key=lambda row: row.adjusted)
        causes = [cause for cause in (DIRECTION, TIME, LOAD) if any(row.cause == cause for row in self.rows)]
        causes += ["temperatures"] if any(row.cause not in (DIRECTION, TIME, LOAD) for row in self.rows) else []
        return (
            f"no cause is confounded with place ({', '.join(causes)}): the greatest, {greatest.cause} on "
            f"{greatest.axis}, is "
            f"{greatest.share:.0%} a function of place, {greatest.chance:.0%} by chance"
        ).replace("%", " %")

    def tree(self) -> Json:
        """The tree that JSON files hold under "confounds"."""
        return {
            "n": self.n,
            "line": self.line(),
            "serious": [f"{row.cause} on {row.axis}" for row in self.serious],
            "rows": [asdict(row) for row in self.rows],
            "constant": list(self.constant),
            "unjudged": list(self.unjudged),
        }


def confounds_of_samples(samples: Samples, mechanism: Parallel | Arm | Chain | Free) -> Confounds | None:
    """Confounds: conditions of a mechanism's samples that go with position, axis by axis.

    None where no recording states their conditions.
    """
    known = samples.conditions
    if known is None:
        return None
    return confounds_of_experimental_design(
        samples.commanded, known.direction, known.t, known.channels, mechanisms.axis_place_texts(mechanism)
    )


def confounds_of_configurations(
    values: Floats, reached_from: Floats, mechanism: Parallel | Arm | Chain | Free
) -> Confounds:
    """Confounds of conditions with position, of configurations (n, axes) m or rad.

    They are visited in order at even times, each reached from (n, axes).
    """
    signs = np.sign(values - reached_from)
    latest = np.maximum.accumulate(np.where(signs != 0, np.arange(len(signs))[:, None], -1), axis=0)
    direction = np.where(latest < 0, 0.0, np.take_along_axis(signs, np.maximum(latest, 0), axis=0))
    return confounds_of_experimental_design(
        values, direction, cast(Floats, EVEN * np.arange(len(values))), {}, mechanisms.axis_place_texts(mechanism)
    )


def confounds_of_recordings(recordings: Sequence[Recording]) -> Confounds | None:
    """Confounds of conditions with position, of several recordings of one machine in order of time.

    None where one has no commands.

    A channel counts where every recording has it.
    """
    if any(recording.commands is None for recording in recordings):
        return None
    frames = [recording.commanded() for recording in recordings]
    known = [conditions_of_exposures(recording, t) for recording, (_, t, _) in zip(recordings, frames)]
    names = [name for name in known[0].channels if all(name in one.channels for one in known)]
    begins = np.cumsum([0.0, *(float(one.t.max()) for one in known[:-1])])
    return confounds_of_experimental_design(
        np.concatenate([values for _, _, values in frames]),
        np.concatenate([one.direction for one in known]),
        np.concatenate([one.t + begin for one, begin in zip(known, begins)]),
        {name: np.concatenate([one.channels[name] for one in known]) for name in names},
        mechanisms.axis_place_texts(recordings[0].design.mechanism),
    )


def confounds_from_entries(table: Entries) -> Confounds:
    """Confounds from their entries in a file.

    Raises FileError for anything else.
    """
    return Confounds(
        table.whole("n", 0),
        tuple(_row_in(row) for row in table.tables("rows")),
        table.texts("constant"),
        table.texts("unjudged"),
    )


def _row_in(row: Entries) -> Confound:
    shares = (row.number(name, least=0.0, most=1.0) for name in ("share", "chance", "p_value", "adjusted"))
    return Confound(row.text("axis"), row.text("cause"), *shares)


def confounds_of_experimental_design(
    values: Floats, direction: Floats, t: Floats, channels: dict[str, Floats], axes: Sequence[str]
) -> Confounds:
    """Confounds of conditions with position, of the design of a plan or a recording.

    values : (n, axes) m or rad, configurations; direction : (n, axes) -1, 0, 1; t : (n,) s; channels : {name: (n,)};
        axes : their places in words
    """
    constant = [f"{DIRECTION} on {axis}" for axis in one_sided_axes(values, direction, axes)]
    rows, unjudged = [], []
    moved = [i for i in range(len(axes)) if np.ptp(values[:, i]) > 0]
    unit = np.zeros_like(values)
    unit[:, moved] = 2 * (values[:, moved] - values[:, moved].min(axis=0)) / np.ptp(values[:, moved], axis=0) - 1
    shared = {TIME: t, **{LOAD if name == PAYLOAD else name: channel for name, channel in channels.items()}}
    for i in moved:
        for cause, values_of in {DIRECTION: direction[:, i], **shared}.items():
            if cause == DIRECTION:
                if len(set(values_of) - {0.0}) < 2:
                    unjudged += [place for place in (f"{cause} on {axes[i]}",) if place not in constant]
                    continue
            elif not np.ptp(values_of) > VARIES.get(cause, VARIES["temperature"]):
                constant.append(cause)
                continue
            columns = [*unit[:, moved].T, unit[:, i] ** 2, *([np.sign(unit[:, i])] if cause == DIRECTION else [])]
            if len(t) < len(columns) + 1 + SPARE:
                columns = columns[len(moved) :] + [unit[:, i]]
            if len(t) < len(columns) + 1 + SPARE:
                unjudged.append(f"{cause} on {axes[i]}")
                continue
            rows.append(Confound(axes[i], cause, *_shares(np.column_stack(columns), values_of)))
    return Confounds(len(t), tuple(rows), tuple(dict.fromkeys(constant)), tuple(unjudged))


def one_sided_axes(values: Floats, direction: Floats, axes: Sequence[str]) -> list[str]:
    """The axes that came to nearly all poses from the same side, of those that moved.

    values : (n, axes) m or rad, configurations; direction : (n, axes) -1, 0, 1, where 0 is not known and not counted;
        axes : their places in words
    """
    found = []
    for i, axis in enumerate(axes):
        below, above = int((direction[:, i] > 0).sum()), int((direction[:, i] < 0).sum())
        several = below + above >= SEVERAL and max(below, above) >= ONE_SIDED * (below + above)
        found += [axis] if several and np.ptp(values[:, i]) > 0 else []
    return found


def approach_text(values: Floats, direction: Floats, axes: Sequence[str]) -> str:
    """From which side the axes came to poses, in words. values, direction : (n, axes), as of `one_sided_axes`."""
    moved = np.ptp(values, axis=0) > 0
    if not ((direction[:, moved] != 0).sum(axis=0) >= SEVERAL).any():
        return "not determined by the commands"
    one = one_sided_axes(values, direction, axes)
    if not one:
        return "from both sides"
    return f"{ONE_SIDE} {'by every axis' if len(one) == moved.sum() else f'on {_numbered(one)}'}"


def _shares(columns: Floats, cause: Floats) -> tuple[float, float, float, float]:
    """(R^2, expected by chance, probability by chance, adjusted R^2) of a cause (n,) by columns (n, p) and a
    constant.
    """
    n = len(cause)
    centred = cause - cause.mean()
    basis, sizes, _ = np.linalg.svd(columns - columns.mean(axis=0), full_matrices=False)
    basis = basis[:, sizes > 1e-9 * sizes[0]]
    p, free = basis.shape[1], n - basis.shape[1] - 1
    share = float(np.clip((basis.T @ centred) @ (basis.T @ centred) / (centred @ centred), 0.0, 1.0))
    p_value = float(np.clip(1 - betainc(p / 2, free / 2, share), 0.0, 1.0))
    return share, p / (n - 1), p_value, float(max(1 - (1 - share) * (n - 1) / free, 0.0))


def _sentence(cause: str, rows: list[Confound]) -> str:
    """What a cause's serious rows mean."""
    low, high = min(row.share for row in rows), max(row.share for row in rows)
    shares = f"{high:.0%}" if round(low, 2) == round(high, 2) else f"{low:.0%} to {high:.0%}"
    effect = {DIRECTION: "play and place", TIME: "drift and place", LOAD: "load and place"}.get(
        cause, "temperature and place"
    )
    axes = _numbered([row.axis for row in rows])
    return f"{cause} is {shares.replace('%', ' %')} a function of place on {axes}: {effect} cannot be separated"


def _numbered(places: list[str]) -> str:
    """Places in words, "strut 1", "strut 2", "strut 3" as "struts 1-3"."""
    words = [place.rpartition(" ") for place in places]
    if len(places) < 2 or len({word for word, _, _ in words}) > 1:
        return ", ".join(places)
    numbers = sorted(int(number) for _, _, number in words)
    runs = [[numbers[0], numbers[0]]]
    for number in numbers[1:]:
        if number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return f"{words[0][0]}s " + ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in runs)


def confound_sentences(confounds: Confounds | None) -> tuple[str, ...]:
    """Sentences on confounds.

    They are a list of one, on a recording's design.
    Empty where there are none.
    """
    return (confounds.line().removesuffix(REMEDY),) if confounds is not None and confounds.serious else ()


def estimate_clocks_from_samples(recording: Recording, samples: Samples) -> tuple[Clocks, ...]:
    """Clocks of a recording, estimated from Samples.

    They are of its poses; () where these are not whole poses.
    """
    if samples.measured != "pose":
        return ()
    return clock_offset_and_drive_lag_by_recording(
        recording, samples.frame, samples.T_base_platform, samples.covariance, samples.common
    )


def recording_and_poses_on_commands_clock(
    recording: Recording, sampled: Sampled, clocks: Sequence[Clocks]
) -> tuple[Recording, Sampled]:
    """The Recording and its Sampled on the commands' clock.

    Exposures are on it, and commands are as the axes follow them.
    """
    if not clocks:
        return recording, sampled
    recording, s = recording_with_clock_offset_and_lag_applied(recording, clocks), sampled.samples
    frames, t, commanded = recording.commanded()
    at = np.searchsorted(frames, s.frame)
    samples = replace(
        s,
        t=t[at],
        commanded=commanded[at],
        conditions=None if s.conditions is None else conditions_of_exposures(recording, t[at]),
        tilts=None if s.tilts is None else tilt_readings(recording, t[at]),
    )
    return recording, replace(sampled, samples=samples)
