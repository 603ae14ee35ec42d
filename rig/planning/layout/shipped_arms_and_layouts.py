"""Shipped arms (rig/arms), and their layouts.

Names, files, and rig.toml layouts with cameras and cubes.

The arm is to move about one posture, far from its singular ones, in which hand and cubes stay in view: its limits are
narrowed to that.
"""

import re
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.numbers_and_units import SI, LengthAndAngleUnits
from rig.formats.rig_toml import design_from_rig_toml
from rig.formats.rig_toml.rig_toml_text_in_other_units import rig_toml_in_units
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import STRUT_COUNTS, Arm
from rig.model.mechanisms import arm_kinematics_limits_and_loads as mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.layout.hexapod_layout_and_camera_placement import (
    FACES,
    CubeRing,
    camera_pose,
    camera_ring_toml_lines,
    cube_ring_toml_lines,
    cube_toml_lines,
    hexapod_layout_rig_toml,
    require_possible_layout,
    single_camera_toml_lines,
    two_strut_layout_rig_toml,
)

INSTRUMENT = """
[instrument]            # a laser tracker with a probe of six degrees of freedom
base = "free"           # its pose is unknown and estimated; "rig" where poses.csv is in the arm's own base
tool = "free"           # where its target sits on the hand, likewise
position_sigma = 2e-5   # m
rotation_sigma = 1e-4   # rad
"""

CONTROLLER = """
[controller]            # what drives the struts
protocol = "grblhal"    # or gcs, gcs-hexapod, hxp, symetrie, linuxcnc, struts, epics, epics-hexapod, or "file:mine.py"
# port = "/dev/ttyACM0" # state it: a device, socket://HOST:PORT or rfc2217://HOST:PORT; until then give --port
homing = true           # false: it cannot home, and what it reads at the start is believed
zero = 0.0              # m, a strut's length, joint centre to joint centre, where the controller counts 0
tolerance = 1e-5        # m, of a read-back
"""


def shipped_arm_names() -> list[str]:
    """Names of the shipped arms, sorted."""
    return sorted(
        entry.name.removesuffix(".toml") for entry in (files("rig") / "arms").iterdir() if entry.name.endswith(".toml")
    )


def shipped_arm_path(path_or_name: str) -> Path:
    """Path of the rig.toml of a shipped arm by its name, or the path itself.

    Raises RigError for what is neither.
    """
    if Path(path_or_name).exists() or Path(path_or_name).suffix:
        return Path(path_or_name)
    if path_or_name not in shipped_arm_names():
        raise RigError(
            f"there is no file {path_or_name!r}, nor is it one of the shipped arms: {', '.join(shipped_arm_names())}"
        )
    return Path(str(files("rig") / "arms" / f"{path_or_name}.toml"))


def load_shipped_arm_design(path_or_name: str) -> Design:
    """Load the Design of a shipped arm by its name, or of a rig.toml by its path.
    Raises RigError for what is neither, FileError as rig.formats.rig_toml.design_from_rig_toml.load_design.
    rig.formats.rig_toml.design_from_rig_toml.load_design.
    """
    return design_from_rig_toml.load_design(shipped_arm_path(path_or_name))


def shipped_arm_rig_toml(name: str) -> str:
    """rig.toml text of a shipped arm.

    It is measured by an instrument.
    Raises RigError for an unknown name.
    """
    if name not in shipped_arm_names():
        raise RigError(f"there is no arm {name!r}; there are {', '.join(shipped_arm_names())}")
    return (files("rig") / "arms" / f"{name}.toml").read_text(encoding="utf-8") + INSTRUMENT


TRIED = 400  # postures, of which the one with the best conditioned Jacobian is taken
TURNS = {"cubes": 0.45, "hand": 0.3}  # rad either way that every joint may turn, by what is carried
SLIDES = 0.15  # of a slide's stroke either way
WIDE = 0.75  # rad to either side that a camera in the hand sees


def arm_layout_rig_toml(
    name: str, hand_mounted: str, cameras: int, size: tuple[int, int], cubes: int, dictionary: str
) -> str:
    """rig.toml text of the layout of a shipped arm with cameras and cubes.

    hand_mounted : "cubes" or "hand", for cameras in the hand; cameras : how many; size : px of the images; cubes : how
        many
    in the hand and on the base, or three times as many before the hand
    Raises RigError for a name that there is not, a dictionary with too few identities, or figures that make no rig
    """
    text = shipped_arm_rig_toml(name).replace(INSTRUMENT, "")
    arm = _arm_with_limits_about_best_posture(require_arm(load_shipped_arm_design(name).mechanism), TURNS[hand_mounted])
    require_possible_layout(1.0, cameras, cubes if hand_mounted == "cubes" else -(-3 * cubes // 2), dictionary)
    lines = [_narrowed(text, arm).rstrip(), ""]
    T = mechanism.forward(sobol_configurations(arm.limits, 64, 1.0), arm)
    middle = T.translation.mean(axis=0)
    reach = float(np.linalg.norm(T.translation - middle, axis=1).max())
    lines += (
        _cubes_in_hand(middle, reach, cameras, size, cubes, dictionary)
        if hand_mounted == "cubes"
        else _cameras_in_hand(
            mechanism.forward(arm.limits.mean(axis=1), arm), reach, cameras, size, 3 * cubes, dictionary
        )
    )
    return "\n".join(lines) + "\n"


def _arm_with_limits_about_best_posture(arm: Arm, turn: float) -> Arm:
    """The arm with limits about its best conditioned posture, of those tried."""
    reach = np.where(arm.slides, SLIDES * np.ptp(arm.limits, axis=1), np.minimum(turn, np.ptp(arm.limits, axis=1) / 2))
    inner = np.stack([arm.limits[:, 0] + reach, arm.limits[:, 1] - reach], axis=1)
    q = sobol_configurations(np.clip(inner, -np.pi, np.pi), TRIED, 0.9)
    q = np.where(inner[:, 0] < inner[:, 1], np.clip(q, inner[:, 0], inner[:, 1]), inner.mean(axis=1))
    least = np.linalg.svd(mechanism.jacobian(q, arm), compute_uv=False)[:, -1]
    best = q[np.argmax(least)].round(2)
    return Arm(arm.joints, np.stack([best - reach, best + reach], axis=1).round(4), arm.base, arm.tool, arm.slides)


def _narrowed(text: str, arm: Arm) -> str:
    """A shipped arm's text with these limits."""
    import tomlkit

    document = tomlkit.parse(text)
    limits = tomlkit.item(arm.limits.tolist())
    limits.comment("narrowed to where hand and cubes are seen; the arm's own are wider")
    document["mechanism"]["limits"] = limits
    return tomlkit.dumps(document)


def _cubes_in_hand(
    middle: Floats, reach: float, cameras: int, size: tuple[int, int], cubes: int, dictionary: str
) -> list[str]:
    edge_platform, edge_base = (share * reach * (2 / np.sqrt(max(cubes, 4))) for share in (0.24, 0.3))
    low = middle - [0, 0, 0.8 * reach - edge_base / 2]
    return camera_ring_toml_lines(middle, reach, cameras, *size) + cube_ring_toml_lines(
        cubes,
        dictionary,
        CubeRing(np.array([0, 0, edge_platform / 2]), 0.22 * reach, edge_platform, 0.35),
        CubeRing(low, reach, edge_base, 0.35),
    )


def _cameras_in_hand(
    T: RigidTransform, reach: float, cameras: int, size: tuple[int, int], cubes: int, dictionary: str
) -> list[str]:
    """Cameras that look out of the hand, along its z, and cubes in a field before it, their +z towards it."""
    lines, apart = list[str](), 0.12 * reach
    for i in range(cameras):
        angle = 2 * np.pi * i / cameras
        at = RigidTransform.from_translation(
            apart * np.array([np.cos(angle), np.sin(angle), 0]) if cameras > 1 else [0.0, 0, 0]
        )
        lines += single_camera_toml_lines(f"cam{i}", at, WIDE, size, "hand")
    ahead = T.rotation.apply([0, 0, 1.0])
    far = 1.6 * reach
    field = camera_pose(T.translation + far * ahead, ahead).rotation
    wide = int(np.ceil(np.sqrt(cubes * 4 / 3)))
    facing = field * Rotation.from_rotvec([np.pi, 0, 0])  # z back to the hand
    for i in range(cubes):
        across, up = i % wide - (wide - 1) / 2, i // wide - (-(-cubes // wide) - 1) / 2
        depth = 0.12 * far * ((i * 2) % 3 - 1)
        place = T.translation + (far + depth) * ahead + 0.42 * far * field.apply([across, up, 0.0])
        turn = (facing * Rotation.from_rotvec([0, 0, 0.4 * i])).as_rotvec()
        lines += cube_toml_lines(f"B{i + 1}", "base", dictionary, len(FACES) * i, 0.17 * far, place, turn)
    return lines


@dataclass(frozen=True, slots=True)
class LayoutOptions:
    """What a new rig.toml is laid out from: the options of `rig new design`.

    mechanism : "hexapod", "planar2", "arm", or None: an arm where `arm` names one, else a hexapod
    arm : name of a shipped one; seen : None for an instrument, or "cubes" or "hand" as of `arm_layout_rig_toml`
    radius : m, of a hexapod's circle of base joints, of planar2 half the joints' distance
    size : WIDTHxHEIGHT of the images, px; limbs : how many measuring limbs stand next to a hexapod's struts
    struts : of a hexapod, six to eight
    own_arm : rig.toml text of an arm that was read from a file, which is measured by an instrument
    units : of the lengths and angles in the text, which states them
    Raises RigError for options that do not belong to each other
    """

    mechanism: str | None = None
    arm: str | None = None
    seen: str | None = None
    radius: float | None = None
    cameras: int = 3
    cubes: int = 4
    size: str = "1280x1024"
    dictionary: str = "DICT_5X5_100"
    limbs: int = 0
    struts: int = 6
    name: str | None = None
    own_arm: str | None = None
    units: LengthAndAngleUnits = SI

    def __post_init__(self) -> None:
        if self.own_arm is not None:
            self._require_own_arm_options()
            return
        if self.struts != 6 and (self.arm is not None or self.mechanism == "arm"):
            raise RigError("--struts is for a hexapod; an arm has joints")
        if self.arm is not None or self.mechanism == "arm":
            self._require_arm_options()
            return
        if self.radius is None:
            raise RigError("a hexapod or planar2 takes --radius, an arm --arm")
        if self.seen is not None:
            raise RigError("--seen applies to an arm; use it with --arm")
        self.image_size()
        if self.limbs < 0:
            raise RigError(f"--limbs takes a number of limbs, not {self.limbs}")
        if self.limbs and self.mechanism == "planar2":
            raise RigError(f"--limbs belong to a hexapod's struts; a {self.mechanism} has none")
        if self.struts not in STRUT_COUNTS:
            raise RigError(f"--struts takes six, seven or eight, not {self.struts}")
        if self.struts > 6 and (self.mechanism == "planar2" or self.limbs):
            raise RigError("--struts of more than six is for a hexapod, without measuring limbs")

    def _require_own_arm_options(self) -> None:
        other = {"--arm": self.arm, "--radius": self.radius, "--seen": self.seen, "--limbs": self.limbs or None}
        if self.mechanism != "arm":
            other["--mechanism"] = self.mechanism
        for option, value in other.items():
            if value is not None:
                raise RigError(f"--urdf and --dh bring an arm's own figures, measured by an instrument; omit {option}")

    def _require_arm_options(self) -> None:
        if self.arm is None:
            raise RigError(
                f"--mechanism arm takes --arm with the name of a shipped one: {', '.join(shipped_arm_names())}"
            )
        if self.mechanism in ("hexapod", "planar2") or self.radius is not None:
            raise RigError(
                f"--arm brings its own figures; --mechanism {self.mechanism or 'hexapod'} and --radius are for struts"
            )

    def image_size(self) -> tuple[int, int]:
        """(width, height) px. Raises RigError for a size that is not like 1280x1024."""
        size = re.fullmatch(r"(\d+)[xX](\d+)", self.size)
        if not size:
            raise RigError(f"--size takes for example 1280x1024, not {self.size!r}")
        return int(size[1]), int(size[2])


def new_rig_toml(options: LayoutOptions) -> str:
    """rig.toml text of a new rig.

    A hexapod, two struts or a shipped arm, with cameras and cubes placed.
    Raises RigError as `hexapod_layout_rig_toml`, `two_strut_layout_rig_toml` and `arm_layout_rig_toml`
    """
    return rig_toml_in_units(_rig_toml_in_si(options), options.units)


def _rig_toml_in_si(options: LayoutOptions) -> str:
    if options.own_arm is not None:
        return options.own_arm + INSTRUMENT
    if options.arm is not None and options.seen is None:
        return shipped_arm_rig_toml(options.arm)
    size, cameras, cubes, dictionary = options.image_size(), options.cameras, options.cubes, options.dictionary
    if options.arm is not None and options.seen is not None:
        return arm_layout_rig_toml(options.arm, options.seen, cameras, size, cubes, dictionary)
    assert options.radius is not None  # LayoutOptions require it of struts
    kind = options.mechanism or "hexapod"
    name = options.name or kind
    if kind == "hexapod":
        text = hexapod_layout_rig_toml(
            options.radius, cameras, *size, cubes, dictionary, name, (options.struts, options.limbs)
        )
        if options.struts > 6:  # which no controller drives yet
            return text
    else:
        text = two_strut_layout_rig_toml(options.radius, cameras, *size, cubes, dictionary, name)
    return text + CONTROLLER
