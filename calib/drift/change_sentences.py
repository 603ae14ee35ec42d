"""Sentences on a change found between visits: what changed, how sure, what to do and to remeasure."""

from collections.abc import Sequence

import numpy as np

from calib.drift.change_evidence import ALARM, SOMETHING, Suspect, Verdict
from calib.drift.visit_equations_and_reference import Reference
from rig.model.effect_places_and_part_tolerances import Place

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
    "temperature": "bring the machine to its calibration temperature, or log its "
    "struts' temperatures and "
    "record the standard "
    "plan warm and cold",
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
    kept = [one for k, one in enumerate(verdict.suspects[:SHOWN]) if k == 0 or one.odds >= LEAST]
    out.append("  odds: " + ", ".join(f"{one.name} {one.odds:.3f}" for one in kept))
    out.append(f"  to do: {REMEASURE[_key(named, reference)]}")
    return out


def _key(named: Suspect | None, reference: Reference) -> str:
    if named is None:
        return SOMETHING
    if named.place is not None and named.kind == "target":
        return "base" if named.place.name in reference.base else "platform"
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
            f"all struts grew by {value * 1e6:.1f} +- {2 * sigma * 1e6:.1f} um/m (k=2), {value / STEEL:+.1f} K "
            "of steel: a new temperature"
        )
    if one.kind == "payload":
        return (
            f"struts yield to {value:.2e} +- {2 * sigma:.1e} kg/(N/m) (k=2) of added load over stiffness: "
            "another payload"
        )
    grown = (
        "play grew by"
        if one.since
        else "play that the calibration does not model, present from the beginning or grown since,"
    )
    word = {"zero": "the zero moved by", "nut": grown}[one.kind]
    return f"{one.name}: {word} {value * 1e3:+.4f} +- {2 * sigma * 1e3:.4f} mm (k=2)"


def _power(log: float) -> str:
    return f"{np.exp(log):.3g}" if log < 600 else f"1e{log / np.log(10):.0f}"
