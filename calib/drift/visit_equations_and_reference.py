"""Normal equations of a visit, and the reference visit.

Equations in places, geometry and machine changes; the first visit is the reference.

Unknowns, in this order: six for each camera and target (or for the instrument), the geometry as a calibration's
covariance counts it, play of each axis, growth, sag.
Poses and lenses, which every visit has for itself, are eliminated.
"""

from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import RigidTransform

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.models.calibration_covariance_parameters import covariance_parameters, pose_scatter_covariance
from calib.samples.commanded_and_measured_pose_samples import Samples, pose_covariance_pseudoinverse, sample_recording
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.machine_motion_and_play import Motion, play_deviation
from rig.errors import RigError
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.arm_hands_effect_places_and_tolerances import Place, hand_names
from rig.model.design import Camera, Design, Platform
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    axis_place_texts,
    has_struts,
    is_parallel,
    is_redundant,
    require_axes,
)
from rig.model.pose import exp, log, skew
from rig.recording.recording_folder import Commands, Recording, Sensors
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import POSE_SCALE
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns_and_start_estimate
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    normal_equations,
    whitened_residuals_and_derivatives,
)
from vision.corner_observations_and_merging import whitener_of_observations
from vision.marker_corner_prediction import marker_map
from vision.opencv_lens_model import lens_parameter_names
from vision.recording_adjustment_with_hand_and_stages import Measurement


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """cameras : (Camera, ...) as the first visit found them; places : what may move, cameras, targets of base and
    platform, or the instrument; base : names of the targets on the base; targets : a mark of where rig.toml
    states all markers, "none" where an instrument measured."""

    cameras: tuple[Camera, ...]
    places: tuple[Place, ...]
    base: tuple[str, ...]
    targets: str

    @classmethod
    def of(cls, design: Design, measured: Measurement | None) -> "Reference":
        """The Reference of a first visit. measured : its Measurement, None where an instrument measured. Raises
        RigError for a camera that moves.
        """
        if measured is None:
            return cls((), (Place("instrument"),), (), "none")
        cameras = measured.design.cameras
        moving = [camera.name for camera in cameras if camera.mount == "moving"]
        if moving:
            raise RigError(f"camera {moving[0]} has a moving mount; watching requires fixed cameras")
        places = (
            *(Place("camera", camera.name) for camera in cameras),
            *(Place("target", target.name) for target in design.targets),
        )
        return cls(
            cameras, places, tuple(target.name for target in design.targets if target.body == "base"), _mark(design)
        )

    def camera(self, name: str) -> Camera:
        """The camera of a name."""
        return next(camera for camera in self.cameras if camera.name == name)

    def refuse(self, recording: Recording, by_cameras: bool) -> None:
        """Raise RigError for a visit with other cameras or targets, or measured by something else than the first
        one.
        """
        design = recording.design
        if by_cameras != bool(self.cameras):
            raise RigError(
                f"{recording.folder} was measured by {'cameras' if by_cameras else 'an instrument'}, the first visit "
                f"{'was not' if by_cameras else 'by cameras'}; begin a new history"
            )
        mine = [camera.name for camera in self.cameras]
        theirs = [camera.name for camera in design.cameras] if self.cameras else []
        if mine != theirs:
            raise RigError(
                f"{recording.folder} has the cameras {', '.join(theirs) or 'of none'}, the first visit "
                f"{', '.join(mine)}; "
                "begin a new history"
            )
        other = [
            a.name
            for a, b in zip(self.cameras, design.cameras)
            if len(a.distortion) != len(b.distortion) or a.mount != b.mount
        ]
        if other:
            raise RigError(
                f"{recording.folder}: camera {other[0]} has a different kind of lens or mount than at the first "
                "visit; begin a new history"
            )
        if self.cameras and _mark(design) != self.targets:
            raise RigError(
                f"{recording.folder}: its rig.toml states other targets, or other places of them, than the "
                "first visit's; begin a new "
                "history"
            )


def _mark(design: Design) -> str:
    markers = marker_map(design)
    return sha256(np.r_[markers.id, np.round(markers.corners, 7).ravel()].tobytes()).hexdigest()[:16]


GAP = 1e-4  # m or rad, of a worn nut or joint: unit of its columns, and the play at which they are taken
GROWTH = 1e-4  # share by which all members grow: unit of its column; 9 K of steel
SOFT = 1e-5  # kg / (N/m) or kg / (N m/rad), added load over an axis' stiffness: unit of its column; 10 kg on 1e6
AT_ORIGIN = Platform(
    1.0, np.zeros(3), np.zeros(3)
)  # where nobody states the platform's: the added load then sits at its origin


def machine_change_names(mechanism: Commanded) -> tuple[str, ...]:
    """Names of a machine's changes beyond its geometry: play of each axis, growth, sag."""
    axes, struts = axis_place_texts(mechanism), has_struts(mechanism)
    play = tuple(f"nut of {axis}" if struts else f"play of {axis}" for axis in axes)
    return (*play, "growth of all struts" if struts else "growth of all members", "sag under added load")


def machine_change_units(mechanism: Commanded) -> tuple[float, ...]:
    """Units of the changes of a machine.

    They are of the columns of `machine_change_names`: m or rad, a share, kg/(N/m) or kg/(N m/rad).
    """
    return (*(GAP,) * len(mechanism.axes), GROWTH, SOFT)


def require_watchable_calibrated_machine(calibration: Calibration) -> Commanded:
    """Require a calibrated machine that can be watched, and return it.

    It has the geometry that the calibration fitted.
    Raises RigError for a platform on more than six struts and an arm with several hands.
    """
    fitted = require_axes(calibration.correction.fitted)
    if is_redundant(fitted) or hand_names(fitted):
        several = f"{len(fitted.axes)} struts" if is_redundant(fitted) else "several hands"
        raise RigError(f"watching does not support a machine with {several}")
    return fitted


def _expected_poses(calibration: Calibration, samples: Samples) -> RigidTransform:
    """T_base_platform (n,) that the calibration gives for the commands of samples, physics of its axes included."""
    return calibration.correction.predict(samples.effective)


def pose_jacobian_by_machine_changes(
    mechanism: Commanded, design: Design, commands: Commands, t: Floats, T: RigidTransform
) -> Floats:
    """Pose Jacobian (n, 6, axes + 2) by machine changes.

    Columns are in the order of `machine_change_names`.
    Pose tangents (m, rad) per unit of each change, at exposures t (n,) s.
    """
    stated = (
        design.platform
        if design.platform.payload_centre_of_mass is not None and design.platform.mass is not None
        else AT_ORIGIN
    )
    machine_design = Design("", design.gravity, mechanism, None, design.actuator, stated, (), ())
    ends, goals = np.array([commands.t[0], commands.t[-1] + 1.0]), commands.at(t)

    def moved(**channels: Floats) -> Motion:
        bare = motion_simulation.motion_of_commands(machine_design, commands, t, (), Sensors(ends, channels))
        return replace(bare, T=T)

    def sagging(motion: Motion) -> Floats:
        return motion.lengths - motion.loads() / (1 / SOFT) - goals

    motion, axes = moved(), len(mechanism.axes)
    play = play_deviation(motion, GAP / 2)
    growth, sway = motion.kind.axis_deviation_and_sway_by_member_growth(
        T, motion.lengths, mechanism, np.full(play.shape, GROWTH)
    )
    out = [motion.lengths + deviation - goals for deviation in (*(axis * play for axis in np.eye(axes)), growth)]
    out.append(sagging(moved(payload_mass_kg=np.ones(2))) - sagging(motion))
    columns = covariance_parameters(mechanism).axis_jacobian(goals, T) @ np.stack(out, axis=-1)
    columns[..., axes] += sway
    return columns


REPEATS = 1e-6  # m or rad, to which axes or poses repeat at the best, where the calibration found no scatter
LOOSE = 1e-2  # m, rad; of coordinates of the platform that no axis moves: they say how the target sits on it
SEEN = 1e-10  # of the best determined direction's information; a frame that nothing holds has less
FREE = ("poses", "lenses", "targets")


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """information : (p, p) and right : (p,) of the unknowns, scaled; square : what the visit's whitened numbers come
    to; count : how many these are."""

    information: Floats
    right: Floats
    square: float
    count: int

    def __add__(self, other: "Equations") -> "Equations":
        return Equations(
            self.information + other.information,
            self.right + other.right,
            self.square + other.square,
            self.count + other.count,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Normal equations of poses (6 f, first) and places (s), scaled by POSE_SCALE, about what was expected;
    samples : Samples.
    """

    information: Floats
    right: Floats
    samples: Samples


def visit_equations_and_reference(
    recording: Recording, calibration: Calibration, reference: Reference | None
) -> tuple[Equations, Reference]:
    """Equations of a visit, and the Reference that they refer to.

    The visit itself where none is given.
    Raises RigError for another machine than the calibration's or other cameras and targets than the reference's, and
        what measuring raises
    """
    mechanism = require_watchable_calibrated_machine(calibration)
    if recording.design.mechanism.kind != mechanism.kind:
        raise RigError(
            f"{recording.folder} is of a mechanism of kind {recording.design.mechanism.kind!r}, the "
            "calibration of one of kind "
            f"{mechanism.kind!r}"
        )
    sampled = sample_recording(recording, FREE)
    # of a platform of fewer freedoms what cameras measured counts like an instrument's poses
    measured = sampled.measurement if len(mechanism.pose_coordinates) == 6 else None
    reference = reference or Reference.of(recording.design, measured)
    reference.refuse(recording, measured is not None)
    samples = calibration.with_physics(recording, sampled.samples)
    T = _expected_poses(calibration, samples)
    seen = _by_instrument(samples, T) if measured is None else _by_cameras(measured, samples, T, reference)
    return _of_machine(seen, T, recording, calibration), reference


def _by_instrument(samples: Samples, T: RigidTransform) -> _Seen:
    """What an outside instrument's poses say: T (n,) expected; its one place is its frame's motion in the base."""
    n = len(samples)
    measured, own = _measured_poses_and_information(samples, T)
    D = np.zeros((6 * n, 6 * n))
    for f in range(n):
        D[6 * f : 6 * f + 6, 6 * f : 6 * f + 6] = own[f]
    K = samples.common.reshape(6 * n, -1)
    if K.shape[1]:
        D -= D @ K @ np.linalg.solve(np.eye(K.shape[1]) + K.T @ D @ K, K.T @ D)
    J = np.concatenate([np.eye(6 * n), base_motion_columns(measured).reshape(6 * n, 6)], axis=1)
    y = log(T.inv() * measured).ravel()
    return _Seen(J.T @ D @ J * POSE_SCALE**2, J.T @ D @ y * POSE_SCALE, samples)


def _measured_poses_and_information(samples: Samples, T: RigidTransform) -> tuple[RigidTransform, Floats]:
    """(measured poses (n,), what was not measured of them as expected, T (n,); their information (n, 6, 6)). Raises
    RigError for directions and distances.
    """
    known = {"pose": slice(0, 6), "position": slice(0, 3), "orientation": slice(3, 6)}.get(samples.measured)
    if known is None:
        raise RigError(f"watching requires poses, positions or orientations, not a {samples.measured}")
    information = np.zeros(samples.covariance.shape)
    information[:, known, known] = pose_covariance_pseudoinverse(samples.covariance[:, known, known])
    seen = samples.T_base_platform
    return RigidTransform.from_components(
        T.translation if samples.measured == "orientation" else seen.translation,
        T.rotation if samples.measured == "position" else seen.rotation,
    ), information


def base_motion_columns(T: RigidTransform) -> Floats:
    """Columns (n, 6, 6) of base motion.

    Tangents of poses T (n,) per motion of the base (m, rad).
    """
    matrix = T.as_matrix()
    back = np.swapaxes(matrix[:, :3, :3], 1, 2)
    out = np.zeros((len(matrix), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = back
    out[:, :3, 3:] = -back @ skew(matrix[:, :3, 3])
    return out


def _by_cameras(measured: Measurement, samples: Samples, T: RigidTransform, reference: Reference) -> _Seen:
    """What corners say, linearised where they fit best. T : (n,) expected; lenses are each visit's own, as good as
    stated.
    """
    a, used = measured.adjustment, measured.used()
    u, estimate = adjustment_unknowns_and_start_estimate(used, a.state, a.stated, FREE)
    _, derivatives = whitened_residuals_and_derivatives(used, estimate, u, whitener_of_observations(used))
    blocks = normal_equations(used, derivatives, u, np.zeros(u.shared))
    frames, at = 6 * len(samples), {Place("target", name): s for name, s in u.targets.items()}
    at |= {Place("camera", a.state.cameras[i].name): s for i, s in u.poses.items()}
    platform = a.state.platform if samples.sway is None else a.state.platform * exp(-samples.sway)
    away = np.concatenate([log(T.inv() * platform).ravel() / POSE_SCALE, np.zeros(u.shared)])
    N = np.zeros((len(away), len(away)))
    for f in range(len(samples)):
        rows = slice(6 * f, 6 * f + 6)
        N[rows, rows] = blocks.local[f, :6, :6]
        N[rows, frames:] = blocks.cross[f, :6]
        N[frames:, rows] = blocks.cross[f, :6].T
    N[frames:, frames:] = blocks.shared - np.diag(u.prior)
    lenses = np.zeros(u.shared, bool)
    for i, camera in enumerate(a.state.cameras):
        was = reference.camera(camera.name)
        if i in u.poses:
            away[frames:][u.poses[i]] = log(was.pose.inv() * camera.pose) / u.scale[u.poses[i]]
        if i in u.lenses:
            lenses[u.lenses[i]] = True
            now = np.r_[
                camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]] - was.matrix[[0, 1, 0, 1], [0, 1, 2, 2]],
                camera.distortion - was.distortion,
            ]
            away[frames:][u.lenses[i]] = now[: len(lens_parameter_names(camera.distortion))] / u.scale[u.lenses[i]]
    for name, s in u.targets.items():
        away[frames:][s] = log(estimate.target_moves[name]) / u.scale[s]
    b = N @ away + np.concatenate([blocks.own[:, :6].ravel(), blocks.common])
    own = frames + np.flatnonzero(lenses)
    N[own, own] += 1.0
    other_rows = np.setdiff1d(np.arange(len(b)), own)
    N, b = _without(N, b, own)
    scale = np.r_[np.ones(frames), POSE_SCALE / u.scale][other_rows]
    of_places = np.zeros((len(other_rows), frames + 6 * len(reference.places)))
    of_places[:frames, :frames] = np.eye(frames)
    for k, place in enumerate(reference.places):
        if place in at:
            motion_rows = np.searchsorted(other_rows, frames + np.arange(at[place].start, at[place].stop))
            of_places[motion_rows, frames + 6 * k : frames + 6 * k + 6] = np.diag(scale[motion_rows])
    return _Seen(of_places.T @ N @ of_places, of_places.T @ b, samples)


def _of_machine(seen: _Seen, T: RigidTransform, recording: Recording, calibration: Calibration) -> Equations:
    """Equations of a visit in which poses (n,) follow from the machine, all to within what it repeats to."""
    mechanism, samples = require_watchable_calibrated_machine(calibration), seen.samples
    n = 6 * len(samples)
    values, vectors = np.linalg.eigh(seen.information)
    held = values > SEEN * values[-1]
    square = float(((vectors[:, held].T @ seen.right) ** 2 / values[held]).sum())
    if recording.commands is None:
        raise RigError(f"{recording.folder}: there is no commands.csv, so nothing was commanded")
    changed = (
        pose_jacobian_by_machine_changes(mechanism, recording.design, recording.commands, samples.t, T) / POSE_SCALE
    )  # its units are its own
    geometry = covariance_parameters(mechanism).jacobian(samples.effective, T)
    of_machine = np.concatenate([geometry, changed], axis=2).reshape(n, -1)
    places = len(seen.right) - n
    M = np.zeros((len(seen.right), n + places + of_machine.shape[1]))
    M[:, : n + places] = np.eye(n + places)
    M[:n, n + places :] = of_machine
    N, b = M.T @ seen.information @ M, M.T @ seen.right
    scatter = np.sqrt(calibration.scatter**2 + REPEATS**2)
    spread = pose_scatter_covariance(mechanism, scatter, T)
    some = covariance_parameters(mechanism).axis_jacobian(samples.effective, T)
    if is_parallel(mechanism) and some.shape[2] < 6:
        spread = spread + LOOSE**2 * (np.eye(6) - some @ np.linalg.pinv(some))
    tight = np.linalg.inv(spread / POSE_SCALE**2)
    for f in range(len(samples)):
        N[6 * f : 6 * f + 6, 6 * f : 6 * f + 6] += tight[f]
    own = np.arange(n)
    square -= float(b[:n] @ cho_solve(cho_factor(N[:n, :n]), b[:n]))
    return Equations(*_without(N, b, own), square, int(held.sum()))


def _without(N: Floats, b: Floats, gone: Integers) -> tuple[Floats, Floats]:
    """Normal equations N (p, p), b (p,) with the unknowns of an index eliminated."""
    stay = np.setdiff1d(np.arange(len(b)), gone)
    solved = cho_solve(cho_factor(N[np.ix_(gone, gone)]), np.column_stack([N[np.ix_(gone, stay)], b[gone]]))
    left = N[np.ix_(stay, stay)] - N[np.ix_(stay, gone)] @ solved[:, :-1]
    return (left + left.T) / 2, b[stay] - N[np.ix_(stay, gone)] @ solved[:, -1]
