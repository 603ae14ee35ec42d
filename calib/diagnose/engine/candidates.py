"""What may be admitted: something at a place, with the grid over which its nonlinear parameters are sought."""

from dataclasses import dataclass
from enum import Enum
from typing import TypeVar

import numpy as np

Node = dict  # {parameter: value} of the nonlinear parameters, one node of a candidate's grid


class Role(Enum):
    """How a number that rigs show over some range enters: in proportion, by its reciprocal, or as the size that a grid
    goes through.
    """

    LINEAR = "linear"
    INVERSE = "inverse"
    SIZE = "size"


@dataclass(frozen=True, slots=True)
class UsualRange:
    """What rigs show of one number: low, high in its own unit; signed : whether minus that is as usual; role."""

    name: str
    low: float
    high: float
    signed: bool
    role: Role


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Candidate:
    """Something that may be at a place. Candidates are told apart by identity.

    name; place; grid : [Node] in the order of the search; label : which variant
    extra : nonlinear parameters that the search chooses; tied : coefficients that the others determine
    usual : what rigs show of its numbers, None where nobody says
    bounds : (low (q,), high (q,)) of its coefficients, None for none
    vector : whether its size is many numbers, of which nobody says what is usual
    searched : whether a parameter that means nothing without the effect is sought over the grid, so that the search
        over it tells its cost
    """

    name: str
    place: str
    grid: list[Node]
    label: str = ""
    extra: int = 0
    tied: int = 0
    usual: tuple[UsualRange, ...] | None = None
    bounds: tuple[np.ndarray, np.ndarray] | None = None
    searched: bool = False
    vector: bool = False

    def allowed(self, coefficients: np.ndarray) -> np.ndarray:
        """Coefficients (q,) within the bounds, those beyond at them."""
        return coefficients if self.bounds is None or not len(coefficients) else np.clip(coefficients, *self.bounds)


C = TypeVar("C", bound=Candidate)  # a problem's own kind of candidate


@dataclass(frozen=True, slots=True)
class NotAsked:
    """An effect that a recording cannot show, and why."""

    effect: str
    reason: str
