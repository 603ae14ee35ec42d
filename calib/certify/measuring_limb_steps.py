"""Whether a measuring limb changed its length while it was held against vision: a step at some pose that the limbs'
geometry does not explain.

All poses at once, by the likelihood ratio of every limb and every onset, with geometry and the errors that vision's
poses share solved for beside it. Source: Basseville and Nikiforov, Detection of Abrupt Changes, 1993, ch. 7 (additive
changes, known noise).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from calib.certify.fitted_limbs import Limbs
from calib.models.platform.identification import PRIOR
from calib.samples.pose_samples import Samples
from rig.model.mechanisms import redundant_legs

RARE = 1e-4  # share of sessions without a step in which one is found, all limbs and onsets together
LEAST = 3  # poses on either side of a step


@dataclass(frozen=True, slots=True)
class Slip:
    """limb : 1..6, of the six that tell the pose
    frame : number of the first one after it; size, sigma : m by which the limb is longer than it reads since."""

    limb: int
    frame: int
    size: float
    sigma: float


def detect_limb_slip(samples: Samples, limbs: Limbs, sigma: float) -> Slip | None:
    """The likeliest Slip among Samples (n,) whose commands are the limbs' readings; None where none is beyond chance.

    limbs : Limbs as fitted to these; sigma : m of one reading, as stated
    """
    n, of = (
        len(samples),
        redundant_legs.combine_legs([("m", limbs.hexapod, np.full(6, sigma), np.zeros((42, 42)))], limbs.hexapod.home),
    )
    if n < 2 * LEAST:
        return None
    told, J, _ = redundant_legs.leg_length_jacobians(of, samples.T_base_platform)
    spread = J @ samples.covariance @ np.swapaxes(J, 1, 2) + sigma**2 * np.eye(6)
    W = np.linalg.inv(np.linalg.cholesky(spread))
    y = (W @ (samples.commanded - told)[..., None]).reshape(-1)
    geometry = redundant_legs.leg_parameter_jacobians(of, samples.T_base_platform)  # (n, 6, 42)
    known = np.concatenate([W @ geometry * PRIOR, W @ J @ samples.common], axis=2).reshape(6 * n, -1)
    known = np.vstack([known, np.eye(known.shape[1])])  # each of these is a draw of unit size
    Q = np.linalg.qr(known)[0][: 6 * n]
    onset = np.arange(LEAST, n - LEAST + 1)
    steps = np.where(np.arange(n)[:, None] >= onset, 1.0, 0.0)
    columns = (W[:, :, :, None] * steps[:, None, None, :]).reshape(6 * n, -1)  # limbs by onsets
    gram = (columns**2).sum(axis=0) - ((Q.T @ columns) ** 2).sum(axis=0)
    right = columns.T @ y - (Q.T @ columns).T @ (Q.T @ y)
    gain = right**2 / np.maximum(gram, 1e-300)
    best = int(gain.argmax())
    left = float(y @ y - (Q.T @ y) @ (Q.T @ y) - gain[best])
    scale = max(left / (6 * n - 42), 1.0)  # where the poses are worse than they say
    if gain[best] / scale < scipy.special.chdtri(1, RARE / len(gain)):
        return None
    limb, at = divmod(best, len(onset))
    return Slip(
        limb + 1, int(samples.frame[onset[at]]), float(-right[best] / gram[best]), float(np.sqrt(scale / gram[best]))
    )
