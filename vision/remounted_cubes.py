"""Measuring without the cubes that were put back: their places are known only to what remounting may do, so their
corners hold no pose.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rig.model.design import Design
from vision.corner_observations import Observations
from vision.predict import predict
from vision.recording_adjustment import Measurement
from vision.targets import MarkerMap


def is_on_remounted_cube(observations: Observations, design: Design, markers: MarkerMap) -> np.ndarray:
    """(n,) bool, whether a corner belongs to a cube that was taken off since its place was stated."""
    names = {target.name for target in design.targets if target.turned is not None}
    return np.array([name in names for name in markers.target])[observations.marker]


def measure_without_remounted(
    observations: Observations, loose: np.ndarray, measure: Callable[[Observations], Measurement]
) -> Measurement:
    """Measurement of the corners that are not loose (n,); these are among its observations again, and none of its
    inliers.

    measure : of Observations. Raises what it raises
    """
    if not loose.any():
        return measure(observations)
    found = measure(observations.take(~loose))
    covariance, inliers, residuals = (
        observations.covariance * found.factor,
        np.zeros(len(loose), bool),
        np.full((len(loose), 2), np.nan),
    )
    covariance[~loose], inliers[~loose], residuals[~loose] = (
        found.observations.covariance,
        found.inliers,
        found.residuals,
    )
    solved = np.isin(observations.frames[observations.frame], found.frames)
    weights = covariance.copy()
    weights[solved & ~loose] = found.weights
    seen = replace(observations, covariance=covariance)
    at = np.flatnonzero(solved & loose)
    kept = seen.take(at)
    kept = replace(kept, frames=found.frames, frame=np.searchsorted(found.frames, kept.frames[kept.frame]))
    residuals[at] = kept.uv - predict(kept, found.adjustment.state)[0]
    return replace(found, observations=seen, inliers=inliers, residuals=residuals, weights=weights[solved])
