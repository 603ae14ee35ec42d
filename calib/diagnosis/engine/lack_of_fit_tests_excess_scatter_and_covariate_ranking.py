"""Tests of lack of fit, excess scatter, and ranking of covariates.

Functions that residuals follow; excess scatter; covariates ranked.
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.diagnosis.engine.cross_validation_and_chance_probabilities import residual_dispersion, scan_p_value
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    SWALLOWED,
    FrameProducts,
    Normal,
    normal_equations_by_direction_weights,
    solve_normal_equations,
    solve_with_prior,
)
from calib.diagnosis.engine.linear_residual_model import LinearModel
from rig.array_and_json_types import Floats
from rig.model.arm_hands_effect_places_and_tolerances import Place

ALPHA = 1e-4  # chance of calling anything unknown where there is nothing, over all tests
LIKELY = 1e-3  # chance above which no dispersion is asked, since that only makes it likelier


@dataclass(frozen=True, slots=True)
class Test:
    """Of one basis of smooth functions, the simplest first, tested whole, at a place. weights : (F, a, q) of what a
    frame can be moved in
    unit : of the size
    depends_on : names of covariates; information : sum of 1 / unit^2 by which the place is weighed; prior : size of a
        coefficient, None for any"""

    place: Place
    unit: str
    depends_on: tuple[str, ...]
    weights: Floats
    information: float
    prior: float | None = None


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Something unknown at a place. magnitude : RMS of what it does, in unit; depends_on : names of covariates, none
    for scatter p_value; delta_chi2; freedom : parameters fitted; dispersion : that delta_chi2 was divided by, None for
    what is no function that was fitted
    simpler : ((delta chi-square, not divided, and parameters) of its first function alone, of its first two, ..)
    among : how many such were asked of its place, of which it is one"""

    place: Place
    magnitude: float
    unit: str
    depends_on: tuple[str, ...]
    p_value: float
    delta_chi2: float
    freedom: int = 1
    dispersion: float | None = None
    simpler: tuple[tuple[float, int], ...] = ()
    among: int = 1

    def delta_bic(self, size: int) -> float:
        """Bayesian information criterion's verdict: how much better than nothing, for residuals of a size."""
        return self.delta_chi2 - self.freedom * np.log(size)

    def shortest(self, size: int) -> tuple[float, float]:
        """(delta chi-square with the dispersion not allowed for, what its parameters and its choice among others cost)
        of as many of the functions, from the first on, as are worth it by Schwarz's criterion: to compare with
        candidates by (Chen and Chen, Biometrika 95, 2008)."""
        whole = self.delta_chi2 * (self.dispersion or 1.0), self.freedom
        delta, freedom = max((whole, *self.simpler), key=lambda one: one[0] - one[1] * np.log(size))
        return delta, float(freedom * np.log(size) + 2 * np.log(self.among))

    def evidence(self, size: int) -> float:
        """Minus twice the logarithm of how much likelier than nothing the shortest is, up to what all share."""
        delta, cost = self.shortest(size)
        return delta - cost


def test_lack_of_fit(
    model: LinearModel, products: FrameProducts, test: Test, correlated_frames: int = 1, alpha: float = LIKELY
) -> LackOfFit | None:
    """Lack of fit (LackOfFit) by a Test of smooth functions.

    None where the nuisances contain its functions.
    alpha : chance above which no dispersion is asked
    """
    normal = normal_equations_by_direction_weights(products, test.weights[None])
    solved = solve_normal_equations(normal) if test.prior is None else solve_with_prior(normal, test.prior)
    delta, rank = solved.delta_chi2, float(solved.rank[0])
    if rank == 0:
        return None
    p, spread = scan_p_value(delta, rank, np.inf), 1.0
    simpler = delta_chi2_and_rank_by_column_count(normal) if test.prior is None and p <= alpha else ()
    if p <= alpha:
        spread, freedom = residual_dispersion(model, products, test.weights, solved.coefficients[0], correlated_frames)
        p = scan_p_value(delta / spread, rank, freedom)
    magnitude = float(np.sqrt(max(delta[0] - rank, 0.0) / test.information))
    return LackOfFit(
        test.place,
        magnitude,
        test.unit,
        test.depends_on,
        p,
        float(delta[0] / spread),
        int(np.ceil(rank)),
        spread,
        simpler,
    )


def delta_chi2_and_rank_by_column_count(normal_equations: Normal) -> tuple[tuple[float, int], ...]:
    """Delta chi-square and rank by count of a candidate's columns.

    Of the first column alone, of the first two, and so on, by elimination.
    """
    scale = np.sqrt(np.maximum(normal_equations.raw[0], 1e-300))
    b, G = normal_equations.b[0] / scale, normal_equations.G[0] / scale[:, None] / scale
    delta, rank, out = 0.0, 0, []
    for j in range(len(b)):
        if G[j, j] > SWALLOWED:
            delta, rank, share = delta + float(b[j] ** 2 / G[j, j]), rank + 1, G[:, j] / G[j, j]
            b, G = b - share * b[j], G - np.outer(share, G[j])
        out.append((delta, rank))
    return tuple(out)


def significant_lack_of_fit(lacks_of_fit: list[LackOfFit | None], alpha: float = ALPHA) -> list[LackOfFit]:
    """The LackOfFits that are significant over all tests.

    The most significant first, functions before scatter.
    """
    held = [u for u in lacks_of_fit if u is not None]
    functions = Counter(u.place for u in held if u.dispersion is not None)
    held = [
        replace(u, among=functions[u.place] if u.dispersion is not None else 1)
        for u in held
        if u.p_value * len(held) < alpha
    ]
    return sorted(held, key=lambda u: (not u.depends_on, u.p_value if u.p_value > 0 else -u.delta_chi2))


def first_lack_of_fit_of_each_place(lacks_of_fit: list[LackOfFit]) -> list[LackOfFit]:
    """The first, most significant LackOfFit of each place, in order."""
    seen: dict[Place, LackOfFit] = {}
    for u in lacks_of_fit:
        seen.setdefault(u.place, u)
    return list(seen.values())


MATERIAL = 1.2  # times the stated noise; a statement of noise is seldom better than that


def detect_excess_scatter(
    place: Place,
    unit: str,
    noise: float,
    sum_of_squares: float,
    degrees_of_freedom: float,
    test_count: int = 1,
    depends_on: tuple[str, ...] = (),
    material: float = MATERIAL,
) -> LackOfFit | None:
    """LackOfFit of excess scatter at a place, beyond chance and the stated noise.

    None where noise suffices.
    noise : in unit, RMS of what is stated; sum_of_squares : sum of squares left, whitened by it
    test_count : how many such are made of one recording; material : times the noise that scatter must be
    """
    ratio = sum_of_squares / max(degrees_of_freedom, 1.0)
    chance = float(scipy.special.chdtrc(max(degrees_of_freedom, 1.0), sum_of_squares))
    if ratio <= material**2 or chance * test_count >= ALPHA:
        return None
    return LackOfFit(
        place, float(noise * np.sqrt(ratio - 1)), unit, depends_on, chance, float(sum_of_squares - degrees_of_freedom)
    )


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


def share_explained_by_functions(
    model: LinearModel, block: int, function_parts: list[tuple[FrameProducts, Floats]], correlated_frames: int = 1
) -> Share:
    """Share of a block's squares that functions explain.

    function_parts : [(FrameProducts, weights)], fitted together
    correlated_frames : frames in a row whose errors may be alike
    """
    found = [
        test_lack_of_fit(model, products, Test(Place(""), "", (), weights, 1.0), correlated_frames, alpha=1.0)
        for products, weights in function_parts
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
    """Covariates ranked by the share they explained before.

    Shares are {name: {what: Share}} before and after.
    """
    found = [Covariate(name, shares, after.get(name, {})) for name, shares in before.items()]
    return sorted(found, key=lambda c: -c.weight)
