"""Lenses to begin from where the stated ones lead nowhere: some of which nothing is known, some found with markers'
places free.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from rig.model.design import Camera

FACTORS = (1.0, 0.9, 1.1)  # times the stated focal length, from which lenses of which nothing is known are adjusted
UNSTATED = (
    0.2,
    0.06,
    # of the focal length and of the image's width, that a lens which nobody stated may be from the stated one and the
    # middle
)
Cameras = tuple[Camera, ...]


def initial_lenses(stated: Cameras, loosened: Callable[[Cameras], Cameras | None]) -> Iterator[Cameras]:
    """Cameras with other lenses to begin from, as stated but for these: some of which nothing is known, then those
    found with markers' places free.

    loosened : Cameras -> these, adjusted with markers' places free, or None where that fails
    A lens far from the stated one puts corners of its camera so far off that frames or the whole camera are left out;
    with places free they are not
    """
    unknown = [unknown_lenses(stated, factor) for factor in FACTORS]
    yield from unknown
    for begun in (stated, unknown[0]):
        found = loosened(begun)
        if found is not None:
            yield found


def unknown_lenses(stated: Cameras, factor: float = 1.0) -> Cameras:
    """The same cameras with no distortion, the centre in the middle of the image and a factor times the stated focal
    length.
    """
    out = []
    for c in stated:
        f = c.matrix[0, 0] * factor
        matrix = np.array([[f, 0, (c.width - 1) / 2], [0, f, (c.height - 1) / 2], [0, 0, 1.0]])
        out.append(replace(c, matrix=matrix, distortion=np.zeros(max(5, len(c.distortion)))))
    return tuple(out)


def are_lenses_plausible(adjusted: Cameras, stated: Cameras) -> bool:
    """Whether lenses that adjusting found from nothing known are such as cameras have: near the stated focal length,
    centred nearly.
    """
    zoomed = [abs(float(a.matrix[0, 0] / s.matrix[0, 0]) - 1) for a, s in zip(adjusted, stated)]
    aside = [
        float(np.abs(a.matrix[:2, 2] - [(s.width - 1) / 2, (s.height - 1) / 2]).max()) / s.width
        for a, s in zip(adjusted, stated)
    ]
    return max(zoomed) < UNSTATED[0] and max(aside) < UNSTATED[1]
