"""Displacements of markers and targets from their stated places.

Their effect on the residuals is stated too.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import special
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Integers
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Marker
from rig.model.pose import log
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import estimate_offset_from_stated
from vision.bundle.adjustment_unknowns_with_priors_and_start_estimate import adjustment_unknowns_and_start_estimate
from vision.bundle.bundle_adjustment import Adjustment, adjust_bundle
from vision.bundle.corner_jacobians_normal_equations_and_schur_complement import (
    normal_equations,
    predicted_cost_decrease,
    solve_shared_and_frame_steps,
    whitened_residuals_and_derivatives,
)
from vision.corner_observations_and_merging import Observations, whitener_of_observations
from vision.marker_corner_prediction import MarkerMap, State, predict_corners
from vision.pose.pose_refinement_and_choice_by_neighbour_frames import (
    MOST,
    neighbour_pose_and_turn_bound,
    neighbour_rotation_scatter,
    rotation_angle_between_poses,
)

HALVED = 0.5  # of the corners' scatter; stated places are doubted where markers that may move leave less than this
PROOF = 0.999  # probability with which an unmoved marker stays unmentioned
WIDE = 1.96  # standard deviations on either side of a 95 % interval


class Measured(Protocol):
    """What is asked here of a vision.recording_adjustment_with_hand_and_stages.Measurement, which stands above."""

    @property
    def frames(self) -> Integers:
        """(f,) numbers of the solved frames."""

    @property
    def T_base_platform(self) -> RigidTransform:
        """(f,) poses of the solved frames."""

    @property
    def observations(self) -> Observations:
        """Of all frames."""

    @property
    def adjustment(self) -> Adjustment:
        """Of the solved frames together."""

    def used(self) -> Observations:
        """Observations that were adjusted."""


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """How far one marker or target sits from its stated place, along its own axes: by : (6,) m, rad; ci95 : (6,) half
    widths;
    moved : whether chance is ruled out."""

    place: Place
    by: Floats
    ci95: Floats
    moved: bool


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """What adjusting places did. moves : one per marker or target; frames : (f,) numbers
    before, after : (f,) px, RMS per axis over the platform's corners of each frame, places as stated and as adjusted,
    all else adjusted both times, the same corners; weighted : (before, after) whitened squares over degrees of freedom,
    of all corners; odd : {frame number: degrees} that turn against the frames around them
    """

    moves: tuple[Move, ...]
    frames: Integers
    before: Floats
    after: Floats
    weighted: tuple[float, float]
    odd: dict[int, float]


def compare_stated_and_adjusted_places(measurement: Measured, t: Floats) -> Places:
    """Comparison (Places) of stated and adjusted marker places, and of the residuals with each.
    measurement : Measurement whose markers were free; t : (F,) s of all frames of the recording
    """
    m, a = measurement, measurement.adjustment
    solved = np.searchsorted(m.observations.frames, m.frames)
    used = m.used()
    rest = tuple(group for group in a.free if group not in ("markers", "targets"))
    stated = replace(
        a.stated,
        platform=a.state.platform,
        moving=a.state.moving,
        markers=a.stated.markers,
        cameras=tuple(replace(s, pose=c.pose) for s, c in zip(a.stated.cameras, a.state.cameras)),
    )
    before = adjust_bundle(used, stated, rest, stated=a.stated)
    weighted = before.cost / before.dof, a.cost / a.dof
    return Places(
        marker_and_target_displacements(a),
        m.frames,
        _by_frame(used, before.state, len(m.frames)),
        _by_frame(used, a.state, len(m.frames)),
        weighted,
        _odd(m, t[solved]),
    )


def are_stated_places_doubtful(measurement: Measured, markers: MarkerMap) -> bool:
    """Whether the stated marker places are doubtful.

    Whether most of the corners' scatter comes from them.
    markers : MarkerMap as stated
    """
    a, used = measurement.adjustment, measurement.used()
    state = replace(a.state, markers=markers)
    u, estimate = adjustment_unknowns_and_start_estimate(
        used, state, replace(a.stated, markers=markers), (*a.free, "markers")
    )
    W = whitener_of_observations(used)
    residual, derivatives = whitened_residuals_and_derivatives(used, estimate, u, W)
    away = estimate_offset_from_stated(estimate, replace(a.stated, markers=markers), u)
    blocks = normal_equations(used, derivatives, u, away)
    left = (residual**2).sum() - predicted_cost_decrease(blocks, *solve_shared_and_frame_steps(blocks, u))
    dof = 2 * len(used) - u.used.sum() - u.basis.shape[1]
    return bool(dof > 0 and left / dof < HALVED**2 * a.cost / a.dof)


def adjusted_markers(measurement: Measured) -> dict[str, tuple[Marker, ...]]:
    """Adjusted markers by target.

    Returns {target name: (Marker, ...)}
    """
    m = measurement.adjustment.state.placed
    out: dict[str, list[Marker]] = {}
    for row, name in enumerate(m.target):
        out.setdefault(name, []).append(
            Marker(int(m.id[row]), float(m.side[row]), m.T_body_marker[row], float(m.margin[row]))
        )
    return {name: tuple(rows) for name, rows in out.items()}


def marker_and_target_displacements(adjustment: Adjustment) -> tuple[Move, ...]:
    """Displacements (Move, ...) of the markers that an Adjustment left free from where they are stated."""
    u, out = adjustment.unknowns, []
    moved = log(adjustment.stated.placed.T_body_marker.inv() * adjustment.state.placed.T_body_marker)
    ids = adjustment.state.placed.id
    for row, columns in u.markers.items():
        if not adjustment.stated.placed.stated[row]:
            continue
        by = moved[row]
        C = adjustment.shared_covariance[columns, columns]
        scale = adjustment.prior[columns]
        values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
        free = values > 1e-12
        square = ((vectors.T @ (by / scale))[free] ** 2 / values[free]).sum()
        out.append(
            Move(
                Place("marker", str(ids[row])),
                by,
                WIDE * np.sqrt(np.diag(C)),
                bool(free.any() and special.chdtrc(free.sum(), square) < 1 - PROOF),
            )
        )
    return tuple(out)


def _by_frame(observations: Observations, state: State, count: int) -> Floats:
    """(count,) px, RMS per axis of the platform's corners in each frame."""
    on = observations.on_platform
    square = ((observations.uv - predict_corners(observations, state)[0]) ** 2).sum(axis=1)
    frame = observations.frame[on]
    return np.sqrt(np.bincount(frame, weights=square[on], minlength=count) / (2 * np.bincount(frame, minlength=count)))


def _odd(m: Measured, t: Floats) -> dict[int, float]:
    """{frame number: degrees} of solved frames whose platform turns against those around it by more than these
    predict.
    """
    found = dict(enumerate(m.T_base_platform.as_matrix()))
    reach = neighbour_rotation_scatter(found, t)
    out: dict[int, float] = {}
    if reach is None:
        return out
    for f, T in found.items():
        expected, limit = neighbour_pose_and_turn_bound(found, f, t, reach)
        if expected is not None and limit < MOST and rotation_angle_between_poses(expected, T) > max(2 * limit, MOST):
            out[int(m.frames[f])] = float(np.degrees(rotation_angle_between_poses(expected, T)))
    return out
