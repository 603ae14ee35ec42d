"""Workspace map in cells with margins, and poses lost by correction.

Cells with margins and error bounds; reach lost or gained by correction.

Source: configuration-space patent, [0029] and claim 5 (the poses that the control function can give, and those that the
    machine really takes)
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.correction_field_methods_fitting_combination_and_json import home_pose
from calib.correction.machine_correction import (
    AnyCorrection,
    indices_and_poses_of_solvable_commands,
    solvable_commands_and_poses,
)
from rig.array_and_json_types import Booleans, Floats, Integers, Json
from rig.errors import NotConverged
from rig.formats.checked_toml_and_json_entries import Entries
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_parallel
from rig.model.pose import pose_difference, pose_to_vector
from rig.planning.configuration_generators import evenly_spread_configurations

SAME = 1e-6  # m and rad, within which a command gives the pose that it was found for


@dataclass(frozen=True, slots=True, eq=False)
class MachineReach:
    """What one machine reaches. commands : (n, axes) m or rad, all over its strokes, those that close on a pose;
    T_base_platform : RigidTransform (n,), the poses; out : (n,) bool, whether the other machine does not reach them
    """

    commands: Floats
    T_base_platform: RigidTransform
    out: Booleans


def correction_that_corrects_nothing(correction: AnyCorrection) -> AnyCorrection:
    """Correction of the nominal machine that corrects nothing."""
    return replace(
        correction, fitted=correction.nominal, remainder=(None,) * len(correction.remainder), extension=None, posed=()
    )


def reachable_poses_with_lost_mask(machine: AnyCorrection, other: AnyCorrection, commands: Floats) -> MachineReach:
    """Reachable poses (MachineReach) of a machine at commands (n, axes), and a mask of those another loses.
    Raises NotConverged where none of them closes on a pose.
    """
    commands, T = solvable_commands_and_poses(commands, machine)
    return MachineReach(commands, T, ~_reached(other.near(T, commands), T, other))


def are_nominal_poses_out_of_corrected_reach(correction: AnyCorrection, configurations: Floats) -> Booleans:
    """Whether the nominal pose at configurations (n, axes) is out of the corrected machine's reach.

    True as well for those that close on no pose
    """
    configurations = np.asarray(configurations, float)
    out = np.ones(len(configurations), bool)
    try:
        index, T = indices_and_poses_of_solvable_commands(
            configurations, correction_that_corrects_nothing(correction).predict
        )
    except NotConverged:
        return out
    out[index] = ~_reached(correction.near(T, configurations[index]), T, correction)
    return out


def _reached(needed: Floats, T: RigidTransform, machine: AnyCorrection) -> Booleans:
    """(n,) bool: whether commands (n, axes) are within the strokes and give the poses (n,), in the assembly in which
    the machine stands.
    """
    known = cast(Booleans, np.isfinite(needed).all(axis=1))
    known[known] = (
        mechanisms.kinematics_of(machine.nominal).signed_limit_excess(needed[known], machine.nominal) == 0
    ).all(axis=1)
    inside, reached = np.flatnonzero(known), np.zeros(len(needed), bool)
    if not len(inside):
        return reached
    try:
        index, given = indices_and_poses_of_solvable_commands(needed[inside], machine.predict)
    except NotConverged:
        return reached
    solvable = inside[index]
    reached[solvable] = np.abs(pose_difference(given, T[solvable])).max(axis=1) < SAME
    return reached


DRAWN, FEWER = 8192, 4096  # configurations of either machine; of an arm, whose commands are sought step by step
ALONG = {2: 16, 3: 10}  # cells along the longest side of a workspace that is flat, and of one that is not
K = 2.0  # standard uncertainties of a bound
FLAT = 1e-9  # m, extent of what is flat
SHORT = (
    "an arm of fewer than six joints gives no pose of the nominal model but by chance: no share of them is "
    "lost or gained, the map shows what the "
    "corrected arm reaches"
)

Covariance = Callable[[RigidTransform, Floats], Floats]  # of poses (n,) at commands (n, axes) -> (n, 6, 6)


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """The workspace by configurations drawn evenly all over the strokes, all axes free of each other, each counting
    alike.

    drawn : of either machine; lost : share of the nominal model's configurations whose poses are out of the corrected
    machine's reach, gained : share of the corrected machine's commands whose poses the nominal model has out of reach;
        None where that means
    nothing (see SHORT)
    origin : (3,) m, a corner of the cells; size : m, their edge; index : (c, 3) of each cell, counted from the corner
    believed, lost_in, reached, gained_in : (c,) of those configurations with poses in a cell, by the nominal model and
        corrected
    room : (c,) m or rad to the nearest limit of an axis, negative beyond it: of the pose in the middle of the cell,
    oriented as home; of a machine without a home the most that a pose drawn there leaves; NaN where no command is known
    singular : (c,) least singular value of the Jacobian over the greatest, the least of the poses there; 0 is singular
    bound : (c, 2) m and rad, expanded uncertainty (k = 2) of a corrected pose, the greatest of the poses there; both
        NaN where no pose is reached
    """

    drawn: int
    lost: float | None
    gained: float | None
    origin: Floats
    size: float
    index: Integers
    believed: Integers
    lost_in: Integers
    reached: Integers
    gained_in: Integers
    room: Floats
    singular: Floats
    bound: Floats

    @property
    def centre(self) -> Floats:
        """(c, 3) m, the middle of each cell."""
        return np.asarray(self.origin + (self.index + 0.5) * self.size)

    @property
    def turns(self) -> bool:
        """Whether the platform turns: a hinge does not."""
        return bool((self.bound[:, 1] > 0).any())

    @property
    def flat(self) -> bool:
        """Whether all cells lie in one layer."""
        return bool((self.index[:, 2] == self.index[0, 2]).all())


def map_workspace(correction: AnyCorrection, covariance: Covariance, count: int | None = None) -> Workspace:
    """Map of a Correction's workspace in cells.

    covariance : of its poses, by poses (n,) and commands (n, axes)
    count : configurations drawn of either machine, DRAWN or FEWER by default
    Raises NotConverged where no configuration closes on a pose
    """
    nominal = correction.nominal
    count = count or (DRAWN if is_parallel(nominal) else FEWER)
    drawn = evenly_spread_configurations(nominal, count, 1.0)
    owner = correction_that_corrects_nothing(correction)
    believed, real = (
        reachable_poses_with_lost_mask(owner, correction, drawn),
        reachable_poses_with_lost_mask(correction, owner, drawn),
    )
    short = not is_parallel(nominal) and len(nominal.axes) < 6
    lost, gained = (np.zeros(len(one.out), bool) if short else one.out for one in (believed, real))
    positions = np.concatenate([believed.T_base_platform.translation, real.T_base_platform.translation])
    origin, size = _corner(positions)
    index, at = np.unique(np.floor((positions - origin) / size).astype(int), axis=0, return_inverse=True)
    first, second = np.split(at.ravel(), [len(lost)])
    cells = len(index)

    def most(values: Floats) -> Floats:
        out = np.full((cells, *values.shape[1:]), -np.inf)
        np.maximum.at(out, second, values)
        return np.where(np.isinf(out), np.nan, out)

    def counted(which: Integers, weights: Booleans | None = None) -> Integers:
        return np.bincount(which, weights, cells).astype(int)

    C = covariance(real.T_base_platform, real.commands)
    bound = K * np.sqrt(
        np.stack([np.trace(C[:, part, part], axis1=1, axis2=2) for part in (slice(0, 3), slice(3, 6))], axis=1)
    )
    middles = origin + (index + 0.5) * size
    room = _at_home(correction, middles) if is_parallel(nominal) else most(_room(correction, real.commands))
    return Workspace(
        count,
        None if short else float(lost.mean()),
        None if short else float(gained.mean()),
        origin,
        size,
        index,
        counted(first),
        counted(first, lost),
        counted(second),
        counted(second, gained),
        room,
        -most(-_singular(correction, real)),
        most(bound),
    )


def _corner(positions: Floats) -> tuple[Floats, float]:
    """(origin (3,), size) m of cells that hold all positions (n, 3); what is flat lies in the middle of its layer."""
    low, extent = positions.min(axis=0), np.ptp(positions, axis=0)
    flat = extent < FLAT
    size = float(max(extent.max(), FLAT)) / ALONG[2 if flat.any() else 3] * (1 + 1e-9)
    return np.where(flat, low - size / 2, low), size


def _room(correction: AnyCorrection, commands: Floats) -> Floats:
    """(n,) m or rad from commands (n, axes) to the nearest limit, negative beyond it; NaN of NaN."""
    low, high = mechanisms.kinematics_of(correction.nominal).travel_ranges(correction.nominal).T
    return np.asarray(np.minimum(commands - low, high - commands).min(axis=1))


def _at_home(correction: AnyCorrection, positions: Floats) -> Floats:
    """(n,) room of poses at positions (n, 3) m that are oriented as home."""
    home = mechanisms.kinematics_of(correction.nominal).home_values(correction.nominal)
    T = RigidTransform.from_components(positions, home_pose(correction.nominal).rotation)
    return _room(correction, correction.near(T, np.broadcast_to(home, (len(positions), len(home)))))


def _singular(correction: AnyCorrection, real: MachineReach) -> Floats:
    """(n,) least over greatest singular value of the corrected machine's Jacobian, turns weighed so that they count
    like moves on the whole.
    """
    fitted, kinematics = correction.fitted, mechanisms.kinematics_of(correction.fitted)
    J = kinematics.jacobian_rows_by_axis(real.T_base_platform, real.commands - correction.rho(real.commands), fitted)
    move, turn = (np.sqrt((J[..., part] ** 2).sum(axis=(1, 2)).mean()) for part in (slice(0, 3), slice(3, 6)))
    if turn:
        J = J * np.repeat([1.0, move / turn], 3)
    values = np.linalg.svd(J, compute_uv=False)
    return np.asarray(values[:, -1] / values[:, 0])


def pose_description_of_axis_margin_map(correction: AnyCorrection) -> str:
    """Description in words of the poses whose margin to the axis limits the workspace map states."""
    if not is_parallel(correction.nominal):
        return "the most that a pose drawn there leaves"
    degrees = np.degrees(pose_to_vector(home_pose(correction.nominal))[3:])
    return "the pose at its centre, oriented as home (" + " ".join(f"{angle:.3g}" for angle in degrees) + " degrees)"


SCHEMA = "workspace/1"
COLUMNS = ("x", "y", "z", "size", "believed", "lost", "reached", "gained", "room", "singular", "bound_m", "bound_rad")
COUNTED = ("believed", "lost_in", "reached", "gained_in")


def workspace_dict(workspace: Workspace) -> Json:
    """dict of a Workspace, as JSON holds it.

    What is not known is null.
    """
    tree = {part.name: getattr(workspace, part.name) for part in fields(workspace)}
    return {"schema": SCHEMA} | {
        name: _plain(value) if isinstance(value, np.ndarray) else value for name, value in tree.items()
    }


def _plain(values: Floats) -> list[object]:
    known = values.astype(object)
    known[values != values] = None
    return list(known.tolist())


def workspace_from_entries(table: Entries) -> Workspace:
    """Workspace from its entries, as `workspace_dict` gives them.

    Raises FileError for anything else.
    """
    table.text("schema", (SCHEMA,))
    index = _whole(table, "index", (None, 3))
    cells = len(index)
    if not cells:
        table.fail(f"{table.name('index')} must list at least one cell", "index")
    lost, gained = (
        None if table.get(name) is None else table.number(name, least=0.0, most=1.0) for name in ("lost", "gained")
    )
    believed, lost_in, reached, gained_in = (_whole(table, name, (cells,)) for name in COUNTED)
    return Workspace(
        table.whole("drawn", 1),
        lost,
        gained,
        table.array("origin", (3,)),
        table.number("size", above=0.0),
        index,
        believed,
        lost_in,
        reached,
        gained_in,
        table.array("room", (cells,), nulls=True),
        table.array("singular", (cells,), nulls=True),
        table.array("bound", (cells, 2), nulls=True),
    )


def _whole(table: Entries, name: str, shape: tuple[int | None, ...]) -> Integers:
    """Numbers of a shape that count, from 0."""
    values = table.array(name, shape)
    if (values < 0).any() or (values != np.floor(values)).any():
        table.fail(f"{table.name(name)} must hold whole numbers from 0", name)
    return values.astype(int)


def workspace_rows(workspace: Workspace) -> Iterator[str]:
    """Rows of a workspace's table, one for each cell.

    Middle and edge in m, counts, the rest as in Workspace.
    """
    for place, counts, room, singular, bound in zip(
        workspace.centre,
        zip(*(getattr(workspace, name) for name in COUNTED)),
        workspace.room,
        workspace.singular,
        workspace.bound,
    ):
        numbers = (
            *(f"{value:.6f}" for value in (*place, workspace.size)),
            *map(str, counts),
            *(_number(value) for value in (room, singular, *bound)),
        )
        yield ",".join(numbers)


def _number(value: float) -> str:
    return f"{value:.6g}" if value == value else ""


def certified_cell_promises(workspace: Workspace, certificate: Entries) -> Floats:
    """Certified promise of each cell (c, 2) m and rad.

    It is that of the smallest box around its middle.
    NaN without one.
    """
    out = np.full((len(workspace.index), 2), np.nan)
    volume = certificate.table("volume")
    for box, promise in [
        (volume, certificate.table("promise")),
        *((cell, cell.table("promise")) for cell in certificate.tables("cells")),
    ]:
        low, high = (box.array(name, (3,)) for name in ("position_low_m", "position_high_m"))
        inside = ((workspace.centre >= low) & (workspace.centre <= high)).all(axis=1)
        out[inside] = promise.number("position_m"), promise.number("rotation_rad", nulls=True)
    return out
