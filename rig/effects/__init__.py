"""The catalogue of left-out physics: adding a file and a line here adds an effect everywhere."""

from rig.effects.axis_coupling import AxisCoupling
from rig.effects.backlash import Backlash
from rig.effects.base import Effect
from rig.effects.base_expansion import BaseExpansion
from rig.effects.camera_bump import CameraBump
from rig.effects.camera_drift import CameraDrift
from rig.effects.clock_drift import ClockDrift
from rig.effects.compliance import Compliance
from rig.effects.creep import Creep
from rig.effects.cube_misplacement import CubeMisplacement
from rig.effects.cyclic_error import CyclicError
from rig.effects.edge_bias import EdgeBias
from rig.effects.face_misplacement import FaceMisplacement
from rig.effects.focal_drift import FocalDrift
from rig.effects.hysteresis import Hysteresis
from rig.effects.joint_clearance import JointClearance
from rig.effects.lens_distortion import LensDistortion
from rig.effects.marker_swap import MarkerSwap
from rig.effects.missed_steps import MissedSteps
from rig.effects.print_scale import PrintScale
from rig.effects.refraction import Refraction
from rig.effects.rolling_shutter import RollingShutter
from rig.effects.scale_error import ScaleError
from rig.effects.screw_coupling import ScrewCoupling
from rig.effects.servo_lag import ServoLag
from rig.effects.settling_error import SettlingError
from rig.effects.thermal_expansion import ThermalExpansion
from rig.effects.time_offset import TimeOffset
from rig.effects.transmission_error import TransmissionError
from rig.effects.vibration import Vibration
from rig.effects.warm_up import WarmUp

ALL: tuple[type[Effect], ...] = (
    ScaleError, CyclicError, TransmissionError, Backlash, Hysteresis, MissedSteps, ServoLag, Creep, ThermalExpansion, WarmUp,
    ScrewCoupling, Compliance, JointClearance, BaseExpansion, Vibration, TimeOffset, ClockDrift, LensDistortion, FocalDrift, CameraDrift,
    CameraBump, RollingShutter, Refraction, EdgeBias, PrintScale, FaceMisplacement, CubeMisplacement, MarkerSwap, AxisCoupling,
    SettlingError,
)
BY_NAME: dict[str, type[Effect]] = {effect.name: effect for effect in ALL}
