"""What is left when the catalogue has had its say: smooth functions of pose, time, history and sensors that nobody named."""

from dataclasses import dataclass

import numpy as np

from calib.diagnose import scan
from calib.diagnose.search import mount_pixels
from rig.effects.lens_distortion import products
from rig.pose import difference

ALPHA = 1e-4  # chance of calling anything unknown where there is nothing
TIME_KNOTS = 8  # of a smooth function of time
WARP = 6  # degree of a smooth warp of an image
JITTER = 6.0  # standard errors by which a camera must shake from frame to frame


@dataclass(frozen=True, slots=True)
class Unknown:
    """place; magnitude : RMS of the smooth function, in unit; depends_on : names of covariates; p_value; drop"""

    place: str
    magnitude: float
    unit: str
    depends_on: tuple[str, ...]
    p_value: float
    drop: float


def unknowns(planes):
    """[Unknown] that the residuals of Planes still hold, the most convincing first; admitted effects belong among the freedoms."""
    k, out = planes.knowledge, []
    if k.axes:
        out += _struts(planes)
    if k.seen is not None:
        out += _cameras(planes)
    count = max(len(out), 1)
    found = [u for u in out if u is not None and u.p_value * count < ALPHA]
    return sorted(found, key=lambda u: u.p_value if u.p_value > 0 else -u.drop)


def _struts(planes):
    k = planes.knowledge
    atoms = scan.strut_atoms(planes)
    bases = {("pose",): _pose_basis(k), ("time",): _time_basis(k.t), ("history",): None}
    for name, values in (k.sensors.channels if k.sensors is not None else {}).items():
        series = np.interp(k.t, k.sensors.t, values)
        if np.ptp(series) > 0:
            bases[(name,)] = _powers(series)
    direction = _history(k)
    out = []
    for depends, basis in bases.items():
        for i in range(k.axes):
            functions = np.stack([direction[:, i], direction[:, i] * _unit(k.motion(()).lengths[:, i])], axis=1) if basis is None else basis
            weights = np.zeros((len(k.t), k.axes, functions.shape[1]))
            weights[:, i] = functions
            out.append(_tested(planes, atoms, weights, f"strut {i + 1}", "m", depends, lambda c, f=functions: f @ c))
    for i in np.flatnonzero(planes.scatter > 0):
        expected = np.sqrt(np.mean(np.linalg.inv(planes.W)[:, i] ** 2, axis=0).sum())
        ratio = (planes.scatter[i] / expected) ** 2 * np.sqrt(len(k.t) / 2)
        out.append(Unknown(f"strut {i + 1}", float(planes.scatter[i]), "m", (), float(np.exp(-0.5 * ratio**2)), float(ratio**2)))
    return out


def _cameras(planes):
    k, out = planes.knowledge, []
    o = k.seen.observations
    time, expected = _time_basis(k.t), k.pixels()  # where corners should be: where they are seen holds their noise
    for i, camera in enumerate(k.design.cameras):
        rows = o.camera == i
        if not rows.any():
            continue
        place = f"camera {camera.name}"
        if i not in k.moving:
            pixels = mount_pixels(planes, place)
            atoms = scan.view_atoms(planes, pixels)
            weights = np.einsum("fk,ab->fabk", time, np.eye(6)).reshape(len(k.t), 6, -1)
            size = np.sqrt((pixels[rows] ** 2).sum(axis=1).mean(axis=0))
            out.append(_tested(planes, atoms, weights, place, "px", ("time",),
                               lambda c, s=size: (time @ c.reshape(6, -1).T) * s))
        basis = products(camera, expected[rows], WARP)
        pixels = np.zeros((len(o), 2, 2 * basis.shape[1]))
        pixels[rows, 0, : basis.shape[1]] = basis
        pixels[rows, 1, basis.shape[1] :] = basis
        atoms = scan.view_atoms(planes, pixels)
        weights = np.broadcast_to(np.eye(pixels.shape[2]), atoms.gamma.shape)
        out.append(_tested(planes, atoms, weights, place, "px", ("image position",),
                           lambda c, b=basis: np.stack([b @ c[: b.shape[1]], b @ c[b.shape[1] :]])))
    return out


def _tested(planes, atoms, weights, place, unit, depends, function):
    """Unknown of one basis (F, a, q), tested whole; its size is that of the fitted function less what noise alone would fit."""
    drop, coefficients, rank, _ = scan.solve(*scan.framewise(atoms, weights[None]))
    if rank[0] == 0:
        return None
    spread, active = scan.dispersion(planes, atoms, weights, coefficients[0])
    p = scan.davies(drop / spread, rank[0], spread, active)
    values = function(coefficients[0])
    share = max(0.0, 1 - rank[0] / max(drop[0] / spread, 1e-9))
    return Unknown(place, float(np.sqrt(np.mean((values - values.mean()) ** 2) * share)), unit, depends, p, float(drop[0] / spread))


def _unit(x):
    return (x - x.mean()) / max(np.abs(x - x.mean()).max(), 1e-300)


def _powers(x):
    x = _unit(x)
    return np.stack([x, x**2], axis=1)


def _pose_basis(k):
    """(F, q) polynomials of the pose up to the second degree, and pure cubes, of what lies between it and its mean."""
    x = difference(k.T.mean(), k.T)
    x = x / np.maximum(np.abs(x).max(axis=0), 1e-300)
    pairs = [x[:, i] * x[:, j] for i in range(6) for j in range(i, 6)]
    return np.column_stack([x, *pairs, x**3])


def _time_basis(t):
    """(F, q) cosines of time, slowest first."""
    s = (t - t[0]) / max(np.ptp(t), 1e-300)
    return np.cos(np.pi * s[:, None] * np.arange(1, TIME_KNOTS + 1))


def _history(k):
    """(F, axes) -1 or 1: which way each strut last moved before the exposure, 0 where it never did."""
    path = k.motion(()).path
    step = np.sign(np.diff(path.lengths, axis=0, prepend=path.lengths[:1]))
    for j in range(1, len(step)):
        step[j] = np.where(step[j] == 0, step[j - 1], step[j])
    return step[path.at]



