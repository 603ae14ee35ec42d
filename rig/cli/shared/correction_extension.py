"""Correction extension (rig calibrate --extend): corrections at recorded configurations extended over a space."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from calib.certify.calibration import Calibration
    from calib.certify.extension_certification import Tried
    from calib.certify.platform_certification import Certified, Progress
    from calib.certify.workspace_claim import Claim
    from calib.correct.interpolation.field_combinations import SpacePart
    from calib.models.arm.certification import Certified as ArmCertified
    from calib.samples.pose_samples import Samples
    from calib.samples.recording_samples import Sampled
    from rig.model.design import Arm, Chain, Free, Instrument
    from rig.model.mechanism_kinds import Struts
    from rig.recording.recording_folder import Recording
    from rig.report.pages.page_and_svg_templates import Link

WAYS = ("linear", "simplex", "delaunay", "axes", "radial", "polynomial", "auto")
SPACES = ("configuration", "pose", "both")


def add_extension_options(parser: ArgumentParser) -> None:
    """Add the options of a correction extension (--extend and its companions) to a parser."""
    parser.add_argument(
        "--extend",
        choices=WAYS,
        metavar="WAY",
        help="extend the corrections at the recorded configurations over all of them: "
        f"{', '.join(WAYS[:-1])} (linear and simplex take a grid, as the plan division:2 visits one), or "
        "auto, by held-out error",
    )
    parser.add_argument(
        "--alone",
        action="store_true",
        help="of --extend: correct the owner's model itself, with no geometry fitted first",
    )
    parser.add_argument(
        "--onto",
        metavar="CALIBRATION",
        type=Path,
        help="of --extend: one more pass, on the rig that this calibration corrects: "
        "what it leaves in the recording is corrected on top; order and count are kept",
    )
    parser.add_argument(
        "--space",
        choices=SPACES,
        help="of --onto: where the pass maps what is left: over configurations (default), "
        "over poses, or over both, poses then holding what the first leaves",
    )
    parser.add_argument(
        "--within",
        metavar="PART",
        help="of --onto: the part in which the pass holds, fading beyond: bounds of axes (m or rad) "
        "and of poses (x y z in m, rx ry rz in rad from home), as l1=0.40:0.46,z=0.41: ",
    )


def refuse_incompatible_extension_options(arguments: Namespace, mechanism_kind: str) -> None:
    """Refuse incompatible options of --extend, and those unsuitable for the mechanism's kind.

    Raises RigError where one is given
    """
    if (arguments.alone or arguments.onto) and not arguments.extend or (arguments.alone and arguments.onto):
        raise RigError("--alone and --onto each say on what --extend stands; it takes one of them")
    if (arguments.space or arguments.within) and not arguments.onto:
        raise RigError("--space and --within are of a pass; name with --onto what it stands on")
    if arguments.onto and mechanism_kind == "arm":
        raise RigError(
            "--onto is a pass on top of a calibration of struts; an arm's is extended in one go, by all of "
            "its recordings"
        )
    if arguments.extend and arguments.joint:
        raise RigError("--extend is not for --joint: give one of them")


@dataclass(frozen=True, slots=True, eq=False)
class Extended:
    """done : Certified, of struts or of an arm; tried : Tried of each way; claim : Claim; kept : what the provenance
    keeps of a pass
    draw : writes the page of (path, Recording, Calibration, its links); misses : (RMS, greatest) of the single step;
        unit : of an axis, m or rad."""

    done: Certified | ArmCertified
    tried: tuple[Tried, ...]
    claim: Claim
    kept: dict[str, Any]
    draw: Callable[[Path, Recording, Calibration, list[Link]], None]
    misses: tuple[float, float]
    unit: str


def certify_correction_extension(
    arguments: Namespace,
    mechanism: Struts | Arm | Chain | Free,
    sampled: Sampled,
    base_calibration: Calibration | None,
    rng: np.random.Generator,
    progress: Progress,
) -> Extended:
    """Extend the corrections of struts or an arm as --extend requests and certify it. Raises RigError for a chain."""
    from rig.model.mechanism_kinds import require_arm, require_struts

    if mechanism.link_rows is not None:
        return _of_arm(arguments, require_arm(mechanism), sampled.samples, sampled.instrument, rng, progress)
    from calib.certify.extension_certification import Asked, certify_extended_correction, claim_without_geometry
    from calib.certify.platform_certification import platform_workspace_claim
    from calib.correct.summand_extension import single_step_errors
    from calib.report.calibration_page import write_calibration_page

    samples, nominal = sampled.samples, require_struts(mechanism)
    kept: dict[str, Any] = {}
    if base_calibration is None:
        done, tried = certify_extended_correction(
            samples, nominal, Asked(arguments.extend, arguments.alone), rng, progress
        )
    else:
        done, tried, kept = _certify_pass(arguments, samples, base_calibration, rng, progress)
    claim = (
        platform_workspace_claim(samples, done, rng)
        if not arguments.alone and base_calibration is None
        else claim_without_geometry(samples, done, rng)
    )
    return Extended(
        done,
        tried,
        claim,
        kept,
        lambda page, rec, made, links: write_calibration_page(page, rec, made, samples, done.found, links),
        single_step_errors(done.correction),
        "m",
    )


def _of_arm(
    arguments: Namespace,
    nominal: Arm,
    samples: Samples,
    instrument: Instrument | None,
    rng: np.random.Generator,
    progress: Progress,
) -> Extended:
    from calib.certify.extension_certification import Asked
    from calib.models.arm.calibration_page import write_arm_calibration_page
    from calib.models.arm.certification import arm_workspace_claim
    from calib.models.arm.extension_certification import (
        certify_extended_arm,
        claim_without_geometry,
        single_step_errors,
    )
    from rig.model import mechanisms

    done, tried = certify_extended_arm(
        samples, nominal, instrument, Asked(arguments.extend, arguments.alone), rng, progress
    )
    claim = (claim_without_geometry if arguments.alone else arm_workspace_claim)(samples, done, rng)
    return Extended(
        done,
        tried,
        claim,
        {},
        lambda page, rec, made, links: write_arm_calibration_page(page, rec, made, samples, done, links),
        single_step_errors(done.correction),
        mechanisms.travel_unit(nominal),
    )


def print_correction_extension(extended: Extended, base_description: str) -> None:
    """Print a correction extension: ways tried with held-out errors, the one chosen. base_description : in words"""
    for one in extended.tried:
        words = f"not tried: {one.reason}" if one.reason else "not held out, for want of poses"
        if one.held_out is not None:
            turned = one.held_out.after.rotation[0]
            words = f"held out {one.held_out.after.position[0] * 1e3:.4f} mm" + (
                f", {turned * 1e3:.4f} mrad RMS" if turned == turned else " RMS"
            )
            words += f"; not taken: {one.reason}" if one.reason else ""
        print(f"{'->' if one.chosen else '  '} {one.kind:10} {words}")
    correction = extended.done.correction
    field = correction.extension
    known = getattr(field, "values", None) if field is not None and field.exact else None
    for held in correction.posed:
        print(f"a map in pose space: {held.field.kind}")
    print(
        f"KSF over the whole configuration space: {'none' if field is None else field.kind}, on {base_description}"
        + (f"; exact at its {len(known)} samples" if known is not None else "")
    )
    rms, most = (f"{value * 1e6:.3f} u{extended.unit.replace(' or ', ' or u')}" for value in extended.misses)
    print(
        f"the single step X + KSF(X) misses the fixed point, which `rig correct` solves for, by {rms} RMS, "
        f"{most} at most"
    )


def _certify_pass(
    arguments: Namespace, samples: Samples, before: Calibration, rng: np.random.Generator, progress: Progress
) -> tuple[Certified, tuple[Tried, ...], dict[str, Any]]:
    """(Certified, what was tried, what the provenance keeps of it) of one more pass. Raises RigError for a part that
    cannot be.
    """
    from calib.certify.additional_pass import CONFIGURATION, POSE, Pass, certify_additional_pass

    space = arguments.space or CONFIGURATION
    configurations, poses = _parts(arguments.within, before.correction.nominal)
    if configurations is not None and space == POSE or poses is not None and space == CONFIGURATION:
        raise RigError(
            f"--within {arguments.within}: a pass over {'poses' if space == POSE else 'configurations'} is bounded by "
            f"{'x y z rx ry rz' if space == POSE else 'the axes'}; --space both takes either"
        )
    done, tried, count = certify_additional_pass(
        samples, before, Pass(arguments.extend, space, configurations, poses), rng, progress
    )
    number = len(before.provenance.get("passes", ())) + 2
    return (
        done,
        tried,
        {
            "number": number,
            "way": arguments.extend,
            "space": space,
            "within": arguments.within,
            "samples": count,
            "chosen": [one.kind for one in tried if one.chosen],
        },
    )


def _parts(text: str | None, mechanism: Struts) -> tuple[SpacePart | None, SpacePart | None]:
    """(Part of the configuration space, Part of pose space), None for all of it, of a text. Raises RigError for one
    that bounds nothing.
    """
    if text is None:
        return None, None
    import numpy as np

    from calib.correct.interpolation.field_combinations import SpacePart
    from calib.correct.pose_space_map import NAMES
    from calib.correct.summand_extension import pose_coordinate_indices

    spaces = [mechanism.axes, tuple(NAMES[i] for i in pose_coordinate_indices(mechanism))]
    bounds = [np.tile([-np.inf, np.inf], (len(names), 1)) for names in spaces]
    for word in text.split(","):
        name, _, span = word.strip().partition("=")
        low, colon, high = span.partition(":")
        try:
            pair = parse_number(low) if low else -np.inf, parse_number(high) if high else np.inf
        except ValueError:
            pair = np.nan, np.nan
        at = [(k, names.index(name)) for k, names in enumerate(spaces) if name in names]
        if not at or not colon or not pair[0] < pair[1] or pair == (-np.inf, np.inf):
            raise RigError(
                f"--within takes NAME=LOW:HIGH joined by commas, names {' '.join(spaces[0] + spaces[1])}, "
                "low below high and either left "
                f"out where free, not {word.strip()!r}"
            )
        bounds[at[0][0]][at[0][1]] = pair
    found = [SpacePart(*pair.T) if np.isfinite(pair).any() else None for pair in bounds]
    return found[0], found[1]
