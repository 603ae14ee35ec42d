"""What is left when the catalogue has had its say: tests of everything that nobody named, at struts, cameras and markers."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from calib.diagnose import scan
from calib.diagnose.corners import MEDIAN
from calib.diagnose.prove import corner_noise
from calib.diagnose.smooth import FAST, SLOW, in_time, marker_pixels, strut_weights, view_pixels, warp_pixels
from rig.effects.lens_distortion import LensDistortion

ALPHA = 1e-4  # chance of calling anything unknown where there is nothing
MEDIAN_SPREAD = 5.6  # variance of a sample's middle square over its square, times the sample's size, for normal residuals
FAR = 5.0  # standard deviations; a residual counts for no more where neighbours are compared


@dataclass(frozen=True, slots=True)
class Unknown:
    """place; magnitude : RMS of the smooth function, in unit; depends_on : names of covariates; p_value; drop; freedom : parameters fitted
    dispersion : that drop was divided by, None for what is no function that was fitted"""

    place: str
    magnitude: float
    unit: str
    depends_on: tuple[str, ...]
    p_value: float
    drop: float
    freedom: int = 1
    dispersion: float | None = None

    def gain(self, size):
        """Bayesian information criterion's verdict: how much better than nothing, for residuals of a size."""
        return self.drop - self.freedom * np.log(size)

    def within(self, place):
        """Whether it sits where an effect at a place does, or at a part of it."""
        kind = {"rig": ("strut ", "rig"), "clock": ("strut ", "rig"), "cameras": "camera ", "markers": "marker "}.get(place)
        return self.place == place or kind is not None and self.place.startswith(kind)


def unknowns(planes):
    """[Unknown] that the residuals of Planes still hold, the most convincing first; admitted effects belong among the freedoms."""
    k, out = planes.knowledge, []
    if k.axes:
        out += _struts(planes)
    if k.seen is not None:
        out += _cameras(planes) + _markers(planes)
    out = [u for u in out if u is not None]
    return sorted((u for u in out if u.p_value * len(out) < ALPHA), key=lambda u: (not u.depends_on, u.p_value if u.p_value > 0 else -u.drop))


def _struts(planes):
    k = planes.knowledge
    atoms = scan.strut_atoms(planes)
    each = np.einsum("fii->i", atoms.gamma)
    out = [_tested(planes, atoms, weights, place, "m", (depends,), each[weights.any(axis=(0, 2))].sum())
           for depends, strutwise in strut_weights(k) for place, weights in strutwise]
    inverse = np.linalg.inv(planes.W)
    left = (inverse @ planes.struts[: len(k.t) * k.axes].reshape(len(k.t), k.axes, 1))[..., 0]
    own = np.einsum("fij,fij->fi", inverse, inverse)
    following = np.clip(left / np.sqrt(own), -FAR, FAR)[np.argsort(k.t)]
    for i in range(k.axes):
        alike = float(following[1:, i] @ following[:-1, i])
        size = np.sqrt(max(alike, 0) / len(k.t) * own[:, i].mean())
        out.append(Unknown(f"strut {i + 1}", float(size), "m", ("order",), float(norm.sf(alike / np.sqrt(len(k.t) - 1))), max(alike, 0.0), 1))
    for i in np.flatnonzero(planes.scatter > 0):
        noise = own[:, i].mean() - planes.scatter[i] ** 2
        middle = np.median(left[:, i] ** 2) / MEDIAN / noise - 1  # a few wild frames are no scatter
        ratio = middle * np.sqrt(len(k.t) / MEDIAN_SPREAD)
        if ratio > 0:
            out.append(Unknown(f"strut {i + 1}", float(planes.scatter[i]), "m", (), float(norm.sf(ratio)), float(ratio**2), 1))
    return out


def _cameras(planes):
    k, out = planes.knowledge, []
    for i, camera in enumerate(k.design.cameras):
        count = np.count_nonzero(k.seen.observations.camera == i)
        if not count:
            continue
        place, information = f"camera {camera.name}", count / corner_noise(planes) ** 2
        if i not in k.moving:
            atoms = scan.view_atoms(planes, view_pixels(planes, place))
            out += [_tested(planes, atoms, in_time(k, cosines), place, "px", ("time",), information) for cosines in (SLOW, FAST)]
            out.append(_following(atoms, np.argsort(k.t), place, information))
        if any(type(e) is LensDistortion and e.place == place for e in k.effects):
            continue  # what its image still bends by belongs to the lens that was named
        out.append(_still(planes, warp_pixels(k, i), place, "image position", information))
    return out


def _markers(planes):
    k, out = planes.knowledge, []
    ids, counts = np.unique(k.seen.markers.id[k.seen.sightings.marker], return_counts=True)
    pixels = marker_pixels(k, ids)
    own = pixels.shape[2] // max(len(ids), 1)
    for j, (number, count) in enumerate(zip(ids, counts)):
        part = pixels[:, :, j * own : (j + 1) * own]
        out.append(_still(planes, part, f"marker {number}", "place on the marker", 4 * count / corner_noise(planes) ** 2))
    return out


def _still(planes, pixels, place, depends, information):
    """Unknown of corner displacements (n, 2, q) px that are the same in every frame."""
    atoms = scan.view_atoms(planes, pixels)
    return _tested(planes, atoms, np.broadcast_to(np.eye(atoms.beta.shape[1]), atoms.gamma.shape), place, "px", (depends,), information)


def _following(atoms, order, place, information):
    """Unknown of a camera that moves in any way by which exposures that follow each other look alike."""
    beta, gamma = atoms.beta[order], atoms.gamma[order]
    scale = np.sqrt(np.maximum(np.einsum("faa->a", gamma), 1e-300))
    beta, gamma = beta / scale, gamma / scale[:, None] / scale
    M = np.linalg.pinv(gamma.mean(axis=0), rcond=1e-6, hermitian=True)
    alike = float(np.einsum("fa,ab,fb->", beta[1:], M, beta[:-1]))
    chance = np.sqrt(np.einsum("ab,fbc,cd,fda->", M, gamma[1:], M, gamma[:-1], optimize=True))
    p = float(norm.sf(alike / max(chance, 1e-300)))
    return Unknown(place, float(np.sqrt(max(alike, 0) / information)), "px", ("order",), p, max(alike, 0.0), 1)


def _tested(planes, atoms, weights, place, unit, depends, information):
    """Unknown of one basis (F, a, q), tested whole. information : sum of 1 / unit^2 by which the place is weighed: what the fit
    explains beyond what noise alone would, freedoms taken out, tells the function's size."""
    drop, coefficients, rank, _ = scan.solve(*scan.framewise(atoms, weights[None]))
    if rank[0] == 0:
        return None
    spread, active = scan.dispersion(planes, atoms, weights, coefficients[0])
    p = scan.davies(drop / spread, rank[0], spread, active)
    return Unknown(place, float(np.sqrt(max(drop[0] - rank[0], 0.0) / information)), unit, depends, p, float(drop[0] / spread), int(rank[0]), spread)
