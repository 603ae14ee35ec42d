"""Hypotheses of machine changes between visits, the verdict on them, and its sentences.

Hypotheses, and the verdict (Shiryaev-Roberts procedure).

The likelihood of all visits with a change since visit k, over that without, averaged over what may change and how
much, is summed over k > 1. While nothing changes the sum grows by one a visit in expectation, so that an alarm at A
comes after A quiet visits or more on average. The first visit has none before it and is held against the calibration
alone, all its numbers together. A change that nobody names is bet on by each visit's own p-value: p^-1/2 / 2, whose
mean is one while nothing changes. Source: Pollak, Optimal detection of a change in distribution, Annals of Statistics
1985; Vovk and Wang, E-values, ibid. 2021
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import scipy
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.special import logsumexp

from calib.drift.visit_equations_and_reference import Equations, Reference, machine_change_names, machine_change_units
from calib.models.calibration_covariance_parameters import covariance_parameters
from rig.array_and_json_types import Floats
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, axis_place_texts, axis_units
from vision.bundle.adjustment_unknowns_estimate_and_marker_printing_errors import POSE_SCALE

SIZES = (1.0, 0.25, 0.0625)  # of the greatest plausible size, each as likely
# m and rad, m, m, share, kg/(N/m): standard deviations
PLACE_SIZE, ZERO_SIZE, GAP_SIZE, GROWTH_SIZE, SOFT_SIZE = 2e-3, 1e-3, 4e-4, 4e-4, 8e-5
# m, rad; how far a place may be from where it counts from, before any visit
STATED = {"camera": 1e-2, "target": 1e-3, "instrument": 1e-3}
# m or rad, share, kg/(N/m): what of play, growth and sag a calibration that held on its own day may have left out
PLAY_LEFT_OUT, GROWTH_LEFT_OUT, SOFT_LEFT_OUT = 2e-5, 5e-5, 5e-6
KINDS = ("camera", "target", "zero", "nut", "temperature", "payload")  # each as likely; "something" is one more, and
# of machines whose parameters may change one at a time "parameter"
SOMETHING = "something"
TOOL = Place("target", "hand")  # where the target sits on an arm's hand, which an instrument sees


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """kind : of KINDS; name : in words; columns : (q,) of the unknowns; size : (q,) their greatest plausible standard
    deviation, scaled
    unit : (q,) own units (m, rad, a share, kg/(N/m)) of a scaled unknown; prior : its probability, were there a
        change; place : what moves, None where no place does; angle : whether it is one angle, rad."""

    kind: str
    name: str
    columns: Floats
    size: Floats
    unit: Floats
    prior: float
    place: Place | None = None
    angle: bool = False


def change_hypotheses(reference: Reference, mechanism: Commanded) -> list[Hypothesis]:
    """Hypotheses of all changes that may happen to a rig with a mechanism."""
    machine, names, axes = (
        covariance_parameters(mechanism),
        machine_change_names(mechanism),
        axis_place_texts(mechanism),
    )
    geometry, units = 6 * len(reference.places), axis_units(mechanism)
    own = geometry + len(machine.names)
    moving: list[tuple[Place, list[int]]] = [
        (place, list(range(6 * k, 6 * k + 6))) for k, place in enumerate(reference.places)
    ]
    if machine.tool and not reference.cameras:
        moving.append((TOOL, [geometry + k for k in machine.tool]))
    found: list[tuple[str, str, list[int], float, float, float, Place | None, str]] = [
        (
            "target" if place.kind == "target" else "camera",
            str(place),
            columns,
            PLACE_SIZE,
            POSE_SCALE,
            POSE_SCALE,
            place,
            "",
        )
        for place, columns in moving
    ]
    single = [
        *(("zero", f"zero of {axis}", k, unit) for axis, k, unit in zip(axes, machine.zeros, units)),
        *(("parameter", machine.names[k], k, machine.units[k]) for k in machine.single),
    ]
    found += [
        (kind, name, [geometry + k], ZERO_SIZE, POSE_SCALE, POSE_SCALE * float(machine.scale[k]), None, unit)
        for kind, name, k, unit in single
    ]
    kinds = [*(("nut", GAP_SIZE, unit) for unit in units), ("temperature", GROWTH_SIZE, ""), ("payload", SOFT_SIZE, "")]
    found += [
        (kind, name, [own + k], size, count, count, None, unit)
        for k, ((kind, size, unit), name, count) in enumerate(zip(kinds, names, machine_change_units(mechanism)))
    ]
    members = Counter(kind for kind, *_ in found)
    return [
        Hypothesis(
            kind,
            name,
            np.array(columns),
            np.full(len(columns), size / count),
            np.full(len(columns), own_unit),
            1 / (len({*KINDS, *members}) + 1) / members[kind],
            place,
            unit == "rad",
        )
        for kind, name, columns, size, count, own_unit, place, unit in found
    ]


def prior_information_of_constants_between_visits(
    reference: Reference, covariance: Floats, mechanism: Commanded
) -> Floats:
    """Prior information (p, p), scaled, in what stays constant between visits."""
    places = np.concatenate([np.full(6, POSE_SCALE / STATED[place.kind]) for place in reference.places])
    values, vectors = np.linalg.eigh(covariance / POSE_SCALE**2)
    values = np.maximum(values, values[-1] * 1e-12)
    left_out = np.array([*(PLAY_LEFT_OUT,) * len(mechanism.axes), GROWTH_LEFT_OUT, SOFT_LEFT_OUT])
    return np.asarray(
        block_diag(
            np.diag(places**2),
            vectors / values @ vectors.T,
            np.diag((np.array(machine_change_units(mechanism)) / left_out) ** 2),
        )
    )


ALARM = 1000.0  # visits, the least average run without a false alarm
FIRST = 1e-4  # chance below which a first visit does not agree with its calibration
UNSAID = 1e-6  # chance beyond which what the likeliest change leaves is no noise


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """A change that is thought of. kind, name, place as in Hypothesis; since : index of the first visit with it,
    0 the first of all
    odds : its probability, were there a change; value, sigma : (q,) in own units, none of what has no name
    angle : as in Hypothesis"""

    kind: str
    name: str
    since: int
    odds: float
    value: Floats
    sigma: Floats
    place: Place | None = None
    angle: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What visits so far say. square, count : innovation of the last, squared and whitened, and how many numbers it has
    log_sum : logarithm of the Shiryaev-Roberts sum, 0 of a first visit; suspects : by falling odds, one of each name;
        left : chance of what
    the first of them leaves; chance : that noise makes a first visit agree no better with the calibration, None of
    later ones."""

    square: float
    count: int
    log_sum: float
    suspects: tuple[Suspect, ...]
    left: float
    chance: float | None = None

    @property
    def alarm(self) -> bool:
        """Whether the calibration, or what measures, is no longer what it was."""
        return bool(self.log_sum >= np.log(ALARM)) if self.chance is None else self.chance < FIRST

    @property
    def named(self) -> Suspect | None:
        """The likeliest change, None where it has no name or leaves what is no noise."""
        first = self.suspects[0]
        return None if first.kind == SOMETHING or self.left < UNSAID else first


def whitened_squares_unexplained_by_constants(visits: Sequence[Equations], prior: Floats) -> float:
    """Whitened squares of visits unexplained by constants with a prior information (p, p)."""
    total = np.sum([v.information for v in visits], axis=0) + prior
    right = np.sum([v.right for v in visits], axis=0)
    return sum(v.square for v in visits) - float(right @ cho_solve(cho_factor(total), right))


def change_verdict(
    visits: Sequence[Equations],
    squares: Sequence[tuple[float, int]],
    scale: float,
    prior: Floats,
    evidence: Sequence[Hypothesis],
    first_visit_count: int,
) -> Verdict:
    """Verdict on which change of the machine explains its visits, in order.

    The first of which may stand for several older ones.
    squares : innovation and count of each visit, the last's included; scale : by which squares exceed what covariances
        say, from quiet visits
    prior : (p, p) information in the constants; first_visit_count : how many visits the first stands for
    """
    n, factor = len(visits), cho_factor(np.sum([v.information for v in visits], axis=0) / scale + prior)
    constants = cho_solve(factor, np.sum([v.right for v in visits], axis=0) / scale)
    onset, alone = [0, *range(first_visit_count, first_visit_count + n - 1)], n == 1
    found: list[tuple[float, Suspect]] = []
    drop: dict[tuple[str, int], float] = {}
    bets = [np.log(0.5) - 0.5 * _log_chance(square / scale, count) for square, count in squares]
    none = np.zeros(0)
    for k in range(0 if alone else 1, n):
        N = np.sum([v.information for v in visits[k:]], axis=0) / scale
        b = np.sum([v.right for v in visits[k:]], axis=0) / scale
        solved = cho_solve(factor, N)
        for h in evidence:
            S = N[np.ix_(h.columns, h.columns)] - N[:, h.columns].T @ solved[:, h.columns]
            r = b[h.columns] - N[:, h.columns].T @ constants
            weight, gain, value, covariance = _bayes(S, r, h)
            drop[h.name, onset[k]] = gain
            found.append(
                (
                    np.log(h.prior) + weight,
                    Suspect(
                        h.kind,
                        h.name,
                        onset[k],
                        0.0,
                        value * h.unit,
                        np.sqrt(np.diag(covariance)) * h.unit,
                        h.place,
                        h.angle,
                    ),
                )
            )
        found.append(
            (
                np.log(evidence[0].prior * sum(h.kind == evidence[0].kind for h in evidence)) + sum(bets[k:]),
                Suspect(SOMETHING, SOMETHING, onset[k], 0.0, none, none),
            )
        )
    log_sum = float(logsumexp([weight for weight, _ in found]))
    suspects = _ranked(found, log_sum)
    best = suspects[0]
    square = sum(a for a, _ in squares) / scale - drop.get((best.name, best.since), 0.0)
    left = float(scipy.special.chdtrc(sum(count for _, count in squares), square))
    if alone:
        return Verdict(*squares[0], 0.0, suspects, left, float(scipy.special.chdtrc(squares[0][1], squares[0][0])))
    return Verdict(*squares[-1], log_sum, suspects, left)


def _log_chance(square: float, count: int) -> float:
    """Logarithm of the chance that noise comes to such a square or more, at the most (Chernoff's bound, which never
    underflows).
    """
    return 0.0 if square <= count else -(square - count) / 2 + count / 2 * float(np.log(square / count))


def _bayes(S: Floats, r: Floats, h: Hypothesis) -> tuple[float, float, Floats, Floats]:
    """(log of the likelihood ratio over all sizes, by how much the squares fall at the best, that best (q,), its
    covariance (q, q)), of information S (q, q) and right side r (q,)."""
    weights, best = [], None
    for share in SIZES:
        inverse = np.diag(1 / (share * h.size) ** 2)
        M = S + inverse
        value = np.linalg.solve(M, r)
        weight = 0.5 * float(r @ value) - 0.5 * float(np.linalg.slogdet(M)[1] - np.linalg.slogdet(inverse)[1])
        weights.append(weight)
        if best is None or weight > best[0]:
            best = weight, float(2 * r @ value - value @ S @ value), cast(Floats, value), cast(Floats, np.linalg.inv(M))
    assert best is not None
    return float(logsumexp(weights)) - float(np.log(len(SIZES))), *best[1:]


def _ranked(found: list[tuple[float, Suspect]], log_sum: float) -> tuple[Suspect, ...]:
    """One Suspect of each name, its likeliest onset, with the odds of all its onsets together, likeliest first."""
    best: dict[str, tuple[float, Suspect]] = {}
    odds: dict[str, float] = {}
    for weight, suspect in found:
        odds[suspect.name] = odds.get(suspect.name, 0.0) + float(np.exp(weight - log_sum))
        if suspect.name not in best or weight > best[suspect.name][0]:
            best[suspect.name] = weight, suspect
    out = [replace(suspect, odds=odds[suspect.name]) for _, suspect in best.values()]
    return tuple(sorted(out, key=lambda one: -one.odds))


SHOWN = 3  # suspects that are listed
LEAST = 0.01  # odds below which none but the first is
STEEL = 1.15e-5  # 1/K, to give growth a temperature
REMEASURE = {
    "camera": "clamp the mount. The calibration remains valid: cameras are located again in every recording that shows "
    "the base targets. "
    "Begin a new history once it is fixed",
    "instrument": "reseat the instrument, or state its frame; the calibration remains valid",
    "base": "reseat that target, or state its true place in rig.toml; poses measured since are in a frame "
    "that moved with it. "
    "No part of the machine needs remeasuring",
    "platform": "reseat that target, or state its true place in rig.toml; poses measured "
    "since are of a platform "
    "frame that moved "
    "with it. No part of the machine needs remeasuring",
    "zero": "home the machine and visit again; if it persists, record 20 poses (rig plan RIG.toml --for parameters "
    "--count 20 --calibration CAL) "
    "and recalibrate",
    "nut": "inspect the nut and bearings of that strut; record a ladder (rig run RIG.toml --plan ladder) and diagnose "
    "it; until then approach "
    "every pose from the same side",
    "play": "inspect gear and bearings of that axis; record the standard plan (rig run RIG.toml --plan standard) and "
    "run rig diagnose; until then approach every pose from the same side",
    "parameter": "inspect that part; record new poses (rig plan RIG.toml --for parameters) and recalibrate",
    "temperature": "bring the machine to its calibration temperature, or log the temperatures of its parts and record "
    "the standard plan warm and cold",
    "payload": "state the load on the platform (payload_mass_kg in sensors.csv); record a plan with payload steps "
    "(--plan payload) and "
    "calibrate with the diagnosis",
    SOMETHING: "record the standard plan (rig run RIG.toml --plan standard) and run rig diagnose",
}


def change_verdict_lines(
    verdict: Verdict, name: str, names: Sequence[str], reference: Reference, scale: float, within_claim: bool = False
) -> list[str]:
    """Lines on a visit's change verdict.

    names : of the visits in order; scale : see History.scale
    within_claim : whether what a first visit disagrees by is within the calibration's claim.
    """
    agree = np.sqrt(verdict.square / verdict.count / scale)
    against = "the visits before" if verdict.chance is None else "the calibration"
    out = [f"{name}: agrees with {against} to {agree:.3f} of the measurement repeatability (1 where nothing changed)"]
    if not verdict.alarm and verdict.chance is not None:
        return [*out, "  the calibration is valid; later visits are compared with it and this one"]
    if not verdict.alarm:
        return [
            *out,
            f"  nothing has changed (sum of likelihood ratios {_power(verdict.log_sum)}; the alarm is at "
            f"{ALARM:g}, which unchanged visits "
            f"reach once in {ALARM:g} visits or more, on average)",
        ]
    first, named = verdict.suspects[0], verdict.named
    since = "since the calibration" if first.since == 0 else f"since {names[first.since]}"
    if within_claim:
        what = "without a name" if named is None else f"likeliest {_suspect_with_size(named, reference)}"
        out.append(
            f"  THE CALIBRATION OMITS AN EFFECT, present from the beginning or since, {what}; its claim "
            "is not refuted by this visit"
        )
    elif named is None:
        nearest = next((one for one in verdict.suspects if one.kind != SOMETHING), None)
        out.append(
            f"  THE CALIBRATION NO LONGER DESCRIBES THE MEASUREMENTS, {since}: an unidentified change"
            + (
                f" (the nearest explanation, {_suspect_with_size(nearest, reference)}, leaves more than noise)"
                if nearest is not None
                else ""
            )
        )
    elif named.kind in ("camera", "target"):
        out.append(f"  THE MEASURING SYSTEM HAS CHANGED, {since}: {_suspect_with_size(named, reference)}")
    else:
        out.append(f"  THE CALIBRATION IS NO LONGER VALID, {since}: {_suspect_with_size(named, reference)}")
    retained = [one for k, one in enumerate(verdict.suspects[:SHOWN]) if k == 0 or one.odds >= LEAST]
    out.append("  odds: " + ", ".join(f"{one.name} {one.odds:.3f}" for one in retained))
    out.append(f"  to do: {REMEASURE[_key(named, reference)]}")
    return out


def _key(named: Suspect | None, reference: Reference) -> str:
    if named is None:
        return SOMETHING
    if named.place is not None and named.kind == "target":
        return "base" if named.place.name in reference.base else "platform"
    if named.kind == "nut" and named.name.startswith("play"):
        return "play"
    return "instrument" if named.place == Place("instrument") else named.kind


def _suspect_with_size(one: Suspect, reference: Reference) -> str:
    """A named suspect with its size."""
    if len(one.value) == 6:
        position, rotation = (float(np.linalg.norm(part)) for part in np.split(one.value, 2))
        what = {
            "camera": "knocked",
            "instrument": "or the base moved",
            "base": "moved on the base",
            "platform": "moved on the platform",
        }
        return f"{one.name} {what[_key(one, reference)]} by {position * 1e3:.3f} mm and {rotation * 1e3:.3f} mrad"
    value, sigma = float(one.value[0]), float(one.sigma[0])
    if one.kind == "temperature":
        return (
            f"{one.name.removeprefix('growth of ')} grew by {value * 1e6:.1f} +- {2 * sigma * 1e6:.1f} um/m (k=2), "
            f"{value / STEEL:+.1f} K of steel: a new temperature"
        )
    if one.kind == "payload":
        return (
            f"axes yield to {value:.2e} +- {2 * sigma:.1e} kg/(N/m) (k=2) of added load over stiffness: another payload"
        )
    grown = (
        "play grew by"
        if one.since
        else "play that the calibration does not model, present from the beginning or grown since,"
    )
    word = {"zero": "the zero moved by", "nut": grown, "parameter": "changed by"}[one.kind]
    unit = "mrad" if one.angle else "mm"
    return f"{one.name}: {word} {value * 1e3:+.4f} +- {2 * sigma * 1e3:.4f} {unit} (k=2)"


def _power(log: float) -> str:
    return f"{np.exp(log):.3g}" if log < 600 else f"1e{log / np.log(10):.0f}"
