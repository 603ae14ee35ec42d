"""Kinematics of a calibrated hexapod for LinuxCNC and for grblHAL, as C source.

The correction of its calibration as LinuxCNC's kinematics module, for halcompile, and as grblHAL's kinematics plug-in.

Each is the C file for controllers, kinematics of poses (controller_pose_parts.c) and the interface of that controller,
linuxcnc_kinematics.c or grblhal_kinematics.c. Both controllers ask for poses in any order, so kinematics are without
memory: play is left to LinuxCNC's own BACKLASH; grblHAL's interface takes it up, strut by strut, as lines are cut.
Source: LinuxCNC 2.9, Developer manual, Kinematics; HAL manual, Creating HAL components; grblHAL's core of build
20260817, kinematics/interface.h and what motion_control.c and machine_limits.c call of it
"""

from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files

import numpy as np

from calib.correction.correction_field_methods_fitting_combination_and_json import home_pose
from calib.correction.hexapod_correction_c_source_and_shared_c_file_parts import (
    CSource,
    c_source_part,
    correction_c_source,
)
from calib.correction.machine_correction import AnyCorrection
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG
from rig.formats.exporters.json_csv_linuxcnc_and_camera_file_exports import UNITS
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod

MARGIN = 0.1  # share of the Jacobian's least singular value at home that must remain, as [controller] margin


def linuxcnc_kinematics_source(
    correction: AnyCorrection, physics: Physics | None, origin: str, units: str = "mm"
) -> CSource:
    """LinuxCNC kinematics source (CSource) of a hexapod's correction.

    It is LinuxCNC's kinematics module "rigkins", of the Correction and the Physics besides, where there is any.
    origin : of which file and by which version it is made; units : "mm" or "m", LinuxCNC's LINEAR_UNITS
    Raises RigError for what no C file states, and for play together with a cyclic error
    """
    source = correction_c_source(correction, physics, origin, play_elsewhere=True)
    fitted, nominal = require_hexapod(correction.fitted), require_hexapod(correction.nominal)
    head = _linuxcnc_settings(fitted, nominal, source, UNITS[units], units)
    return _with_kinematics(source, fitted, head, UNITS[units], [], "linuxcnc_kinematics.c")


def grblhal_kinematics_source(
    correction: AnyCorrection, physics: Physics | None, origin: str, made: str, zero: Floats | None = None
) -> CSource:
    """GrblHAL kinematics source (CSource) of a hexapod's correction.

    It is grblHAL's kinematics plug-in, of the Correction and the Physics besides, where there is any.
    origin : of which file and by which version it is made; made : the same in a few words, which $I reports
    zero : (6,) m, lengths of the struts where the motors count 0; None for those of the home pose
    Raises RigError for what no C file states, for play together with a cyclic error, and for a zero that is not a
        finite length
    """
    source = correction_c_source(correction, physics, origin, play_elsewhere=True)
    fitted, nominal = require_hexapod(correction.fitted), require_hexapod(correction.nominal)
    zero = hexapod.home_values(nominal) if zero is None else zero
    if zero.shape != (6,) or not ((zero >= 0) & (zero <= LARGEST_RIG)).all():
        raise RigError(f"--zero is one length or six, 0 to {LARGEST_RIG:g} m, not {zero.tolist()}")
    head = _grblhal_settings(fitted, nominal, source, zero)
    constants = [
        f"static const double MOTOR_ZERO[6] = {{{', '.join(map(repr, zero.tolist()))}}}; /* m */",
        f"static const double PLAY[6] = {{{', '.join(map(repr, source.gaps.tolist()))}}}; /* m */",
        f'#define RIGKINS_MADE "{made}"',
    ]
    return _with_kinematics(source, fitted, head, UNITS["mm"], constants, "grblhal_kinematics.c")


def _with_kinematics(
    source: CSource, fitted: Hexapod, head: Sequence[str], scale: float, constants: Sequence[str], interface: str
) -> CSource:
    """The source with a head comment before it, and behind it kinematics of poses and a controller's interface.

    head : lines; scale : machine units of a metre; constants : lines; interface : name of the file in C
    """
    comment = "/*\n" + "\n".join(f" * {line}".rstrip() for line in head).replace("*/", "* /") + "\n */"
    return replace(
        source,
        text="\n".join(
            [
                comment,
                source.text,
                _constants(fitted, source),
                *constants,
                f"#define UNITS {scale!r} /* machine units of a metre */\n",
                c_source_part("pose kinematics"),
                files(__package__).joinpath(interface).read_text(),
            ]
        ),
    )


def _home_place(fitted: Hexapod, scale: float) -> str:
    """The home pose as X Y Z A B C in machine units and degrees. scale : units of a metre"""
    T = home_pose(fitted)
    place = [*(T.translation * scale), *T.rotation.as_euler("xyz", degrees=True)]
    return " ".join(f"{value:.6f}" for value in place)


def _linuxcnc_settings(fitted: Hexapod, nominal: Hexapod, source: CSource, scale: float, units: str) -> list[str]:
    """Head of the module: how it is built, its pins, and what LinuxCNC's ini has to state of it.

    scale : units of a metre
    """
    home = hexapod.home_values(nominal)
    ranges = nominal.strut_range + 0.5 * source.gaps[:, None] * [1, -1]
    lines = [
        "Kinematics module rigkins of LinuxCNC 2.8 and 2.9, by the correction that `rig correct` computes.",
        "Build and install it: halcompile --install rigkins.c; in the ini:",
        "",
        "[KINS]",
        "KINEMATICS = rigkins",
        "JOINTS = 6",
        "[TRAJ]",
        "COORDINATES = X Y Z A B C",
        f"LINEAR_UNITS = {'mm' if units == 'mm' else '0.001'}",
        "ANGULAR_UNITS = degree",
        f"HOME = {_home_place(fitted, scale)}",
    ]
    for i, (low, high) in enumerate((ranges * scale).tolist()):
        lines += [
            f"[JOINT_{i}]",
            f"HOME = {home[i] * scale:.9f}",
            f"MIN_LIMIT = {low:.9f}",
            f"MAX_LIMIT = {high:.9f}",
            *([f"BACKLASH = {source.gaps[i] * scale:.9f}"] if source.gaps[i] else []),
        ]
    return [
        *lines,
        "",
        "A pose that is refused returns below 0 and changes no joint. Pins: rigkins.inverse-status, .forward-status,",
        ".forward-steps of the latest calls; rigkins.refused, .refused-strut (1 to 6, 0 for none) of the latest",
        "refusal, .refusals, their number. Statuses are those below, and 6 RIG_SINGULAR. Pins in, with their medians:",
        *([f"  rigkins.{name} {value:g}" for name, value in source.channels.items()] or ["  none"]),
    ]


def _grblhal_settings(fitted: Hexapod, nominal: Hexapod, source: CSource, zero: Floats) -> list[str]:
    """Head of the plug-in: how it is built, and what the controller's settings have to be. zero : (6,) m"""
    ranges = ((nominal.strut_range - zero[:, None]) * UNITS["mm"]).tolist()  # of motors: of struts half a play less
    return [
        "Kinematics plug-in of grblHAL, by the correction that `rig correct` computes. Put it beside driver.c and",
        "compile it with all of grblHAL, which needs N_AXIS=6 and KINEMATICS_API. It starts in my_plugin_init.",
        "",
        "X Y Z (mm) and A B C (degrees) are T_base_platform: turns about the fixed x, y and z, in this order.",
        "Motors X Y Z A B C are struts 1 to 6, mm from where they count 0; settings $100 .. to $135 are theirs.",
        "",
        f"Home: {_home_place(fitted, UNITS['mm'])}",
        *(
            f"Motor {letter}: {low:.6f} to {high:.6f}, 0 where strut {i + 1} is {zero[i]:.9f} m long"
            for i, (letter, (low, high)) in enumerate(zip("XYZABC", ranges))
        ),
        "",
        *(
            f"Motor {letter} takes up the play of strut {i + 1}, {gap * UNITS['mm']:.6f} mm: home before the first line"
            for i, (letter, gap) in enumerate(zip("XYZABC", source.gaps.tolist()))
            if gap
        ),
        "A line that is refused anywhere is refused as a whole, before it moves: alarm 2, a message with the reason.",
        "Reports state the motors as KPos (mm). $RIG lists refusals and sensors; statuses are those below, 6",
        "RIG_SINGULAR and 7 RIG_PARKS ($41 is 1). $RIG=NAME:VALUE, or firmware through rig_channel_values, sets",
        "a sensor. Sensors and medians:",
        *([f"  {name} {value:g}" for name, value in source.channels.items()] or ["  none"]),
    ]


def _constants(fitted: Hexapod, source: CSource) -> str:
    """Definitions of what the interface in C needs: scales of the Jacobian, the home pose, names of channels."""
    home = home_pose(fitted)
    lever = float(np.linalg.norm(fitted.platform_joints, axis=1).mean())
    scaled = hexapod.jacobian(home, fitted) / np.r_[1, 1, 1, np.full(3, lever)]
    least = MARGIN * float(np.linalg.svd(scaled, compute_uv=False)[-1])
    matrix = ", ".join(f"{{{', '.join(map(repr, row))}}}" for row in home.rotation.as_matrix().tolist())
    place = ", ".join(map(repr, home.translation.tolist()))
    names = ", ".join(f'"{name}"' for name in source.channels) or "0"
    medians = ", ".join(map(repr, source.channels.values())) or "0.0"
    return "\n".join(
        [
            f"#define LEVER {lever!r} /* m, at which turns are compared with shifts */",
            f"#define LEAST {least!r} /* singular value of the Jacobian, {MARGIN:g} of the least at home */",
            f"#define HANDED {float(np.sign(np.linalg.det(scaled)))!r} /* sign of its determinant at home */",
            f"static const struct placed HOME_POSE = {{{{{matrix}}}, {{{place}}}}};",
            f"static const char *const CHANNEL_NAMES[] = {{{names}}};",
            f"static const double CHANNEL_MEDIANS[] = {{{medians}}};",
            "",
        ]
    )
