"""Sizes of the components of each strut's deviations, drawn from their posterior given the closures.

Three kinds of machines are weighed: a sound one; one whose struts, most of them, have one component alone, of one size;
and one whose struts have each their own. A strut's closures are normal, with the variances of the poses, of its own
parameters and of its components; that a component is absent has a probability of its own, so that what nothing shows is
mostly 0. Source: George and McCulloch, Variable selection via Gibbs sampling, J. Am. Stat. Assoc. 88, 1993; Kass and
Raftery, Bayes factors, J. Am. Stat. Assoc. 90, 1995
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from calib.certification.strut_deviation_kernels import Component
from rig.arrays import Floats, Integers

SOUND, ALIKE, MIXED = 0.3, 0.4, 0.3  # probabilities, before the poses, of the three kinds
CLEARLY = 3.0  # of logarithms of probabilities
SHARED = 0.7  # probability of a strut to have the component of its machine
CHAINS, STEPS, BURN, EVERY = 8, 130, 50, 5  # sweeps over all components
LEAST, MOST = 0.3, 100.0  # sizes that a present component may have, in standard deviations of a closure's noise
SMALL = np.geomspace(0.15, 30.0, 14)  # sizes likewise of the component that struts have alike
BEYOND = 1e15  # more than closures' whitened squares add up to
WALK = 0.6  # of a size's logarithm, a step between present sizes
LARGEST = 120  # samples by which sizes are found; more are thinned out for that


class Closures(NamedTuple):
    """Of one strut at n samples. values : (n,) m; covariance : (n, n) m^2, of poses and parameters; unit : m, standard
    deviation of the noise
    parts : its Components"""

    values: Floats
    covariance: Floats
    unit: float
    parts: list[Component]


def draw_component_sizes(
    struts: list[Closures], scattered: Callable[[Floats], Floats], count: int, rng: np.random.Generator
) -> list[Floats]:
    """Draws of component sizes per strut (count, components) m; the same row of all struts is one machine.

    scattered : (k,) m -> (k,) by how much the log likelihood of all closures grows where all struts scatter by so much
    """
    n, axes = len(struts[0].values), len(struts)
    some = np.arange(n) if n <= LARGEST else np.sort(rng.choice(n, LARGEST, replace=False))
    problems = [_Problem(one, some) for one in struts]
    unit = float(np.sqrt(np.mean([one.unit**2 for one in struts])))
    names = {part.name: part.likely for one in struts for part in one.parts}
    total = sum(names.values())
    gains = {
        name: np.stack([problem.alone(name, SMALL * unit) for problem in problems]) for name in names
    }  # (axes, sizes) each
    with np.errstate(divide="ignore", over="ignore"):
        odds = {name: SHARED * np.exp(np.minimum(gain, 600.0)) for name, gain in gains.items()}
        alike = {
            name: np.log(1 - SHARED + odd).sum(axis=0) + np.log(ALIKE * names[name] / total / len(SMALL))
            for name, odd in odds.items()
        }
        chains = [problem.sampled(rng) for problem in problems]
        # the share of draws without any component, over what it was before, is p(closures | none) / p(closures)
        mixed = np.log(MIXED) - sum(
            np.log((~draws.any(axis=1)).mean() / problem.none) for draws, problem in zip(chains, problems)
        )
    first = next(iter(names))  # scatter
    if (
        max(mixed, *(one.max() for one in alike.values())) < np.log(SOUND) + CLEARLY
    ):  # no strut by itself says more than that all is sound
        together = scattered(SMALL * unit) + np.log(ALIKE * names[first] / total / len(SMALL))
        odds[first] = np.where(together > alike[first], np.inf, odds[first])
        alike[first] = np.maximum(alike[first], together)
    weight = np.concatenate([[np.log(SOUND), mixed], *alike.values()])
    weight = np.where(np.isposinf(weight), max(700.0, weight[np.isfinite(weight)].max()), weight)
    weight = np.exp(weight - weight.max())
    kind = rng.choice(len(weight), count, p=weight / weight.sum())
    out = [np.zeros((count, len(one.parts))) for one in struts]
    for k in np.flatnonzero(kind == 1):
        for strut, draws in zip(out, chains):
            strut[k] = draws[rng.integers(len(draws))]
    listed = list(names)
    for k in np.flatnonzero(kind > 1):
        name, at = listed[(kind[k] - 2) // len(SMALL)], (kind[k] - 2) % len(SMALL)
        odd = odds[name][:, at]
        for i in np.flatnonzero(rng.random(axes) < 1 / (1 + (1 - SHARED) / odd)):
            out[i][k, [part.name == name for part in struts[i].parts]] = SMALL[at] * unit
    return out


class _Problem:
    """The closures of one strut in units of their noise, at some samples."""

    def __init__(self, of: Closures, some: Integers) -> None:
        self.parts, self.unit = of.parts, of.unit
        self.y, self.base = of.values[some] / of.unit, of.covariance[np.ix_(some, some)] / of.unit**2
        self.flat = np.stack([(part.basis[some] @ part.basis[some].T).ravel() for part in of.parts])
        self.none = float(np.prod([1 - part.likely for part in of.parts]))

    def cost(self, state: Floats) -> Floats:
        """(states,) minus twice the log likelihood of states (states, components), logarithms of sizes."""
        n = len(self.y)
        V = np.empty((len(state), n + 1, n + 1))
        V[:, :n, :n] = self.base + (np.exp(2 * state) @ self.flat).reshape(-1, n, n)
        V[:, n, :n] = V[:, :n, n] = self.y
        V[:, n, n] = BEYOND
        L = np.linalg.cholesky(V)  # whose last row is the whitened y
        return np.asarray((L[:, n, :n] ** 2).sum(axis=1) + 2 * np.log(np.einsum("kii->ki", L[:, :n, :n])).sum(axis=1))

    def alone(self, name: str, size: Floats) -> Floats:
        """(k,) by how much the log likelihood grows with one component alone, of sizes (k,) m; nothing where the strut
        has none of that name.
        """
        state = np.full((1 + len(size), len(self.parts)), -np.inf)
        state[1:, [part.name == name for part in self.parts]] = np.log(size / self.unit)[:, None]
        cost = self.cost(state)
        return np.asarray(0.5 * (cost[0] - cost[1:]))

    def sampled(self, rng: np.random.Generator) -> Floats:
        """(draws, components) m of the sizes of the strut's own components: Metropolis steps, one component at a
        time.
        """
        likely, (low, high) = [part.likely for part in self.parts], np.log([LEAST, MOST])
        state = np.full((CHAINS, len(likely)), -np.inf)  # logarithms, none of what is absent
        gains = np.stack([self.alone(part.name, SMALL * self.unit) for part in self.parts])
        best = np.argsort(-gains.max(axis=1))[
            : CHAINS // 2
        ]  # every two chains begin with one that explains much by itself
        for chain, j in enumerate([*best, *best]):
            state[chain, j] = np.log(np.clip(SMALL[gains[j].argmax()], LEAST, MOST))
        cost, draws = self.cost(state), []
        for sweep in range(STEPS):
            for j in rng.permutation(len(likely)):
                new = np.where(
                    rng.random(CHAINS) < 0.5,
                    state[:, j] + WALK * rng.normal(size=CHAINS),
                    np.where(rng.random(CHAINS) < likely[j], rng.uniform(low, high, CHAINS), -np.inf),
                )
                inside = ~np.isfinite(new) | ((new >= low) & (new <= high))
                asked = np.flatnonzero(inside & (new != state[:, j]))  # most stay absent
                if not len(asked):
                    continue
                proposed = state[asked]
                proposed[:, j] = new[asked]
                costs = self.cost(proposed)
                better = np.log(rng.random(len(asked))) < 0.5 * (cost[asked] - costs)
                state[asked[better]], cost[asked[better]] = proposed[better], costs[better]
            if sweep >= BURN and (sweep - BURN) % EVERY == 0:
                draws.append(state.copy())
        return np.exp(np.concatenate(draws)) * self.unit
