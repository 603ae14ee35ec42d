"""Linearised residuals of corners and loop closures.

With calibration's freedoms projected out.

Corners say what is left when every frame's pose is free; closures say what the poses so found ask of the struts against
the commands. Corners' noise splits into the two without correlation, so together they are the whole likelihood, and a
search over thousands of hypotheses runs on inner products alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.engine.linear_residual_model import (
    Block,
    Column,
    FactoredColumns,
    LinearModel,
    orthonormal_combinations,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corners import (
    CLIP,
    MEDIAN,
    PARTS,
    CornerDerivatives,
    CornerFrames,
    camera_edge_bias_nuisances,
    coordinates_and_rest_in_frame_bases,
    corner_derivatives,
    remounted_cube_pose_nuisances,
)
from calib.models.platform.platform_identification import PRIOR
from calib.models.platform.strut_loop_closure_equations import (
    add_length_resolution_to_loop_covariance,
    loop_covariance,
    scatter_of_redundant_struts,
)
from rig.array_and_json_types import Booleans, Floats
from rig.model.arm_hands_effect_places_and_tolerances import FINDER, SEAT
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    geometric_parameters,
    loop_closure_parameter_jacobian,
    strut_or_axis_jacobian_by_pose,
)
from rig.report.verdict_refutations_and_result_display import FieldSummaryRepr
from vision.bundle.pose_covariance_of_correlated_corner_errors import pose_covariance_by_estimated_corner_errors

CORNERS, CLOSURES = 0, 1  # the blocks
# standard deviations; a residual counts for no more, so that one wild corner proves nothing and a crowd still does
REACHED = 0.98  # share of the corners
EXCESS = 3.0  # standard errors by which struts must scatter beyond the poses' noise before it counts as theirs
ROUNDS = 3  # of weighing the struts anew by their scatter
WILD = 50.0  # standard deviations; a residual counts for no more where the corners' noise is judged


@dataclass(frozen=True, slots=True, eq=False)
class ClosureFrames:
    """W : (F, axes, axes) whitening of closures; to_rows : (F, axes, L) from frames' own coordinates to whitened
    closures
    scatter : (axes,) m of struts beyond the poses' noise"""

    W: Floats
    to_rows: Floats
    scatter: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Nuisances:
    """Cameras, lenses, finder and geometry. names : (p,) of them; camera_columns : {camera's index: its nuisances}
    solve : (p, r) from projections on the basis to nuisances' values; at_rest : (r,) the residual's projections before
        they were taken out"""

    names: tuple[tuple[str, str | int], ...]
    camera_columns: dict[int, list[int]]
    solve: Floats
    at_rest: Floats


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LinearisedModel(FieldSummaryRepr):
    """All that an OperatingPoint leaves, linear about it. linear : LinearModel of the blocks corners (px) and closures
    (m); point : OperatingPoint
    corners : CornerFrames; closures : ClosureFrames; nuisances : Nuisances; derivatives : of the corners, or None"""

    linear: LinearModel
    point: OperatingPoint
    corners: CornerFrames
    closures: ClosureFrames
    nuisances: Nuisances
    derivatives: CornerDerivatives | None

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.point.t)

    @property
    def size(self) -> int:
        """How many independent numbers the residuals hold, the nuisances taken off."""
        return self.linear.size

    @property
    def corner_residual(self) -> Floats:
        """(2n,) whitened, frame by frame."""
        return self.linear.blocks[CORNERS].residual

    @property
    def closure_residual(self) -> Floats:
        """(m,) whitened: F axes, then one row for each prior."""
        return self.linear.blocks[CLOSURES].residual

    def fold(self, pixels: Floats) -> Column:
        """Column of corner displacements (n, 2, k) px in the observations' order: what poses swallow goes to the
        closures.
        """
        return self.folded(*self.split_by_frames(pixels))

    def split_by_frames(self, pixels: Floats) -> tuple[Floats, Floats]:
        """(in each frame's own coordinates (F, L, k), rest (2n, k)) of corner displacements (n, 2, k) px, both whitened
        but for the noise's common factor, so that models with the same derivatives share them.
        """
        c = self.corners
        whitened = c.whiten @ pixels[c.order]
        return coordinates_and_rest_in_frame_bases(whitened.reshape(2 * len(c.order), -1), c.local, c.edges)

    def folded(self, inner: Floats, rest: Floats) -> Column:
        """Column of corner displacements that `split_by_frames` split."""
        inner = inner / self.corners.sigma
        closures = self.on_closures(self.closures.to_rows @ inner) if self.point.axes else self.nothing(inner.shape[-1])
        return Column((rest / self.corners.sigma, closures), inner)

    def lengthened(self, deviation: Floats) -> Column:
        """Column of struts longer by deviation (F, axes, k) m."""
        return Column((None, self.on_closures(self.closures.W @ deviation)))

    def on_closures(self, rows: Floats) -> Floats:
        """(m, k) from rows (F, axes, k), the priors' rows empty."""
        out = self.nothing(rows.shape[-1])
        out[: self.frames * self.point.axes] = rows.reshape(self.frames * self.point.axes, -1)
        return out

    def nothing(self, k: int) -> Floats:
        """(m, k) zeros of the closures' block."""
        return np.zeros((len(self.closure_residual), k))

    def marginalise(self, column: Column) -> "LinearisedModel":
        """The model with the directions of a Column (k) among the nuisances."""
        return replace(self, linear=self.linear.marginalise(column))

    def strut_noise(self) -> Floats:
        """(F, axes) m^2, variance of each strut's closure: the poses' noise and its own scatter."""
        inverse = np.linalg.inv(self.closures.W)
        return np.einsum("fij,fij->fi", inverse, inverse)

    def corner_noise(self) -> float:
        """px, standard deviation of a corner per axis, in the middle of all; 0 without corners."""
        if not len(self.corner_residual):
            return 0.0
        return float(
            self.corners.sigma
            * np.sqrt(np.median(np.einsum("nii->n", self.point.observed.observations.covariance)) / 2)
        )


def linearise(
    point: OperatingPoint,
    clip: float = CLIP,
    nearby_model: LinearisedModel | None = None,
    scattered: Floats | None = None,
    as_uncertain_as: LinearisedModel | None = None,
) -> LinearisedModel:
    """Linearise an OperatingPoint (LinearisedModel).

    It has residuals of corners and loop closures, and their derivatives.
    Cameras, lenses and geometry are its nuisances.

    Each frame's pose is free in the image. clip : standard deviations for which a corner's residual counts at most
    nearby_model : of another OperatingPoint, whose corners' derivatives are taken over where they hold here, or None
    scattered : (axes,) m, by which struts scatter beside other effects, taken where that is likelier; or None
    as_uncertain_as : of the same frames, whose poses' covariance by their corners is taken over; or None
    """
    k = point
    if k.seen is not None:
        pixels, rows = k.pixels(), nearby_model.derivatives if nearby_model is not None else None
        rows = rows if rows is not None and rows.holds_at(k, pixels) else corner_derivatives(k, pixels)
        frames, left = _corner_frames(k, rows, pixels, clip)
        if as_uncertain_as is not None:
            frames = replace(frames, spread=as_uncertain_as.corners.spread)
        names: list[tuple[str, str | int]] = list(rows.names)
        priors, camera_columns = list(rows.priors), rows.camera_columns
    else:
        rows = None
        F = len(k.t)
        frames = CornerFrames(
            np.zeros(0, int),
            np.zeros(F + 1, int),
            np.zeros((0, 2, 2)),
            np.zeros((0, 6)),
            np.tile(np.eye(6), (F, 1, 1)),
            np.zeros((F, 6, 1)),
        )
        left, names, priors, camera_columns = np.zeros(0), [], [], {}
    closures = _closures(k, frames, scattered) if k.axes else _no_closures(k, frames, len(names))
    if k.axes:
        p = len(geometric_parameters(k.platform))
        names += [("geometry", j) for j in range(p)]
        priors += [1 / PRIOR] * p
    beforehand = np.column_stack([np.zeros(len(priors)), np.diag(np.array(priors))])
    for i, j in camera_edge_bias_nuisances(tuple(names), k.design) if k.finder else ():
        beforehand[j, 0] = -k.finder[i] / FINDER.sigma
    at = remounted_cube_pose_nuisances(names)
    for seat in (seat for seat in k.seats if seat.place in at):
        beforehand[at[seat.place], 0] = -seat.numbers() / np.repeat(SEAT, 3)
    if k.axes and k.known is not None:
        mechanism, root = k.known
        beforehand[-len(root) :, 0] = root @ (geometric_parameters(mechanism) - geometric_parameters(k.platform))
        beforehand[-len(root) :, -len(root) :] = root
    return _weighed(k, frames, left, rows, closures, beforehand, tuple(names), camera_columns)


@dataclass(frozen=True, slots=True, eq=False)
class _Closures:
    """Of F frames: covariance (F, axes, axes) m^2 by the poses' noise; rows (F, axes, 1 + p) m, the residual and the
    change with the nuisances; to_length (F, axes, L) from frames' own coordinates to lengths, m
    jacobian : (F, axes, 6) of the axes with the pose
    scattered : (axes,) m, by which struts do beside other effects"""

    covariance: Floats
    rows: Floats
    to_length: Floats
    jacobian: Floats
    scattered: Floats


def _corner_frames(
    k: OperatingPoint, rows: CornerDerivatives, pixels: Floats, clip: float
) -> tuple[CornerFrames, Floats]:
    """(CornerFrames, (2n,) residual with each frame's own poses taken out, in units of the corners' noise) of corners
    predicted at pixels (n, 2) px.
    """
    local, edges = rows.local, rows.edges
    off = (k.observed.observations.uv - pixels)[rows.order]
    rho = np.einsum("nij,nj->ni", rows.whiten, off).reshape(-1, 1)
    _, whole = coordinates_and_rest_in_frame_bases(rho.copy(), local, edges)
    sigma = _noise(whole[:, 0], rows, local.shape[1] * len(k.t))
    far = np.abs(rho / sigma)
    excess = float((2 * clip * np.maximum(far - clip, 0)).sum())
    reach = float(np.quantile(far, REACHED)) if len(far) else 0.0
    projected, left = coordinates_and_rest_in_frame_bases(np.clip(rho / sigma, -clip, clip), local, edges)
    inner = np.concatenate([projected, rows.inner / sigma], axis=2)
    spread = pose_covariance_by_estimated_corner_errors(rows.smooth, rows.without_nuisances(left[:, 0]), local, edges)
    return (
        CornerFrames(
            rows.order, edges, rows.whiten, local, rows.to_local * sigma, inner, sigma, excess, clip, reach, spread
        ),
        left[:, 0],
    )


def _closures(k: OperatingPoint, frames: CornerFrames, scattered: Floats | None) -> _Closures:
    m = k.platform
    A = strut_or_axis_jacobian_by_pose(k.T, m)
    to_length = A @ frames.to_local[:, :6]  # (F, axes, L): local coordinates to struts' lengths
    if k.own is not None:
        covariance = loop_covariance(A, k.own)
    else:
        covariance = add_length_resolution_to_loop_covariance(frames.pose_covariance(to_length))
    inner = frames.inner
    rows = np.concatenate(
        [
            (k.closures()[..., None] + to_length @ inner[..., :1]),
            to_length @ inner[..., 1:],
            loop_closure_parameter_jacobian(k.T, m),
        ],
        axis=2,
    )
    return _Closures(covariance, rows, to_length, A, np.zeros(k.axes) if scattered is None else scattered)


def _no_closures(k: OperatingPoint, frames: CornerFrames, count: int) -> _Closures:
    F = len(k.t)
    return _Closures(
        np.zeros((F, 0, 0)),
        np.zeros((F, 0, 1 + count)),
        np.zeros((F, 0, frames.to_local.shape[1])),
        np.zeros((F, 0, 6)),
        np.zeros(0),
    )


def _noise(left: Floats, rows: CornerDerivatives, lost: int) -> float:
    """What standard deviations must be multiplied by, from the middle of the corners' residuals left (2n,) where
    covariances are corners' own. lost : freedoms that the frames' own poses took
    """
    left, own = rows.without_nuisances(np.clip(left, -WILD, WILD)), rows.own if rows.own.any() else slice(None)
    return float(np.sqrt(np.median(left[own] ** 2) / MEDIAN / (1 - (lost + rows.free.shape[1]) / len(left))))


@dataclass(frozen=True, slots=True, eq=False)
class _Weighed:
    """Struts weighed by what they scatter, scatter (axes,) m, beyond the poses' noise. cost : minus twice the log
    likelihood; W : (F, axes, axes) whitener; rows, half, z, basis : of the closures and what was known beforehand"""

    cost: float
    scatter: Floats
    W: Floats
    rows: Floats
    half: Floats
    z: Floats
    basis: Floats


def _weighed(
    k: OperatingPoint,
    frames: CornerFrames,
    left: Floats,
    derivatives: CornerDerivatives | None,
    closures: _Closures,
    beforehand: Floats,
    names: tuple[tuple[str, str | int], ...],
    camera_columns: dict[int, list[int]],
) -> LinearisedModel:
    """LinearisedModel with the struts weighed by the poses' noise and by what they scatter beyond, the likeliest.

    left : (2n,) corners' residual; derivatives : CornerDerivatives, None without corners; beforehand : (q, 1 + p) rows
        of what was known before
    """
    F, axes = len(k.t), k.axes
    table = np.zeros((0, 0)) if derivatives is None else derivatives.table
    seen = table.shape[1]
    inner = np.zeros((1 + seen, 1 + seen))
    if derivatives is not None:
        inner[0, 0], inner[1:, 1:] = left @ left, derivatives.gram / frames.sigma**2
        parts = zip(np.array_split(table, PARTS), np.array_split(left, PARTS))
        inner[0, 1:] = inner[1:, 0] = sum(part.T @ some for part, some in parts) / frames.sigma

    def weighed(scatter: Floats) -> _Weighed:
        W = (
            np.linalg.inv(np.linalg.cholesky(closures.covariance + np.diag(scatter**2)))
            if axes
            else np.zeros((F, 0, 0))
        )
        rows = np.concatenate([(W @ closures.rows).reshape(F * axes, closures.rows.shape[2]), beforehand])
        gram = rows.T @ rows
        gram[: seen + 1, : seen + 1] += inner
        half = orthonormal_combinations(gram[1:, 1:])
        z = half.T @ gram[1:, 0]
        cost = gram[0, 0] - z @ z - 2 * np.linalg.slogdet(W)[1].sum()
        return _Weighed(float(cost), scatter, W, rows, half, z, rows[:, 1:] @ half)

    def settled(now: _Weighed, known: Booleans) -> _Weighed:
        for _ in range(ROUNDS - 1):
            left = (now.rows[: F * axes, 0] - now.basis[: F * axes] @ now.z).reshape(F, axes, 1)
            beyond = np.asarray(np.linalg.solve(now.W, left)[..., 0], float)
            new = (
                scatter_of_redundant_struts(beyond, closures.jacobian, 7)
                if axes > 6
                else _scatter(beyond, closures.covariance, known)
            )
            if np.abs(new - now.scatter).max(initial=0.0) < 1e-8:
                break
            now = weighed(new)
        return now

    none = weighed(np.zeros(axes))
    tried = [none, settled(none, np.zeros(axes, bool))] if axes else [none]
    if closures.scattered.any():
        before = weighed(closures.scattered)
        tried += [before, settled(before, closures.scattered > 0)]
    # struts are correlated: what one scatters beyond its share by chance is no scatter of its own
    best = min(tried, key=lambda one: one.cost)
    scatter, W, rows, half, z, basis = best.scatter, best.W, best.rows, best.half, best.z, best.basis
    onto = half[:seen] / frames.sigma
    Q = Column((FactoredColumns(table, onto), basis))
    blocks = (
        Block("corners", "px", left - table @ (onto @ z), 2 * frames.edges),
        Block("closures", k.axis_unit, rows[:, 0] - basis @ z, np.arange(F + 1) * axes),
    )
    size = len(table) - (frames.local.shape[1] * F if len(table) else 0) + F * axes - basis.shape[1]
    to_rows = W @ closures.to_length if axes else closures.to_length
    return LinearisedModel(
        LinearModel(blocks, Q, None, size),
        k,
        frames,
        ClosureFrames(W, to_rows, scatter),
        Nuisances(names, camera_columns, half, z),
        derivatives,
    )


def _scatter(left: Floats, S: Floats, known: Booleans) -> Floats:
    """(axes,) m: what each strut scatters beyond the poses' own noise, 0 where that suffices; by the middle, not the
    extremes. known : (axes,) whether one is known to scatter, and no excess is asked of it
    """
    own = np.einsum("nii->ni", S)
    seen = (left**2).mean(axis=0)
    own = own.mean(axis=0) * max(1 - 7 / len(left), 0.1)
    beyond = known | (seen > own * (1 + EXCESS * np.sqrt(2 / len(left))))
    return np.where(beyond, np.sqrt(np.maximum(seen - own, 0)), 0.0)
