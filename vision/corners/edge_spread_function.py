"""Edge spread function of one camera's images.

A plain blur at first, then learned from fit residuals.

An edge spread function is tabulated over the distance from the edge in edge widths, one table for each direction of the
edge's normal and each of some widths. It begins as a Gaussian seen through square pixels. What is learnt is added to
it: a spline, odd about the edge (an even part would only move the edge, and the width of each marker's edges is fitted
with its corners), times a Fourier series in the direction.
Source: edge spread functions from slanted edges, ISO 12233; de Boor, A Practical Guide to Splines, 1978
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

from rig.array_and_json_types import Floats, Integers
from vision.corners.blurred_edge_image_model_and_numba_kernels import GRID
from vision.corners.occlusion_illumination_and_displaced_edges_in_square_fit import PROFILED

FIRST_WIDTH = 0.8  # px
DIRECTIONS = 36  # of tables, over half a turn
BINS = 60  # of a profile, over PROFILED widths on either side of an edge
WIDTHS = np.array([0.33, 0.38, 0.43, 0.49, 0.56, 0.65, 0.78, 1.0, 1.4])  # px, of edges that have tables of their own
LEVELS = np.sqrt(WIDTHS[1:] * WIDTHS[:-1])
KNOT = 0.3  # edge widths between the spline's knots
# on either side; chosen together with vision/corners/edge_pixels.py's REACH on exact and rendered pictures, see there
KNOTS = 11
HARMONICS = (0, 2, 4)  # of the direction; an edge and the same edge seen from its other side are one
PLAUSIBLE = 0.02  # of the contrast, how far a camera's edges are expected to be from plain ones
LEAST = 2000  # pixels from which anything is learnt


def _splines(h: Floats) -> Floats:
    """(..., KNOTS) odd pairs of cubic B-splines at distances h (edge widths)."""
    at = np.asarray(h)[..., None] / KNOT
    knots = np.arange(1, KNOTS + 1)
    return _bump(at - knots) - _bump(at + knots)


def _bump(t: Floats) -> Floats:
    """The cubic B-spline of unit knots about 0."""
    t = np.abs(t)
    return np.where(t < 1, 2 / 3 - t * t + t**3 / 2, np.where(t < 2, (2 - np.minimum(t, 2)) ** 3 / 6, 0.0))


def _waves(angles: Floats) -> Floats:
    """(..., 5) Fourier series of a direction, of period half a turn."""
    return np.stack([f(k * angles) for k in HARMONICS for f in ((np.cos, np.sin) if k else (np.cos,))], axis=-1)


def _plain() -> Floats:
    """(widths, DIRECTIONS, STEPS + 1, 2) share of white and its slope across an edge that a Gaussian blurs and square
    pixels integrate.
    """
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    half_c, half_s = (np.maximum(np.abs(f(angles)), 1e-3)[:, None] / 2 for f in (np.cos, np.sin))
    out = np.empty((len(WIDTHS), DIRECTIONS, len(GRID), 2))
    for k, width in enumerate(WIDTHS):
        blur = np.sqrt(width**2 - 1 / 12)
        share = slope = 0.0
        for sign_c in (1, -1):
            for sign_s in (1, -1):
                x = (GRID * width + sign_c * half_c + sign_s * half_s) / blur
                bell = np.exp(-x * x / 2) / np.sqrt(2 * np.pi)
                share = share + sign_c * sign_s * ((x * x + 1) * ndtr(x) + x * bell) / 2
                slope = slope + sign_c * sign_s * (x * ndtr(x) + bell)
        area = 4 * half_c * half_s
        out[k, :, :, 0], out[k, :, :, 1] = share * blur**2 / area, slope * blur * width / area
    return out


_PLAIN = _plain()


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSpread:
    """tables : (widths, d, STEPS + 1, 2) share of white and its slope, for WIDTHS and d directions of an edge's normal
    over half a turn; width : px, to start from; terms : (knots, harmonics) of the spline, what the tables have beyond a
    plain edge's."""

    width: float = FIRST_WIDTH
    terms: Floats = field(default_factory=lambda: np.zeros((KNOTS, 2 * len(HARMONICS) - 1)))
    tables: Floats = field(init=False)

    def __post_init__(self) -> None:
        more = _waves(np.pi * np.arange(DIRECTIONS) / DIRECTIONS) @ self.terms.T @ _splines(GRID).T
        object.__setattr__(self, "tables", _PLAIN + np.stack([more, np.gradient(more, GRID, axis=1)], axis=-1))

    def rows(self, angles: Floats) -> Integers:
        """(...,) row of the tables for directions (rad) of edges' normals."""
        return np.rint(np.asarray(angles) % np.pi / np.pi * DIRECTIONS).astype(np.int64) % DIRECTIONS


PLAIN_EDGE_SPREAD = EdgeSpread()
NO_PROFILE = np.zeros((1, 0, 3))


def empty_residual_profile() -> Floats:
    """Empty residual profile (DIRECTIONS, BINS, 3) of edges.

    Count, sum, sum of squares.
    """
    return np.zeros((DIRECTIONS, BINS, 3))


def learn_edge_spread(spread: EdgeSpread, profile: Floats, width: float) -> EdgeSpread:
    """Edge spread learned from the residual profile of fits with `spread`.

    profile : (DIRECTIONS, BINS, 3); width : px, typical of the edges. Where there are too few pixels the spread stays
        as it was.
    """
    count, total, squares = np.moveaxis(profile, -1, 0)
    if count.sum() < LEAST:
        return spread
    h = PROFILED * ((np.arange(BINS) + 0.5) * 2 / BINS - 1)
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    A = np.einsum("dw,bk->dbkw", _waves(angles), _splines(h)).reshape(count.size, -1)
    mean = np.divide(total, count, out=np.zeros_like(total), where=count > 0)
    noise2 = max((squares - count * mean**2).sum() / count.sum(), 1e-8)
    weight = count.ravel() / noise2
    H = A.T @ (weight[:, None] * A) + np.eye(A.shape[1]) / PLAUSIBLE**2
    step = np.linalg.solve(H, A.T @ (weight * mean.ravel()) - spread.terms.ravel() / PLAUSIBLE**2)
    return EdgeSpread(float(width), spread.terms + step.reshape(spread.terms.shape))
