"""What is left when the catalogue has had its say: smooth functions of pose, time, history and sensors that nobody named."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from calib.diagnose import scan
from calib.diagnose.corners import MEDIAN
from calib.diagnose.planes import Column
from calib.diagnose.prove import corner_noise
from calib.diagnose.search import mount_pixels
from rig.effects.lens_distortion import products
from rig.pose import difference

ALPHA = 1e-4  # chance of calling anything unknown where there is nothing
SLOW, FAST = 8, 24  # cosines of a smooth function of time
WARP = 6  # degree of a smooth warp of an image
MEDIAN_SPREAD = 5.6  # variance of a sample's middle square over its square, times the sample's size, for normal residuals


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
    return sorted(found, key=lambda u: (not u.depends_on, u.p_value if u.p_value > 0 else -u.drop))


def _struts(planes):
    k = planes.knowledge
    atoms = scan.strut_atoms(planes)
    out = [_tested(planes, atoms, weights, place, "m", depends, atoms.gamma[:, i, i].sum())
           for depends, strutwise in _strut_weights(k) for i, (place, weights) in enumerate(strutwise)]
    inverse = np.linalg.inv(planes.W)
    left = (inverse @ planes.struts[: len(k.t) * k.axes].reshape(len(k.t), k.axes, 1))[..., 0]
    for i in np.flatnonzero(planes.scatter > 0):
        own = np.mean((inverse[:, i] ** 2).sum(axis=1)) - planes.scatter[i] ** 2
        middle = np.median(left[:, i] ** 2) / MEDIAN / own - 1  # a few wild frames are no scatter
        ratio = middle * np.sqrt(len(k.t) / MEDIAN_SPREAD)
        if ratio > 0:
            out.append(Unknown(f"strut {i + 1}", float(planes.scatter[i]), "m", (), float(norm.sf(ratio)), float(ratio**2)))
    return out


def _strut_weights(k):
    """[(depends on, [(place, (F, axes, q) m of the struts under smooth functions of it) for each strut])]."""
    bases = [(("pose",), _pose_basis(k)), (("time",), _time_basis(k.t, SLOW)), (("time",), _time_basis(k.t, FAST)), (("history",), None)]
    for name, values in (k.sensors.channels if k.sensors is not None else {}).items():
        series = np.interp(k.t, k.sensors.t, values)
        if np.ptp(series) > 0:
            bases.append(((name,), _powers(series)))
    direction, lengths = _history(k), k.motion(()).lengths
    for j in range(k.axes):
        bases.append(((f"strut {j + 1}'s position",), np.stack([_unit(lengths[:, j]) ** n for n in (2, 3, 4)], axis=1)))
    out = []
    for depends, basis in bases:
        strutwise = []
        for i in range(k.axes):
            functions = np.stack([direction[:, i], direction[:, i] * _unit(lengths[:, i])], axis=1) if basis is None else basis
            weights = np.zeros((len(k.t), k.axes, functions.shape[1]))
            weights[:, i] = functions
            strutwise.append((f"strut {i + 1}", weights))
        out.append((depends, strutwise))
    return out


def cover(planes, left):
    """Column of all smooth functions of what Unknowns depend on, at all struts where it is struts and else at the cameras themselves; None
    where nothing depends on anything."""
    k = planes.knowledge
    weights = dict(_strut_weights(k)) if k.axes else {}  # of two for the same, the finer
    named = {"pose" if d.endswith("position") else d for u in left if u.place.startswith("strut") for d in u.depends_on}
    parts = [w for d in sorted(named) for _, w in weights[(d,)]]
    struts = Column(None, planes.whitened(np.concatenate(parts, axis=2))) if parts else None
    pixels = [_camera_pixels(planes, u) for u in left if u.place.startswith("camera") and u.depends_on]
    if not pixels:
        return struts
    seen = planes.fold(np.concatenate(pixels, axis=2))
    if struts is None:
        return seen
    return Column(np.column_stack([seen.image, np.zeros((len(seen.image), struts.struts.shape[1]))]), np.column_stack([seen.struts, struts.struts]))


def _camera_pixels(planes, u):
    """(n, 2, q) px of corners under the smooth functions that a camera's Unknown was found in."""
    k = planes.knowledge
    o = k.seen.observations
    if u.depends_on == ("time",):
        moved = mount_pixels(planes, u.place)[..., None] * _time_basis(k.t, FAST)[o.frame][:, None, None, :]
        return moved.reshape(len(o), 2, -1)
    i = [f"camera {c.name}" for c in k.design.cameras].index(u.place)
    return _warped(k, i, o.camera == i, k.pixels())


def _cameras(planes):
    k, out = planes.knowledge, []
    o = k.seen.observations
    expected = k.pixels()
    for i, camera in enumerate(k.design.cameras):
        rows = o.camera == i
        if not rows.any():
            continue
        place = f"camera {camera.name}"
        if i not in k.moving:
            pixels = mount_pixels(planes, place)
            atoms = scan.view_atoms(planes, pixels)
            for count in (SLOW, FAST):
                weights = np.einsum("fk,ab->fabk", _time_basis(k.t, count), np.eye(6)).reshape(len(k.t), 6, -1)
                out.append(_tested(planes, atoms, weights, place, "px", ("time",), rows.sum() / corner_noise(planes) ** 2))
        if any(e.name == "lens_distortion" and e.place == place for e in k.effects):
            continue  # what its image still bends by belongs to the lens that was named
        atoms = scan.view_atoms(planes, _warped(k, i, rows, expected))
        weights = np.broadcast_to(np.eye(atoms.beta.shape[1]), atoms.gamma.shape)
        out.append(_tested(planes, atoms, weights, place, "px", ("image position",), rows.sum() / corner_noise(planes) ** 2))
    return out


def _warped(k, i, rows, expected):
    """(n, 2, q) px of corners under smooth warps of one camera's image; where corners should be, since where they are seen holds their noise."""
    basis = products(k.design.cameras[i], expected[rows], WARP)
    pixels = np.zeros((len(rows), 2, 2 * basis.shape[1]))
    pixels[rows, 0, : basis.shape[1]] = basis
    pixels[rows, 1, basis.shape[1] :] = basis
    return pixels


def _tested(planes, atoms, weights, place, unit, depends, information):
    """Unknown of one basis (F, a, q), tested whole. information : sum of 1 / unit^2 by which the place is weighed: what the fit
    explains beyond what noise alone would, freedoms taken out, tells the function's size."""
    drop, coefficients, rank, _ = scan.solve(*scan.framewise(atoms, weights[None]))
    if rank[0] == 0:
        return None
    spread, active = scan.dispersion(planes, atoms, weights, coefficients[0])
    p = scan.davies(drop / spread, rank[0], spread, active)
    return Unknown(place, float(np.sqrt(max(drop[0] - rank[0], 0.0) / information)), unit, depends, p, float(drop[0] / spread))


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


def _time_basis(t, count):
    """(F, q) so many cosines of time, slowest first."""
    s = (t - t[0]) / max(np.ptp(t), 1e-300)
    return np.cos(np.pi * s[:, None] * np.arange(1, count + 1))


def _history(k):
    """(F, axes) -1 or 1: which way each strut last moved before the exposure, 0 where it never did."""
    path = k.motion(()).path
    step = np.sign(np.diff(path.lengths, axis=0, prepend=path.lengths[:1]))
    for j in range(1, len(step)):
        step[j] = np.where(step[j] == 0, step[j - 1], step[j])
    return step[path.at]



