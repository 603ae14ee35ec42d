"""Mistakes that explain why a platform's commands disagree with its measured poses.

Wrong struts, joints, clocks, frames, conventions.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake
from rig.checks.unit_and_convention_mistakes import poses_in_other_conventions
from rig.errors import RigError
from rig.formats import csv_and_parquet_tables_and_time_origin
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod as kinematics
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod_or_redundant_hexapod
from rig.recording.corner_and_pose_csv_tables import POSE_COLUMNS
from rig.recording.recording_folder import Commands, Recording

LEAST = 6  # frames from which commands are held against poses
AWAY = 6e-3  # m, RMS of what commands and poses disagree by, beyond which it is no calibration's matter
SHARE = 0.06  # of the struts' own motion that a scatter may have, likewise
SMALL = 1e-3  # m, RMS of a disagreement that is always a calibration's matter
LIKELY = 0.85  # proof of a mistake that explains all: figures that are impossible by themselves go first
BETTER = 0.35  # of the disagreement that a mistake named may leave
SURE = 0.15  # m; beyond, lengths are not in metres or not of this machine
SCALES, SCALED = (
    (0.75, 1.33),
    0.03,
)  # of joints' distances from the axis that are tried; beyond the second it is a mistake
ALIKE = 1.3  # times the least disagreement, within which two mistakes explain as much
SHIFTED, CLOCK = "the frames are shifted by", "the frames' clock"
SHIFTS = (-3, -2, -1, 1, 2, 3)
LAG = 0.5  # s; clocks that differ by less are an effect, not a mistake
STEPS = 1500  # clock offsets tried
ALIKE_CLOCKS = 1.02  # of the least miss; offsets that leave less cannot be told from the best
QUARTER = 1800.0  # s; time zones


@dataclass(frozen=True, slots=True, eq=False)
class CommandsAndPoses:
    """What was commanded and what was measured, of one platform.

    mechanism : Hexapod as stated; frame : (n,) numbers; index : (n,) of these among all frames; times : (F,) s of all
        frames
    q : (n, struts) m commanded at the frames; T : RigidTransform (n,) measured
    commands : Commands, for other times; vector : (n, 6) m and rad as poses.csv has them, or None where vision measured
    """

    mechanism: Hexapod
    frame: Integers
    index: Integers
    times: Floats
    q: Floats
    T: RigidTransform
    commands: Commands
    vector: Floats | None = None

    def at(self, t: Floats) -> Floats:
        """(n, struts) m commanded at other times t (n,) s."""
        return np.stack([np.interp(t, self.commands.t, column) for column in self.commands.values.T], axis=1)

    def at_all(self) -> Floats:
        """(F, struts) m commanded at all frames."""
        return self.at(self.times)

    def left(self) -> Floats:
        """(n, struts) m that commanded lengths differ from those of the measured poses."""
        return self.q - kinematics.inverse(self.T, self.mechanism)

    def miss(self) -> float:
        """m, RMS of what is left."""
        return float(np.sqrt((self.left() ** 2).mean()))


def commands_and_measured_poses(
    recording: Recording, frames: Integers, T: RigidTransform, pose_vectors: Floats | None = None
) -> CommandsAndPoses:
    """Commands of a recording and its measured poses, T (n,), in some of its frames.

    Raises RigError without commands, and for what is not a hexapod.
    """
    known, times = recording.exposures.times()
    c, t = recording.commands, times[np.searchsorted(known, frames)]
    if c is None:
        raise RigError(f"{recording.folder}: there is no commands.csv, so nothing was commanded")
    q = np.stack([np.interp(t, c.t, column) for column in c.values.T], axis=1)
    return CommandsAndPoses(
        require_hexapod_or_redundant_hexapod(recording.design.mechanism),
        frames,
        np.searchsorted(known, frames),
        times,
        q,
        T,
        c,
        pose_vectors,
    )


def pose_columns_of_poses_csv_as_written(recording: Recording) -> Floats:
    """Pose columns (n, 6) m and rad of poses.csv as written.

    Rotation vectors longer than pi included.
    """
    return csv_and_parquet_tables_and_time_origin.read_csv_table(recording.folder / "poses.csv", POSE_COLUMNS).matrix(
        POSE_COLUMNS
    )


def commands_disagree_with_poses(commands_and_poses: CommandsAndPoses) -> bool:
    """Whether commands disagree with poses by more than a calibration can correct."""
    if len(commands_and_poses.frame) < LEAST:
        return False
    L = kinematics.inverse(commands_and_poses.T, commands_and_poses.mechanism)
    moved = float(np.sqrt(((L - L.mean(axis=0)) ** 2).mean()))
    left = commands_and_poses.left()
    scatter = float(np.sqrt(((left - np.median(left, axis=0)) ** 2).mean()))
    return commands_and_poses.miss() > AWAY or (scatter > max(SMALL, SHARE * moved))


def command_pose_mistakes(commands_and_poses: CommandsAndPoses) -> Iterator[Mistake]:
    """Mistakes that best explain why commands disagree with poses.

    Where none explains it, the size of the disagreement.
    """
    if not commands_disagree_with_poses(commands_and_poses):
        return
    before = commands_and_poses.miss()
    tried = [(other.miss(), what, do) for what, do, other in _candidates(commands_and_poses)]
    left, what, do = min(tried, key=lambda one: one[0], default=(np.inf, "", ""))
    shifts = [one for one in tried if SHIFTED in one[1] and one[0] < ALIKE * left]
    if shifts and CLOCK in what:  # an offset of clocks, being fitted, is as good wherever frames are evenly spaced
        left, what, do = min(shifts, key=lambda one: one[0])
    message = f"commands and measured poses differ by {before * 1e3:.3g} mm"
    if left < BETTER * before and left < max(AWAY, 0.3 * before):
        yield Mistake(
            f"{what}: {message} RMS as recorded, by {left * 1e3:.3g} mm so", do, True, LIKELY * (1 - left / before)
        )
    else:
        yield Mistake(
            f"{message} RMS along the struts, and no common mistake explains it",
            "Check the joints, the struts' order and the zeros in rig.toml, and whether poses and commands match",
            before > SURE,
            0.3,
        )


Candidate = tuple[str, str, CommandsAndPoses]


def _candidates(moves: CommandsAndPoses) -> Iterator[Candidate]:
    yield from _struts(moves)
    yield from _joints(moves)
    yield from _clocks(moves)
    yield from _frames(moves)
    yield from _poses(moves)


def _struts(moves: CommandsAndPoses) -> Iterator[Candidate]:
    """Columns of commands.csv matched to struts by how they move together, then by an offset and a factor."""
    L = kinematics.inverse(moves.T, moves.mechanism)
    a, b = L - L.mean(axis=0), moves.q - moves.q.mean(axis=0)
    size = np.sqrt((a**2).sum(axis=0))[:, None] * np.sqrt((b**2).sum(axis=0)) + 1e-30
    C = a.T @ b / size  # (struts, columns)
    order = scipy.optimize.linear_sum_assignment(-np.abs(C))[1]
    signs = np.sign(C[np.arange(len(order)), order])
    listed = ", ".join(f"strut {i + 1} is column l{k + 1}" for i, k in enumerate(order) if i != k)
    if listed:
        yield (
            "commands.csv: the struts are in another order: " + listed,
            "Put the columns, or the joints of rig.toml, in one order",
            replace(moves, q=moves.q[:, order]),
        )
    if (signs < 0).any() and not listed:
        turned = [i + 1 for i in range(len(order)) if signs[i] < 0]
        q = moves.q.copy()
        middle = kinematics.inverse(moves.mechanism.home, moves.mechanism)
        for i in turned:
            q[:, i - 1] = 2 * middle[i - 1] - q[:, i - 1]
        which = (
            "all struts run"
            if len(turned) == len(order)
            else f"strut {turned[0]} runs"
            if len(turned) == 1
            else f"struts {', '.join(map(str, turned))} run"
        )
        yield (
            f"commands.csv: {which} with the sign reversed about home",
            "Reverse the sign of their travel",
            replace(moves, q=q),
        )
    home = kinematics.inverse(moves.mechanism.home, moves.mechanism)
    for what, do, q in (
        ("commands.csv: lengths are relative to home", "Add each strut's length at home", moves.q + home),
        ("commands.csv: lengths are in millimetres", "Divide them by 1000", moves.q / 1e3),
    ):
        yield what, do, replace(moves, q=q)
    offset = np.median(L - moves.q, axis=0)
    if np.ptp(offset) < 0.3 * abs(offset.mean()):
        yield (
            f"commands.csv: all lengths are {abs(offset.mean()) * 1e3:.3g} mm too "
            f"{'short' if offset.mean() > 0 else 'long'}: they are not joint "
            "centre to joint centre",
            "Add what lies between the controller's zero and the joints' centres",
            replace(moves, q=moves.q + offset),
        )
    else:
        worst = int(np.argmax(np.abs(offset)))
        q = moves.q.copy()
        q[:, worst] += offset[worst]
        yield (
            f"commands.csv: strut {worst + 1} is {abs(offset[worst]) * 1e3:.3g} mm "
            f"{'longer' if offset[worst] > 0 else 'shorter'} than commanded "
            "throughout: its zero is wrong",
            "Home it once more, or correct its zero",
            replace(moves, q=q),
        )
    slope = float((a * b).sum() / max((b * b).sum(), 1e-30))
    if slope > 0 and abs(slope - 1) > 0.02:
        yield (
            f"commands.csv: the struts' travel is {slope:.4g} times what is commanded (screw lead, gear or "
            "steps per metre)",
            "Correct the lead or the steps per metre",
            replace(moves, q=L.mean(axis=0) + slope * b),
        )


def _joints(moves: CommandsAndPoses) -> Iterator[Candidate]:
    """rig.toml's joints exchanged, numbered otherwise, turned or mirrored, one side at a time."""
    m = moves.mechanism
    base, platform = m.base_joints, m.platform_joints

    def other(what: str, do: str, b: Floats, p: Floats) -> Candidate:
        return f"rig.toml: {what}", do, replace(moves, mechanism=replace(m, base_joints=b, platform_joints=p))

    yield other("base_joints and platform_joints are exchanged", "Exchange them", platform, base)
    count = len(base)
    numbers = np.arange(count)
    for name, put in (("base_joints", lambda J: (J, platform)), ("platform_joints", lambda J: (base, J))):
        joints = base if name[0] == "b" else platform
        do = f"Number the {name.split('_')[0]}'s joints as the struts"
        for by in range(1, count):
            yield other(f"{name} are numbered from another joint, by {by} on", do, *put(joints[(numbers + by) % count]))
        for by in range(count):
            yield other(f"{name} are numbered the other way round", do, *put(joints[(by - numbers) % count]))
        for i, k in combinations(range(count), 2):
            order = numbers.copy()
            order[[i, k]] = k, i
            yield other(f"{name} {i + 1} and {k + 1} are exchanged", do, *put(joints[order]))
        for axis, what in enumerate("xyz"):
            turned = joints.copy()
            turned[:, axis] *= -1
            yield other(f"{name} have the sign of {what} reversed", f"Reverse the sign of {what}", *put(turned))
        for i, k in ((0, 1), (0, 2), (1, 2)):
            columns = [0, 1, 2]
            columns[i], columns[k] = k, i
            yield other(f"{name} have {'xyz'[i]} and {'xyz'[k]} exchanged", "Exchange them", *put(joints[:, columns]))
        for angle in (60, 120, 180, 240, 300, 90, 270):
            turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
            yield other(
                f"{name} are turned by {angle} degrees about z",
                "Turn them back, or the targets of that body",
                *put(joints @ turn.T),
            )
        for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254)):
            yield other(f"{name} are in {unit}", f"Multiply them by {factor:g}", *put(joints * factor))
        for factor, what in ((0.5, "diameters instead of radii"), (2.0, "half of what they should be")):
            yield other(f"{name} are {what}", f"Multiply them by {factor:g}", *put(joints * [factor, factor, 1]))
        yield from _scaled(moves, name)
    both = np.stack([base, platform])
    for what, J in (("mirrored in x", both * [-1, 1, 1]), ("mirrored in y", both * [1, -1, 1])):
        yield other(f"base_joints and platform_joints are {what}", "Mirror them back", J[0], J[1])


def _scaled(moves: CommandsAndPoses, name: str) -> Iterator[Candidate]:
    """The joints of one side nearer to its axis or farther, by the share that agrees best."""

    def wider(share: float) -> CommandsAndPoses:
        return replace(
            moves, mechanism=replace(moves.mechanism, **{name: getattr(moves.mechanism, name) * [share, share, 1]})
        )

    best = scipy.optimize.minimize_scalar(lambda share: wider(share).miss(), bounds=SCALES, method="bounded").x
    if abs(best - 1) > SCALED:
        yield (
            f"rig.toml: {name} are {abs(1 / best - 1):.0%} too {'large' if best < 1 else 'small'}",
            f"Remeasure them: times {best:.3f} they agree",
            wider(best),
        )


def _clocks(moves: CommandsAndPoses) -> Iterator[Candidate]:
    """Other times of the same commands: other clocks, other units."""
    c = moves.commands
    span = float(c.t[-1] - c.t[0])

    def miss(by: float) -> float:
        return replace(moves, q=moves.at(t + by)).miss()

    t, coarse = moves.times[moves.index], np.linspace(-span / 2, span / 2, STEPS)
    left = np.array([miss(by) for by in coarse])
    k, apart = int(left.argmin()), np.flatnonzero(left > ALIKE_CLOCKS * left.min())  # within a dwell all are alike
    first, last = apart[apart < k].max(initial=0), apart[apart > k].min(initial=len(coarse) - 1)
    fine = np.linspace(coarse[max(first - 1, 0)], coarse[min(last + 1, len(coarse) - 1)], 401)
    left = np.array([miss(by) for by in fine])
    alike = fine[left <= ALIKE_CLOCKS * left.min()]
    best = float(alike[0] + alike[-1]) / 2
    room = max(float(alike[-1] - alike[0]), float(fine[1] - fine[0])) / 2
    if abs(best) > LAG:
        quarters = abs(best) / QUARTER
        zone = (
            f" ({round(quarters) / 2:g} hours: time zones?)"
            if abs(quarters - round(quarters)) * QUARTER < 5 and abs(best) > 1000
            else ""
        )
        yield (
            f"frames.csv: {CLOCK} is {abs(best):.4g} s {'behind' if best > 0 else 'ahead of'} the commands' "
            f"(+-{room:.2g} s){zone}",
            f"{'Add' if best > 0 else 'Subtract'} {abs(best):.4g} s to t of frames.csv, or log both by one clock",
            replace(moves, q=moves.at(t + best)),
        )


def _frames(moves: CommandsAndPoses) -> Iterator[Candidate]:
    """The same frames in another order: shifted by some, run backwards, two exchanged, sorted by name, shuffled."""
    last, do = (
        len(moves.times) - 1,
        "Look at how images or poses were numbered: one missing or one too many at the start shifts all",
    )
    for by in SHIFTS:
        yield (
            f"frames.csv: {SHIFTED} {abs(by)}: frame k shows what was commanded for frame k "
            f"{'+' if by > 0 else '-'} {abs(by)}",
            do,
            _only(
                replace(moves, q=moves.at(moves.times[np.clip(moves.index + by, 0, last)])),
                (moves.index + by >= 0) & (moves.index + by <= last),
            ),
        )
    orders = {
        "in the order of their names as text (1, 10, 2)": np.array(sorted(range(last + 1), key=str)),
        "in reverse": np.arange(last + 1)[::-1],
    }
    for what, order in orders.items():
        yield (
            f"frames.csv: the frames are listed {what}",
            "List them in the order in which they were exposed",
            replace(moves, q=moves.at(moves.times[order[moves.index]])),
        )
    yield from _shuffled(moves)


def _only(moves: CommandsAndPoses, selected: Booleans) -> CommandsAndPoses:
    return replace(
        moves, frame=moves.frame[selected], index=moves.index[selected], q=moves.q[selected], T=moves.T[selected]
    )


def _shuffled(moves: CommandsAndPoses) -> Iterator[Candidate]:
    """Frames that show what others were commanded, each matched to the one it shows."""
    L, q = kinematics.inverse(moves.T, moves.mechanism), moves.at_all()
    cost = np.sqrt(((L[:, None] - q[None]) ** 2).mean(axis=2))
    match, n = scipy.optimize.linear_sum_assignment(cost)[1], len(L)
    wrong = np.flatnonzero(cost[np.arange(n), moves.index] > 2 * cost[np.arange(n), match] + SMALL)
    if len(wrong) >= 2:
        some = (
            f"frames {', '.join(map(str, moves.frame[wrong[:6]].tolist()))}{' ..' if len(wrong) > 6 else ''} "
            "show what others were commanded"
        )
        order = np.where(np.isin(np.arange(n), wrong), match, moves.index)
        yield (
            f"frames.csv: {len(wrong)} of {n} frames are in another order (shuffled or exchanged): {some}",
            "Reassign images or poses to their frames",
            replace(moves, q=q[order]),
        )


def _poses(moves: CommandsAndPoses) -> Iterator[Candidate]:
    """poses.csv written another way. Of poses that vision measured nothing is asked."""
    if moves.vector is None:
        return
    for what, T in poses_in_other_conventions(moves.vector):
        yield f"poses.csv: {what}", "Write platform in base: m, and rotation vectors in rad", replace(moves, T=T)
