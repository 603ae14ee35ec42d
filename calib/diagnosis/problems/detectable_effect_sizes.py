"""Smallest size of each effect that a recording would show.

From what nuisances leave of a candidate's columns, and the threshold that the search admits candidates by.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from calib.diagnosis.engine.candidate_scores_and_their_significance import Threshold, least_significant_delta_chi2
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import C, Node
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Dispersion
from calib.diagnosis.engine.forward_and_backward_term_selection import Selection
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import SWALLOWED
from calib.diagnosis.engine.problem_interface import Fit
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Candidate as EffectCandidate
from rig.effects.framework.parameters_covariates_and_marker_table import QUADRATURE, Parameter

NODES = 7  # of a grid that are looked at, evenly over it
INVERSE, RMS = "inverse", "rms"


@dataclass(frozen=True, slots=True)
class DetectableSize:
    """Smallest size of an effect at a place that would be found in about half of such recordings.

    parameter : that tells its size, RMS of what it moves where several numbers do; unit; size : of that, infinite where
        none within its bounds would be found; is_greatest : whether it is the greatest that would be found, as of a
        stiffness, 0 then where none would be
    """

    effect: str
    place: str
    parameter: str
    unit: str
    size: float
    is_greatest: bool = False

    @property
    def smallness(self) -> float:
        """A number that grows with what it takes to be found: the size, or its reciprocal."""
        return (1 / self.size if self.size else np.inf) if self.is_greatest else self.size


class SizeParameter(NamedTuple):
    """The parameter that tells an effect's size, and the columns (c,) of a candidate that it scales."""

    parameter: Parameter
    columns: Integers


def size_parameter(spec: EffectCandidate, node: Node) -> SizeParameter | None:
    """Size parameter (SizeParameter) of a candidate at a node.

    It is the linear one, the one sought over the grid where none is linear. None for several numbers, and where neither
    is there.
    """
    by = {p.name: p for p in spec.kind.parameters_at(spec.place)}
    named = [column.name for column in spec.linear if column.name != QUADRATURE]
    if not named:
        sized = [by[name] for name in node if name in by and by[name].role in ("linear", INVERSE, "size")]
        return SizeParameter(sized[0], np.zeros(1, int)) if sized else None
    own = [j for j, c in enumerate(spec.linear) if c.name in (named[0], QUADRATURE)]
    several = any(c.entry is not None for c in spec.linear if c.name == named[0])
    return None if several else SizeParameter(by[named[0]], np.array(own))


class NodeLook(NamedTuple):
    """What the data tell of a candidate at one node. gram : (q, q) by which delta chi-square grows with the squares of
    the coefficients; rank : numbers that the data determine
    moved : (q, q) by which the mean square of what the effect moves grows with the coefficients, in the square of unit
    whole : whether the node has the size, and gram is that of the whole effect
    """

    node: Node
    gram: Floats
    rank: float
    moved: Floats
    unit: str
    whole: bool = False

    def information(self, size: SizeParameter | None) -> float:
        """Delta chi-square per square of the size; of several numbers, per mean square of what they move, the mean over
        their independent combinations."""
        if size is None:
            return float(np.trace(np.linalg.pinv(self.moved, rcond=SWALLOWED, hermitian=True) @ self.gram)) / len(
                self.gram
            )
        own = float(np.diag(self.gram)[size.columns].mean())
        return own / float(self.node[size.parameter.name]) ** 2 if self.whole else own


def evenly_spaced_grid_nodes(grid: Sequence[Node]) -> list[Node]:
    """A few nodes, evenly over a grid."""
    at = np.unique(np.linspace(0, len(grid) - 1, min(len(grid), NODES)).round().astype(int))
    return [grid[i] for i in at]


def mean_square_displacement_matrix(moved: Floats) -> Floats:
    """Mean square (q, q) of what moves (n, a, q) per unit of each coefficient."""
    return np.einsum("nai,naj->ij", moved, moved) / len(moved)


def detectable_size(
    candidate: C,
    spec_at: Callable[[Node], EffectCandidate],
    looks: Sequence[NodeLook],
    dispersion: Callable[[Node], Dispersion],
    threshold: Threshold,
) -> DetectableSize:
    """Detectable size (DetectableSize) of a candidate.

    It is at its middle node by size.
    spec_at : of a node, the effect's candidate with its columns; looks : of some nodes; dispersion : of the residuals
        about a node
    """
    sized = [(look, size_parameter(spec_at(look.node), look.node)) for look in looks]
    information, look, named = sorted(
        ((look.information(named), look, named) for look, named in sized), key=lambda one: -one[0]
    )[len(looks) // 2]
    size = np.inf
    if information > 0 and look.rank > 0:
        about = dispersion(look.node)
        scan = len(candidate.grid), about.freedom
        least = least_significant_delta_chi2(look.rank, candidate.extra, scan, threshold)
        size = float(np.sqrt(threshold.delta_chi2_by_noise_alone(least * about.ratio) / information))
    if named is None:
        return DetectableSize(candidate.name, candidate.place, RMS, look.unit, size)
    parameter = named.parameter
    is_greatest = parameter.role == INVERSE
    if is_greatest:
        size = 1 / size if size * parameter.bounds[0] <= 1 else 0.0
    elif size > max(map(abs, parameter.bounds)):
        size = np.inf
    return DetectableSize(candidate.name, candidate.place, parameter.name, parameter.unit, size, is_greatest)


def smallest_detectable_size_by_place(sizes: Iterable[DetectableSize]) -> list[DetectableSize]:
    """Smallest of an effect's sizes at each place.

    They are of its variants, in the order of the search; of an effect that one number tells, those by that number.
    """
    sizes = list(sizes)
    by_number = {one.effect for one in sizes if one.parameter != RMS}
    out: dict[tuple[str, str], DetectableSize] = {}
    for one in sizes:
        if one.parameter != RMS or one.effect not in by_number:
            key = one.effect, one.place
            out[key] = min(out.get(key, one), one, key=lambda size: size.smallness)
    return list(out.values())


@runtime_checkable
class EffectDetection(Protocol[Fit, C]):
    """Capability: how large each effect would have to be to be found is known."""

    def detectable_sizes(self, selection: Selection[Fit, C]) -> list[DetectableSize]:
        """[DetectableSize] of each effect and place, but for those found, beside the findings."""
