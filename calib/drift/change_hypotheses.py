"""What may have changed: each hypothesis frees some unknowns from one visit on, and has a size that it may plausibly
have.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from calib.drift.first_visit_reference import Reference
from calib.drift.machine_changes import GAP, GROWTH, OWN, SOFT, UNITS
from calib.drift.visit_equations import GEOMETRY
from vision.bundle.unknown_priors import POSE_SCALE

SIZES = (1.0, 0.25, 0.0625)  # of the greatest plausible size, each as likely
PLACE_SIZE, ZERO_SIZE, GAP_SIZE, GROWTH_SIZE, SOFT_SIZE = (
    2e-3,
    1e-3,
    4e-4,
    4e-4,
    8e-5,
)  # m and rad, m, m, share, kg/(N/m): standard deviations
STATED = {
    "camera": 1e-2,
    "target": 1e-3,
    "instrument": 1e-3,
}  # m, rad; how far a place may be from where it counts from, before any visit
LEFT_OUT = (
    *(2e-5,) * 6,
    5e-5,
    5e-6,
)  # m, share, kg/(N/m): what of OWN a calibration that held on its own day may have left out
KINDS = ("camera", "target", "zero", "nut", "temperature", "payload")  # each as likely; "something" is one more
SOMETHING = "something"


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """kind : of KINDS; name : in words; columns : (q,) of the unknowns; size : (q,) their greatest plausible standard
    deviation, scaled
    unit : (q,) own units (m, rad, a share, kg/(N/m)) of a scaled unknown; prior : its probability, were there a
        change."""

    kind: str
    name: str
    columns: np.ndarray
    size: np.ndarray
    unit: np.ndarray
    prior: float


def change_hypotheses(reference: Reference) -> list[Hypothesis]:
    """[Hypothesis] of all that may change on a rig."""
    places = 6 * len(reference.places)
    own, zeros = places + GEOMETRY, places + GEOMETRY - 6
    found: list[tuple[str, str, list[int], float, float]] = []
    for k, name in enumerate(reference.places):
        kind = "target" if name.startswith("target") else "camera"
        found.append((kind, name, list(range(6 * k, 6 * k + 6)), PLACE_SIZE, POSE_SCALE))
    found += [("zero", f"zero of strut {i + 1}", [zeros + i], ZERO_SIZE, POSE_SCALE) for i in range(6)]
    found += [("nut", OWN[i], [own + i], GAP_SIZE, GAP) for i in range(6)]
    found += [("temperature", OWN[6], [own + 6], GROWTH_SIZE, GROWTH), ("payload", OWN[7], [own + 7], SOFT_SIZE, SOFT)]
    members = {kind: sum(one[0] == kind for one in found) for kind in KINDS}
    return [
        Hypothesis(
            kind,
            name,
            np.array(columns),
            np.full(len(columns), size / unit),
            np.full(len(columns), unit),
            1 / (len(KINDS) + 1) / members[kind],
        )
        for kind, name, columns, size, unit in found
    ]


def prior_information(reference: Reference, covariance: np.ndarray) -> np.ndarray:
    """(p, p) information, scaled, in what stays constant from visit to visit before any: places, the geometry, whose
    covariance (42, 42) m^2 is the calibration's, and what it left out."""
    places = np.concatenate([np.full(6, POSE_SCALE / STATED[name.split(" ")[0]]) for name in reference.places])
    values, vectors = np.linalg.eigh(covariance / POSE_SCALE**2)
    values = np.maximum(values, values[-1] * 1e-12)
    return np.asarray(
        block_diag(np.diag(places**2), vectors / values @ vectors.T, np.diag((np.array(UNITS) / LEFT_OUT) ** 2))
    )
