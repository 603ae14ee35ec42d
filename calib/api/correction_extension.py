"""Corrections at recorded configurations extended over a space: in one go, or as one more pass on a calibration."""

from dataclasses import dataclass

import numpy as np

from calib.certification.additional_pass import CONFIGURATION, POSE, Pass, certify_additional_pass
from calib.certification.calibration import Calibration
from calib.certification.extension_certification import (
    Asked,
    Tried,
    certify_extended_correction,
    claim_without_geometry,
)
from calib.certification.platform_certification import Certified, Progress, platform_workspace_claim
from calib.certification.workspace_claim import Claim
from calib.correction.interpolation.field_combinations import SpacePart
from calib.correction.pose_space_map import NAMES
from calib.correction.summand_extension import pose_coordinate_indices, single_step_errors
from calib.files.calibration_file_entries import mechanism_dict
from calib.models.arm import certification as arm_certification
from calib.models.arm import extended_correction_certification as arm_extension
from calib.models.arm.certification import Certified as ArmCertified
from calib.samples.pose_samples import Samples
from calib.samples.recording_samples import Sampled
from rig.errors import RigError
from rig.formats.json_tree import Json
from rig.formats.number_parsing_and_rounding import parse_number
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.mechanism_kinds import Struts, has_links, require_arm, require_struts

SPACES = ("configuration", "pose", "both")


@dataclass(frozen=True, slots=True, eq=False)
class ExtendOptions:
    """way : how, of "linear", "simplex", "delaunay", "axes", "radial", "polynomial" or, by held-out error, "auto"
    alone : whether to correct the owner's model itself, with no geometry fitted first; onto : Calibration on which this
    is one more pass, or None; name : of that, in words
    space : of a pass, where it maps what is left, one of SPACES, None for configurations
    within : of a pass, the part in which it holds, as "l1=0.40:0.46,z=0.41:" (m, rad), None for all of it
    """

    way: str
    alone: bool = False
    onto: Calibration | None = None
    name: str = "the calibration"
    space: str | None = None
    within: str | None = None

    def __post_init__(self) -> None:
        if self.alone and self.onto is not None:
            raise RigError("--alone and --onto each say on what --extend stands; it takes one of them")
        if (self.space or self.within) and self.onto is None:
            raise RigError("--space and --within are of a pass; name with --onto what it stands on")

    def refuse_unsuited(self, design: Design) -> None:
        """Raise RigError where a pass cannot be of a design's machine, or stand on its calibration."""
        if self.onto is None:
            return
        if design.mechanism.link_rows is not None:
            raise RigError(
                "--onto is a pass on top of a calibration of struts; an arm's is extended in one go, by all of "
                "its recordings"
            )
        struts = require_struts(design.mechanism)
        if mechanism_dict(self.onto.correction.nominal) != mechanism_dict(struts):
            raise RigError(f"{self.name} is a calibration of another machine than this recording's rig.toml states")
        if self.onto.physics is not None:
            raise RigError(
                f"{self.name} knows physics besides the configuration; a pass goes on top of corrections by "
                "configuration alone"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Extended:
    """done : Certified, of struts or of an arm; tried : Tried of each way; claim : Claim; provenance : what is recorded
    of a pass; misses : (RMS, greatest) of the single step; unit : of an axis, m or rad; base : what the extension
    stands on, in words
    """

    done: Certified | ArmCertified
    tried: tuple[Tried, ...]
    claim: Claim
    provenance: Json
    misses: tuple[float, float]
    unit: str
    base: str


def certify_correction_extension(
    options: ExtendOptions, design: Design, sampled: Sampled, rng: np.random.Generator, progress: Progress
) -> Extended:
    """Extended, of a machine on struts or an arm. Raises RigError for a chain, and for a part that bounds nothing"""
    samples, ask = sampled.samples, Asked(options.way, options.alone)
    base = "the owner's model alone" if options.alone else "the fitted geometry"
    if has_links(design.mechanism):
        arm = require_arm(design.mechanism)
        of_arm, tried = arm_extension.certify_extended_arm(samples, arm, sampled.instrument, ask, rng, progress)
        claim_of = arm_extension.claim_without_geometry if options.alone else arm_certification.arm_workspace_claim
        misses = arm_extension.single_step_errors(of_arm.correction)
        claim = claim_of(samples, of_arm, rng)
        return Extended(of_arm, tried, claim, {}, misses, mechanisms.travel_unit(arm), base)
    provenance: Json = {}
    if options.onto is None:
        done, tried = certify_extended_correction(samples, require_struts(design.mechanism), ask, rng, progress)
    else:
        done, tried, provenance = _certify_pass(options, options.onto, samples, rng, progress)
        base = f"{options.name}, pass {provenance['number']}"
    fitted = not options.alone and options.onto is None
    claim = platform_workspace_claim(samples, done, rng) if fitted else claim_without_geometry(samples, done, rng)
    return Extended(done, tried, claim, provenance, single_step_errors(done.correction), "m", base)


def _certify_pass(
    options: ExtendOptions, before: Calibration, samples: Samples, rng: np.random.Generator, progress: Progress
) -> tuple[Certified, tuple[Tried, ...], Json]:
    """(Certified, what was tried, what the provenance records of it) of one more pass."""
    space = options.space or CONFIGURATION
    configurations, poses = _parts(options.within, before.correction.nominal)
    if configurations is not None and space == POSE or poses is not None and space == CONFIGURATION:
        raise RigError(
            f"--within {options.within}: a pass over {'poses' if space == POSE else 'configurations'} is bounded by "
            f"{'x y z rx ry rz' if space == POSE else 'the axes'}; --space both takes either"
        )
    done, tried, count = certify_additional_pass(
        samples, before, Pass(options.way, space, configurations, poses), rng, progress
    )
    return (
        done,
        tried,
        {
            "number": len(before.provenance.get("passes", ())) + 2,
            "way": options.way,
            "space": space,
            "within": options.within,
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
