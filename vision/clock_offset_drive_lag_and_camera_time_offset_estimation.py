"""Estimation of clock offset, drive lag and time offsets of cameras.

They are estimated from a recording in motion.

A platform that moves at v is off by v times the difference between the clocks. In the lengths that struts must have at
the measured poses, less those commanded, this is a term by itself: the struts' speeds at the exposures. It is solved
for with the geometry, whose figures are nominal before a calibration, with what struts do by their direction (play),
and with the errors that all poses share. A first-order lag of all drives differs from it only where struts speed up.

Cameras that expose at other moments than their stamps say see the platform at different places. A delay that all of
them share moves the measured pose alone; what differs from the first camera remains in the corners' residuals, along
the direction in which each corner moves. The pose of every frame is eliminated. A delay that grows from row to row is
solved for as well, the readout time of a rolling shutter, where nobody stated it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Booleans, Floats, Integers, Json
from rig.effects.framework.first_order_lag_weighted_sum_and_curved_scale_laws import lagged_path
from rig.effects.framework.machine_motion_and_play import Path
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    geometric_parameters,
    is_hexapod,
    is_redundant,
    loop_closure_parameter_jacobian,
    mechanism_with_parameters,
    strut_or_axis_jacobian_by_pose,
)
from rig.recording.recording_folder import Commands, Recording
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    corner_jacobians_to_poses_and_lens_by_camera,
)
from vision.corner_observations_and_merging import Observations
from vision.marker_corner_prediction import State, predict_corners

ABOUT = 0.02  # s; commands that stay the same for so long before and after an exposure are of a platform at rest
FEWEST = 12  # exposures in motion from which clocks are compared
POSES = 20  # exposures in all
SLOWEST = 1e-3  # m/s of the strut that moves most, below which an exposure counts as one at rest
PRIOR = 5e-3  # m; how far a joint or a zero may be from where it is stated
FLOOR = 1e-6  # m of a strut, below which no pose is taken to be known
LONGEST_LAG, LARGEST = 0.5, 5.0  # s, of a lag and of an offset
LAG_AT_FIRST, STEP = 5e-3, 1e-4  # s, from which a lag is searched for; over which derivatives are taken
SURE = 4.0  # standard deviations from which a lag counts as one
GATE = 6.0  # times the typical deviation, beyond which an exposure is left out
ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Clocks:
    """offset : s, exposures logged at t happened at t + offset on the commands' clock; lag : s, time constant by which
    the axes follow their commands, 0 where none shows; offset_sigma, lag_sigma : s, standard deviations, the second
    infinite where only offset and lag together are determined; moving : how many exposures in motion tell it
    speed : m/s, RMS of the strut that moves most at these; frames : (first, last) that it is of
    """

    offset: float
    offset_sigma: float
    lag: float
    lag_sigma: float
    moving: int
    speed: float
    frames: tuple[int, int]

    def tree(self) -> Json:
        """As JSON has it; null for a lag that is not determined by itself."""
        return {
            "frames": list(self.frames),
            "moving": self.moving,
            "speed_m_per_s": self.speed,
            "offset_s": self.offset,
            "offset_sigma_s": self.offset_sigma,
            "lag_s": self.lag,
            "lag_sigma_s": self.lag_sigma if np.isfinite(self.lag_sigma) else None,
        }

    def __str__(self) -> str:
        late = "late" if self.offset < 0 else "early"
        text = (
            f"frames {self.frames[0]} to {self.frames[1]}: by {self.moving} exposures in motion "
            f"({self.speed * 1e3:.1f} mm/s RMS) the cameras' times are {abs(self.offset) * 1e3:.3f} ms {late} on the "
            f"commands' clock, +- {2 * self.offset_sigma * 1e3:.3f} ms (k = 2)"
        )
        if self.lag:
            text += f"; the struts follow their commands {self.lag * 1e3:.2f} ms late, +- {2e3 * self.lag_sigma:.2f} ms"
        return text


def are_commands_changing(commands: Commands, t: Floats) -> Booleans:
    """Whether commands change about times t (n,) s."""
    around = [commands.at(np.maximum(t + shift, commands.t[0])) for shift in (-ABOUT, 0.0, ABOUT)]
    return np.asarray((np.ptp(around, axis=0) > 0).any(axis=1))


def clock_offset_and_drive_lag_by_recording(
    recording: Recording, frames: Integers, T_base_platform: RigidTransform, own: Floats, common: Floats
) -> tuple[Clocks, ...]:
    """Clock offset and drive lag (Clocks) of each recording.

    There is one for each of the recordings that a recording consists of which moves enough; () for a machine that is no
    hexapod, or whose struts press against each other.
    frames : (f,) numbers; own : (f, 6, 6) covariance of each pose, on the right; common : (f, 6, k) what they share
    """
    mechanism, commands = recording.design.mechanism, recording.commands
    if commands is None or not is_hexapod(mechanism) or is_redundant(mechanism) and not mechanism.followers:
        return ()
    known, t = recording.exposures.times()
    t = t[np.searchsorted(known, frames)]
    firsts = [part.frames for part in recording.apart]
    found = []
    for k, first in enumerate(firsts):
        last = firsts[k + 1] if k + 1 < len(firsts) else np.inf
        rows = np.flatnonzero((frames >= first) & (frames < last))
        if len(rows) < POSES or not recording.apart[k].recording.commands:
            continue
        problem = _Problem(mechanism, commands, t[rows], T_base_platform[rows], own[rows], common[rows])
        if problem.moving.sum() >= FEWEST:
            found.append(problem.solve((int(frames[rows[0]]), int(frames[rows[-1]])), len(firsts) == 1))
    return tuple(found)


def recording_with_clock_offset_and_lag_applied(recording: Recording, clocks: Sequence[Clocks]) -> Recording:
    """The Recording with clock offset and drive lag applied.

    Its exposures are on the commands' clock, and its commands are as the axes follow them.
    Exposures that would precede the first command stand at it: before it nothing moved.
    """
    commands, exposures = recording.commands, recording.exposures
    if commands is None or not clocks:
        return recording
    t = exposures.t.copy()
    for one in clocks:
        own = (exposures.frame >= one.frames[0]) & (exposures.frame <= one.frames[1])
        t[own] = np.maximum(t[own] + one.offset, commands.t[0])
    lags = [one.lag for one in clocks if one.lag]
    if lags:
        commands = lagged_commands(commands, lags[0], t)
    return replace(recording, exposures=replace(exposures, t=t), commands=commands)


def lagged_commands(commands: Commands, time_constant: float, t: Floats) -> Commands:
    """Commands as axes follow them with a lag.

    It is by a time constant (s), linear between knots, exact at times t (n,) s.
    """
    path = Path(commands.t, commands.values, np.zeros(1, int), commands.starts).with_knots(t)
    path = lagged_path(path, time_constant, np.ones(commands.values.shape[1], bool))
    return replace(commands, t=path.t, values=path.lengths)


@dataclass(frozen=True, slots=True, eq=False)
class _Fitted:
    """offset, lag : s, with standard deviations; parameters : (p,) of the geometry; left : (n, 6) whitened closures;
    squares : their sum over the exposures that count; scale : by which they exceed the poses' covariance
    """

    offset: float
    offset_sigma: float
    lag: float
    lag_sigma: float
    parameters: Floats
    left: Floats
    squares: float
    scale: float


class _Problem:
    """Closures of a hexapod's struts at the exposures of one recording, as functions of offset and lag."""

    def __init__(
        self, mechanism: Hexapod, commands: Commands, t: Floats, T: RigidTransform, own: Floats, common: Floats
    ) -> None:
        self.mechanism, self.commands, self.t, self.T, self.common = mechanism, commands, t, T, common
        speed = np.abs(self._commanded(ABOUT, 0.0) - self._commanded(-ABOUT, 0.0)).max(axis=1) / (2 * ABOUT)
        self.moving = speed > SLOWEST
        self.speed = float(np.sqrt(np.mean(speed[self.moving] ** 2))) if self.moving.any() else 0.0
        A = strut_or_axis_jacobian_by_pose(T, mechanism)
        strut = A @ own @ np.swapaxes(A, 1, 2) + FLOOR**2 * np.eye(A.shape[1])
        self.whiten = np.linalg.inv(np.linalg.cholesky(strut))
        step = np.sign(self._commanded(0.0, 0.0) - self._commanded(-ABOUT, 0.0))
        self.direction = np.einsum("ni,ij->nij", step, np.eye(A.shape[1]))

    def solve(self, frames: tuple[int, int], with_lag: bool) -> Clocks:
        """Clocks by all exposures but those that deviate far. with_lag : whether a lag is looked for"""
        nominal = geometric_parameters(self.mechanism)
        p, good = nominal, np.ones(len(self.t), bool)
        found = None
        for _ in range(ROUNDS):
            found = self._fitted(p, nominal, 0.0 if found is None else found.offset, good, with_lag)
            p, size = found.parameters, np.sqrt(np.mean(found.left**2, axis=1))
            good = size <= GATE * np.median(size)
        assert found is not None
        if with_lag:
            at_once = self._fitted(p, nominal, found.offset - found.lag, good, False)
            if at_once.squares - found.squares <= (SURE * found.scale) ** 2:
                found = replace(at_once, lag_sigma=found.lag_sigma)
        moving = int((self.moving & good).sum())
        return Clocks(found.offset, found.offset_sigma, found.lag, found.lag_sigma, moving, self.speed, frames)

    def _fitted(self, p: Floats, nominal: Floats, start: float, good: Booleans, with_lag: bool) -> "_Fitted":
        """Fit about parameters p (p,). start : s, offset to start from; good : (n,) exposures that count"""
        mechanism = mechanism_with_parameters(self.mechanism, p)
        inverse = mechanisms.kinematics_of(mechanism).inverse(self.T, mechanism)
        A = strut_or_axis_jacobian_by_pose(self.T, mechanism)
        shared = A @ self.common
        columns = np.concatenate([loop_closure_parameter_jacobian(self.T, mechanism), shared, self.direction], axis=2)
        prior = np.r_[np.full(len(p), 1 / PRIOR), np.ones(shared.shape[2]), np.full(self.direction.shape[2], 1 / PRIOR)]
        weighed = (self.whiten @ columns)[good].reshape(-1, columns.shape[2])
        stated = np.zeros(len(prior))
        stated[: len(p)] = (nominal - p) / PRIOR
        whole = np.vstack([weighed, np.diag(prior)])
        scale = np.linalg.norm(whole, axis=0)
        whole = whole / scale
        factor = cho_factor(whole.T @ whole)  # a decomposition of `whole` itself takes twenty times as long

        def closures(values: Floats) -> Floats:
            off = self._commanded(values[0], values[1] if with_lag else 0.0) - inverse
            return np.einsum("nij,nj->ni", self.whiten, off)

        def projected(values: Floats) -> Floats:
            b = np.r_[closures(values)[good].ravel(), -stated]
            return b - whole @ cho_solve(factor, whole.T @ b)

        def slopes(values: Floats) -> Floats:
            steps, here = STEP * np.eye(len(values)), projected(values)
            return np.stack([(projected(values + step) - here) / STEP for step in steps], axis=1)

        bounds = ([-LARGEST, 0.0], [LARGEST, LONGEST_LAG]) if with_lag else ([-LARGEST], [LARGEST])
        begun = [start, LAG_AT_FIRST] if with_lag else [start]
        fit = least_squares(projected, begun, slopes, bounds=bounds, x_scale=STEP)
        squares = float(fit.fun @ fit.fun)
        excess = float(np.sqrt(squares / max(len(fit.fun) - len(prior) - len(fit.x), 1)))
        sigma = excess * np.sqrt(np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)))
        step = -cho_solve(factor, whole.T @ np.r_[closures(fit.x)[good].ravel(), -stated]) / scale
        left = closures(fit.x) + np.einsum("nij,j->ni", self.whiten @ columns, step)
        lag, lag_sigma = (float(fit.x[1]), float(sigma[1])) if with_lag else (0.0, np.inf)
        return _Fitted(float(fit.x[0]), float(sigma[0]), lag, lag_sigma, p + step[: len(p)], left, squares, excess)

    def _commanded(self, offset: float, lag: float) -> Floats:
        t = np.maximum(self.t + offset, self.commands.t[0])
        return (lagged_commands(self.commands, lag, t) if lag > 0 else self.commands).at(t)


FARTHEST = 5.0  # px of a residual, beyond which a corner says nothing of times
SURE_OFFSET, LEAST = 5.0, 1e-4  # standard deviations, s; a smaller difference, or readout time, counts as none


@dataclass(frozen=True, slots=True, eq=False)
class CameraTimes:
    """offset, offset_sigma : (cameras,) s by which each camera exposed later than its stamps say, relative to the
    first; readout, readout_sigma : (cameras,) s from the exposure of the first image row to that of the last, 0 and
    infinite where it is stated
    """

    offset: Floats
    offset_sigma: Floats
    readout: Floats
    readout_sigma: Floats

    def beyond(self, offset: Floats, readout: Floats) -> "CameraTimes":
        """The times, where those that were estimated are beyond an offset and a readout (cameras,) s."""
        return replace(self, offset=self.offset + offset, readout=self.readout + readout)

    @property
    def certain_offset(self) -> Floats:
        """(cameras,) s, the offsets that are beyond doubt; 0 for the others."""
        return _certain(self.offset, self.offset_sigma)

    @property
    def certain_readout(self) -> Floats:
        """(cameras,) s, the readout times that are beyond doubt; 0 for the others."""
        return _certain(self.readout, self.readout_sigma)


def _certain(value: Floats, sigma: Floats) -> Floats:
    """(cameras,) s, values that are beyond doubt by their standard deviations; 0 for the others."""
    return np.where((np.abs(value) > SURE_OFFSET * sigma) & (np.abs(value) > LEAST), value, 0.0)


def camera_times(
    observations: Observations,
    delayed_observations: Observations,
    delay: float,
    residuals: Floats,
    state: State,
    moving: Booleans,
    is_readout_stated: Booleans,
) -> CameraTimes | None:
    """Time offsets and readout times of cameras (CameraTimes).

    They are fixed cameras; None where too few frames move, or these do not determine them.

    observations : of solved frames, with the motion to each corner's exposure; delayed_observations : the same with all
    exposures later by delay (s); residuals : (n, 2) px; state : State of these frames; moving : (F,) whether they move;
    is_readout_stated : (cameras,) whether the time of each row is stated, and is no unknown
    """
    count = len(state.cameras)
    near = np.isfinite(residuals[:, 0]) & (np.nan_to_num(np.abs(residuals)).max(axis=1) < FARTHEST)
    rows = np.flatnonzero(observations.on_platform & moving[observations.frame] & near)
    if len(np.unique(observations.frame[rows])) < FEWEST:
        return None
    seen, shown = observations.take(rows), predict_corners(observations.take(rows), state)[0]
    speed = (predict_corners(delayed_observations.take(rows), state)[0] - shown) / delay  # px/s
    J = np.empty((len(rows), 2, 6))
    for _, at, J_platform, *_ in corner_jacobians_to_poses_and_lens_by_camera(seen, state):
        J[at] = J_platform
    own_camera = seen.camera[:, None, None] == np.arange(count)
    rows_late = seen.uv[:, 1] / np.array([camera.height for camera in state.cameras])[seen.camera] - 0.5
    late = rows_late[:, None, None] * own_camera[..., ~is_readout_stated]
    G = speed[..., None] * np.concatenate([own_camera[..., 1:], late], axis=2)
    width = G.shape[2]
    normal, right, squares, free = np.zeros((width, width)), np.zeros(width), 0.0, 0
    for frame in np.unique(seen.frame):
        own = seen.frame == frame
        Q, _ = np.linalg.qr(J[own].reshape(-1, 6))
        left = np.column_stack([G[own].reshape(-1, width), residuals[rows[own]].ravel()])
        left -= Q @ (Q.T @ left)
        normal += left[:, :-1].T @ left[:, :-1]
        right += left[:, :-1].T @ left[:, -1]
        squares += float(left[:, -1] @ left[:, -1])
        free += len(left) - 6
    shown_by = np.diag(normal) > 0  # a camera that sees nothing that moves determines nothing of its own
    normal, right, width = normal[np.ix_(shown_by, shown_by)], right[shown_by], np.count_nonzero(shown_by)
    if not 0 < width < free or np.linalg.matrix_rank(normal) < width:
        return None
    found, sigma = np.zeros(len(shown_by)), np.full(len(shown_by), np.inf)
    found[shown_by] = np.linalg.solve(normal, right)
    scale = max(squares - float(found[shown_by] @ right), 0.0) / (free - width)
    sigma[shown_by] = np.sqrt(scale * np.diag(np.linalg.inv(normal)))
    readout, readout_sigma = np.zeros(count), np.full(count, np.inf)
    readout[~is_readout_stated], readout_sigma[~is_readout_stated] = found[count - 1 :], sigma[count - 1 :]
    return CameraTimes(np.r_[0.0, found[: count - 1]], np.r_[0.0, sigma[: count - 1]], readout, readout_sigma)
