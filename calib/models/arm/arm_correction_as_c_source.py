"""Correction of an arm's calibration as C source.

One C99 file: joint commands in, corrected joint commands out.

An arm's controller has kinematics of its own, the nominal one. What it commands means a pose, that of the nominal
figures; the file finds, near these joint values, those that `rig correct` commands for this pose.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.correction_as_c_source import (
    FIELDS,
    CCall,
    CSource,
    c_file_opening,
    c_source_part,
    commands_of_effects,
    controller_terms_of_compensable_effects,
    define_remainder,
    joined_c_parts,
)
from calib.correction.correction_fields_as_c_functions import CTables
from calib.correction.physics_compensation import Physics
from calib.models.arm.correction import ArmCorrection
from calib.models.arm.identification_and_joint_profiles import Profile
from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.closed_form_and_numerical_arm_inverse import hand_motion_direction_counts

CALL = CCall(
    "Corrected joint commands of an arm, as `rig correct` computes them.",
    "int rig_correct(const double joints[{0}], const double *channels, struct rig_state *state, double commands[{0}]);",
    (
        "  joints: that the nominal kinematics gives for the wanted pose, rad, of slides m; commands: as them",
        "  The pose is that of the nominal figures, base and tool as the calibration has them. Corrected commands are",
        "  those next to the joints given, on the same side of elbow and wrist; no joint is moved by a whole turn.",
    ),
    "joint",
    "the joint values",
    "commands",
)


def arm_correction_c_source(correction: ArmCorrection, physics: Physics | None, origin: str) -> CSource:
    """C source of an arm's correction (CSource).

    Of an ArmCorrection and the Physics besides, or None.
    origin : of which file and by which version it is made, for its head
    Raises RigError for a way to extend corrections and for an effect that no C file states
    """
    nominal, fitted = correction.nominal, correction.fitted
    axes = len(nominal.joints)
    call = replace(CALL, prototype=CALL.prototype.format(axes))
    effects = controller_terms_of_compensable_effects(correction, physics)
    geometry, tables = CTables(axes), CTables(axes)
    geometry.array("SLIDES", fitted.slides.astype(float), "int")
    geometry.array("RANGE", nominal.limits, shape="[RIG_AXES][2]")
    geometry.array("GAP", effects.plays, shape="[RIG_AXES]")
    profiles = [_profile(tables, one) for one in correction.remainder if one is not None]
    settled = define_remainder(tables, correction.extension, profiles)
    few = correction.deficient
    if few:
        count = hand_motion_direction_counts(nominal)
        geometry.lines.append(f"enum {{ POSITIONS = {count.position}, ROTATIONS = {count.rotation} }};")
    return CSource(
        joined_c_parts(
            *c_file_opening(call, correction, effects, effects.plays, origin),
            c_source_part("arm"),
            "\n".join([*geometry.lines, *_chain("NOMINAL", nominal), *_chain("FITTED", fitted)]),
            *(c_source_part(name) for name in FIELDS if name in tables.parts),
            "\n".join(tables.lines),
            c_source_part("settle" if settled else "no remainder"),
            c_source_part("rotation vector"),
            c_source_part("arm kinematics"),
            c_source_part("arm of few joints" if few else "arm of six joints or more"),
            *commands_of_effects(effects),
            c_source_part("ranges"),
            c_source_part("arm correct"),
        ),
        effects.notes,
        effects.channels,
        effects.plays,
    )


def _chain(name: str, arm: Arm) -> list[str]:
    """Lines that define an arm's figures: rows of its links, base and tool."""
    return [
        f"static const struct chain {name} = {{",
        f"    {_braced(arm.rows)},",
        *(f"    {_placed(T)}," for T in (arm.base, arm.tool)),
        "};",
    ]


def _placed(T: RigidTransform) -> str:
    """A pose in C: {rotation, position}."""
    return f"{{{_braced(T.rotation.as_matrix())}, {_braced(T.translation)}}}"


def _braced(values: Floats) -> str:
    """Numbers in C, an array of arrays in braces each."""
    if np.ndim(values) == 0:
        return repr(float(values))
    return f"{{{', '.join(map(_braced, values))}}}"


def _profile(tables: CTables, profile: Profile) -> list[str]:
    """Name of the function that adds a joint's profile, its waves in tables."""
    waves = len(profile.orders)
    own = np.stack([profile.own[:waves], profile.own[waves:]], axis=1)
    arrays = {"orders": profile.orders, "own": own, "others": profile.others}
    return tables.structure("profile", (profile.axis, waves), arrays)
