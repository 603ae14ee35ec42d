"""What poses tell of a hexapod's 42 parameters: which combinations they determine, how well, and what each is in plain terms."""

from dataclasses import dataclass

import numpy as np

from calib.identify.geometry import NAMES
from calib.identify.least_squares import Visibility, visibility
from rig.design import Hexapod
from rig.mechanisms import hexapod as mechanism
from rig.pose import skew

PLAUSIBLE = 5e-4  # m; how far off a joint or a zero may well be
TERMS = 3  # of a combination's description
MOSTLY = 0.9  # share of a combination that its description covers, where that many terms suffice


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """direction : (42,) unit; sigma : m, standard error along it from the poses alone; name : what it is, mostly."""

    direction: np.ndarray
    sigma: float
    name: str

    @property
    def determined(self) -> bool:
        """Whether the poses say more of it than its plausible size does."""
        return self.sigma < PLAUSIBLE


def combinations(root: np.ndarray, hexapod: Hexapod) -> tuple[tuple[Combination, ...], Visibility]:
    """(tuple of 42 Combinations, the worst determined first; Visibility) of the information's square root (42, 42) 1/m."""
    seen: Visibility = visibility(root, np.full(42, PLAUSIBLE))
    patterns = _patterns(hexapod)
    with np.errstate(divide="ignore"):
        sigma = PLAUSIBLE / seen.singular
    return tuple(Combination(d, float(s), describe(d, patterns)) for d, s in zip(seen.directions[::-1], sigma[::-1])), seen


def gauge(hexapod: Hexapod) -> np.ndarray:
    """(42, 12) the parameters' motions with the frames: base joints with the base frame (x y z rx ry rz), platform joints with theirs.

    Where targets with stated poses hold both frames the poses determine them like any other combination; where an instrument
    stands free, or its tool sits anywhere, they are no different from where it stands and must be held.
    """
    out = np.zeros((42, 12))
    for k, joints in enumerate((hexapod.base_joints, hexapod.platform_joints)):
        out[18 * k : 18 * k + 18, 6 * k : 6 * k + 6] = np.concatenate([np.tile(np.eye(3), (6, 1, 1)), -skew(joints)], axis=2).reshape(18, 6)
    return out


def describe(direction: np.ndarray, patterns: dict[str, np.ndarray]) -> str:
    """A unit direction (42,) in words: up to TERMS of the patterns {name: (42,) unit} or single parameters, the largest first."""
    left, terms = direction.copy(), list[str]()
    while len(terms) < TERMS and left @ left > 1 - MOSTLY:
        shares = {name: left @ pattern for name, pattern in patterns.items()}
        name = max(shares, key=lambda key: abs(shares[key]))
        terms.append(f"{shares[name]:+.2f} {name}")
        left = left - shares[name] * patterns[name]
    return ", ".join(terms)


def _patterns(hexapod: Hexapod) -> dict[str, np.ndarray]:
    """{name: unit direction (42,)}: plates moved and scaled as a whole, all zeros together, each strut's loop, each parameter alone."""
    found = {}
    motions = gauge(hexapod)
    for k, plate in enumerate(("base", "platform")):
        for j, axis in enumerate(("along x", "along y", "along z", "about x", "about y", "about z")):
            found[f"{plate} joints moved {axis}"] = motions[:, 6 * k + j]
        joints = hexapod.base_joints if k == 0 else hexapod.platform_joints
        found[f"{plate} joints spread"] = np.r_[np.zeros(18 * k), (joints - joints.mean(axis=0)).ravel(), np.zeros(24 - 18 * k)]
    found["all zeros"] = np.r_[np.zeros(36), np.ones(6)]
    u = _directions(hexapod)
    for i in range(6):
        for name, start in (("base", 0), ("platform", 18)):
            along = np.zeros(42)
            along[start + 3 * i : start + 3 * i + 3] = u[i]
            found[f"{name} joint {i + 1} along its strut"] = along
    for i, name in enumerate(NAMES):
        found[name] = np.eye(42)[i]
    return {name: pattern / np.linalg.norm(pattern) for name, pattern in found.items() if np.linalg.norm(pattern) > 0}


def _directions(hexapod: Hexapod) -> np.ndarray:
    """(6, 3) the struts' unit directions at home, in the base frame."""
    return mechanism.jacobian(hexapod.home, hexapod)[:, :3] @ hexapod.home.rotation.as_matrix().T
