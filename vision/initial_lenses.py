"""Initial lenses for an adjustment where the stated lenses fail."""

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


def alternative_initial_lenses(
    stated: Cameras, adjust_with_free_places: Callable[[Cameras], Cameras | None]
) -> Iterator[Cameras]:
    """Alternative initial lenses in turn: plain ones first, then lenses adjusted with free marker places.

    adjust_with_free_places : Cameras -> these, adjusted with markers' places free, or None where that fails
    A lens far from the stated one puts corners of its camera so far off that frames or the whole camera are left out;
    with places free they are not
    """
    unknown = [_undistorted_lenses(stated, factor) for factor in FACTORS]
    yield from unknown
    for begun in (stated, unknown[0]):
        found = adjust_with_free_places(begun)
        if found is not None:
            yield found


def _undistorted_lenses(stated: Cameras, factor: float = 1.0) -> Cameras:
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
    """Whether adjusted lenses are plausible: near the stated focal length, centred in the image."""
    zoomed = [abs(float(a.matrix[0, 0] / s.matrix[0, 0]) - 1) for a, s in zip(adjusted, stated)]
    aside = [
        float(np.abs(a.matrix[:2, 2] - [(s.width - 1) / 2, (s.height - 1) / 2]).max()) / s.width
        for a, s in zip(adjusted, stated)
    ]
    return max(zoomed) < UNSTATED[0] and max(aside) < UNSTATED[1]
