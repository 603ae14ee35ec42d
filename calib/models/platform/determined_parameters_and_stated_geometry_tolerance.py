"""Determined parameters, and tolerance of the stated geometry.

Parameter combinations that a platform's poses determine.

The widths of these draws, one for the joints' coordinates and one for the zeros, are found by the evidence, so that
what the poses do not tell rests on a tolerance that they bear out, and what is promised of it too. Source: MacKay,
Bayesian interpolation, Neural Computation 1992.
"""

from dataclasses import dataclass

import numpy as np

from calib.identify.bounded_and_robust_least_squares_fit import Visibility, parameter_visibility
from calib.models.platform.platform_identification import PRIOR, Identified
from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import FileMechanism, Hexapod
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    Struts,
    geometric_parameters,
    parameter_group_sizes,
    parameter_names,
)
from rig.model.pose import skew

PLAUSIBLE = 5e-4  # m; how far off a joint or a zero may well be
TERMS = 3  # of a combination's description
MOSTLY = 0.9  # share of a combination that its description covers, where that many terms suffice


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """direction : (p,) unit; sigma : m, standard error along it from the poses alone; name : what it is, mostly."""

    direction: Floats
    sigma: float
    name: str

    @property
    def determined(self) -> bool:
        """Whether the poses say more of it than its plausible size does."""
        return self.sigma < PLAUSIBLE


def parameter_combinations_and_visibility(
    information_root: Floats, mechanism: Parallel
) -> tuple[tuple[Combination, ...], Visibility]:
    """Parameter combinations, and Visibility, by the information's root (p, p) 1/m.

    The worst determined comes first.
    """
    seen: Visibility = parameter_visibility(information_root, np.full(information_root.shape[1], PLAUSIBLE))
    patterns = _patterns(mechanism)
    with np.errstate(divide="ignore"):
        sigma = PLAUSIBLE / seen.singular
    return tuple(
        Combination(d, float(s), _direction_text(d, patterns)) for d, s in zip(seen.directions[::-1], sigma[::-1])
    ), seen


def standard_error_along(information_root: Floats, direction: Floats) -> float:
    """Standard error (m) along a direction (p,) for the information's square root."""
    return float(np.linalg.norm(np.linalg.solve(information_root.T, direction)))


def parameter_changes_by_base_and_platform_frame_motion(mechanism: Hexapod) -> Floats:
    """Parameter changes (7 struts, 12) by motion of the base's and the platform's frame.

    The parameters' change with the base frame and the platform frame.

    Where targets with stated poses hold both frames the poses determine them like any other combination; where an
    instrument stands free, or its tool sits anywhere, they are no different from where it stands and must be held.
    """
    count = len(mechanism.axes)
    out = np.zeros((7 * count, 12))
    for k, joints in enumerate((mechanism.base_joints, mechanism.platform_joints)):
        out[3 * count * k : 3 * count * (k + 1), 6 * k : 6 * k + 6] = np.concatenate(
            [np.tile(np.eye(3), (count, 1, 1)), -skew(joints)], axis=2
        ).reshape(-1, 6)
    return out


def base_motion_columns(mechanism: Struts) -> Floats:
    """Base motion columns (p, 6).

    The parameters' change with the base frame; of two struts (6, 3).
    """
    if isinstance(mechanism, Hexapod):
        return parameter_changes_by_base_and_platform_frame_motion(mechanism)[:, :6]
    out = np.zeros((6, 3))
    out[0:4:2, 0] = out[1:4:2, 1] = 1.0
    out[:4, 2] = (mechanism.base_joints @ [[0, 1.0], [-1, 0]]).ravel()
    return out


def _direction_text(direction: Floats, patterns: dict[str, Floats]) -> str:
    """A unit direction (p,) in words: up to TERMS of the patterns {name: (p,) unit} or single parameters, the largest
    first.
    """
    left, terms = direction.copy(), list[str]()
    while len(terms) < TERMS and left @ left > 1 - MOSTLY:
        shares = {name: left @ pattern for name, pattern in patterns.items()}
        name = max(shares, key=lambda key: abs(shares[key]))
        terms.append(f"{shares[name]:+.2f} {name}")
        left = left - shares[name] * patterns[name]
    return ", ".join(terms)


def _patterns(mechanism: Parallel) -> dict[str, Floats]:
    """{name: unit direction (p,)}: plates moved and scaled as a whole, all zeros together, each strut's loop, each
    parameter alone.
    """
    found: dict[str, Floats] = (
        _of_hexapod(mechanism)
        if isinstance(mechanism, Hexapod)
        else {}
        if isinstance(mechanism, FileMechanism)
        else {
            **{
                f"base joints moved {axis}": motion
                for axis, motion in zip(("along x", "along y", "about z"), base_motion_columns(mechanism).T)
            },
            "base joints spread": np.r_[(mechanism.base_joints - mechanism.base_joints.mean(axis=0)).ravel(), 0, 0],
            "both zeros": np.r_[np.zeros(4), 1, 1.0],
        }
    )
    names = parameter_names(mechanism)
    for name, unit in zip(names, np.eye(len(names))):
        found[name] = unit
    return {name: pattern / np.linalg.norm(pattern) for name, pattern in found.items() if np.linalg.norm(pattern) > 0}


def _of_hexapod(mechanism: Hexapod) -> dict[str, Floats]:
    """{name: direction (7 struts,)} of a hexapod's patterns beyond single parameters."""
    found, count = {}, len(mechanism.axes)
    motions = parameter_changes_by_base_and_platform_frame_motion(mechanism)
    for k, plate in enumerate(("base", "platform")):
        for j, axis in enumerate(("along x", "along y", "along z", "about x", "about y", "about z")):
            found[f"{plate} joints moved {axis}"] = motions[:, 6 * k + j]
        joints = mechanism.base_joints if k == 0 else mechanism.platform_joints
        found[f"{plate} joints spread"] = np.r_[
            np.zeros(3 * count * k), (joints - joints.mean(axis=0)).ravel(), np.zeros(count * (4 - 3 * k))
        ]
    found["all zeros"] = np.r_[np.zeros(6 * count), np.ones(count)]
    u = _directions(mechanism)
    for i in range(count):
        for name, start in (("base", 0), ("platform", 3 * count)):
            along = np.zeros(7 * count)
            along[start + 3 * i : start + 3 * i + 3] = u[i]
            found[f"{name} joint {i + 1} along its strut"] = along
    return found


def _directions(mechanism: Hexapod) -> Floats:
    """(struts, 3) the struts' unit directions at home, in the base frame."""
    return hexapod.jacobian(mechanism.home, mechanism)[:, :3] @ mechanism.home.rotation.as_matrix().T


LEAST = 1e-5  # m; no owner knows his joints better
STEPS = 25  # of the grid of either width, in equal ratios


@dataclass(frozen=True, slots=True, eq=False)
class Tolerance:
    """widths : (k, 2) m, of joints and of zeros; weight : (k,) probability of each pair
    information : (p, p) 1/m^2 of the poses alone; right : (p,) 1/m, information times what the poses alone move the
        parameters by
    counts : how many of the parameters are joints' coordinates and how many are zeros
    """

    widths: Floats
    weight: Floats
    information: Floats
    right: Floats
    counts: tuple[int, int]

    @property
    def prior(self) -> Floats:
        """(p,) m, the likeliest standard deviation of each parameter (the mean of its logarithm)."""
        return expand_parameter_widths(np.exp(self.weight @ np.log(self.widths)), self.counts)


def expand_parameter_widths(widths: Floats, counts: tuple[int, int]) -> Floats:
    """Widths (..., p) of all parameters, expanded from those (..., 2) of joints and of zeros."""
    return np.repeat(widths, counts, axis=-1)


def estimate_tolerance_of_stated_geometry(identified: Identified, nominal: Parallel) -> Tolerance:
    """Estimated tolerance of the owner's stated geometry.

    Probable widths of its errors, 10 um to 5 mm.
    """
    information = identified.root.T @ identified.root
    counts = parameter_group_sizes(nominal)
    right = (
        information @ (geometric_parameters(identified.mechanism) - geometric_parameters(nominal))
        + (geometric_parameters(identified.mechanism) - geometric_parameters(nominal)) / identified.prior**2
    )
    grid = np.geomspace(LEAST, PRIOR, STEPS)
    widths = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    sigma = expand_parameter_widths(widths, counts)
    # with p = sigma x, x ~ N(0, I): log evidence = -1/2 log |I + sigma Lambda sigma| + 1/2 |L^-1 sigma right|^2
    L = np.linalg.cholesky(np.eye(len(identified.prior)) + sigma[:, :, None] * information * sigma[:, None, :])
    half = np.linalg.solve(L, (sigma * right)[..., None])[..., 0]
    evidence = 0.5 * (half**2).sum(axis=1) - np.log(np.einsum("kii->ki", L)).sum(axis=1)
    weight = np.exp(evidence - evidence.max())
    return Tolerance(widths, weight / weight.sum(), information, right, counts)
