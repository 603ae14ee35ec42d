"""The catalogue at an arm's joints: for every effect, joint and shape, by how much it would turn the joint in every pose.

What is metres of a strut in the catalogue is radians of a joint; what is force is torque. Masses are not stated for an arm, but the
weight's torque on a joint is linear in the mass moments of the links behind it, so their products with the compliance are fitted.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import qr

from calib.diagnose.hypotheses import Skipped
from rig.effects import BY_NAME
from rig.effects.base import REFERENCE_TEMPERATURE
from rig.effects.play import play
from rig.effects.servo_lag import lag
from rig.mechanisms import arm as mechanism

KNOTS = (1.0, 0.5, 0.25, 0.12, 0.07, 0.05, 0.035)  # rad between knots of a profile
FEWEST = 4  # knots
SHARE = 0.125  # of the poses: more knots than that are no profile
ORDERS = 450.0  # cycles per turn of the joint; twice what a gear of 1 : 101 with four cycles per motor turn shows
FINE = 0.3  # step of the orders, of what the joint's travel resolves
GAPS = np.geomspace(2e-5, 5e-3, 20)  # rad
RANGES = np.geomspace(1e-3, 1.0, 10)  # rad
TAUS = np.geomspace(600.0, 14400.0, 8)  # s
CREEPS = np.geomspace(1.0, 1000.0, 7)  # s
EDGE = 8  # poses that a step needs on either side
STRIDE = 4  # poses between the moments at which a step is looked for
FAINT = 5e-3  # of a load's column, m/s^2 m; a smaller one bends nothing
RANK = 2e-2  # of the greatest column; what a column has beyond the earlier ones must be more
USUAL = {"scale_error": 2e-3, "cyclic_error": 5e-4, "transmission_error": 5e-4, "backlash": 1e-3, "hysteresis": 1e-2, "compliance": 1e-3,
         "joint_clearance": 1e-3, "warm_up": 1e-3, "missed_steps": 2e-3, "creep": 1e-2, "thermal_expansion": 1e-4}  # prior sizes
REST = "poses are taken at rest"
REASONS = {"servo_lag": REST, "time_offset": REST, "clock_drift": REST}


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """One effect at one place. name : of the effect; joint : index, or None for "rig"; shapes : [{parameter: value}] in order
    weights : shape -> (n, q) rad per unit; prior : size of a coefficient; extra : parameters beyond the coefficients
    step : between the orders of shapes that are even multiples of it, 0 for all other families"""

    name: str
    joint: int | None
    shapes: list
    weights: object
    prior: float
    extra: int = 0
    step: float = 0.0

    @property
    def place(self):
        """"joint 1".. or "rig"."""
        return "rig" if self.joint is None else f"joint {self.joint + 1}"


def moments(q, arm, gravity):
    """Per joint (values (n, columns), names): torque about the joint (Nm) per kg of mass at each link's frame and per kg m along its axes.

    q : (n, joints) rad; arm : Arm as fitted; gravity : (3,) m/s^2 in the frame of poses. Columns that others make up, or that the
    weight hardly turns, are left out. Source: regressor of Luh, Walker and Paul's recursion at rest; Gautier and Khalil 1990
    """
    chain = mechanism.frames(q, arm)
    n = len(arm.joints)
    z, o, R = chain[:, :n, :3, 2], chain[:, : n + 1, :3, 3], chain[:, 1 : n + 1, :3, :3]
    out = []
    for j in range(n):
        values, names = [], []
        for k in range(j, n):
            values.append(np.cross(o[:, k + 1] - o[:, j], gravity))
            names.append(f"mass {k + 1}")
            for axis, label in enumerate("xyz"):
                values.append(np.cross(R[:, k, :, axis], gravity))
                names.append(f"moment {label} {k + 1}")
        table = np.einsum("cni,ni->nc", np.array(values), z[:, j])
        centred = table - table.mean(axis=0)  # a constant is the joint's zero
        _, r, order = qr(centred / np.sqrt(len(q)), mode="economic", pivoting=True)
        keep = order[: max(int((np.abs(np.diag(r)) > max(FAINT, RANK * np.abs(r[0, 0]))).sum()), 0)]
        keep = np.sort(keep)
        out.append((table[:, keep], tuple(names[i] for i in keep)))
    return tuple(out)


def families(arms, only=None, without=()):
    """([Family], [Skipped]) that these poses can be asked for; only, without : effects, or "effect joint 3"."""
    out, skipped = [], []
    for name, kind in BY_NAME.items():
        if not _asked(name, None, only, without):
            continue
        if name in REASONS or name not in USUAL or (name == "thermal_expansion" and "ambient_temperature_C" not in arms.channels):
            if {"axis", "rig", "clock"} & set(kind.places):
                skipped.append(Skipped(name, REASONS.get(name, "the recording does not hold what it needs" if name in USUAL else
                                                         "it has no meaning at an arm's joints")))
            continue
        for j in [None] if name == "thermal_expansion" else range(arms.q.shape[1]):
            family = _family(name, j, arms)
            if family is not None and family.shapes and _asked(name, family.place, only, without):
                out.append(family)
    return out, skipped


def _asked(name, place, only, without):
    texts = (name,) if place is None else (name, f"{name} {place}")
    return (not only or any(t.startswith(name) if place is None else t in texts for t in only)) and not any(t in texts for t in without)


def _family(name, j, arms):
    usual = USUAL[name]
    if name == "thermal_expansion":
        warmer = arms.channels["ambient_temperature_C"] - REFERENCE_TEMPERATURE
        return Family(name, None, [{}], lambda shape: warmer[:, None], usual)
    q, path = arms.q[:, j], arms.path
    low, high = float(q.min()), float(q.max())
    travel = max(high - low, 1e-6)
    if name == "scale_error":
        return Family(name, j, [{}], lambda shape: (q - q.mean())[:, None], usual)
    if name == "cyclic_error":
        step = FINE * 2 * np.pi / travel
        orders = step * np.arange(int(np.ceil(max(0.5, np.pi / travel) / step)), int(ORDERS / step))
        return Family(name, j, [{"order": float(w)} for w in orders], lambda shape: sinusoid(q, shape["order"]), usual, 1, step)
    if name == "transmission_error":
        counts = sorted({max(FEWEST, int(np.ceil(travel / step)) + 1) for step in KNOTS})
        counts = [c for c in counts if c <= SHARE * len(q)]
        return Family(name, j, [{"knots": c, "low": low, "high": high} for c in counts], _kept(lambda shape: spline(q, shape)), usual)
    if name == "backlash":
        behind = _kept(lambda shape: _behind(path, j, shape["gap"] / 2)[:, None] / shape["gap"])
        return Family(name, j, [{"gap": float(g)} for g in GAPS], behind, usual)
    if name == "hysteresis":
        return Family(name, j, [{"range": float(r)} for r in RANGES], _kept(lambda shape: _loops(path, j, shape["range"])[:, None]), usual, 1)
    if name == "warm_up":
        return Family(name, j, [{"time_constant": float(tau)} for tau in TAUS],
                      lambda shape: (1 - np.exp(-(arms.t - path.t[0]) / shape["time_constant"]))[:, None], usual, 1)
    if name == "missed_steps":
        t = arms.t
        times = ((t[EDGE - 1 : -EDGE : STRIDE] + t[EDGE : len(t) - EDGE + 1 : STRIDE]) / 2).tolist()
        return Family(name, j, [{"time": v} for v in times], lambda shape: (t >= shape["time"]).astype(float)[:, None], usual, 1)
    if name == "creep":
        shapes = [{"time_constant": float(tau)} for tau in CREEPS]
        return Family(name, j, shapes, _kept(lambda shape: _late(path, j, shape["time_constant"])[:, None]), usual, 1)
    load = arms.moments[j][0]
    if not load.shape[1]:
        return None
    if name == "compliance":
        return Family(name, j, [{}], lambda shape: -load, usual)
    sides = _sides(load)
    return Family(name, j, [{"moment": i} for i in range(len(sides))], lambda shape: -sides[shape["moment"]][:, None] / 2, usual) if sides else None


def _kept(weights):
    """The function of a shape, its answers kept: histories are long, and asked for in every search."""
    known = {}

    def answer(shape):
        key = tuple(sorted(shape.items()))
        if key not in known:
            known[key] = weights(shape)
        return known[key]

    return answer


def sinusoid(q, order):
    """(n, 2) sine and cosine of order times the angle."""
    return np.stack([np.sin(order * q), np.cos(order * q)], axis=1)


def spline(q, shape):
    """(n, knots): natural cubic spline by its values at even knots from low to high; beyond, it stays as it is at the end."""
    knots = np.linspace(shape["low"], shape["high"], shape["knots"])
    return CubicSpline(knots, np.eye(shape["knots"]), bc_type="natural")(np.clip(q, shape["low"], shape["high"]))


def _behind(path, j, half):
    """(n,) rad by which a play of half width `half` trails the command."""
    x = path.lengths[:, [j]]
    return (play(x, half) - x)[path.at, 0]


def _late(path, j, time_constant):
    x = path.lengths[:, [j]]
    return (lag(path.t, x, time_constant) - x)[path.at, 0]


def _loops(path, j, reach, plays=8):
    return np.mean([_behind(path, j, half) for half in reach * (np.arange(plays) + 0.5) / plays], axis=0)


def _sides(load):
    """Signs (n,) that the weight's torque takes where one mass moment makes it, those that change sides at all."""
    signs = [np.sign(column) for column in load.T]
    return [s for s in signs if min((s > 0).sum(), (s < 0).sum()) >= EDGE]
