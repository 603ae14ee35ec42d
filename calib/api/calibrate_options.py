"""What a calibration is asked for."""

from dataclasses import dataclass
from pathlib import Path

from calib.api.correction_extension import ExtendOptions
from calib.online.limb_pose_source import LimbSource
from rig.effects.texts.user_effect_files import Plugin
from rig.errors import RigError
from rig.model.design import Design


@dataclass(frozen=True, slots=True, eq=False)
class CalibrateOptions:
    """diagnosis : folder that `rig diagnose` wrote, whose findings are refined with the geometry; find : whether to
    diagnose the recording first and take in what is found; effects : files of effects besides the catalogue
    quick : whether not to search for what the geometry leaves out; joint : whether to solve cameras, lenses and
    geometry once more from all corners together
    extend : how corrections are extended over a space, None for the geometry and its remainder; limbs : measuring limbs
    as the source of poses, None for vision or poses.csv
    anyway : whether to go on though a mistake makes results meaningless; arguments : of a command, for the provenance
    """

    diagnosis: Path | None = None
    find: bool = False
    effects: tuple[Plugin, ...] = ()
    quick: bool = False
    joint: bool = False
    extend: ExtendOptions | None = None
    limbs: LimbSource | None = None
    anyway: bool = False
    arguments: tuple[str, ...] = ()

    @property
    def with_findings(self) -> bool:
        """Whether the physics that a diagnosis finds is taken in."""
        return self.find or self.diagnosis is not None

    def __post_init__(self) -> None:
        asked = "--find" if self.find else "--diagnosis"
        if self.with_findings and self.joint:
            raise RigError(
                f"{asked} solves cameras, lenses, geometry and physics from all corners together; leave out --joint"
            )
        if self.with_findings and self.limbs is not None:
            raise RigError(f"{asked} looks at what cameras saw of every pose; leave out --limbs")
        if self.with_findings and self.extend is not None:
            raise RigError(f"{asked} corrects what it finds by its own models, --extend by none; give one of them")
        if self.effects and not self.with_findings:
            raise RigError("--effects adds to what a diagnosis is asked for: give --find or --diagnosis as well")
        if self.extend is not None and self.joint:
            raise RigError("--extend is not for --joint: give one of them")

    def refuse_unsuited(self, design: Design) -> None:
        """Raise RigError for what a design's machine takes none of."""
        mechanism = design.mechanism
        if self.with_findings and mechanism.bodies:
            raise RigError(
                f"{'--find' if self.find else '--diagnosis'} is for platforms on struts and for arms; a chain is "
                "corrected by its geometry"
            )
        if self.extend is not None:
            self.extend.refuse_unsuited(design)
        elif self.joint and mechanism.axes and mechanism.strut_joints is None:
            raise RigError(
                f"--joint solves a hexapod's cameras and struts together; "
                f"a mechanism of kind {mechanism.kind!r} takes none "
                "of it"
            )


SEARCHED = CalibrateOptions()  # the geometry and its remainder, and what they leave out searched for
