"""Covariates ranked by how much of what is left goes with them, before anything is admitted and after."""

from dataclasses import dataclass

import numpy as np
import scipy

from calib.diagnose.engine.frame_inner_products import FrameProducts
from calib.diagnose.engine.lack_of_fit import Test, test_lack_of_fit
from calib.diagnose.engine.linear_model import LinearModel


@dataclass(frozen=True, slots=True)
class Share:
    """share : of the squares left, that smooth functions of a covariate explain beyond what as many numbers do by
    chance; p_value : of chance.
    """

    share: float
    p_value: float


@dataclass(frozen=True, slots=True)
class Covariate:
    """name; before, after : {what is looked at: Share}, with nothing admitted and with all."""

    name: str
    before: dict[str, Share]
    after: dict[str, Share]

    @property
    def weight(self) -> float:
        """The greatest share that it explained before."""
        return max((s.share for s in self.before.values()), default=0.0)


def explained_share(
    model: LinearModel, block: int, parts: list[tuple[FrameProducts, np.ndarray]], cluster: int = 1
) -> Share:
    """Share of a block's squares that functions explain. parts : [(FrameProducts, (F, a, q) weights)] fitted one beside
    the other
    cluster : frames in a row whose errors may be alike"""
    found = [
        test_lack_of_fit(model, products, Test("", "", (), weights, 1.0), cluster, alpha=1.0)
        for products, weights in parts
    ]
    seen = [u for u in found if u is not None]
    if not seen:
        return Share(0.0, 1.0)
    left = float(np.square(model.blocks[block].residual[model.blocks[block].frames_rows]).sum())
    beyond = sum(u.delta_chi2 * (u.dispersion or 1.0) - u.freedom for u in seen)
    p = (
        seen[0].p_value
        if len(seen) == 1
        else float(scipy.special.chdtrc(sum(u.freedom for u in seen), sum(u.delta_chi2 for u in seen)))
    )
    return Share(float(np.clip(beyond / max(left, 1e-300), 0.0, 1.0)), p)


def rank_covariates(before: dict[str, dict[str, Share]], after: dict[str, dict[str, Share]]) -> list[Covariate]:
    """[Covariate] of {name: {what: Share}} before and after, the one that explained most before first."""
    found = [Covariate(name, shares, after.get(name, {})) for name, shares in before.items()]
    return sorted(found, key=lambda c: -c.weight)
