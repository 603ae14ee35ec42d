"""List of all effects of the catalogue; a file and a line here add an effect everywhere."""

from rig.effects.catalogue.axis_coupling import AxisCoupling
from rig.effects.catalogue.backlash import Backlash
from rig.effects.catalogue.base_expansion import BaseExpansion
from rig.effects.catalogue.camera_bump import CameraBump
from rig.effects.catalogue.camera_drift import CameraDrift
from rig.effects.catalogue.clock_drift import ClockDrift
from rig.effects.catalogue.compliance import Compliance
from rig.effects.catalogue.creep import Creep
from rig.effects.catalogue.cube_misplacement import CubeMisplacement
from rig.effects.catalogue.cyclic_error import CyclicError
from rig.effects.catalogue.edge_bias import EdgeBias
from rig.effects.catalogue.face_misplacement import FaceMisplacement
from rig.effects.catalogue.focal_drift import FocalDrift
from rig.effects.catalogue.hysteresis import Hysteresis
from rig.effects.catalogue.joint_clearance import JointClearance
from rig.effects.catalogue.lens_distortion import LensDistortion
from rig.effects.catalogue.marker_swap import MarkerSwap
from rig.effects.catalogue.missed_steps import MissedSteps
from rig.effects.catalogue.print_scale import PrintScale
from rig.effects.catalogue.refraction import Refraction
from rig.effects.catalogue.rolling_shutter import RollingShutter
from rig.effects.catalogue.scale_error import ScaleError
from rig.effects.catalogue.screw_coupling import ScrewCoupling
from rig.effects.catalogue.servo_lag import ServoLag
from rig.effects.catalogue.settling_error import SettlingError
from rig.effects.catalogue.thermal_expansion import ThermalExpansion
from rig.effects.catalogue.time_offset import TimeOffset
from rig.effects.catalogue.transmission_error import TransmissionError
from rig.effects.catalogue.vibration import Vibration
from rig.effects.catalogue.warm_up import WarmUp
from rig.effects.framework.effect import Effect
from rig.model.manufacturing_tolerances import Tolerance

ALL: tuple[type[Effect], ...] = (
    ScaleError,
    CyclicError,
    TransmissionError,
    Backlash,
    Hysteresis,
    MissedSteps,
    ServoLag,
    Creep,
    ThermalExpansion,
    WarmUp,
    ScrewCoupling,
    Compliance,
    JointClearance,
    BaseExpansion,
    Vibration,
    TimeOffset,
    ClockDrift,
    LensDistortion,
    FocalDrift,
    CameraDrift,
    CameraBump,
    RollingShutter,
    Refraction,
    EdgeBias,
    PrintScale,
    FaceMisplacement,
    CubeMisplacement,
    MarkerSwap,
    AxisCoupling,
    SettlingError,
)
BY_NAME: dict[str, type[Effect]] = {effect.name: effect for effect in ALL}


def effect_of_tolerance(tolerance: Tolerance | tuple[float, float]) -> type[Effect]:
    """The effect of the catalogue that what lies beyond a manufacturing tolerance is."""
    return next(kind for kind in ALL if kind.tolerance == tolerance)
