"""What is left when every candidate has had its say: tests of smooth functions, and of scatter, that nobody named."""

from dataclasses import dataclass

import numpy as np

from calib.diagnose.engine.chance import davies, dispersion
from calib.diagnose.engine.linear import LinearModel
from calib.diagnose.engine.products import FrameProducts, framewise, solve, solve_with_prior

ALPHA = 1e-4  # chance of calling anything unknown where there is nothing, over all tests


@dataclass(frozen=True, slots=True)
class Test:
    """Of one basis of smooth functions, tested whole, at a place. weights : (F, a, q) of what a frame can be moved in; unit : of the size
    depends_on : names of covariates; information : sum of 1 / unit^2 by which the place is weighed; prior : size of a coefficient, None for any"""

    place: str
    unit: str
    depends_on: tuple[str, ...]
    weights: np.ndarray
    information: float
    prior: float | None = None


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Something unknown at a place. magnitude : RMS of what it does, in unit; depends_on : names of covariates, none for scatter
    p_value; delta_chi2; freedom : parameters fitted; dispersion : that delta_chi2 was divided by, None for what is no function that was fitted"""

    place: str
    magnitude: float
    unit: str
    depends_on: tuple[str, ...]
    p_value: float
    delta_chi2: float
    freedom: int = 1
    dispersion: float | None = None

    def delta_bic(self, size: int) -> float:
        """Bayesian information criterion's verdict: how much better than nothing, for residuals of a size."""
        return self.delta_chi2 - self.freedom * np.log(size)

    def evidence(self, size: int) -> float:
        """The same with the dispersion not allowed for, to compare with candidates by."""
        return self.delta_chi2 * (self.dispersion or 1.0) - self.freedom * np.log(size)


def tested(model: LinearModel, products: FrameProducts, test: Test, cluster: int = 1, alpha: float = ALPHA) -> LackOfFit | None:
    """LackOfFit of a Test, None where the nuisances swallow its functions: what the fit explains beyond what noise alone would, nuisances
    taken out, tells their size. alpha : chance above which no dispersion is asked, since that only makes it likelier"""
    normal = framewise(products, test.weights[None])
    solved = solve(normal) if test.prior is None else solve_with_prior(normal, test.prior)
    delta, rank = solved.delta_chi2, float(solved.rank[0])
    if rank == 0:
        return None
    p, spread = davies(delta, rank, np.inf), 1.0
    if p <= alpha:
        spread, freedom = dispersion(model, products, test.weights, solved.coefficients[0], cluster)
        p = davies(delta / spread, rank, freedom)
    magnitude = float(np.sqrt(max(delta[0] - rank, 0.0) / test.information))
    return LackOfFit(test.place, magnitude, test.unit, test.depends_on, p, float(delta[0] / spread), int(np.ceil(rank)), spread)


def convincing(found: list[LackOfFit | None]) -> list[LackOfFit]:
    """Those too good for chance over all of them, functions of something before scatter, the most convincing first."""
    held = [u for u in found if u is not None]
    held = [u for u in held if u.p_value * len(held) < ALPHA]
    return sorted(held, key=lambda u: (not u.depends_on, u.p_value if u.p_value > 0 else -u.delta_chi2))


def first_of_each_place(found: list[LackOfFit]) -> list[LackOfFit]:
    """The most convincing of each place, in order."""
    seen: dict[str, LackOfFit] = {}
    for u in found:
        seen.setdefault(u.place, u)
    return list(seen.values())
