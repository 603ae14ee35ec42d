"""Displacement of an outside instrument between recordings, estimated from all its poses and removed.

The geometry and, for each further recording, the six numbers of the instrument's place are fitted to all closures at
once, each strut weighed by its poses' noise and by what it scatters beyond in that recording: what the machine's model
leaves out differs from plan to plan, and must not be taken for a place. Only a place that chance does not explain, and
that does more to the struts than all that it leaves there, is taken out.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from calib.drift.visit_equations import base_motion_columns
from calib.models.platform.identification import (
    PRIOR,
    geometric_parameters,
    loop_closure_jacobian,
    mechanism_with_parameters,
    strut_length_jacobian,
)
from calib.samples.pose_samples import Samples
from calib.samples.recording_samples import sample_recording
from rig.arrays import Floats, Integers
from rig.model import mechanisms
from rig.model.mechanism_kinds import Struts, require_struts
from rig.model.pose import exp
from rig.recording.recording_folder import Recording

ROUNDS = 4  # of linearising anew
ALIKE = 1e-3  # probability with which an instrument that stands still is taken for moved, which costs little
CLEAR = 2.0  # times what it leaves of the struts' closures; a place that does less may be what the model leaves out
SPREAD = 1.4826  # standard deviations in a median of absolute values


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where an instrument stood in a recording (its number, from 0), seen from its place in the first. motion : (6,) m,
    rad, in the base
    p_value : of so much by chance"""

    recording: int
    motion: Floats
    p_value: float

    def line(self, name: str) -> str:
        """In words; name : of the recording."""
        far, turned = np.linalg.norm(self.motion[:3]), np.linalg.norm(self.motion[3:])
        return (
            f"the instrument stands elsewhere, by {far * 1e3:.3g} mm and {turned * 1e3:.3g} mrad, in {name}: its "
            "poses are brought to the first's"
        )


def remove_instrument_displacement(recording: Recording) -> tuple[Recording, list[Place]]:
    """(Recording with the instrument's displacement removed, [Place] where it was displaced), of a platform.

    Raises what sampling raises
    """
    samples, m = sample_recording(recording).samples, require_struts(recording.design.mechanism)
    number = _numbers(recording, samples.frame)
    motions, scatter, start = (
        np.zeros((len(recording.parts), 6)),
        np.zeros((len(recording.parts), len(m.axes))),
        geometric_parameters(m),
    )
    for _ in range(ROUNDS):
        at = replace(samples, T_base_platform=_back(samples.T_base_platform, motions[number]))
        step, covariance, scatter = _solved(at, number, m, start, scatter)
        m = mechanism_with_parameters(m, geometric_parameters(m) + step[: len(start)])
        motions = motions + np.concatenate([np.zeros((1, 6)), step[len(start) :].reshape(-1, 6)])
    places = []
    for k, motion in enumerate(motions[1:]):
        rows = slice(len(start) + 6 * k, len(start) + 6 * k + 6)
        p = float(scipy.special.chdtrc(6, motion @ np.linalg.solve(covariance[rows, rows], motion)))
        if p * (len(motions) - 1) < ALIKE and _clear(samples.take(number == k + 1), motion, m):
            places.append(Place(k + 1, motion, p))
    return _taken(recording, places), places


def _clear(samples: Samples, motion: Floats, m: Struts) -> bool:
    """Whether a place (6,) does CLEAR times as much to the closures of a recording's samples as it leaves, by a
    mechanism as fitted.
    """
    inverse, T = mechanisms.kinematics_of(m).inverse, samples.T_base_platform
    here = inverse(_back(T, np.tile(motion, (len(samples), 1))), m)
    return float(np.linalg.norm(inverse(T, m) - here)) > CLEAR * float(np.linalg.norm(here - samples.commanded))


def _solved(
    samples: Samples, number: Integers, m: Struts, start: Floats, scatter: Floats
) -> tuple[Floats, Floats, Floats]:
    """(step (p + 6 later,), its covariance, (parts, axes) m scatter) of geometry and places, linear about a mechanism
    and places as they are.

    number : (n,) recording of each sample; start : (p,) the stated geometry, to which the prior pulls;
        scatter : (parts, axes) m, so far
    """
    T, p = samples.T_base_platform, len(start)
    later = int(number.max())
    A = strut_length_jacobian(T, m)
    C = A @ samples.covariance @ np.swapaxes(A, 1, 2)
    W = np.linalg.inv(np.linalg.cholesky(C + np.eye(len(m.axes)) * scatter[number][:, None] ** 2))
    moved = np.zeros((*A.shape[:2], later, 6))
    for k in range(later):
        moved[number == k + 1, :, k] = (A @ base_motion_columns(T))[number == k + 1]
    J = np.concatenate([loop_closure_jacobian(T, m), moved.reshape(*A.shape[:2], -1)], axis=2)
    left = mechanisms.kinematics_of(m).inverse(T, m) - samples.commanded
    white, away = (
        (W @ J).reshape(-1, J.shape[2]),
        np.r_[(start - geometric_parameters(m)) / PRIOR**2, np.zeros(6 * later)],
    )
    covariance = np.linalg.inv(white.T @ white + np.diag(np.r_[np.full(p, 1 / PRIOR**2), np.zeros(6 * later)]))
    step = covariance @ (white.T @ (W @ left[..., None]).ravel() + away)
    left, own = np.abs(left - J @ step), np.einsum("nii->ni", C)
    spread = np.stack(
        [(SPREAD * np.median(left[number == k], axis=0)) ** 2 - own[number == k].mean(axis=0) for k in range(later + 1)]
    )
    return step, covariance, np.sqrt(np.maximum(spread, 0.0))


def _back(T: RigidTransform, motions: Floats) -> RigidTransform:
    """Poses (n,) as the instrument would have seen them from its first place; motions : (n, 6) of the base, m and rad,
    along its axes.
    """
    return exp(motions).inv() * T


def _taken(recording: Recording, places: list[Place]) -> Recording:
    poses = recording.poses
    if not places or poses is None:
        return recording
    motions = np.zeros((len(recording.parts), 6))
    for place in places:
        motions[place.recording] = place.motion
    turned = motions[_numbers(recording, poses.frame)]
    return replace(recording, poses=replace(poses, T_base_platform=_back(poses.T_base_platform, turned)))


def _numbers(recording: Recording, frame: Integers) -> Integers:
    """(n,) which of several recordings together, from 0, frames (n,) are of."""
    return np.searchsorted([part.frames for part in recording.parts], frame, side="right") - 1
