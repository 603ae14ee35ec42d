"""Parameters, corrected pose covariance and file entries of machines, for each kind of mechanism."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification import platform_certification
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    gaussian_process_from_entries,
    pose_map_from_entries,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import Field
from calib.correction.machine_correction import AnyCorrection, Correction
from calib.correction.timed_command_sequence_and_pose_space_correction_map import PoseMap
from calib.models.arm import arm_certification as arm_certification
from calib.models.arm import arm_error_model_and_instrument_observations as arm_errors
from calib.models.arm.arm_correction import ArmCorrection
from calib.models.arm.arm_identification_and_joint_profiles import Profile
from calib.models.calibration_covariance_parameters import covariance_parameters
from calib.models.chain import chain_certification_and_page as chain_certification
from calib.models.chain import chain_error_model_and_identification as chains
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import map_workspace
from rig.array_and_json_types import Floats
from rig.formats.checked_toml_and_json_entries import Entries
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.mechanism_geometry_classes import Arm, Chain, FileMechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    Mechanism,
    geometric_parameters,
    parameter_names,
    require_arm,
    require_axes,
    require_chain,
    require_parallel,
)
from rig.model.mechanisms.user_kinematics_file_mechanism import SCALE

Certified = platform_certification.Certified | arm_certification.CertifiedArm | chain_certification.CertifiedChain
Parts = list[Entries | None]  # the remainder's table of each axis, None where an axis has none

FRAMES = (
    "T_base_platform maps platform coordinates to the base; base and platform frame as the stated targets hold them; "
    "tangent x y z rx ry rz on the right, in the platform frame; commanded length = joint distance - strut zero"
)
FILE_FRAMES = (
    "T_base_platform maps platform coordinates to the base; base and platform frame as the stated targets hold them; "
    "tangent x y z rx ry rz on the right, in the platform frame; axes and parameters as the kinematics file has them"
)
ARM_FRAMES = (
    "T_base_platform maps the target on the hand to the frame of poses.csv = base A_1(theta_1 + q_1) .. A_n tool, "
    "A = Rz Tz(d) Tx(a) Rx(alpha) Ry(beta); base and tool of the nominal arm are fitted where [instrument] says free; "
    "a joint turns to q - remainder(q); a slide's q adds to d, m; tangents x y z rx ry rz on the right"
)
ARM_FRAMES_KNOWN = (ARM_FRAMES, ARM_FRAMES.replace("a slide's q adds to d, m; ", ""))  # before arms had slides


class MachineModel(Protocol):
    """What calibration asks of a kind of machine."""

    @property
    def frames(self) -> tuple[str, ...]:
        """What its files may say of their frames, the first what is written."""
        ...

    @property
    def scatter_key(self) -> str:
        """Under which key its files hold how much it scatters."""
        ...

    def parameter_count(self, nominal: Commanded) -> int:
        """How many parameters its geometry has."""
        ...

    def parameter_order(self, nominal: Commanded) -> str:
        """The names of the parameters in their order, as a file states them."""
        ...

    def pose_covariance(self, calibration: Calibration, T: RigidTransform, commands: Floats) -> Floats:
        """(n, 6, 6) covariance (m, rad) of the poses T (n,) that commands (n, axes) give, docs/mathematics.md (21)."""
        ...

    def correction_from_entries(
        self, tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
    ) -> AnyCorrection:
        """The Correction of a calibration's file. Raises FileError for what cannot be one."""
        ...


@dataclass(frozen=True, slots=True)
class PlatformModel:
    """A platform, or a hinge, on struts, or of a kinematics file. order : the names of its parameters, "" : by name."""

    order: str = ""
    frames: tuple[str, ...] = (FRAMES,)
    scatter_key: str = "strut_scatter"

    def parameter_count(self, nominal: Commanded) -> int:
        """How many parameters its geometry has."""
        return len(geometric_parameters(require_parallel(nominal)))

    def parameter_order(self, nominal: Commanded) -> str:
        """The names of the parameters in their order."""
        if self.order:
            return self.order.replace("1..6", f"1..{len(nominal.axes)}")
        return "changes from nominal, 0.0005 for each tolerance: " + ", ".join(
            parameter_names(require_parallel(nominal))
        )

    def pose_covariance(self, calibration: Calibration, T: RigidTransform, commands: Floats) -> Floats:
        """(n, 6, 6) covariance (m, rad) of the poses T (n,)."""
        return platform_certification.corrected_platform_pose_covariance(calibration, T)

    def correction_from_entries(
        self, tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
    ) -> AnyCorrection:
        """The Correction of a calibration's file."""
        return _correction(tree, nominal, fitted, parts, extension)


@dataclass(frozen=True, slots=True)
class ArmModel:
    """A serial arm."""

    frames: tuple[str, ...] = ARM_FRAMES_KNOWN
    scatter_key: str = "pose_scatter"

    def parameter_count(self, nominal: Commanded) -> int:
        """How many parameters its geometry has."""
        return len(arm_errors.parameter_names(require_arm(nominal)))

    def parameter_order(self, nominal: Commanded) -> str:
        """The names of the parameters in their order."""
        return ", ".join(arm_errors.parameter_names(require_arm(nominal)))

    def pose_covariance(self, calibration: Calibration, T: RigidTransform, commands: Floats) -> Floats:
        """(n, 6, 6) covariance (m, rad) of the poses that commands (n, axes) give."""
        return arm_certification.corrected_arm_pose_covariance(calibration, commands)

    def correction_from_entries(
        self, tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
    ) -> AnyCorrection:
        """The ArmCorrection of a calibration's file."""
        axes = len(nominal.axes)
        profiles = tuple(None if part is None else _profile(part, axes) for part in parts)
        visited = tree.array("visited", (None, axes))
        return ArmCorrection(
            require_arm(nominal),
            require_arm(fitted),
            profiles,
            visited,
            extension=extension,
            posed=_pose_maps(tree, nominal),
        )


@dataclass(frozen=True, slots=True)
class ChainModel:
    """Mechanisms one upon the other."""

    frames: tuple[str, ...] = (FRAMES,)
    scatter_key: str = "pose_scatter"

    def parameter_count(self, nominal: Commanded) -> int:
        """How many parameters its geometry has."""
        return len(chains.parameter_names(require_chain(nominal)))

    def parameter_order(self, nominal: Commanded) -> str:
        """The names of the parameters in their order."""
        return "changes from nominal: " + ", ".join(chains.parameter_names(require_chain(nominal)))

    def pose_covariance(self, calibration: Calibration, T: RigidTransform, commands: Floats) -> Floats:
        """(n, 6, 6) covariance (m, rad) of the poses that commands (n, axes) give."""
        return chain_certification.corrected_chain_pose_covariance(calibration, commands)

    def correction_from_entries(
        self, tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
    ) -> AnyCorrection:
        """The Correction of a calibration's file."""
        return _correction(tree, nominal, fitted, parts, extension)


MODELS: dict[str, MachineModel] = {
    "hexapod": PlatformModel("base joints 1..6 (x y z), platform joints 1..6 (x y z), strut zeros 1..6"),
    "planar2": PlatformModel("base joints 1, 2 (x y), strut zeros 1, 2"),
    "file": PlatformModel(frames=(FILE_FRAMES,)),
    "arm": ArmModel(),
    "chain": ChainModel(),
}


def machine_model_of_mechanism(mechanism: Mechanism) -> MachineModel:
    """The MachineModel of a mechanism.

    Raises RigError for a body that is moved by hand.
    """
    return MODELS[require_axes(mechanism).kind]


def _correction(
    tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
) -> AnyCorrection:
    remainder = tuple(
        None if part is None else gaussian_process_from_entries(part, len(nominal.axes)) for part in parts
    )
    return Correction(nominal, fitted, remainder, extension=extension, posed=_pose_maps(tree, nominal))


def _pose_maps(tree: Entries, nominal: Commanded) -> tuple[PoseMap, ...]:
    return tuple(pose_map_from_entries(one, nominal) for one in tree.tables("pose_maps"))


def _profile(table: Entries, axes: int) -> Profile:
    orders = table.array("orders", (None,))
    return Profile(
        table.whole("axis", 0, most=axes - 1),
        orders,
        table.array("own", (2 * len(orders),)),
        table.array("others", (axes, 2)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class IndependentParameters:
    """names, units : of p parameters, "m" or "rad"; size : (p,) what each may be off by; jacobian : values (n, axes) m
    or rad -> (n, 6, p) change of the pose's tangent on the right; alike : whether some combinations of them no pose
    tells, so that only `size` holds them"""

    names: tuple[str, ...]
    units: tuple[str, ...]
    size: Floats
    jacobian: Callable[[Floats], Floats]
    alike: bool


def independent_parameter_names_units_sizes_and_jacobian(mechanism: Mechanism) -> IndependentParameters:
    """Names, units, sizes and pose Jacobian of a mechanism's independent geometric parameters.

    Raises RigError for a body that is moved by hand.
    """
    machine = require_axes(mechanism)
    whole, kinematics = covariance_parameters(machine), mechanisms.kinematics_of(machine)
    free = np.flatnonzero(whole.tolerance).tolist()
    scale = whole.scale[free]

    def by_unit(values: Floats) -> Floats:
        return whole.jacobian(values, kinematics.forward(values, machine))[..., free] / scale

    return IndependentParameters(
        tuple(whole.names[k] for k in free),
        tuple(whole.units[k] for k in free),
        SCALE * scale if isinstance(machine, FileMechanism) else whole.tolerance[free],
        by_unit,
        isinstance(machine, Chain),
    )


def corrected_pose_covariance(calibration: Calibration, T_base_platform: RigidTransform, commands: Floats) -> Floats:
    """Covariance (n, 6, 6) (m, rad) of the corrected poses (n,) at commands (n, axes).

    Source: docs/mathematics.md (21)
    """
    return machine_model_of_mechanism(calibration.correction.nominal).pose_covariance(
        calibration, T_base_platform, commands
    )


def calibration_with_workspace(calibration: Calibration) -> Calibration:
    """Calibration with its workspace computed, where its machine has one.

    A chain has none, nor has an arm whose hand stays in one place or has others beside it.
    Raises NotConverged where no configuration closes on a pose
    """
    nominal = calibration.correction.nominal
    pointing = isinstance(nominal, Arm) and not (nominal.rows[:, 1:3].any() or nominal.tool.translation.any())
    if nominal.bodies or hand_names(nominal) or pointing and not nominal.slides.any():
        return calibration
    return replace(
        calibration,
        workspace=map_workspace(
            calibration.correction, lambda T, commands: corrected_pose_covariance(calibration, T, commands)
        ),
    )
