"""A linearisation point -> whitened residuals in two planes, with calibration's own freedoms projected out of both.

The image plane is what corners say when every frame's pose is free; the strut plane is what the poses so found say against the
commands. Corners' noise splits into the two without correlation, so together they are the whole likelihood, and a search over
thousands of hypotheses runs on inner products alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from calib.diagnose.corners import FINDER, MEDIAN, corner_rows, edges_of
from calib.diagnose.knowledge import Knowledge
from calib.identify import PRIOR, loop_jacobian, parameters
from rig import mechanisms

CLIP = 5.0  # standard deviations; a residual counts for no more, so that one wild corner proves nothing and a crowd still does
EXCESS = 3.0  # standard errors by which struts must scatter beyond the poses' noise before it counts as theirs
RANK = 1e-11  # of the greatest eigenvalue; freedoms below are none
ROUNDS = 3  # of weighing the struts anew by their scatter


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """k directions in both planes. image : (2n, k) frame by frame, None for nothing; struts : (m, k); inner : (F, L, k) coordinates in
    each frame's own basis, None for nothing."""

    image: np.ndarray | None
    struts: np.ndarray
    inner: np.ndarray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """knowledge : Knowledge at which all is linear.

    order : (n,) corners frame by frame; edges : (F + 1,) where frames begin in it; whiten : (n, 2, 2) so ordered
    local : (2n, L) orthonormal basis of each frame's own poses; to_local : (F, L, L) from its coordinates to tangents
    to_struts : (F, axes, axes) from tangents (hexapod: struts) to whitened closures, see `fold`; W : (F, a, a) whitening of closures
    image, struts : residuals (2n,), (m,), freedoms taken out; m = F axes, then one row for each prior
    basis : Column of orthonormal freedoms; freedoms : Column as they were; solve : (p, p) from projections to freedoms' values
    names : of the freedoms; sigma : px, noise of a corner over what its covariance said; scatter : (axes,) m of struts beyond noise
    raw : the closures (F, axes) m before any freedom is taken out
    framewise : (F, p) projections of each frame's residuals on the basis, and (F, p, p) of the basis on itself
    inner : (F, L, 1 + freedoms of cameras) residual's and those freedoms' coordinates in each frame's own basis
    at_rest : (p,) the residual's projections on the basis before they were taken out
    excess : what Huber's loss of the clipped corners is above the squares that they were clipped to
    """

    knowledge: Knowledge
    order: np.ndarray
    edges: np.ndarray
    whiten: np.ndarray
    local: np.ndarray
    to_local: np.ndarray
    to_struts: np.ndarray
    W: np.ndarray
    image: np.ndarray
    struts: np.ndarray
    basis: Column
    freedoms: Column
    solve: np.ndarray
    names: tuple
    sigma: float
    scatter: np.ndarray
    raw: np.ndarray
    camera_columns: dict
    framewise: tuple
    inner: np.ndarray
    at_rest: np.ndarray
    excess: float

    @property
    def frames(self):
        """How many frames there are."""
        return len(self.knowledge.t)

    @property
    def size(self):
        """How many independent numbers the residuals hold, the freedoms taken off."""
        return len(self.image) - self.local.shape[1] * (self.frames if len(self.image) else 0) + self.frames * self.knowledge.axes \
            - self.basis.struts.shape[1]

    def fold(self, pixels):
        """Column of corner displacements (n, 2, k) px in the observations' order: what poses swallow goes to the struts."""
        V = np.einsum("nij,njk->nik", self.whiten, pixels[self.order]).reshape(2 * len(self.order), -1) / self.sigma
        inner, out = _split(V, self.local, self.edges)
        return Column(out, self.on_struts(np.einsum("fij,fjk->fik", self.to_struts, inner)) if self.knowledge.axes else self.nothing(V.shape[1]),
                      inner)

    def project(self, column):
        """(basis' projections (p, k), projection of the residual (k,), Gram matrix (k, k) with the freedoms taken out) of a Column."""
        K, b, G = self.basis.struts.T @ column.struts, column.struts.T @ self.struts, column.struts.T @ column.struts
        if column.image is not None:
            K, b, G = K + self.basis.image.T @ column.image, b + column.image.T @ self.image, G + column.image.T @ column.image
        return K, b, G - K.T @ K

    def without(self, column):
        """Planes with the directions of a Column (k) among the freedoms."""
        K, b, G = self.project(column)
        half = _orthonormal(G)
        struts = column.struts @ half - self.basis.struts @ (K @ half)
        image = (column.image @ half if column.image is not None else 0) - self.basis.image @ (K @ half)
        z = half.T @ b
        left = Column(self.image - image @ z, self.struts - struts @ z)
        basis = Column(np.column_stack([self.basis.image, image]), np.column_stack([self.basis.struts, struts]))
        return replace(self, image=left.image, struts=left.struts, basis=basis,
                       framewise=by_frame(self.edges, self.frames, self.knowledge.axes, basis, left))

    def whitened(self, deviation):
        """(m, k) rows of the strut plane of struts longer by deviation (F, axes, k) m."""
        return self.on_struts(self.W @ deviation)

    def on_struts(self, rows):
        """(m, k) from rows (F, axes, k), the priors' rows empty."""
        out = self.nothing(rows.shape[-1])
        out[: self.frames * self.knowledge.axes] = rows.reshape(self.frames * self.knowledge.axes, -1)
        return out

    def nothing(self, k):
        """(m, k) zeros of the strut plane."""
        return np.zeros((len(self.struts), k))

    def cost(self):
        """Sum of squares of both planes."""
        return float(self.image @ self.image + self.struts @ self.struts)


def linearise(knowledge):
    """Planes of a Knowledge: cameras, lenses and geometry are the freedoms, each frame's pose is free in the image."""
    k = knowledge
    priors, names, camera_columns = [], [], {}
    if k.seen is not None:
        order, edges, whiten, image, local, to_local, image_names, image_priors, camera_columns, own = corner_rows(k)
        names += image_names
        priors += image_priors
    else:
        order, edges, whiten = np.zeros(0, int), np.zeros(k.frames.shape[0] + 1, int), np.zeros((0, 2, 2))
        image, local, to_local = np.zeros((0, 1)), np.zeros((0, 6)), np.tile(np.eye(6), (len(k.t), 1, 1))
    sigma, excess = 1.0, 0.0
    if len(image):
        rho = image[:, 0].copy()
        inner, image = _split(image, local, edges)
        sigma = _noise(image[:, 0], image[:, 1:], priors, own, local.shape[1] * len(k.t))
        far = np.abs(rho / sigma)
        excess = float((2 * CLIP * np.maximum(far - CLIP, 0)).sum())
        image /= sigma
        inner /= sigma
        inner[..., :1], image[:, :1] = _split(np.clip(rho / sigma, -CLIP, CLIP)[:, None], local, edges)
        to_local = to_local * sigma
    else:
        inner = np.zeros((len(k.t), 6, 1))
    if k.axes:
        m = k.design.mechanism
        A = mechanisms.of(m).jacobian(k.T, m)
        to_length = A @ to_local[:, :6]  # (F, axes, L): local coordinates to struts' lengths
        S = to_length @ np.swapaxes(to_length, 1, 2) if k.own is None else A @ k.own @ np.swapaxes(A, 1, 2)
        raw = k.closures()
        lengths = np.concatenate([(raw[..., None] + to_length @ inner[..., :1]), to_length @ inner[..., 1:], loop_jacobian(k.T, m)], axis=2)
        names += [("geometry", j) for j in range(42)]
        priors += [1 / PRIOR] * 42
    else:
        S, raw, lengths = np.zeros((len(k.t), 0, 0)), np.zeros((len(k.t), 0)), np.zeros((len(k.t), 0, image.shape[1]))
        to_length = np.zeros((len(k.t), 0, to_local.shape[1]))
    beforehand = np.column_stack([np.zeros(len(priors)), np.diag(np.array(priors))])
    for i, j in edges_of(names, k.design) if k.finder else ():
        beforehand[j, 0] = -k.finder[i] / FINDER
    if k.axes and k.known is not None:
        mechanism, root = k.known
        beforehand[-42:, 0] = root @ (parameters(mechanism) - parameters(k.design.mechanism))
        beforehand[-42:, -42:] = root
    return _weighed(k, order, edges, whiten, local, to_local, to_length, S, raw, image, lengths, beforehand, tuple(names), sigma,
                    camera_columns, inner, excess)


def _split(rows, local, edges):
    """(coordinates in each frame's own basis (F, L, k), what is orthogonal to it (2n, k)) of rows (2n, k), which are overwritten."""
    inner = np.empty((len(edges) - 1, local.shape[1], rows.shape[1]))
    for f, (a, b) in enumerate(zip(2 * edges[:-1], 2 * edges[1:])):
        inner[f] = local[a:b].T @ rows[a:b]
        rows[a:b] -= local[a:b] @ inner[f]
    return inner, rows


def _noise(left, V, priors, own, lost):
    """What standard deviations must be multiplied by, from the middle of the image plane's residuals where covariances are corners' own."""
    left = np.clip(left, -50, 50)
    half = _orthonormal(V.T @ V + np.diag(np.square(priors)))
    left = left - V @ (half @ (half.T @ (V.T @ left)))
    return float(np.sqrt(np.median(left[own if own.any() else slice(None)] ** 2) / MEDIAN / (1 - (lost + half.shape[1]) / len(left))))


def _orthonormal(gram):
    """(p, r) combinations of columns with a Gram matrix (p, p) that are orthonormal: the columns' span, what is null left out."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / scale[:, None] / scale)
    kept = values > RANK * values[-1]
    return vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]


def _weighed(k, order, edges, whiten, local, to_local, to_length, S, raw, image, lengths, beforehand, names, sigma, camera_columns, at_own, excess):
    """Planes with the struts weighed by the poses' noise and by what they scatter beyond.

    beforehand : (q, 1 + freedoms) rows of what was known before: residual, then freedoms
    """
    F, axes, seen = len(k.t), k.axes, image.shape[1] - 1
    scatter = np.zeros(axes)
    inner = image.T @ image
    for turn in range(ROUNDS):
        W = np.linalg.inv(np.linalg.cholesky(S + np.diag(scatter**2))) if axes else np.zeros((F, 0, 0))
        rows = np.concatenate([(W @ lengths).reshape(F * axes, lengths.shape[2]), beforehand])
        gram = rows.T @ rows
        gram[: seen + 1, : seen + 1] += inner
        half = _orthonormal(gram[1:, 1:])
        z = half.T @ gram[1:, 0]
        basis = rows[:, 1:] @ half
        if not axes or turn == ROUNDS - 1:
            break
        left = np.linalg.solve(W, (rows[: F * axes, 0] - basis[: F * axes] @ z).reshape(F, axes, 1))[..., 0]
        new = _scatter(left, S)
        if np.abs(new - scatter).max() < 1e-8:
            break
        scatter = new
    Q = Column(image[:, 1:] @ half[:seen], basis)
    left = Column(image[:, 0] - Q.image @ z, rows[:, 0] - Q.struts @ z)
    return Planes(k, order, edges, whiten, local, to_local, W @ to_length if axes else to_length, W, left.image, left.struts, Q,
                  Column(image[:, 1:], rows[:, 1:]), half, names, sigma, scatter, raw, camera_columns,
                  by_frame(edges, F, axes, Q, left), at_own, z, excess)


def by_frame(edges, frames, axes, basis, left):
    """(F, p) projections of each frame's residuals on a basis, and (F, p, p) of the basis on itself."""
    rho, gram = np.empty((frames, basis.struts.shape[1])), np.empty((frames, basis.struts.shape[1], basis.struts.shape[1]))
    for f, (a, b) in enumerate(zip(2 * edges[:-1], 2 * edges[1:])):
        image, struts = basis.image[a:b], basis.struts[f * axes : (f + 1) * axes]
        rho[f] = image.T @ left.image[a:b] + struts.T @ left.struts[f * axes : (f + 1) * axes]
        gram[f] = image.T @ image + struts.T @ struts
    return rho, gram


def _scatter(left, S):
    """(axes,) m: what each strut scatters beyond the poses' own noise, 0 where that suffices; by the middle, not the extremes."""
    own = np.einsum("nii->ni", S)
    seen = (left**2).mean(axis=0)
    own = own.mean(axis=0) * max(1 - 7 / len(left), 0.1)
    return np.where(seen > own * (1 + EXCESS * np.sqrt(2 / len(left))), np.sqrt(np.maximum(seen - own, 0)), 0.0)
