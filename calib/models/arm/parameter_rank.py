"""Which parameters depend on others in the data at hand: pivoted QR of the scaled observation matrix, in words."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

PLAUSIBLE = {
    "m": 5e-3,
    "rad": 2e-2,
}  # what a maker's figure may be wrong by; data that tell less than this tell nothing
NAMED = 0.1  # share of the greatest coefficient from which a parameter is named as a partner


@dataclass(frozen=True, slots=True, eq=False)
class Rank:
    """free : (p,) bool, parameters fitted; dependent : pairs (held parameter, those it cannot be told from)
    condition : of the columns that were fitted, scaled by what is plausible; asked : parameters asked for."""

    free: np.ndarray
    dependent: tuple[tuple[str, tuple[str, ...]], ...]
    condition: float
    asked: int

    def report(self) -> list[str]:
        """Lines for a reader."""
        if not self.asked:
            return ["no parameters were sought"]
        lines = [f"{self.free.sum()} of {self.asked} parameters fitted; condition number {self.condition:.0f}"]
        lines += [
            f"{name} cannot be told from {', '.join(others)} and stays as stated"
            if others
            else f"{name} has no effect on what was measured and stays as stated"
            for name, others in self.dependent
        ]
        return lines


def independent_parameters(B: np.ndarray, free: np.ndarray, names: tuple[str, ...], units: tuple[str, ...]) -> Rank:
    """Rank of the columns of B (rows, p), rows whitened, of the parameters asked for: free (p,) bool.

    A column is dependent where, those before it given, the data leave its parameter less certain than PLAUSIBLE: a
    plain zero of the pivoted QR, but also a direction in which only rounding or noise would be fitted.
    """
    asked = np.flatnonzero(free)
    scaled = B[:, asked] * np.array([PLAUSIBLE[unit] for unit in units])[asked]
    dead = np.linalg.norm(scaled, axis=0) < 1
    live = asked[~dead]
    R, order = qr(scaled[:, ~dead], mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R)[: min(R.shape)])
    rank = int((diagonal >= 1).sum())
    keep = np.zeros(len(free), bool)
    keep[live[order[:rank]]] = True
    dependent = [(names[i], ()) for i in asked[dead]]
    if rank < len(live):
        partners = np.linalg.solve(R[:rank, :rank], R[:rank, rank:])
        for j, column in enumerate(partners.T):
            strong = np.abs(column) > NAMED * np.abs(column).max()
            dependent.append((names[live[order[rank + j]]], tuple(names[i] for i in live[order[:rank]][strong])))
    values = np.linalg.svd(R[:rank, :rank], compute_uv=False)
    return Rank(keep, tuple(dependent), float(values[0] / values[-1]), len(asked))
