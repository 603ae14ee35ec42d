"""Tolerance model of markers and thermometers, and which tolerances are significant.

Each with its prior: what they do to corners and struts.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.sparse import csr_array

from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    Normal,
    chi2_reduction_at_unit_coefficient,
    solve_normal_equations,
    solve_with_prior,
)
from calib.diagnosis.engine.linear_residual_model import Column, Projection
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import time_cosines
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.smooth_function_columns_of_struts_cameras_and_markers import SLOW
from rig.array_and_json_types import Floats, Integers
from rig.effects.catalogue.effect_list import effect_of_tolerance
from rig.effects.framework.parameters_covariates_and_marker_table import Linear
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import PLACES, SIDES, STEEL, THERMOMETER, Place, Tolerance
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import KINDS, NAMES

ALPHA = 1e-3  # chance, over all, that tolerances are taken to be at work where they are not
STEP = 1e-4  # of a side, a metre or a radian, for derivatives
ALL_MARKERS = "markers"
VARIED = [k for k, part in enumerate(KINDS) for _ in NAMES[part]]  # which variance each of NAMES has, of one marker
TOGETHER, WARMED = len(KINDS), len(KINDS) + 1  # the side of all markers; what a thermometer does


@dataclass(frozen=True, slots=True)
class Site:
    """What one tolerance moves at a place. effect : name of the effect that would be it; parameters : ((name, unit,
    numbers), ..)
    tolerance : Tolerance; columns : slice of them"""

    effect: str
    place: str
    parameters: tuple[tuple[str, str, int], ...]
    tolerance: Tolerance
    columns: slice


@dataclass(frozen=True, slots=True, eq=False)
class ToleranceModel:
    """What tolerances do at a linearisation, q numbers. corners : (2n, q) whitened, frames' own poses still in, of
    which a number touches few
    inner : (F, L, q) coordinates in these; closures : (m, q); sigma : (q,) standard deviations of the numbers;
        sites : what they belong to
    kinds : (q,) those of one kind vary equally: VARIED of a marker, TOGETHER, WARMED"""

    corners: csr_array
    inner: Floats
    closures: Floats
    sigma: Floats
    sites: tuple[Site, ...]
    kinds: Floats

    def column(self, model: LinearisedModel) -> Column:
        """Column (q) at the linearisation, written out."""
        c, out = model.corners, self.corners.toarray()
        for f, (a, b) in enumerate(zip(2 * c.edges[:-1], 2 * c.edges[1:])):
            out[a:b] -= c.local[a:b] @ self.inner[f]
        return Column((out, self.closures), self.inner)

    def projected(self, model: LinearisedModel) -> Projection:
        """Projection of the column, which is not written out: residual and nuisances stand square to frames' own poses
        already.
        """
        basis, inner = model.linear.columns.whole, self.inner.reshape(-1, len(self.sigma))
        onto = basis[CORNERS].T @ self.corners + basis[CLOSURES].T @ self.closures
        right = self.corners.T @ model.corner_residual + self.closures.T @ model.closure_residual
        gram = (self.corners.T @ self.corners).toarray() - inner.T @ inner + self.closures.T @ self.closures
        return Projection(onto, right, gram - onto.T @ onto)

    def with_column(self, column: Column) -> Floats:
        """(k, q) inner products of a Column (k) with the tolerances' one, nuisances still in."""
        seen = [part.T @ own for part, own in zip(column.parts, (self.corners, self.closures)) if part is not None]
        return np.sum(seen, axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class SignificantTolerance:
    """What a recording shows of a Site beyond chance: values, sigma (q,) of its numbers; p_value : over all sites."""

    site: Site
    values: Floats
    sigma: Floats
    p_value: float


def tolerance_model(model: LinearisedModel, sensitivities: Sensitivities) -> ToleranceModel | None:
    """ToleranceModel of a LinearisedModel.

    Columns of the tolerances that can be seen; None where none can.
    """
    k, c, n = model.point, model.corners, 2 * len(model.corners.order)
    sites, sigma, table = _markers(model, sensitivities.at(k)) if k.seen is not None else ([], [], csr_array((n, 0)))
    kinds = [TOGETHER, *VARIED * (len(sigma) // len(VARIED))][: len(sigma)]
    L = c.local.shape[1]
    frame = np.repeat(np.arange(model.frames), 2 * np.diff(c.edges))
    own = csr_array(
        (c.local.ravel(), (L * frame[:, None] + np.arange(L)).ravel(), np.arange(0, n * L + 1, L)),
        (n, model.frames * L),
    )
    inner = (own.T @ table).toarray().reshape(model.frames, L, -1)
    closures = model.nothing(table.shape[1])
    if k.axes:
        closures = model.on_closures(np.einsum("fij,fjk->fik", model.closures.to_rows, inner))
    if k.axes and mechanisms.kinematics_of(k.design.mechanism).UNIT == "m" and k.sensors is not None:
        courses, size = _courses(k), THERMOMETER.sigma * STEEL * float(np.median(k.motion(()).lengths))
        more = courses.shape[2]
        closures = np.concatenate([closures, model.on_closures(model.closures.W @ courses)], axis=1)
        inner = np.concatenate([inner, np.zeros((model.frames, L, more))], axis=2)
        table.resize((n, table.shape[1] + more))
        sigma += [size * np.sqrt(2 / SLOW)] * more
        kinds += [WARMED] * more
    return ToleranceModel(table, inner, closures, np.array(sigma), tuple(sites), np.array(kinds)) if sigma else None


def _markers(model: LinearisedModel, sensitivities: Sensitivities) -> tuple[list[Site], list[float], csr_array]:
    """([Site], standard deviations (q,), (2n, q) of corners whitened) of each marker's place, angle and side, and of
    all sides together.
    """
    k, c = model.point, model.corners
    o, ids, at = k.observed, k.observed.markers.id, np.argsort(model.corners.order)
    sites: list[Site] = []
    sigma: list[float] = []
    entries: list[tuple[Floats, Floats, Floats]] = []

    def add(site: Site, sizes: list[float], hit: Integers, pixels: Floats) -> None:
        moved = np.einsum("hij,hjq->hiq", c.whiten[at[hit]], pixels) / c.sigma
        rows, columns = 2 * at[hit][:, None, None] + np.arange(2)[:, None], len(sigma) + np.arange(len(sizes))
        value, row, column = np.broadcast_arrays(moved, rows, columns)
        entries.append((value.ravel(), row.ravel(), column.ravel()))
        sites.append(replace(site, columns=slice(len(sigma), len(sigma) + len(sizes))))
        sigma.extend(sizes)

    everywhere, scaled = sensitivities.touched(*_derivatives(sensitivities, SIDES, ALL_MARKERS))
    add(_site(SIDES, ALL_MARKERS), [SIDES.sigma], everywhere, scaled)
    own = ids[o.sightings.marker][o.row[everywhere]]
    _, prints = np.unique(ids, return_index=True)
    for m in np.sort(prints[np.isin(ids[prints], own)]):
        place, half = str(Place("marker", str(ids[m]))), o.markers.side[m] / 2
        sizes = [PLACES.sigma] * 3 + [PLACES.sigma / half] * 3
        add(_site(PLACES, place), sizes, *sensitivities.touched(*_derivatives(sensitivities, PLACES, place)))
        add(_site(SIDES, place), [SIDES.sigma], everywhere[own == ids[m]], scaled[own == ids[m]])
    values, at_rows, at_columns = (np.concatenate(part) for part in zip(*entries))
    return sites, sigma, csr_array((values, (at_rows, at_columns)), (2 * len(c.order), len(sigma)))


def _site(tolerance: Tolerance, place: str) -> Site:
    """Site of a tolerance at a place, its columns still to be chosen."""
    kind = effect_of_tolerance(tolerance)
    return Site(kind.name, place, tuple((p.name, p.unit, p.size) for p in kind.parameters), tolerance, slice(0))


def _derivatives(sensitivities: Sensitivities, tolerance: Tolerance, place: str) -> tuple[Integers, Floats]:
    """(sighting rows (s,), (s, 4, 2, q) px per unit) of the numbers of what a tolerance may move at a place."""
    kind = effect_of_tolerance(tolerance)
    columns = [Linear(p.name, None if p.size == 1 else j, STEP) for p in kind.parameters for j in range(p.size)]
    found = [sensitivities.derivative(kind, place, column, {}) for column in columns]
    return found[0][0], np.stack([quads for _, quads in found], axis=-1)


def _courses(k: OperatingPoint) -> Floats:
    """(F, axes, axes SLOW) of each strut on its own, longer as slow cosines of time."""
    return np.einsum("fs,ab->fabs", time_cosines(k.t, SLOW), np.eye(k.axes)).reshape(len(k.t), k.axes, -1)


def tolerances_explain_residuals(projection: Projection, sigma: Floats) -> bool:
    """Whether tolerances together, each within its sigma (q,), explain a model's residuals."""
    solved = solve_with_prior(
        Normal(projection.right[None], projection.gram[None], np.diag(projection.gram)[None]), sigma
    )
    return bool(scipy.special.chdtrc(max(solved.rank[0], 1.0), solved.delta_chi2[0]) < ALPHA)


def log_likelihood_ratio_with_tolerances(projection: Projection, sigma: Floats) -> float:
    """Twice the log likelihood ratio of a model's residuals with tolerances to those without.

    sigma : (n,) standard deviation of each column's tolerance, in the column's unit, as m
    Source: MacKay, Information theory, inference and learning algorithms, 2003, ch. 28
    """
    scaled = np.eye(len(sigma)) + sigma[:, None] * projection.gram * sigma
    right = sigma * projection.right
    return float(right @ np.linalg.solve(scaled, right) - np.linalg.slogdet(scaled)[1])


def share_not_explained_by_tolerances(
    model: LinearisedModel, tolerance_effects: ToleranceModel, column: Column, has_unit_coefficient: bool
) -> float:
    """Share of a Column's explained chi-square that tolerances do not explain."""
    alone, tolerances = model.linear.project(column), tolerance_effects.projected(model)
    cross = tolerance_effects.with_column(column) - alone.onto.T @ tolerances.onto
    explained = np.linalg.solve(
        tolerances.gram + np.diag(tolerance_effects.sigma**-2.0), np.column_stack([tolerances.right, cross.T])
    )
    right, gram = alone.right - cross @ explained[:, 0], alone.gram - cross @ explained[:, 1:]
    deltas = [
        (chi2_reduction_at_unit_coefficient if has_unit_coefficient else solve_normal_equations)(
            Normal(b[None], G[None], np.diag(alone.gram)[None])
        ).delta_chi2[0]
        for b, G in ((alone.right, alone.gram), (right, gram))
    ]
    return float(deltas[1] / deltas[0])


def model_with_tolerances(model: LinearisedModel, tolerance_effects: ToleranceModel) -> LinearisedModel:
    """The LinearisedModel with tolerances among the nuisances.

    Each is held by its prior.
    """
    linear, more = model.linear, len(tolerance_effects.sigma)
    closures = linear.blocks[CLOSURES]
    closures = replace(closures, residual=np.r_[closures.residual, np.zeros(more)])
    bases = list(linear.columns.whole)
    bases[CLOSURES] = np.concatenate([bases[CLOSURES], np.zeros((more, bases[CLOSURES].shape[1]))])
    blocks = tuple(closures if i == CLOSURES else block for i, block in enumerate(linear.blocks))
    grown = replace(linear, blocks=blocks, columns=Column(tuple(bases)), size=linear.size + more)
    parts = list(tolerance_effects.column(model).parts)
    parts[CLOSURES] = np.concatenate([tolerance_effects.closures, np.diag(1 / tolerance_effects.sigma)])
    return replace(model, linear=grown.marginalise(Column(tuple(parts))))


def significant_tolerances(model: LinearisedModel, tolerance_effects: ToleranceModel) -> list[SignificantTolerance]:
    """Tolerances that are significant ([SignificantTolerance]).

    They are beyond chance, the surest first.
    What is admitted belongs among the nuisances.
    """
    seen = tolerance_effects.projected(model)
    covariance = np.linalg.inv(seen.gram + np.diag(tolerance_effects.sigma**-2.0))
    values, out = covariance @ seen.right, []
    for site in tolerance_effects.sites:
        own, block = values[site.columns], covariance[site.columns, site.columns]
        p = float(scipy.special.chdtrc(len(own), own @ np.linalg.solve(block, own))) * len(tolerance_effects.sites)
        if p < ALPHA:
            out.append(SignificantTolerance(site, own, np.sqrt(np.diag(block)), p))
    return sorted(out, key=lambda s: s.p_value)


MOST = 2.0  # of what is tolerated, that a kind of it is taken to vary by


ROUNDS, SETTLED = 100, 1e-3  # of the fixed point; the part of what is tolerated by which it may still change


def tolerance_sigmas_from_residuals(projection: Projection, tolerances: ToleranceModel) -> Floats:
    """Tolerance sigmas (q,) estimated from residuals.

    Kind by kind, at the most MOST times the stated ones.
    Source: MacKay, Bayesian interpolation, Neural Computation 4, 1992, sec. 4
    """
    share = np.ones(tolerances.kinds.max() + 1)
    for _ in range(ROUNDS):
        sigma = tolerances.sigma * share[tolerances.kinds]
        on = np.flatnonzero(sigma)
        width = sigma[on]
        inverse = np.linalg.inv(np.eye(len(on)) + width[:, None] * projection.gram[np.ix_(on, on)] * width)
        sizes, known = share[tolerances.kinds[on]] * (inverse @ (width * projection.right[on])), 1 - np.diag(inverse)
        new = share.copy()
        for kind in np.unique(tolerances.kinds[on]):
            own = tolerances.kinds[on] == kind
            if kind != TOGETHER:
                new[kind] = min(np.sqrt((sizes[own] ** 2).sum() / max(known[own].sum(), 1e-9)), MOST)
        new[new < SETTLED] = 0.0
        if np.abs(new - share).max() < SETTLED:
            break
        share = new
    return tolerances.sigma * share[tolerances.kinds]
