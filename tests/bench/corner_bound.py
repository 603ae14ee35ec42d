"""Corners in pictures against the Cramer-Rao bound, over blur, noise, tilt and size; OpenCV's SUBPIX on the same
pictures.

Every kind is drawn twice: exactly, and as a ray caster and a camera of 8 bits would: so many points to the pixel, each
black or white.
"""

from collections.abc import Iterator
from itertools import product

import cv2
import numpy as np

from tests.vision.exact_pictures import camera, picture, quad
from vision.corners.marker_detection_and_corner_fit import ReadMarkers, fit_read_markers

NAME = "DICT_5X5_100"
BLURS, NOISES, TILTS, SIDES = (0.5, 1.0, 1.5), (0.5, 1.0, 2.0, 4.0), (0, 35, 65), (25, 50, 120)
QUADS, DRAWS, SAMPLES = 3, 8, 8
WHITE, BLACK = 190.0, 20.0


def bound(corners, number, blur, size) -> np.ndarray:
    """(8, 8) inverse of the information that pixels of unit noise hold on the corners; width and planes of black and
    white unknown.

    The pictures' own derivatives, by differences; pixels that see past the paper are left out.
    """

    def image(c, b=blur, **greys):
        return picture(c, NAME, number, b, samples=SAMPLES, size=size, **greys)

    paper = image(corners, white=1.0, black=1.0, beyond=0.0) > 0.999
    columns = []
    for k in range(8):
        step = np.zeros((4, 2))
        step.flat[k] = 0.25
        columns.append(
            (image(corners + step, white=WHITE, black=BLACK) - image(corners - step, white=WHITE, black=BLACK)) / 0.5
        )
    columns.append(
        (image(corners, blur + 0.02, white=WHITE, black=BLACK) - image(corners, blur - 0.02, white=WHITE, black=BLACK))
        / 0.04
    )
    share = image(corners, white=1.0, black=0.0)
    v, u = np.mgrid[:size, :size] / size - 0.5
    columns += [part * plane for part in (share, 1 - share) for plane in (np.ones_like(u), u, v)]
    J = np.stack([column[paper] for column in columns], axis=1)
    return np.linalg.inv(J.T @ J)[:8, :8]


def subpix(image, corners) -> np.ndarray:
    """(4, 2) corners that OpenCV refines from places half a pixel off, in the window that its detector takes by
    itself.
    """
    parameters = cv2.aruco.DetectorParameters()
    cell = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min() / 7
    window = int(
        np.clip(round(parameters.relativeCornerRefinmentWinSize * cell), 1, parameters.cornerRefinementWinSize)
    )
    criteria = (
        cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS,
        parameters.cornerRefinementMaxIterations,
        parameters.cornerRefinementMinAccuracy,
    )
    eight = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return cv2.cornerSubPix(
        eight, np.round(2 * corners).astype(np.float32)[:, None] / 2, (window, window), (-1, -1), criteria
    )[:, 0].astype(float)


def cells(markers, seed=0) -> Iterator[tuple]:
    """Yield (exact, blur, noise, tilt, side, bound px, errors of ours (k, 4, 2), whether each lies in its 95 % ellipse,
    OpenCV's, left out).
    """
    rng = np.random.default_rng(seed)
    for tilt, side, blur in product(TILTS, SIDES, BLURS):
        size = int(side * 1.45) + 24
        view = camera(size=size)
        scenes = [quad(rng, side, np.radians(tilt), size) for _ in range(QUADS)]
        limit = np.sqrt(np.trace(bound(scenes[0], 0, blur, size)) / 8)
        for exact in (True, False):
            clean = [
                picture(corners, NAME, k, blur, WHITE, BLACK, samples=SAMPLES, size=size, sharp=not exact)
                for k, corners in enumerate(scenes)
            ]
            for noise in NOISES:
                yield (
                    exact,
                    blur,
                    noise,
                    tilt,
                    side,
                    limit * noise,
                    *_fitted(clean, scenes, noise, exact, view, markers, rng),
                )


def _fitted(clean, scenes, noise, exact, view, markers, rng):
    ours, inside, theirs, lost = [], [], [], 0
    for k, corners in enumerate(scenes):
        for _ in range(DRAWS):
            image = clean[k] + rng.normal(0, noise, clean[k].shape)
            image = image if exact else np.clip(np.rint(image), 0, 255)
            found = fit_read_markers(
                image.astype(np.float32), view, markers, ReadMarkers([k], (corners + rng.normal(0, 0.3, (4, 2)))[None])
            )
            theirs.append(subpix(image, corners) - corners)
            if not len(found.marker):
                lost += 1
                continue
            error = found.corners[0] - corners
            C = np.stack([found.covariance[0, 2 * c : 2 * c + 2, 2 * c : 2 * c + 2] for c in range(4)])
            ours.append(error)
            inside.append(np.einsum("ci,cij,cj->c", error, np.linalg.inv(C), error) < 5.991)
    return np.array(ours).reshape(-1, 4, 2), np.array(inside).reshape(-1, 4), np.array(theirs), lost
