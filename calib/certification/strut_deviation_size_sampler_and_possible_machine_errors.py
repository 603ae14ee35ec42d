"""Sampler of strut deviation sizes, and pose errors of possible machines.

Sizes by component, and possible machines with their pose errors over the workspace.

Three kinds of machines are weighed: a sound one; one whose struts, most of them, have one component alone, of one size;
and one whose struts have each their own. A strut's closures are normal, with the variances of the poses, of its own
parameters and of its components; that a component is absent has a probability of its own, so that what nothing shows is
mostly 0. Source: George and McCulloch, Variable selection via Gibbs sampling, J. Am. Stat. Assoc. 88, 1993; Kass and
Raftery, Bayes factors, J. Am. Stat. Assoc. 90, 1995
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from calib.certification.strut_deviation_covariance_functions_by_cause import (
    CONDITION,
    CONFIGURATION,
    PLACE,
    SAMPLE,
    Component,
)
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.formats.numbers_and_units import number_text

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


def draw_strut_deviation_component_sizes(
    struts: list[Closures],
    scatter_log_likelihood_gain: Callable[[Floats], Floats],
    count: int,
    rng: np.random.Generator,
) -> list[Floats]:
    """Draws (count, components) m of the sizes of each strut's deviation components.

    A row a machine.
    scatter_log_likelihood_gain : (k,) m -> (k,) by how much the log likelihood of all closures grows where all struts
    scatter by so much
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
        together = scatter_log_likelihood_gain(SMALL * unit) + np.log(ALIKE * names[first] / total / len(SMALL))
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
        self.none = float(np.prod([1 - part.likely for part in of.parts]))
        lower = np.linalg.cholesky(of.covariance[np.ix_(some, some)])
        self.y = solve_triangular(lower, of.values[some], lower=True)
        self.white = [of.unit * solve_triangular(lower, part.basis[some], lower=True) for part in of.parts]
        self.flat = np.stack([(W @ W.T).ravel() for W in self.white])

    def cost(self, state: Floats) -> Floats:
        """(states,) minus twice the log likelihood of states (states, components), logarithms of sizes, to a
        constant.
        """
        return np.array([self._cost(one) for one in np.exp(state)])

    def _cost(self, size: Floats) -> float:
        """The same of sizes (components,): by as many unknowns as the present components' bases have, where these are
        fewer than the samples (Woodbury).
        """
        n, present = len(self.y), np.flatnonzero(size)
        few = sum(self.white[j].shape[1] for j in present) < n
        if few:
            W = np.hstack([np.zeros((n, 0)), *(size[j] * self.white[j] for j in present)])
            V, right = W.T @ W, W.T @ self.y
        else:
            V, right = (size[present] ** 2 @ self.flat[present]).reshape(n, n), self.y
        m = len(V)
        bordered = np.eye(m + 1)
        bordered[:m, :m] += V
        bordered[m, :m], bordered[m, m] = right, BEYOND
        L = np.linalg.cholesky(bordered)  # whose last row is the whitened right side
        square = L[m, :m] @ L[m, :m]
        return float((self.y @ self.y - square if few else square) + 2 * np.log(np.diag(L)[:m]).sum())

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
                changed = np.flatnonzero(inside & (new != state[:, j]))  # most stay absent
                if not len(changed):
                    continue
                proposed = state[changed]
                proposed[:, j] = new[changed]
                costs = self.cost(proposed)
                better = np.log(rng.random(len(changed))) < 0.5 * (cost[changed] - costs)
                state[changed[better]], cost[changed[better]] = proposed[better], costs[better]
            if sweep >= BURN and (sweep - BURN) % EVERY == 0:
                draws.append(state.copy())
        return np.exp(np.concatenate(draws)) * self.unit


ANY = "any"
SURELY = 0.95  # probability from which a component is reported
# of the greatest singular value; combinations of a strut's parameters that are fainter stand for no function of place
FAINT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Machines:
    """d machines about a fit, and what their struts do at m places of the workspace.

    parameters : (d, p) m, less the fitted ones; components : per strut its Components; parts : per strut (d, its
    components) m^2, mean square over the workspace of each
    mean : (d, m, axes) m by which struts are longer at the places than commanded, in the mean over the ways to come
    there; variance : (d, m, axes) m^2 about that; together : (d, axes, axes) m^2, covariance of what goes by time,
    temperature and load as recorded
    seen : (d, axes, axes) m^2, likewise of what either the struts do or whoever measured them saw amiss; amiss : (d,)
        bool, where it is the latter
    """

    parameters: Floats
    components: list[list[Component]]
    parts: list[Floats]
    mean: Floats
    variance: Floats
    together: Floats
    seen: Floats
    amiss: Booleans

    def squares(self, jacobian: Floats, back: Floats, offset: Floats, rho: Floats) -> tuple[Floats, Floats]:
        """(before, after), each (d, 2) m^2 and rad^2: the pose error's mean square over the places, by the owner's
        model and corrected.

        jacobian : (m, 6, p) and back : (m, 6, axes) of poses with parameters and struts; offset : (m, 6) of the owner's
        model against the corrected one; rho : (m, axes) m, the remainder
        """
        error = np.einsum("mip,dp->dmi", jacobian, self.parameters) + np.einsum("mia,dma->dmi", back, self.mean + rho)
        beyond = np.einsum("mia,dma->di", back**2, self.variance) / len(back)
        together = self.together + self.seen * ~self.amiss[:, None, None]
        beyond += np.einsum("mia,dab,mib->di", back, together, back, optimize=True) / len(back)
        before, after = (
            ((whole**2).mean(axis=1) + beyond).reshape(-1, 2, 3).sum(axis=2) for whole in (error + offset, error)
        )
        return before, after

    def second_moments(self, loops: Floats, rho: Floats) -> tuple[Floats, Floats]:
        """((p, p) m^2 of the parameters about the fitted ones, (axes, axes) m^2 of what struts are off besides), which
        over the workspace add up to what the machines do there: what is a function of place counts as parameters as far
        as these can stand for it.

        loops : (m, axes, p) derivatives of the struts' closures with the parameters at the places; rho : (m, axes) m,
            the remainder
        """
        beyond, parameters = self.mean + rho, self.parameters.copy()
        left = np.empty_like(beyond)
        for i in range(beyond.shape[2]):
            found = beyond[:, :, i] @ np.linalg.pinv(loops[:, i], rcond=FAINT).T
            parameters += found
            left[:, :, i] = beyond[:, :, i] - found @ loops[:, i].T
        rows = left.reshape(-1, left.shape[2])
        own = (
            np.diag(self.variance.mean(axis=(0, 1)))
            + (self.together + self.seen).mean(axis=0)
            + rows.T @ rows / len(rows)
        )
        return parameters.T @ parameters / len(parameters), (own + own.T) / 2

    def with_more(self, parameters: Floats, course: Floats) -> "Machines":
        """The machines with errors added. parameters : (d, p) m; course : (d, n, axes) m, of struts in the course of
        the recording
        """
        about = course - course.mean(axis=1, keepdims=True)
        more = np.swapaxes(about, 1, 2) @ about / course.shape[1]
        return replace(
            self,
            parameters=self.parameters + parameters,
            mean=self.mean + course.mean(axis=1)[:, None],
            together=self.together + more,
        )

    def moved(self, parameters: Floats) -> "Machines":
        """The machines about another fit, whose parameters exceed this one's by (p,) m."""
        return replace(self, parameters=self.parameters - parameters)

    def unexplained(self, corrected: tuple[bool, ...], axis: str, units: tuple[str, ...]) -> tuple[str, ...]:
        """A sentence for each thing that struts do, almost certainly, and that nothing corrects.

        corrected : per strut, whether functions of place are; axis : what an axis is called; units : of each, m or rad
        """
        found: dict[tuple[str, str], dict[int, float]] = {}
        rest = []
        for i, (own, parts) in enumerate(zip(self.components, self.parts)):
            groups = {
                (part.over, part.word if part.over == CONDITION else ""): None
                for part in own
                if not (part.over == PLACE and corrected[i])
            }
            squares = {
                key: parts[:, [(part.over, part.word if part.over == CONDITION else "") == key for part in own]].sum(
                    axis=1
                )
                for key in groups
            }
            sure = [key for key, square in squares.items() if _surely(square)]
            for key in sure:
                found.setdefault(key, {})[i] = _size(squares[key])
            rest.append(np.sum([square for key, square in squares.items() if key not in sure], axis=0))
            if not sure and _surely(rest[-1]):
                found.setdefault((ANY, ""), {})[i] = _size(rest[-1])
        if not found and _surely(np.sum(rest, axis=0)):
            return (
                f"the {_plural(axis)} together leave {number_text(_size(np.sum(rest, axis=0)) * 1e6, 2)} "
                f"{_micro(units)} beyond what the stated pose noise explains, "
                "which is attributable to no single one or cause",
            )
        return tuple(_sentence(over, word, sizes, axis, units) for (over, word), sizes in found.items())


def _surely(squares: Floats) -> bool:
    return bool((squares > 0).mean() > SURELY)


def _size(squares: Floats) -> float:
    return float(np.sqrt(np.median(squares[squares > 0])))


def _plural(axis: str) -> str:
    return "axes" if axis == "axis" else f"{axis}s"


def _micro(units: Iterable[str]) -> str:
    """Millionths of units, as messages name them."""
    return " or ".join(f"u{unit}" for unit in dict.fromkeys(units))


def _sentence(over: str, word: str, sizes: dict[int, float], axis: str, units: tuple[str, ...]) -> str:
    struts = f"{axis if len(sizes) == 1 else _plural(axis)} {', '.join(str(i + 1) for i in sizes)}"
    size = f"{number_text(max(sizes.values()) * 1e6, 2)} {_micro(units[i] for i in sizes)}" + (
        "" if len(sizes) == 1 else " at most"
    )
    what = {
        SAMPLE: f"scatter by {size} beyond what the stated pose noise explains",
        CONFIGURATION: f"differ from configuration to configuration by {size}, with no pattern "
        "that these poses resolve",
        ANY: f"are {size} beyond what the stated pose noise explains, of a cause that these poses do not identify",
        PLACE: f"depend on the configuration, {size}, which no remainder corrects",
    }
    return f"{struts}: residuals {what.get(over, f'depend on {word}, {size}, which this calibration does not correct')}"
