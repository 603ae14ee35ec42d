"""What calibration asks of a machine of any kind: names of its parameters, its certification, how its file is read."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification import platform_certification
from calib.certification.calibration import Calibration
from calib.certification.platform_certification import Progress
from calib.certification.workspace_claim import Claim
from calib.correction.correction import AnyCorrection, Correction
from calib.correction.interpolation.field import Field
from calib.correction.interpolation.interpolation_methods import gaussian_process_from_entries
from calib.correction.pose_space_map_json import pose_map_from_entries
from calib.models.arm import certification as arm_certification
from calib.models.arm import error_model as arm_errors
from calib.models.arm.correction import ArmCorrection
from calib.models.arm.joint_profiles import Profile
from calib.models.chain import certification as chain_certification
from calib.models.chain import error_model as chain_errors
from calib.models.platform.identification import geometric_parameters
from calib.samples.recording_samples import Sampled
from rig.arrays import Floats
from rig.formats.checked_entries import Entries
from rig.model.mechanism_kinds import Commanded, Mechanism, require_arm, require_axes, require_chain, require_struts

Certified = platform_certification.Certified | arm_certification.Certified | chain_certification.Certified
Parts = list[Entries | None]  # the remainder's table of each axis, None where an axis has none

FRAMES = (
    "T_base_platform maps platform coordinates to the base; base and platform frame as the stated targets hold them; "
    "tangent x y z rx ry rz on the right, in the platform frame; commanded length = joint distance - strut zero"
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

    def certify(
        self, sampled: Sampled, nominal: Commanded, rng: np.random.Generator, progress: Progress | None = None
    ) -> tuple[Certified, Claim]:
        """What a calibration of samples finds, and what it claims all over the workspace. Raises NotEnoughData,
        NotConverged.
        """
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
    """A platform, or a hinge, on struts. order : the names of its parameters."""

    order: str
    frames: tuple[str, ...] = (FRAMES,)
    scatter_key: str = "strut_scatter"

    def parameter_count(self, nominal: Commanded) -> int:
        """How many parameters its geometry has."""
        return len(geometric_parameters(require_struts(nominal)))

    def parameter_order(self, nominal: Commanded) -> str:
        """The names of the parameters in their order."""
        return self.order

    def certify(
        self, sampled: Sampled, nominal: Commanded, rng: np.random.Generator, progress: Progress | None = None
    ) -> tuple[Certified, Claim]:
        """What a calibration of samples finds, and what it claims all over the workspace."""
        done = platform_certification.certify_platform(sampled.samples, require_struts(nominal), rng, progress)
        return done, platform_certification.platform_workspace_claim(sampled.samples, done, rng)

    def pose_covariance(self, calibration: Calibration, T: RigidTransform, commands: Floats) -> Floats:
        """(n, 6, 6) covariance (m, rad) of the poses T (n,)."""
        return platform_certification.platform_pose_covariance(calibration, T)

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

    def certify(
        self, sampled: Sampled, nominal: Commanded, rng: np.random.Generator, progress: Progress | None = None
    ) -> tuple[Certified, Claim]:
        """What a calibration of samples finds, and what it claims all over the workspace."""
        done = arm_certification.certify_arm(sampled.samples, require_arm(nominal), sampled.instrument, rng, progress)
        return done, arm_certification.arm_workspace_claim(sampled.samples, done, rng)

    def pose_covariance(self, calibration: Calibration, T: RigidTransform, commands: Floats) -> Floats:
        """(n, 6, 6) covariance (m, rad) of the poses that commands (n, axes) give."""
        return arm_certification.arm_pose_covariance(calibration, commands)

    def correction_from_entries(
        self, tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
    ) -> AnyCorrection:
        """The ArmCorrection of a calibration's file."""
        axes = len(nominal.axes)
        profiles = tuple(None if part is None else _profile(part, axes) for part in parts)
        visited = tree.array("visited", (None, axes))
        return ArmCorrection(require_arm(nominal), require_arm(fitted), profiles, visited, extension=extension)


@dataclass(frozen=True, slots=True)
class ChainModel:
    """Mechanisms one upon the other."""

    frames: tuple[str, ...] = (FRAMES,)
    scatter_key: str = "pose_scatter"

    def parameter_count(self, nominal: Commanded) -> int:
        """How many parameters its geometry has."""
        return len(chain_errors.parameter_names(require_chain(nominal)))

    def parameter_order(self, nominal: Commanded) -> str:
        """The names of the parameters in their order."""
        return "changes from nominal: " + ", ".join(chain_errors.parameter_names(require_chain(nominal)))

    def certify(
        self, sampled: Sampled, nominal: Commanded, rng: np.random.Generator, progress: Progress | None = None
    ) -> tuple[Certified, Claim]:
        """What a calibration of samples finds, and what it claims all over the workspace."""
        done = chain_certification.certify_chain(sampled.samples, require_chain(nominal), rng, progress)
        return done, chain_certification.chain_workspace_claim(sampled.samples, done, rng)

    def pose_covariance(self, calibration: Calibration, T: RigidTransform, commands: Floats) -> Floats:
        """(n, 6, 6) covariance (m, rad) of the poses that commands (n, axes) give."""
        return chain_certification.chain_pose_covariance(calibration, commands)

    def correction_from_entries(
        self, tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
    ) -> AnyCorrection:
        """The Correction of a calibration's file."""
        return _correction(tree, nominal, fitted, parts, extension)


MODELS: dict[str, MachineModel] = {
    "hexapod": PlatformModel("base joints 1..6 (x y z), platform joints 1..6 (x y z), strut zeros 1..6"),
    "planar2": PlatformModel("base joints 1, 2 (x y), strut zeros 1, 2"),
    "arm": ArmModel(),
    "chain": ChainModel(),
}


def model_of(mechanism: Mechanism) -> MachineModel:
    """The MachineModel of a mechanism. Raises RigError for a body that is moved by hand."""
    return MODELS[require_axes(mechanism).kind]


def _correction(
    tree: Entries, nominal: Commanded, fitted: Commanded, parts: Parts, extension: Field | None
) -> AnyCorrection:
    posed = tuple(pose_map_from_entries(one, require_struts(nominal)) for one in tree.tables("pose_maps"))
    remainder = tuple(
        None if part is None else gaussian_process_from_entries(part, len(nominal.axes)) for part in parts
    )
    return Correction(nominal, fitted, remainder, extension=extension, posed=posed)


def _profile(table: Entries, axes: int) -> Profile:
    orders = table.array("orders", (None,))
    return Profile(
        table.whole("axis", 0, most=axes - 1),
        orders,
        table.array("own", (2 * len(orders),)),
        table.array("others", (axes, 2)),
    )
