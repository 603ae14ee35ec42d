"""ISO 230-2 and ISO 9283 tests.

Of single axes, and of accuracy and repeatability of repeated poses.

An axis' deviation is what the calibrated machine would have had to be commanded beyond the command for the pose that
was measured. The standard requires five positions at least, each come to five times from either side; what a recording
has short of that is reported with its counts.
docs/mathematics.md (29); ISO 230-2:2014, clause 3, whose symbols these are, up standing for an arrow up (the axis had
lengthened).

Of each pose that was visited k times from equal commands: AP, the barycentre's distance from where the pose should be;
l_j, the visits' distances from the barycentre; RP = mean of l + 3 s_l; for rotations AP and RP = 3 s axis by axis. They
are the standard's where the test is: five poses on a diagonal plane of a cube, one after the other in one order, thirty
times, each come to from one side, at full load and full speed. What of that is not met is named. docs/mathematics.md
(27); ISO 9283:1998, 6.8 to 7.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.certification.held_out_pose_errors_and_distinct_configurations import HeldPoses
from calib.correction.machine_correction import AnyCorrection
from rig.array_and_json_types import Floats, Integers
from rig.model import mechanisms
from rig.model.design import Design
from rig.recording.recording_folder import Recording

POSITIONS, CYCLES = 5, 5  # of ISO 230-2


@dataclass(frozen=True, slots=True)
class AxisTest:
    """axis : "strut 1" ..; unit : m or rad; positions come to from both sides; cycles : fewest from either side
    B : greatest reversal over them, by size; B_mean : mean reversal, with its sign
    E : bidirectional systematic deviation, the range of both directions' means; E_up, E_down : of one direction's
    M : mean bidirectional deviation, the range of the two directions' common means
    A, R : bidirectional accuracy and repeatability; A_up, A_down, R_up, R_down : of one direction
    each A and R None where some position was come to once alone from a side
    u : standard uncertainty of one deviation from measuring; formal : whether there are as many as the standard asks
        for."""

    axis: str
    unit: str
    positions: int
    cycles: int
    B: float
    B_mean: float
    E: float
    E_up: float
    E_down: float
    M: float
    A: float | None
    A_up: float | None
    A_down: float | None
    R: float | None
    R_up: float | None
    R_down: float | None
    u: float
    formal: bool


def iso230_tests_of_corrected_axes(correction: AnyCorrection, poses: HeldPoses) -> tuple[AxisTest, ...]:
    """ISO 230-2 test of each axis as corrected, where it was moved alone from both sides."""
    if not poses.rotations:
        return ()
    J = _to_axes(correction, poses)
    deviation = np.einsum("nij,nj->ni", J, poses.errors)
    noise = np.sqrt(np.einsum("nij,njk,nik->ni", J, poses.own, J))
    mechanism = correction.nominal
    alone = poses.step.sum(axis=1) == 1
    out = []
    for axis, name in enumerate(mechanisms.axis_place_texts(mechanism)):
        rows = np.flatnonzero(alone & poses.step[:, axis])
        found = _test(
            name,
            mechanisms.axis_units(mechanism)[axis],
            poses,
            rows,
            axis,
            deviation[:, axis],
            float(noise[:, axis].mean()),
        )
        if found is not None:
            out.append(found)
    return tuple(out)


def _to_axes(correction: AnyCorrection, poses: HeldPoses) -> Floats:
    """(n, axes, 6) change of the axes with the pose's tangent."""
    fitted = correction.fitted
    return mechanisms.kinematics_of(fitted).inverse_kinematics_jacobian(poses.T_base_platform, poses.commanded, fitted)


def _test(
    name: str, unit: str, poses: HeldPoses, rows: Integers, axis: int, deviation: Floats, u: float
) -> AxisTest | None:
    means, spreads, counts = [], [], []
    for label in np.unique(poses.label[rows]):
        sides = [
            deviation[rows[(poses.label[rows] == label) & (poses.before[rows, axis] == sign)]] for sign in (1.0, -1.0)
        ]
        if all(len(side) for side in sides):
            means.append([side.mean() for side in sides])
            spreads.append([side.std(ddof=1) if len(side) > 1 else np.nan for side in sides])
            counts.append(min(len(side) for side in sides))
    if not means:
        return None
    mean, s = np.array(means), np.array(spreads)
    cycles = min(counts)
    E_up, E_down = np.ptp(mean, axis=0).tolist()
    return AxisTest(
        name,
        unit,
        len(mean),
        cycles,
        *iso230_reversal_values(mean),
        float(np.ptp(mean)),
        E_up,
        E_down,
        float(np.ptp(mean.mean(axis=1))),
        *iso230_axis_accuracy(mean, s),
        *iso230_axis_repeatability(mean, s),
        u,
        len(mean) >= POSITIONS and cycles >= CYCLES,
    )


def iso230_reversal_values(mean: Floats) -> tuple[float, float]:
    """ISO 230-2 reversal values (B, mean B) of mean deviations (positions, 2), from below and from above."""
    B = mean[:, 0] - mean[:, 1]
    return float(np.abs(B).max()), float(B.mean())


def iso230_axis_accuracy(mean: Floats, standard_deviation: Floats) -> tuple[float | None, float | None, float | None]:
    """Axis accuracy (A, A up, A down) of means and standard deviations (positions, 2).

    None where unknown.
    """
    if not np.isfinite(standard_deviation).all():
        return None, None, None
    high, low = mean + 2 * standard_deviation, mean - 2 * standard_deviation
    up, down = (high.max(axis=0) - low.min(axis=0)).tolist()
    return float(high.max() - low.min()), up, down


def iso230_axis_repeatability(
    mean: Floats, standard_deviation: Floats
) -> tuple[float | None, float | None, float | None]:
    """Axis repeatability (R, R up, R down) of means and standard deviations (positions, 2).

    None where unknown.
    """
    if not np.isfinite(standard_deviation).all():
        return None, None, None
    up, down = (4 * standard_deviation).max(axis=0).tolist()
    both = 2 * standard_deviation.sum(axis=1) + np.abs(mean[:, 0] - mean[:, 1])
    return float(max(both.max(), up, down)), up, down


VISITS, POSES = 30, 5
FEWEST = 3  # visits from which a scatter is reported
NEAR = 0.03  # of half a diagonal, by which the five poses may lie off their places
FULL = 0.98  # of the rated speed and load
PLANE = 1 / 3  # cosine between the diagonals of a plane through opposite edges of a cube


@dataclass(frozen=True, slots=True)
class RepeatedPose:
    """place : (3,) m; visits; AP, RP : m; AP_axes, RP_axes : (3,) rad about x y z of the platform, None where no
    rotation was measured
    approaches : from how many sides it was come to."""

    place: tuple[float, ...]
    visits: int
    approaches: int
    AP: float
    RP: float
    AP_axes: tuple[float, ...] | None
    RP_axes: tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Iso9283:
    """repeated : RepeatedPose of poses with FEWEST visits at least
    formal : whether the test is the standard's; not_met : what of it is not, in words
    random : AP over all distinct poses, one visit each: n, mean, greatest (m), and the same of rotations (rad) or
        None."""

    repeated: tuple[RepeatedPose, ...]
    formal: bool
    not_met: tuple[str, ...]
    random: tuple[int, float, float]
    random_rotation: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Duty:
    """speed : m/s or rad/s, the least over the visits of the fastest axis on the way there, None where commands do not
    show it; rated_speed
    load : (least, greatest) kg at the exposures, None where not logged; rated_load : kg; each None where not stated."""

    speed: float | None
    rated_speed: float | None
    load: tuple[float, float] | None
    rated_load: float | None


def iso9283_accuracy_and_repeatability(poses: HeldPoses, duty: Duty) -> Iso9283:
    """ISO 9283 pose accuracy and repeatability of HeldPoses."""
    rows = []
    for label in np.flatnonzero(np.bincount(poses.label) >= FEWEST):
        at = np.flatnonzero(poses.label == label)
        errors = poses.errors[at]
        mean = errors.mean(axis=0)
        far = np.linalg.norm(errors[:, :3] - mean[:3], axis=1)
        place = tuple(poses.T_base_platform[at].translation.mean(axis=0).tolist())
        turn = (
            (tuple(mean[3:].tolist()), tuple((3 * errors[:, 3:].std(axis=0, ddof=1)).tolist()))
            if poses.rotations
            else (None, None)
        )
        rows.append(
            RepeatedPose(
                place,
                len(at),
                len(np.unique(poses.before[at], axis=0)),
                float(np.linalg.norm(mean[:3])),
                float(far.mean() + 3 * far.std(ddof=1)),
                *turn,
            )
        )
    first = poses.errors[poses.first]
    lengths, turned = np.linalg.norm(first[:, :3], axis=1), np.linalg.norm(first[:, 3:], axis=1)
    missing = _unmet_requirements(poses, duty)
    return Iso9283(
        tuple(rows),
        not missing,
        missing,
        (len(first), float(lengths.mean()), float(lengths.max())),
        (float(turned.mean()), float(turned.max())) if poses.rotations else None,
    )


def _unmet_requirements(poses: HeldPoses, duty: Duty) -> tuple[str, ...]:
    """What the standard requires of the test and these HeldPoses do not show, one sentence each, without its full
    stop.
    """
    order = np.lexsort((poses.t, poses.recording))
    label, recording = poses.label[order], poses.recording[order]
    fresh = np.append(
        True, (label[1:] != label[:-1]) | (recording[1:] != recording[:-1])
    )  # exposures without a move between are one visit
    visits = order[fresh]
    often = np.flatnonzero(np.bincount(poses.label[visits]) >= VISITS)
    if len(often) != POSES:
        return (f"{len(often)} poses were visited {VISITS} times or more, where the standard has {POSES}", *_duty(duty))
    tested = visits[np.isin(poses.label[visits], often)]
    out = [*_places(np.stack([poses.T_base_platform[poses.label == one].translation.mean(axis=0) for one in often]))]
    start, end = np.flatnonzero(np.isin(visits, tested))[[0, -1]]
    run = poses.label[visits[start : end + 1]]
    if not np.isin(run, often).all():
        out.append("other poses were visited between them")
    elif len(np.unique(run[:POSES])) < POSES or (run[POSES:] != run[:-POSES]).any():
        out.append("they were not visited in a consistent order")
    sides = [len(np.unique(poses.before[tested[poses.label[tested] == one]], axis=0)) for one in often]
    if max(sides) > 1:
        out.append(f"{sum(side > 1 for side in sides)} of them were approached from more than one side")
    return (*out, *_duty(duty))


def _places(places: Floats) -> tuple[str, ...]:
    """What is wrong with the five places (5, 3) m: one in the middle, four at the corners of a diagonal plane of a cube
    about it.
    """
    from_middle = places - places.mean(axis=0)
    centre = int(np.argmin(np.linalg.norm(from_middle, axis=1)))
    arms = np.delete(places - places[centre], centre, axis=0)
    half = np.linalg.norm(arms, axis=1)
    opposite = next((k for k in (1, 2, 3) if np.linalg.norm(arms[0] + arms[k]) < NEAR * half[0]), None)
    if half.min() < (1 - NEAR) * half.max() or opposite is None:
        return ("they do not lie in the middle and at the corners of a rectangle about it",)
    other = [k for k in (1, 2, 3) if k != opposite]
    if np.linalg.norm(arms[other[0]] + arms[other[1]]) > NEAR * half[0]:
        return ("they do not lie in the middle and at the corners of a rectangle about it",)
    cosine = abs(float(arms[0] @ arms[other[0]])) / (half[0] * half[other[0]])
    return () if abs(cosine - PLANE) < NEAR else ("the rectangle of their corners is no diagonal plane of a cube",)


def _duty(duty: Duty) -> list[str]:
    out = []
    if duty.rated_load is None:
        out.append("the rated load is not stated")
    elif duty.load is None:
        out.append("the load was not logged")
    elif duty.load[0] < FULL * duty.rated_load:
        out.append(f"the load was {duty.load[0]:g} to {duty.load[1]:g} kg, the rated one is {duty.rated_load:g} kg")
    if duty.rated_speed is None:
        out.append("the rated speed is not stated")
    elif duty.speed is None or duty.speed < FULL * duty.rated_speed:
        reached = (
            "commands do not show the speed"
            if duty.speed is None
            else f"some poses were approached at {duty.speed / duty.rated_speed:.0%} of it"
        )
        out.append(f"the rated speed was not reached: {reached}")
    return out


def speeds_and_loads_of_test(
    poses: HeldPoses,
    recordings: Sequence[Recording],
    design: Design,
    load: tuple[float, float] | None,
    rated_load: float | None,
) -> Duty:
    """Speeds and loads (Duty) of a test.

    They are those of held-out poses, and those rated.
    recordings : in the order of poses.recording; load : as logged, kg; rated_load : kg, as stated
    """
    top = design.actuator.max_speed
    return Duty(_least_speed(poses, recordings), top, load, rated_load)


def _least_speed(poses: HeldPoses, recordings: Sequence[Recording]) -> float | None:
    """m/s or rad/s, the least over visits of the fastest commanded axis on the way there from the pose before."""
    found = []
    for k, recording in enumerate(recordings):
        commands, t = recording.commands, np.sort(poses.t[poses.recording == k])
        if commands is None or len(commands.t) < 2:
            return None
        speed = np.abs(np.diff(commands.values, axis=0)).max(axis=1) / np.maximum(np.diff(commands.t), 1e-12)
        edges = np.searchsorted(commands.t[:-1], t)
        found += [float(speed[a:b].max()) for a, b in zip(edges[:-1], edges[1:]) if b > a and speed[a:b].max() > 0]
    return min(found, default=None)
