"""Design of a rig as its owner states it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats, freeze_array
from rig.errors import RigError
from rig.model.base_and_link_tilt_sensors import BaseTilt, TiltSensor
from rig.model.calibration_board_layout_and_description_parsing import DICTIONARIES as DICTIONARIES
from rig.model.calibration_board_layout_and_description_parsing import Board
from rig.model.mechanism_geometry_classes import Arm, Chain, FileMechanism, Free, Hexapod, Planar2
from rig.model.protocol_port_and_user_program_name_checks import PROTOCOLS as PROTOCOLS


@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """What drives the axes.

    protocol : grblhal, gcs, gcs-hexapod, hxp, symetrie, linuxcnc, struts, epics, epics-hexapod, urscript,
    "file:NAME.py" or "package:NAME"; baudrate : bit/s; usb : serial number or hardware id of the port, or ""
    port : device, or URL socket://, rfc2217://, ca:// (EPICS), xps:// (hxp), ur:// (urscript), loop:// (tests)
    axes : the controller's names of them, () for usual ones; homing : whether it can home; else its first reading is
    believed; zero : (n,) m or rad, an axis's value where it reads 0; home : (n,) m or rad, after homing, or None
    max_speed : (n,) m/s or rad/s; max_acceleration : (n,) m/s^2 or rad/s^2, None for what the controller itself allows
    tolerance : m or rad, of a read-back; max_step : m or rad, largest change of one axis in a move, None for any
    margin : smallest share that the Jacobian's least singular value may have of its value at home; timeout : s, for an
    answer; home_timeout : s, for homing all axes; watchdog : s of silence after which a controller stops
    kinematics : "joint" (an axis word is an axis) or "world" (the controller takes poses)
    password, enable_password : of linuxcncrsh; ini : path of LinuxCNC's .ini, whose limits are compared, or ""
    work, tool : T_base_work, T_platform_tool, None at home and for itself; angles : of U V W, "moving" or "fixed" axes
    """

    protocol: str
    port: str
    baudrate: int
    usb: str
    axes: tuple[str, ...]
    homing: bool
    zero: Floats
    home: Floats | None
    max_speed: Floats
    max_acceleration: Floats | None
    tolerance: float
    max_step: float | None
    margin: float
    timeout: float
    home_timeout: float
    watchdog: float
    kinematics: str
    password: str
    enable_password: str
    ini: str = ""
    work: RigidTransform | None = None
    tool: RigidTransform | None = None
    angles: str = "moving"


DISTORTION_TERMS = (4, 5, 8, 12, 14)
FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
PERMITTED = ("payload", "wait")  # what an owner may allow experiments, besides TURN and the name of a cube
TURN = "turn cube "  # before the name of a cube that may be taken off and put back turned


@dataclass(frozen=True, slots=True)
class Instrument:
    """Who wrote poses.csv. base, tool : "free" (where it stands, its target sits, is unknown and solved for) or "rig";
    position_sigma : m, of a coordinate; rotation_sigma : rad, or None for one that sees positions alone (a reflector, a
    touched ball); kind : "pose", "orientation" (rotations alone, position_sigma infinite), "distance" (of a wire from
    the frame's origin to the target) or "direction" (in which the target's z axis points, as of a telescope)"""

    base: str
    tool: str
    position_sigma: float
    rotation_sigma: float | None
    kind: str = "pose"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuringLimbs:
    """Limbs beside the driving struts that measure their own length (sensors.csv, m1..mn, m) and carry nothing.

    base_joints : (n, 3) m, base frame; platform_joints : (n, 3) m, platform frame; length_sigma : m, of one reading
    zeros : (n,) m, what a limb is longer than it reads, 0 where they are left out
    """

    base_joints: Floats
    platform_joints: Floats
    length_sigma: float
    zeros: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        n = len(self.base_joints)
        if not len(self.zeros):
            object.__setattr__(self, "zeros", np.zeros(n))
        for name, shape in (("base_joints", (n, 3)), ("platform_joints", (n, 3)), ("zeros", (n,))):
            freeze_array(self, name, shape)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of their columns in sensors.csv: m1 .."""
        return tuple(f"m{i + 1}" for i in range(len(self.base_joints)))


@dataclass(frozen=True, slots=True)
class SensorPort:
    """Where further sensors are read. port : device, URL socket://, rfc2217://, or a user's "file:NAME.py" or
    "package:NAME"; baudrate : bits per second
    ask : line that makes them answer, "" where they send by themselves; channels : names as in sensors.csv, in the
        order of the numbers in a line"""

    port: str
    baudrate: int
    ask: str
    channels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Permission:
    """What an owner permits experiments besides motion. may : "payload" (somebody can load the platform), "wait" (to
    wait while temperatures change), "turn cube NAME" (somebody can take that cube off and put it back turned)"""

    may: tuple[str, ...] = ()

    @property
    def cubes(self) -> tuple[str, ...]:
        """Names of the cubes that may be turned."""
        return tuple(word.removeprefix(TURN) for word in self.may if word.startswith(TURN))


@dataclass(frozen=True, slots=True)
class Actuator:
    """What moves a strut; None where not stated. screw_lead : m per revolution; joints : at base and platform;
    max_speed : m/s
    """

    screw_lead: float | None
    joints: str | None
    max_speed: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Platform:
    """What the struts carry; None where not stated. mass : kg; centre_of_mass, payload_centre_of_mass : (3,) m,
    platform frame
    """

    mass: float | None
    centre_of_mass: Floats | None
    payload_centre_of_mass: Floats | None


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """How a run sets a camera; what is not stated stays as the camera has it.

    pixel_format : GenICam's PixelFormat ("Mono8", "BayerRG8", "RGB8"), or four letters of a UVC format ("MJPG", "YUYV")
    gain : dB (GenICam, whose automatic gain is switched off), or the driver's own figure (UVC)
    focus : the driver's own figure, its automatic focus is switched off; white_balance : K, likewise (UVC)
    trigger, strobe : lines of a GenICam camera: whose edges expose it, and high meanwhile; ptp : keeps time by PTP
    """

    pixel_format: str = ""
    gain: float | None = None
    focus: float | None = None
    white_balance: float | None = None
    trigger: str = ""
    strobe: str = ""
    ptp: bool = False


AS_IT_IS = CaptureSettings()  # of a camera of which nothing is to be set


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera with an OpenCV lens.

    name : as frames.csv has it; width, height : px; matrix : (3, 3) px, no skew
    distortion : (4, 5, 8, 12 or 14,) OpenCV order; pose : T_base_camera, OpenCV axes
    shutter : "global" or "rolling"; row_time : s from one row of the image to the next, of a rolling one; below 0 if
        the last row is first; where it is not stated (None), it is found from exposures in motion
    mount : "fixed", "moving" (a pose in every frame) or "hand": the platform carries it, and pose is T_platform_camera
    source : what a run opens it by, for example "uvc:0" or "file:cam.py", or None; capture : how it is set
    """

    name: str
    width: int
    height: int
    matrix: Floats
    distortion: Floats
    pose: RigidTransform
    shutter: str = "global"
    row_time: float | None = 0.0
    mount: str = "fixed"
    source: str | None = None
    capture: CaptureSettings = AS_IT_IS

    def __post_init__(self) -> None:
        freeze_array(self, "matrix", (3, 3))
        freeze_array(self, "distortion", (None,))
        if len(self.distortion) not in DISTORTION_TERMS:
            raise ValueError(f"distortion: expected {DISTORTION_TERMS} terms, got {len(self.distortion)}")


@dataclass(frozen=True, slots=True)
class Sensor:
    """What an image sensor and its optics do to light, for a simulated camera; the defaults do nothing but quantise.

    blur : px, standard deviation of the optics' spot; defocus : px, radius of a disc on top of it
    vignetting : share of the light lost in the image's corners; gain : grey levels of 255 for white in full light
    exposure : s; exposures : pictures averaged over it; read_noise : grey levels
    electrons : per grey level, for shot noise (0: none); bits : 8 or 12
    """

    blur: float = 0.0
    defocus: float = 0.0
    vignetting: float = 0.0
    gain: float = 230.0
    exposure: float = 0.0
    exposures: int = 1
    read_noise: float = 0.0
    electrons: float = 0.0
    bits: int = 8


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """One square marker. id : in its target's dictionary; side : m, of the black border; margin : m, of white beyond
    pose : T_body_marker, x right, y up, z out of the paper; where it is not stated, measuring finds it from a recording
    stated : whether the pose is what rig.toml states; else it was found from a recording, or is None"""

    id: int
    side: float
    pose: RigidTransform | None
    margin: float
    stated: bool = True

    def __post_init__(self) -> None:
        if self.pose is None and self.stated:
            raise ValueError(f"marker {self.id}: expected a pose, or stated = False, got neither")

    @property
    def T_body_marker(self) -> RigidTransform:
        """The pose. Raises RigError where none is stated and none was found."""
        if self.pose is None:
            raise RigError(f"rig.toml: the pose of marker {self.id} is not stated; `rig measure --out DIR` writes it")
        return self.pose


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Markers fixed to one body. A cube has edge, marker, faces and pose, a board its board and
    T_body_board; any other target lists its markers.

    name : its own; body : what it is fixed to, of a chain also "stage 1", of an arm with hands a hand's name
    dictionary : OpenCV's name of the markers'; edge : m, of the cube; marker : m, outer side of the black border
    faces : pairs of face and id; pose : T_body_cube, of the cube's centre; listed : the markers of one that is no cube
    board : printed layout of one that is a board; T_body_board : of its lower left corner, x right, y up, z out of the
        paper
    turned : quarter turns about the cube's own z, right-handed, with which it was taken off and put back since its pose
    was stated: its place is that only to what remounting may do; None for a target that was never taken off
    shift : added to its identities where it is one of several recordings together (see
    rig.recording.combined_recordings): the same prints are another target there
    """

    name: str
    body: str
    dictionary: str
    edge: float | None = None
    marker: float | None = None
    faces: tuple[tuple[str, int], ...] = ()
    pose: RigidTransform | None = None
    listed: tuple[Marker, ...] = ()
    board: Board | None = None
    T_body_board: RigidTransform | None = None
    turned: int | None = None
    shift: int = 0

    @property
    def seat(self) -> RigidTransform:
        """T_body_cube at present, turned about its z axis. Raises ValueError for a target that is no cube."""
        if self.pose is None:
            raise ValueError(f"target {self.name!r} is not a cube, and has no seat")
        if not self.turned:
            return self.pose
        return self.pose * RigidTransform.from_rotation(Rotation.from_rotvec([0.0, 0.0, np.pi / 2 * self.turned]))

    @property
    def stage(self) -> int:
        """Number (from 1) of the chain's stage below the last whose platform carries it; 0 on base or platform."""
        return int(self.body.removeprefix("stage ")) if self.body.startswith("stage ") else 0

    @property
    def ids(self) -> tuple[int, ...]:
        """Identities of all its markers."""
        return tuple(number + self.shift for _, number in self.faces) + tuple(
            marker.id + self.shift for marker in self.listed
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Design:
    """The whole rig.toml. name : of the rig; gravity : (3,) m/s^2 in the base frame; tilts : turns of the base by
    which gravity turns in it; tilt_sensors : on links of an arm, or on a platform; sensor : of its simulated cameras;
    controller : None where nothing is driven; joint_names : of an arm's joints, in words, or none"""

    name: str
    gravity: Floats
    mechanism: Hexapod | Planar2 | FileMechanism | Arm | Chain | Free
    instrument: Instrument | None
    actuator: Actuator
    platform: Platform
    cameras: tuple[Camera, ...]
    targets: tuple[Target, ...]
    sensor: Sensor = Sensor()
    insitu: MeasuringLimbs | None = None
    controller: Controller | None = None
    sensors: SensorPort | None = None
    experiment: Permission = Permission()
    tilts: tuple[BaseTilt, ...] = ()
    tilt_sensors: tuple[TiltSensor, ...] = ()
    joint_names: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Design: {self.name}, {self.mechanism.kind}, {len(self.cameras)} cameras, {len(self.targets)} targets>"

    def camera(self, name: str) -> Camera:
        """The camera of that name. Raises ValueError with the names there are."""
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise ValueError(f"no camera {name!r}; there are {[camera.name for camera in self.cameras]}")

    def without_stages(self) -> Design:
        """The same without the targets that a chain carries below its last platform."""
        return replace(self, targets=tuple(target for target in self.targets if not target.stage))

    def driver(self) -> Controller:
        """The Controller. Raises RigError where nothing is driven."""
        if self.controller is None:
            raise RigError("rig.toml has no [controller], so nothing is driven: state its protocol and port there")
        return self.controller


def quarter_turns_of_cubes(design: Design) -> dict[str, int]:
    """Quarter turns {cube: quarter turns} of a design's remounted cubes."""
    return {target.name.partition("@")[0]: target.turned for target in design.targets if target.turned is not None}


def chebyshev_products(camera: Camera, uv: Floats, degree: int) -> Floats:
    """Chebyshev products (..., m) of image positions uv (..., 2) px, from the second degree up to a degree."""
    x = np.clip((np.asarray(uv) - [camera.width / 2, camera.height / 2]) / (camera.width / 2), -1, 1)
    T = [np.polynomial.chebyshev.chebvander(x[..., c], degree) for c in range(2)]
    return np.stack(
        [T[0][..., i] * T[1][..., j] for i in range(degree + 1) for j in range(degree + 1 - i) if i + j > 1], axis=-1
    )


def image_warp_columns(camera: Camera, uv: Floats, degree: int) -> Floats:
    """Columns (..., 2, 2 m) px of an image warp at uv (..., 2) px, per unit of each coefficient."""
    basis = chebyshev_products(camera, uv, degree)
    zero = np.zeros_like(basis)
    return np.stack([np.concatenate([basis, zero], axis=-1), np.concatenate([zero, basis], axis=-1)], axis=-2)


def corners_of_squares_with_edges_moved_inward(quads: Floats, distance: float) -> Floats:
    """Corners (..., 4, 2) px of squares whose edges have each moved inward by a distance px, negative for outward."""
    edge = np.roll(quads, -1, axis=-2) - quads  # edge k runs from corner k to k + 1
    unit = edge / np.linalg.norm(edge, axis=-1, keepdims=True)
    before = np.roll(unit, 1, axis=-2)
    # a corner moves along both its edges by the distance / sin of the angle between them
    sine = np.abs(before[..., 0] * unit[..., 1] - before[..., 1] * unit[..., 0])
    return np.asarray(quads + distance / sine[..., None] * (unit - before))


_OUT = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}


@lru_cache(maxsize=256)
def markers_of_target(target: Target) -> tuple[Marker, ...]:
    """Markers of a target: listed, or on a cube's faces, top to +z on the sides and to +y on +z and -z.

    Raises ValueError for a target that lists neither faces nor markers.
    """
    if target.listed:
        return target.listed
    edge, side, seat = target.edge, target.marker, target.seat
    if edge is None or side is None:
        raise ValueError(
            f"expected a target that lists markers or a cube with edge and marker, got {target.name!r} with "
            f"{edge} and {side}"
        )
    return tuple(Marker(number, side, seat * face_pose(face, edge), (edge - side) / 2) for face, number in target.faces)


def face_pose(face: str, edge: float) -> RigidTransform:
    """Pose T_cube_marker of a face ("+x" .. "-z") on a cube of that edge (m): x right, y up, z out.

    Raises ValueError for a face that there is not.
    """
    if face not in FACES:
        raise ValueError(f"expected a face out of {FACES}, got {face!r}")
    out, up = np.array(_OUT[face], float), np.array([0, 1, 0] if face[1] == "z" else [0, 0, 1], float)
    matrix = np.stack([np.cross(up, out), up, out], axis=-1)
    return RigidTransform.from_components(out * edge / 2, Rotation.from_matrix(matrix))
