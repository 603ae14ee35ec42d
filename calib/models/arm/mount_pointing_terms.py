"""Pointing terms of a two-axis mount.

The names, values and uncertainties that astronomers use for what was found.

Directions are in a frame with x north, y east and z down. A term is what the direction of the telescope has beyond its
commanded one, in azimuth A and elevation E, or in hour angle h and declination d. The first order of the terms is
matched with that of the arm's parameters, so that both state one mount.
Source: Wallace, TPOINT telescope pointing analysis system (terms and their signs); Meeks, Ball and Hull, IEEE Trans.
Antennas Propag. 16, 1968
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.models.arm import arm_error_model_and_instrument_observations
from calib.models.arm.arm_identification_and_joint_profiles import independent_arm_parameter_mask
from rig.array_and_json_types import Floats, Json
from rig.effects.catalogue.effect_list import compliance_under_link_weight, mass_and_moments_over_stiffness
from rig.effects.framework.effect_base_class import Effect
from rig.errors import RigError
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm

ZENITH, NORTH, EAST = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
UPRIGHT = float(np.cos(np.radians(5)))  # first axes nearer to the vertical than this are of an altazimuth mount
ALONG = 0.99  # cosine with an axis of the last link, from which the tube lies along it
START = 1e-7  # rad per m/s^2, from which a tube's flexure is fitted
EXACT = 1e-6  # of a term, that the arm's parameters may not reproduce
FLEXURE = "TF"
ARCSEC = np.pi / 648000
Column = Callable[[Floats, Floats], tuple[Floats, Floats]]  # of (A, E) or (h, d): (change of the first times cos, of E)

ALTAZIMUTH: dict[str, tuple[str, Column]] = {
    "IA": ("index error in azimuth", lambda a, e: (-np.cos(e), 0 * e)),
    "IE": ("index error in elevation", lambda a, e: (0 * e, 1 + 0 * e)),
    "CA": ("collimation: left-right error of the telescope", lambda a, e: (-1 + 0 * e, 0 * e)),
    "NPAE": ("azimuth and elevation axes not perpendicular", lambda a, e: (-np.sin(e), 0 * e)),
    "AN": ("azimuth axis tilted to the north", lambda a, e: (-np.sin(a) * np.sin(e), -np.cos(a))),
    "AW": ("azimuth axis tilted to the west", lambda a, e: (-np.cos(a) * np.sin(e), np.sin(a))),
    FLEXURE: ("tube flexure", lambda a, e: (0 * e, -np.cos(e))),
}
SHARED = "TF is not stated: it and the other effect at joint 2 both go with E, and only their sum is determined"
EQUATORIAL: dict[str, tuple[str, Column]] = {
    "IH": ("index error in hour angle", lambda h, d: (np.cos(d), 0 * d)),
    "ID": ("index error in declination", lambda h, d: (0 * d, 1 + 0 * d)),
    "CH": ("collimation: east-west error of the telescope", lambda h, d: (1 + 0 * d, 0 * d)),
    "NP": ("polar and declination axes not perpendicular", lambda h, d: (np.sin(d), 0 * d)),
    "MA": ("polar axis off in azimuth", lambda h, d: (-np.cos(h) * np.sin(d), np.sin(h))),
    "ME": ("polar axis off in elevation", lambda h, d: (np.sin(h) * np.sin(d), np.cos(h))),
}
ALIKE = {
    "altazimuth": "TF cannot be distinguished from ECEC, run-out of the elevation circle: both go with cos E",
    "equatorial": "flexure of the tube is not a term here: its part in hour angle is none of a joint",
}


@dataclass(frozen=True, slots=True, eq=False)
class PointingTerms:
    """mount : "altazimuth" or "equatorial"; names, meanings : of t terms; values, sigma : (t,) rad; lines : on what
    cannot be distinguished or determined
    """

    mount: str
    names: tuple[str, ...]
    meanings: tuple[str, ...]
    values: Floats
    sigma: Floats
    lines: tuple[str, ...]

    def report(self) -> list[str]:
        """Lines for a reader, in arc seconds with 95 % intervals."""
        rows = [
            f"  {name:5}{value / ARCSEC:+9.2f} +- {1.96 * sigma / ARCSEC:.2f} arcsec  {meaning}"
            for name, meaning, value, sigma in zip(self.names, self.meanings, self.values, self.sigma)
        ]
        return [
            f"pointing terms of an {self.mount} mount, star less commanded, with 95 % intervals:",
            *rows,
            *(f"  {line}" for line in self.lines),
        ]

    def tree(self) -> Json:
        """What `rig calibrate --json` prints of them."""
        terms = {
            name: {"value": float(value), "sigma": float(sigma), "unit": "rad", "meaning": meaning}
            for name, meaning, value, sigma in zip(self.names, self.meanings, self.values, self.sigma)
        }
        return {"mount": self.mount, "terms": terms, "cannot_be_told": list(self.lines)}


def mount_kind(arm: Arm) -> str | None:
    """Kind of mount of an Arm.

    It is by the first axis as stated.
    "altazimuth" or "equatorial"; None without two turning axes.
    """
    if len(arm.joints) != 2 or arm.slides.any():
        return None
    axis = arm.base.rotation.as_matrix()[:, 2]
    return "altazimuth" if abs(axis @ ZENITH) > UPRIGHT else "equatorial"


def tube_flexure_effect(arm: Arm) -> tuple[Effect, ...]:
    """Effect of the flexure of a mount's tube.

    The tube of an altazimuth mount sinks by it at its second joint.
    None of other arms.

    It is the joint's compliance under one mass moment, along the tube.
    """
    along = arm.tool.rotation.as_matrix()[:, 2]
    axis = int(np.argmax(np.abs(along)))
    if mount_kind(arm) != "altazimuth" or abs(along[axis]) < ALONG:
        return ()
    moments = np.zeros(8)
    moments[5 + axis] = START
    return (compliance_under_link_weight("joint 2", tuple(moments.tolist())),)


def pointing_terms(design: Design, calibration: Calibration, commanded: Floats) -> PointingTerms | None:
    """PointingTerms of a mount as calibrated against that stated.

    None for an arm that is none.
    design : whose mechanism is the arm as stated; commanded : (n, 2) rad, commands
    """
    stated, fitted = require_arm(design.mechanism), calibration.correction.fitted
    physics = calibration.physics
    flexure, shared = None, False
    if physics is not None and sum(one.form == "load" for one in physics.effects) == 1:
        for k, c in enumerate(physics.coordinates):
            effect = physics.effects[c.effect]
            if _is_flexure(effect, stated):
                shared = shares_angle_with_another_effect(effect, physics.effects)
                flexure = None if shared else (float(c.read(effect)), float(physics.own[k, k]))
    assert isinstance(fitted, Arm)
    terms = pointing_terms_of_parameters(stated, fitted, calibration.covariance, commanded, design.gravity, flexure)
    return replace(terms, lines=(SHARED, *terms.lines[1:])) if terms is not None and shared else terms


def shares_angle_with_another_effect(effect: Effect, effects: Iterable[Effect]) -> bool:
    """Whether another of the effects turns the same joint as a function of its own angle, so that only the sum of both
    is determined.
    """
    return any(other.place == effect.place and other.own_axis for other in effects if other is not effect)


def _is_flexure(effect: Effect, arm: Arm) -> bool:
    """Whether an effect is the flexure of an Arm's tube, and nothing more."""
    own, moments = tube_flexure_effect(arm), mass_and_moments_over_stiffness(effect)
    if not own or not moments or effect.place != own[0].place:
        return False
    return [bool(value) for value in moments] == [bool(value) for value in mass_and_moments_over_stiffness(own[0])]


def pointing_terms_of_parameters(
    stated: Arm, fitted: Arm, covariance: Floats, visited: Floats, gravity: Floats, flexure: tuple[float, float] | None
) -> PointingTerms | None:
    """PointingTerms of a mount as fitted against that stated.

    None for an arm that is none or has other errors.
    stated, fitted : Arm; covariance : (p, p) of its parameters; visited : (n, 2) rad; gravity : (3,) m/s^2
    flexure : (mass moment over stiffness of `tube_flexure_effect`, rad per m/s^2, its variance), None where not fitted
    """
    mount = mount_kind(stated)
    if mount is None:
        return None
    table = ALTAZIMUTH if mount == "altazimuth" else EQUATORIAL
    names = [name for name in table if name != FLEXURE]
    J = _moved(arm_error_model_and_instrument_observations.parameter_jacobian(visited, stated), visited, stated)
    free = independent_arm_parameter_mask(stated, "direction")
    columns = {name: _column(one, visited, stated) for name, (_, one) in table.items()}
    wanted = np.stack([columns[name] for name in names], axis=1)
    made, *_ = np.linalg.lstsq(J[:, free], wanted)
    if len(names) != free.sum() or np.abs(J[:, free] @ made - wanted).max() > EXACT:
        return None
    back = np.linalg.inv(made)
    values, spread = back @ _step(stated, fitted)[free], back @ covariance[np.ix_(free, free)] @ back.T
    sigma, lines = np.sqrt(np.diag(spread)), [ALIKE[mount]]
    if flexure is not None:
        moments = np.array(mass_and_moments_over_stiffness(tube_flexure_effect(stated)[0])) / START
        loads = mechanism.link_weight_loads(mechanism.forward(visited, stated), visited, stated, gravity)
        joints = _moved(arm_error_model_and_instrument_observations.joint_jacobian(visited, stated), visited, stated)[
            :, 1
        ]
        sunk = -joints * np.repeat(loads[:, 1] @ moments, 3)
        unit = float(sunk @ columns[FLEXURE] / (columns[FLEXURE] @ columns[FLEXURE]))
        names.append(FLEXURE)
        values, sigma = np.r_[values, unit * flexure[0]], np.r_[sigma, abs(unit) * np.sqrt(flexure[1])]
    untold = [name for name, size in zip(names, sigma) if not size > 0]
    if untold:
        lines.append(f"{', '.join(untold)} cannot be determined from these directions")
    return PointingTerms(mount, tuple(names), tuple(table[name][0] for name in names), values, sigma, tuple(lines))


def pointing_term_jacobian_and_names(q: Floats, arm: Arm) -> tuple[tuple[str, ...], Floats]:
    """Jacobian (n, 6, t) of the hand's tangent by pointing terms, and their names.

    At commands q (n, 2), with its turn about x and y.
    Raises RigError for an arm that is no mount
    """
    mount = mount_kind(arm)
    if mount is None:
        raise RigError("pointing terms are those of a mount that turns about two axes")
    table = ALTAZIMUTH if mount == "altazimuth" else EQUATORIAL
    R = mechanism.forward(q, arm).rotation.as_matrix()
    out = np.zeros((len(q), 6, len(table)))
    for k, (_, one) in enumerate(table.values()):
        x, y, _ = np.einsum("nji,nj->in", R, _column(one, q, arm).reshape(-1, 3))
        out[:, 3, k], out[:, 4, k] = -y, x
    return tuple(table), out


def _moved(J: Floats, q: Floats, arm: Arm) -> Floats:
    """(3 n, p) change of the direction, in the frame of poses, of a pose Jacobian (n, 6, p) at commands q (n, 2)."""
    R = mechanism.forward(q, arm).rotation.as_matrix()
    return (R[:, :, :2] @ np.stack([J[:, 4], -J[:, 3]], axis=1)).reshape(-1, J.shape[2])


def _column(term: Column, q: Floats, arm: Arm) -> Floats:
    """(3 n,) change of the direction with a term, in the frame of poses, at commands q (n, 2)."""
    d = mechanism.forward(q, arm).rotation.as_matrix()[..., 2]
    if mount_kind(arm) == "altazimuth":
        pole, first, second = ZENITH, NORTH, EAST
    else:
        axis = arm.base.rotation.as_matrix()[:, 2]
        pole = axis * (1.0 if axis @ NORTH > 0 else -1.0)
        first = ZENITH - (ZENITH @ pole) * pole
        first /= np.linalg.norm(first)
        second = np.cross(first, pole)  # to the west, as hour angles go
    a, e = np.arctan2(d @ second, d @ first), np.arcsin(np.clip(d @ pole, -1, 1))
    along, up = term(a, e)
    to_second = np.cos(a)[:, None] * second - np.sin(a)[:, None] * first
    level = np.cos(a)[:, None] * first + np.sin(a)[:, None] * second
    to_pole = np.cos(e)[:, None] * pole - np.sin(e)[:, None] * level
    return (along[:, None] * to_second + up[:, None] * to_pole).ravel()


def _step(stated: Arm, fitted: Arm) -> Floats:
    """(p,) step from the stated to the fitted parameters; the base's turn as a tilt after a turn about axis 1, of
    which an index error may be large.
    """
    turned = (stated.base.rotation.inv() * fitted.base.rotation).as_matrix()
    lean = Rotation.align_vectors(turned[:, 2], [0, 0, 1])[0]
    about = (lean.inv() * Rotation.from_matrix(turned)).as_rotvec()
    tool = (stated.tool.inv() * fitted.tool).rotation.as_rotvec()
    step = np.zeros(12 + 5 * len(stated.joints))
    step[3:6], step[-3:] = lean.as_rotvec() + about, tool
    step[6:-6] = (fitted.rows - stated.rows).ravel()
    return step
