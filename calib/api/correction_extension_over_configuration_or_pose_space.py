"""Extension of a correction over a configuration or pose space.

It is extended from samples at once, or as an additional pass.

Source: configuration-space patent, [0035]
"""

from dataclasses import dataclass, field

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.claimed_error_reduction_over_workspace import Claim
from calib.certification.configuration_space_correction_certification import (
    ExtensionRequest,
    Tried,
    certify_extended_correction,
    claim_without_geometry,
)
from calib.certification.platform_certification import Certified, Progress, platform_workspace_claim
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    rms_and_greatest_strut_single_step_error,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import SpacePart
from calib.correction.timed_command_sequence_and_pose_space_correction_map import NAMES
from calib.files.mechanism_and_physics_entries import mechanism_dict
from calib.models.additional_correction_pass import (
    CONFIGURATION,
    POSE,
    CorrectionPass,
    certify_additional_pass,
    mechanism_placed_as_calibrated,
    samples_in_frames_of_calibration,
)
from calib.models.arm import joint_space_correction_and_workspace_claim as arm_extension
from calib.models.arm.arm_certification import CertifiedArm as ArmCertified
from calib.models.arm.joint_space_correction_and_workspace_claim import arm_workspace_claim
from calib.models.chain.chain_certification_and_page import CertifiedChain, chain_workspace_claim
from calib.models.chain.chain_correction_over_configuration_space import (
    certify_chain_correction_extension,
    rms_and_greatest_chain_single_step_error,
)
from calib.samples.commanded_and_measured_pose_samples import Sampled, Samples
from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_no_couplings, require_single_hand_mechanism
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    has_links,
    is_redundant,
    require_arm,
    require_axes,
    require_chain,
    require_parallel,
)


@dataclass(frozen=True, slots=True, eq=False)
class ExtendOptions:
    """method : how, of "linear", "simplex", "delaunay", "axes", "radial", "polynomial" or, by held-out error, "auto"
    alone : whether to correct the nominal model itself, with no geometry fitted first; onto : Calibration on which this
    is one more pass, or None; name : of that, in words
    space : of a pass, where it maps what is left, one of SPACES, None for configurations
    within : of a pass, the part in which it holds, as "l1=0.40:0.46,z=0.41:" (m, rad), None for all of it
    """

    method: str
    alone: bool = False
    onto: Calibration | None = None
    name: str = "the calibration"
    space: str | None = None
    within: str | None = None

    def __post_init__(self) -> None:
        if self.alone and self.onto is not None:
            raise RigError("--alone and --onto each state the base of --extend; use one of them")
        if (self.space or self.within) and self.onto is None:
            raise RigError("--space and --within apply to a pass; name with --onto its base")

    def refuse_unsuited(self, design: Design) -> None:
        """Raise RigError where a pass cannot be of a design's machine, or stand on its calibration."""
        require_single_hand_mechanism(design.mechanism, "corrections are extended")
        require_no_couplings(design.mechanism, "corrections are extended")
        if is_redundant(design.mechanism) and self.space != POSE:
            raise RigError(
                f"--extend {self.method} interpolates between independent commands, and the lengths of "
                f"{len(design.mechanism.axes)} struts depend on each other; over the six coordinates of poses it is a "
                "pass: --onto CALIBRATION --space pose"
            )
        if self.onto is None:
            return
        known = self.onto.correction.nominal
        nominal = mechanism_placed_as_calibrated(require_axes(design.mechanism), known, design.instrument)
        if mechanism_dict(known) != mechanism_dict(nominal):
            raise RigError(f"{self.name} is for another machine than this recording's rig.toml")
        if self.onto.physics is not None:
            raise RigError(
                f"{self.name} models physics besides the configuration; a pass extends corrections by "
                "configuration alone"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedCorrection:
    """done : Certified, of struts, an arm or a chain; tried : Tried of each method; claim : Claim; misses : (RMS,
    greatest) of the single step; unit : of these, m or rad; base : what the extension stands on, in words; provenance :
    what is recorded of a pass; remarks : on where base and tool stand
    """

    done: Certified | ArmCertified | CertifiedChain
    tried: tuple[Tried, ...]
    claim: Claim
    misses: tuple[float, float]
    unit: str
    base: str
    provenance: Json = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def lost(self) -> Floats:
        """(k, axes) vertices of its grid that were not measured, where corrections are estimated from the others."""
        return next(one.lost for one in self.tried if one.chosen)


def certify_correction_extension(
    options: ExtendOptions, design: Design, sampled: Sampled, rng: np.random.Generator, progress: Progress
) -> ExtendedCorrection:
    """ExtendedCorrection of a machine, certified.

    Raises RigError for a part that bounds nothing
    """
    if options.onto is not None:
        return _certify_pass(options, options.onto, design, sampled.samples, rng, progress)
    samples, ask = sampled.samples, ExtensionRequest(options.method, options.alone)
    done: Certified | ArmCertified | CertifiedChain
    if has_links(design.mechanism):
        arm = require_arm(design.mechanism)
        done, tried = arm_extension.certify_arm_correction_extension(
            samples, arm, sampled.instrument, ask, rng, progress
        )
    elif design.mechanism.bodies:
        done, tried = certify_chain_correction_extension(samples, require_chain(design.mechanism), ask, rng, progress)
    else:
        done, tried = certify_extended_correction(samples, require_parallel(design.mechanism), ask, rng, progress)
    base = "the nominal model alone" if options.alone else "the fitted geometry"
    return ExtendedCorrection(done, tried, *_claim_and_misses(samples, done, not options.alone, rng), base)


def _claim_and_misses(
    samples: Samples, done: Certified | ArmCertified | CertifiedChain, fitted: bool, rng: np.random.Generator
) -> tuple[Claim, tuple[float, float], str]:
    """(Claim, (RMS, greatest) of the single step, unit of these). fitted : whether a geometry was fitted with it"""
    if isinstance(done, ArmCertified):
        arm_claim = arm_workspace_claim if fitted else arm_extension.claim_without_geometry
        misses = arm_extension.rms_and_greatest_joint_single_step_error(done.correction)
        return arm_claim(samples, done, rng), misses, mechanisms.travel_unit(done.correction.nominal)
    if isinstance(done, CertifiedChain):
        misses = rms_and_greatest_chain_single_step_error(done.correction, samples.commanded)
        return chain_workspace_claim(samples, done, rng), misses, "m"
    claim = platform_workspace_claim if fitted else claim_without_geometry
    return claim(samples, done, rng), rms_and_greatest_strut_single_step_error(done.correction), "m"


def _certify_pass(
    options: ExtendOptions,
    before: Calibration,
    design: Design,
    samples: Samples,
    rng: np.random.Generator,
    progress: Progress,
) -> ExtendedCorrection:
    """ExtendedCorrection of one more pass."""
    space, nominal = options.space or CONFIGURATION, before.correction.nominal
    configurations, poses = _parts(options.within, nominal)
    if configurations is not None and space == POSE or poses is not None and space == CONFIGURATION:
        raise RigError(
            f"--within {options.within}: a pass over {'poses' if space == POSE else 'configurations'} is bounded by "
            f"{'x y z rx ry rz' if space == POSE else 'the axes'}; --space both accepts either"
        )
    placed = samples_in_frames_of_calibration(before, design.instrument, samples)
    if placed.unexpected:
        raise RigError(
            f"the {' and the '.join(placed.unexpected)} stands elsewhere than for {options.name}, and no pass corrects "
            "that: put it back, or calibrate anew"
        )
    samples = placed.samples
    done, tried, count = certify_additional_pass(
        samples, before, CorrectionPass(options.method, space, configurations, poses), rng, progress
    )
    provenance: Json = {
        "number": len(before.provenance.get("passes", ())) + 2,
        "way": options.method,
        "space": space,
        "within": options.within,
        "samples": count,
        "chosen": [one.kind for one in tried if one.chosen],
    }
    base = f"{options.name}, pass {provenance['number']}"
    return ExtendedCorrection(
        done, tried, *_claim_and_misses(samples, done, False, rng), base, provenance, placed.lines
    )


def _parts(text: str | None, mechanism: Commanded) -> tuple[SpacePart | None, SpacePart | None]:
    """(Part of the configuration space, Part of pose space), None for all of it, of a text. Raises RigError for one
    that bounds nothing.
    """
    if text is None:
        return None, None
    spaces = [mechanism.axes, tuple(NAMES[i] for i in mechanism.pose_coordinates)]
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
                f"--within takes NAME=LOW:HIGH separated by commas, names {' '.join(spaces[0] + spaces[1])}, "
                "low below high and either omitted "
                f"where free, not {word.strip()!r}"
            )
        bounds[at[0][0]][at[0][1]] = pair
    found = [SpacePart(*pair.T) if np.isfinite(pair).any() else None for pair in bounds]
    return found[0], found[1]
