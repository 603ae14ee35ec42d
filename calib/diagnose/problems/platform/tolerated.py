"""What tolerances do to corners and struts, each with its prior: held beside findings, so that what they may do on their own is no finding."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from calib.diagnose.engine.linear import Column, joined
from calib.diagnose.engine.products import Normal, solve_with_prior
from calib.diagnose.problems.platform.linearised import CLOSURES, LinearisedModel
from calib.diagnose.problems.platform.operating_point import OperatingPoint
from calib.diagnose.problems.platform.sensitivities import Sensitivities
from calib.diagnose.problems.platform.smooth import SLOW, cosines
from calib.diagnose.tolerances import PLACES, SIDES, STEEL, THERMOMETER, Tolerance
from rig import mechanisms
from rig.effects.base import Linear
from rig.effects.face_misplacement import FaceMisplacement
from rig.effects.print_scale import PrintScale

ALPHA = 1e-3  # chance, over all, that tolerances are taken to be at work where they are not
STEP = 1e-4  # of a side, a metre or a radian, for derivatives
ALL_MARKERS = "markers"


@dataclass(frozen=True, slots=True)
class Site:
    """What one tolerance moves at a place. effect : name of the effect that would be it; parameters : ((name, unit, numbers), ..)
    tolerance : Tolerance; columns : slice of them"""

    effect: str
    place: str
    parameters: tuple[tuple[str, str, int], ...]
    tolerance: Tolerance
    columns: slice


@dataclass(frozen=True, slots=True, eq=False)
class Tolerated:
    """column : Column (q) of what tolerances do at a linearisation; sigma : (q,) standard deviations of its sizes; sites : what they belong to."""

    column: Column
    sigma: np.ndarray
    sites: tuple[Site, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Slight:
    """What a recording shows of a Site beyond chance: values, sigma (q,) of its numbers; p_value : over all sites."""

    site: Site
    values: np.ndarray
    sigma: np.ndarray
    p_value: float


def tolerated(model: LinearisedModel, sensitivities: Sensitivities) -> Tolerated | None:
    """Tolerated of a LinearisedModel; None where nothing of the kind could be seen."""
    k, parts = model.point, []
    sigma: list[float] = []
    sites: list[Site] = []
    kept = sensitivities.at(k)
    if k.seen is not None:
        for site, pixels, sizes in _markers(k, kept):
            parts.append(model.fold(pixels))
            sites.append(replace(site, columns=slice(len(sigma), len(sigma) + len(sizes))))
            sigma += sizes
    if k.axes and mechanisms.of(k.design.mechanism).UNIT == "m" and k.sensors is not None:
        courses, size = _courses(k), THERMOMETER.sigma * STEEL * float(np.median(k.motion(()).lengths))
        parts.append(model.lengthened(courses))
        sigma += [size * np.sqrt(2 / SLOW)] * courses.shape[2]
    return Tolerated(joined(parts), np.array(sigma), tuple(sites)) if parts else None


def _markers(k: OperatingPoint, kept: Sensitivities) -> list[tuple[Site, np.ndarray, list[float]]]:
    """[(Site, (n, 2, q) px, standard deviations (q,))] of each marker's place, angle and side, and of all sides together."""
    ids = k.observed.markers.id
    rows, quads = kept.derivative(PrintScale, ALL_MARKERS, Linear("scale", None, STEP), {})
    scaled, own = kept.corners(rows, quads[..., None]), ids[k.observed.sightings.marker][k.observed.row]
    out = [(Site(PrintScale.name, ALL_MARKERS, (("scale", "", 1),), SIDES, slice(0)), scaled, [SIDES.sigma])]
    for m in np.unique(k.observed.sightings.marker):
        place, half = f"marker {ids[m]}", k.observed.markers.side[m] / 2
        columns = [kept.derivative(FaceMisplacement, place, Linear(name, j, STEP), {}) for name in ("offset", "rotation") for j in range(3)]
        pixels = kept.corners(columns[0][0], np.stack([quads for _, quads in columns], axis=-1))
        site = Site(FaceMisplacement.name, place, (("offset", "m", 3), ("rotation", "rad", 3)), PLACES, slice(0))
        out.append((site, pixels, [PLACES.sigma] * 3 + [PLACES.sigma / half] * 3))
        side = np.where((own == ids[m])[:, None, None], scaled, 0.0)
        out.append((Site(PrintScale.name, place, (("scale", "", 1),), SIDES, slice(0)), side, [SIDES.sigma]))
    return out


def _courses(k: OperatingPoint) -> np.ndarray:
    """(F, axes, axes SLOW) of each strut on its own, longer as slow cosines of time."""
    return np.einsum("fs,ab->fabs", cosines(k.t, SLOW), np.eye(k.axes)).reshape(len(k.t), k.axes, -1)


def at_work(model: LinearisedModel, found: Tolerated) -> bool:
    """Whether tolerances, all together and each within its own, explain more than chance does."""
    seen = model.linear.project(found.column)
    solved = solve_with_prior(Normal(seen.right[None], seen.gram[None], np.diag(seen.gram)[None]), found.sigma)
    return bool(chi2.sf(solved.delta_chi2[0], max(solved.rank[0], 1.0)) < ALPHA)


def beside(model: LinearisedModel, found: Tolerated) -> LinearisedModel:
    """The LinearisedModel with what tolerances do among the nuisances, each known beforehand to its prior."""
    linear, more = model.linear, len(found.sigma)
    closures = linear.blocks[CLOSURES]
    closures = replace(closures, residual=np.r_[closures.residual, np.zeros(more)])
    bases = list(linear.columns.whole)
    bases[CLOSURES] = np.concatenate([bases[CLOSURES], np.zeros((more, bases[CLOSURES].shape[1]))])
    blocks = tuple(closures if i == CLOSURES else block for i, block in enumerate(linear.blocks))
    grown = replace(linear, blocks=blocks, columns=Column(tuple(bases)), size=linear.size + more)
    parts = list(found.column.parts)
    own = np.zeros((len(linear.blocks[CLOSURES].residual), more)) if parts[CLOSURES] is None else parts[CLOSURES]
    parts[CLOSURES] = np.concatenate([own, np.diag(1 / found.sigma)])
    return replace(model, linear=grown.marginalise(Column(tuple(parts))))


def slight(model: LinearisedModel, found: Tolerated) -> list[Slight]:
    """[Slight] of what tolerances are beyond chance, the surest first; what is admitted belongs among the nuisances."""
    seen = model.linear.project(found.column)
    covariance = np.linalg.inv(seen.gram + np.diag(found.sigma**-2.0))
    values, out = covariance @ seen.right, []
    for site in found.sites:
        own, block = values[site.columns], covariance[site.columns, site.columns]
        p = float(chi2.sf(own @ np.linalg.solve(block, own), len(own))) * len(found.sites)
        if p < ALPHA:
            out.append(Slight(site, own, np.sqrt(np.diag(block)), p))
    return sorted(out, key=lambda s: s.p_value)
