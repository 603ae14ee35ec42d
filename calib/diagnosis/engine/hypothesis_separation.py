"""How well two hypotheses are told apart: what each does to what is measured, less what calibration's own freedoms can
swallow.
"""

from dataclasses import dataclass

import numpy as np

from rig.arrays import Floats


@dataclass(frozen=True, slots=True)
class Separation:
    """plan : its text; frames; misfit : standard deviations by which the better of two models beats the other, scaled
    to fit its best, over the plan's exposures; cosine : of the two sensitivities, freedoms taken out"""

    plan: str
    frames: int
    misfit: float
    cosine: float


def _signal_separation(
    text: str, frames: int, parts: tuple[Floats, Floats], freedoms: Floats, prior: Floats
) -> Separation:
    """Separation of two sensitivities (n,), whitened, by freedoms (n, p), whitened, each of which a prior (p,)
    holds.
    """
    Q = np.linalg.qr(np.concatenate([freedoms, np.diag(1 / prior)]))[0]
    a, b = (np.r_[part, np.zeros(len(prior))] for part in parts)
    a, b = a - Q @ (Q.T @ a), b - Q @ (Q.T @ b)
    norms = np.linalg.norm(a), np.linalg.norm(b)
    if min(norms) == 0:
        return Separation(text, frames, float(max(norms)), 0.0)
    cosine = float(a @ b / norms[0] / norms[1])
    return Separation(text, frames, float(min(norms) * np.sqrt(max(1 - cosine**2, 0.0))), cosine)
