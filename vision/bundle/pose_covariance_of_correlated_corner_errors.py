"""Covariance of poses whose corner errors are correlated.

Each frame's poses; errors are correlated within an image, or larger in some places.

Air, vibration and a finder's habits move neighbouring corners alike, corners far from an image's middle may scatter
more, and some far more than usual. The poses then scatter by more than equal and independent errors make of them, and
no strut is to blame for that. The sizes of the errors are estimated by moments (Rao and Kleffe, Estimation of variance
components and applications, 1988), and from there how their terms go together by rounds of expectation and maximisation
(Laird and Ware, Biometrics 38, 1982, 963-974); what they make of poses is White's covariance (Econometrica 48, 1980,
817-838).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr, chdtrc

from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model.design import Camera
from vision.corner_observations_and_merging import Observations

DEGREE = 3  # of the polynomials of a place in an image that errors may follow
RINGS = 3  # parts of an image from its middle outwards, of as many corners each
HEAVY = 0.1  # by which the mean square of errors must exceed what their middle gives, for tails to be heavy
LEAST = 0.05  # of the squares: errors of neighbouring corners are never quite alike
FEW = 2.0  # corners' worth of usual errors that every part is taken to have beside its own
CHANCE = 1e-6  # that the errors in one of all parts are as unlike the others
ROUNDS = 20  # of expectation and maximisation; what images hardly tell stays near the estimate by moments
PROOF = 5.0  # standard errors by which errors must be seen to be unlike equal and independent ones


@dataclass(frozen=True, slots=True, eq=False)
class SmoothImageErrors:
    """Errors that vary smoothly over each of I images of F frames, anew in each, whitened.

    columns : (2n, 2K) 1/px of each corner's own image, by polynomials of mean square 1 in each direction together
    starts, frame, camera : (I,) each image's first corner, its frame and camera
    onto : (F, L, 2K C) on the frames' own poses
    products : (I, 2K, 2K) of each image's columns with each other
    size : (n,) sum of squares of each corner's rows of the columns; taken : (F,) of what the frames' own poses take
    part : (n,) each corner's camera and ring, and spare : (n,) how much of its errors' squares the poses leave
    """

    columns: Floats
    starts: Integers
    frame: Integers
    camera: Integers
    onto: Floats
    products: Floats
    size: Floats
    taken: Floats
    part: Integers
    spare: Floats

    def of_images(self) -> Floats:
        """(I, L, 2K) of each image's columns on its frame's own poses."""
        by_camera = self.onto.reshape(*self.onto.shape[:2], -1, self.products.shape[1])
        return by_camera[self.frame, :, self.camera]

    def sum_of_squares(self) -> float:
        """Sum of the squares of what the frames' own poses leave of the products of all of a frame's columns."""
        onto, taken = self.of_images(), self.onto @ np.swapaxes(self.onto, 1, 2)
        crossed = np.vdot(onto @ self.products, onto)
        return float((self.products**2).sum() - 2 * crossed + (taken**2).sum())


def smooth_image_error_model_of_corners(
    observations: Observations,
    cameras: Sequence[Camera],
    order: Integers,
    edges: Integers,
    whiten: Callable[[Floats], Floats],
    local: Floats,
    own: Booleans,
) -> SmoothImageErrors:
    """SmoothImageErrors of n corners in an order (n,), frame by frame and camera by camera.

    edges : (F + 1,) where frames begin; whiten : of columns (n, 2, k) px in that order
    local : (2n, L) orthonormal basis of frames' own poses
    own : (n,) whether a corner's covariance is that of its own errors alone; only such corners count, also those of the
        base, which see the same air
    """
    camera, frame = observations.camera[order], observations.frame[order]
    leverage = (local**2).reshape(len(order), -1).sum(axis=1) / 2
    place, pixels = image_places_and_smooth_error_columns(observations, cameras, order)
    columns = (whiten(pixels) * own[:, None, None]).reshape(2 * len(order), -1)
    starts = np.flatnonzero(np.r_[True, (np.diff(camera) != 0) | (np.diff(frame) != 0)])
    F, L, width = len(edges) - 1, local.shape[1], columns.shape[1]
    onto, products = np.zeros((F, L, len(cameras), width)), np.zeros((len(starts), width, width))
    for image, (a, b) in enumerate(zip(2 * starts, [*2 * starts[1:], 2 * len(order)])):
        f, i = frame[starts[image]], camera[starts[image]]
        onto[f, :, i] = local[a:b].T @ columns[a:b]
        products[image] = columns[a:b].T @ columns[a:b]
    flat = onto.reshape(F, L, -1)
    size, taken = (columns**2).sum(axis=1).reshape(-1, 2).sum(axis=1), (flat**2).sum(axis=(1, 2))
    spare = np.where(own, np.maximum(1 - leverage, LEAST), 0.0)
    return SmoothImageErrors(
        columns, starts, frame[starts], camera[starts], flat, products, size, taken, _parts(camera, place), spare
    )


def image_places_and_smooth_error_columns(
    observations: Observations, cameras: Sequence[Camera], order: Integers
) -> tuple[Floats, Floats]:
    """Places (n, 2) in the image, and columns (n, 2, 2K) px of smooth errors.

    They are of n corners in an order (n,); places are from -1 to 1.
    """
    half = np.array([[c.width / 2, c.height / 2] for c in cameras])[observations.camera[order]]
    place = (observations.uv[order] - half) / half
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    terms = np.stack([place[:, 0] ** i * place[:, 1] ** j for i, j in powers], axis=1)
    terms /= np.sqrt((terms**2).sum(axis=1).mean())
    return place, np.einsum("ij,nk->nikj", np.eye(2), terms).reshape(len(order), 2, -1)


def _parts(camera: Integers, place: Floats) -> Integers:
    """(n,) number of each corner's camera and ring of the image."""
    radius, out = np.linalg.norm(place, axis=1), np.zeros(len(camera), int)
    for i in np.unique(camera):
        own = camera == i
        out[own] = RINGS * i + np.searchsorted(np.quantile(radius[own], np.arange(1, RINGS) / RINGS), radius[own])
    return out


def own_and_smooth_corner_error_variances(
    errors: SmoothImageErrors, left: Floats, edges: Integers
) -> tuple[Floats, Floats] | None:
    """Variances of the own and of the smooth errors of corners.

    ((n,) mean square of each corner's own whitened errors, (2K, 2K) px^2 covariance of the smooth ones along the
    columns), in the order of `smooth_image_error_model_of_corners`; None where corners show no errors but equal and
    independent ones.
    left : (2n,) whitened residuals with the frames' own poses taken out; edges : as of
    `smooth_image_error_model_of_corners`
    """
    F, spare, total = len(edges) - 1, errors.spare, errors.spare.sum()
    square = np.where(spare > 0, (left**2).reshape(-1, 2).mean(axis=1), 0.0)
    if not square.any():
        return None  # corners without errors, or none whose covariance is their own
    level = square.sum() / total
    frame = np.repeat(np.arange(F), np.diff(edges))
    shares = _shares(errors.part, square / level, spare)
    shares = shares * _shares(frame, square / level, spare * shares)
    if (shares != 1).any():
        shares *= total / (shares @ spare)
    v = np.add.reduceat(errors.columns * left[:, None], 2 * errors.starts, axis=0)
    seen = np.bincount(errors.frame, (v**2).sum(axis=1), F)
    mean_share = np.bincount(frame, shares, F) / np.maximum(np.bincount(frame, minlength=F), 1)
    white_alone = np.bincount(frame, shares * errors.size, F) - mean_share * errors.taken
    excess = seen - level * white_alone
    correlated = excess.sum() > PROOF * np.sqrt((excess**2).sum())
    heavy = level - 1 > max(HEAVY, PROOF / np.sqrt(total))
    if (shares == 1).all() and not correlated and not heavy:
        return None
    width = errors.columns.shape[1]
    if not correlated:
        return level * shares, np.zeros((width, width))
    # both from what all squares are, and those along the smooth columns
    left_of_columns = errors.size.sum() - errors.taken.sum()
    A = np.array([[2 * total, left_of_columns], [white_alone.sum(), errors.sum_of_squares()]])
    white, smooth = np.linalg.solve(A, [2 * square.sum(), seen.sum()])
    along = np.zeros((F, errors.onto.shape[2] // width, width))
    along[errors.frame, errors.camera] = v
    white, Sigma = _smooth_covariance(errors, along, mean_share, max(white, LEAST * level), max(smooth, 0.0))
    return white * shares, Sigma


def _smooth_covariance(
    errors: SmoothImageErrors, along: Floats, share: Floats, white: float, smooth: float
) -> tuple[float, Floats]:
    """(mean square of the errors beside the smooth ones, (2K, 2K) px^2 covariance of the smooth ones along an image's
    columns), from estimates by moments.

    along : (F, C, 2K) of the residuals on the columns; share : (F,) of the mean square of each frame's errors
    """
    width = along.shape[2]
    frame, images = errors.frame, len(errors.frame)
    onto = errors.of_images()
    alone = errors.products.sum(axis=0) - onto.reshape(-1, width).T @ onto.reshape(-1, width)
    squares = white * errors.spare.sum() * 2 + smooth * np.trace(alone)
    Sigma = smooth * np.eye(width)
    right, identity = along[frame, errors.camera][..., None], np.eye(onto.shape[1])
    starts = np.flatnonzero(np.diff(frame, prepend=-1))  # each frame's first image, of frames that have any
    of_frame = np.repeat(np.arange(len(starts)), np.diff(starts, append=images))
    for _ in range(ROUNDS):
        noise = (white * share[frame])[:, None, None]
        # posterior of each image by itself; what its frame's own poses take of all its images comes after, by Woodbury
        loose = np.eye(width) + Sigma @ errors.products / noise
        single = np.linalg.solve(loose, np.broadcast_to(Sigma, loose.shape))
        reach = onto @ single
        joint = np.add.reduceat(np.concatenate([reach @ np.swapaxes(onto, 1, 2), reach @ right], axis=2), starts)
        rest = noise[starts] * identity - joint[..., :-1]
        both_sides = np.concatenate([np.broadcast_to(identity, rest.shape), joint[..., -1:]], axis=2)
        taken = np.linalg.solve(rest, both_sides)[of_frame]
        back = np.swapaxes(reach, 1, 2)
        mean = ((single @ right + back @ taken[..., -1:]) / noise)[..., 0]
        shared = np.tensordot(reach, taken[..., :-1] @ reach, ((0, 1), (0, 1)))
        both = mean.T @ mean + single.sum(axis=0) + shared
        both /= images
        one = np.einsum("aibi->ab", both.reshape(width // 2, 2, width // 2, 2)) / 2  # alike in both directions
        Sigma = np.kron(one, np.eye(2))
        white = max((squares - (alone * Sigma).sum()) / (2 * errors.spare.sum()), LEAST * white)
    return white, Sigma


def pose_covariance_by_estimated_corner_errors(
    errors: SmoothImageErrors, left: Floats, local: Floats, edges: Integers
) -> Floats | None:
    """Covariance (F, L, L) of poses by estimated corner errors.

    It is of the frames' own poses on their basis, whose unit is that of equal and independent errors; None where
    corners show no others.
    left : (2n,) whitened residuals with the frames' own poses taken out; local, edges : as of
    `smooth_image_error_model_of_corners`
    """
    sizes = own_and_smooth_corner_error_variances(errors, left, edges)
    return None if sizes is None else pose_covariance_from_corner_error_variances(errors, *sizes, local, edges)


def pose_covariance_from_corner_error_variances(
    errors: SmoothImageErrors, white: Floats, smooth: Floats, local: Floats, edges: Integers
) -> Floats:
    """Covariance (F, L, L) of poses from variances of corner errors.

    It is of the frames' own poses on their basis by the sizes of errors, white (n,) and smooth, as
    `own_and_smooth_corner_error_variances` has them.
    """
    each, cameras = np.repeat(white, 2), errors.onto.shape[2] // len(smooth)
    out = errors.onto @ np.kron(np.eye(cameras), smooth) @ np.swapaxes(errors.onto, 1, 2)
    for f, (a, b) in enumerate(zip(2 * edges[:-1], 2 * edges[1:])):
        out[f] += local[a:b].T @ (each[a:b, None] * local[a:b])
    return out


def _shares(part: Integers, square: Floats, spare: Floats) -> Floats:
    """(n,) mean square of the errors in each corner's part (n,), of what is expected there; 1 in parts that chance
    explains.

    square : (n,) mean of each corner's two, spare : (n,) expected. Chance is that of chi-square, whose freedoms are
    fewer as the errors' tails are heavier.
    """
    seen, expected = np.bincount(part, square), np.bincount(part, spare)
    counted = spare > 0
    heavy = max(float(((square - spare)[counted] ** 2).mean() / (spare[counted] ** 2).mean()), 1.0)
    freedom, sums = 2 * expected / heavy, 2 * seen / heavy
    some = expected > 0
    p = np.ones(len(seen))
    p[some] = np.minimum(chdtrc(freedom[some], sums[some]), chdtr(freedom[some], sums[some]))
    unlikely = p * some.sum() < CHANCE
    return np.where(unlikely, (seen + FEW) / (expected + FEW), 1.0)[part]
