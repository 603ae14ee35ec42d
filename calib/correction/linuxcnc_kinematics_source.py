"""LinuxCNC kinematics source of a calibrated hexapod.

The correction of its calibration as a kinematics module, in C for LinuxCNC's halcompile.

It is the C file for controllers with LinuxCNC's interface around it, linuxcnc_kinematics.c. LinuxCNC calls kinematics
also for poses that it only considers, so they are without memory: play is left to LinuxCNC's own BACKLASH.
Source: LinuxCNC 2.9, Developer manual, Kinematics; HAL manual, Creating HAL components
"""

from dataclasses import replace
from importlib.resources import files

import numpy as np

from calib.correction.correction import AnyCorrection
from calib.correction.correction_as_c_source import CSource, correction_c_source
from calib.correction.interpolation_methods_and_correction_summand_fields import home_pose
from calib.correction.physics_compensation import Physics
from rig.formats.exporters.geometry_and_camera_files import UNITS
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
    text = "\n".join([_settings(fitted, nominal, source, UNITS[units], units), source.text, _constants(fitted, source)])
    interface = files(__package__).joinpath("linuxcnc_kinematics.c").read_text()
    return replace(source, text=f"{text}#define UNITS {UNITS[units]!r} /* machine units of a metre */\n\n{interface}")


def _settings(fitted: Hexapod, nominal: Hexapod, source: CSource, scale: float, units: str) -> str:
    """Head comment: how it is built, its pins, and what LinuxCNC's ini has to state of it. scale : units of a metre"""
    home = hexapod.home_values(nominal)
    T = home_pose(fitted)
    place = [*(T.translation * scale), *T.rotation.as_euler("xyz", degrees=True)]
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
        "HOME = " + " ".join(f"{value:.6f}" for value in place),
    ]
    for i, (low, high) in enumerate((ranges * scale).tolist()):
        lines += [
            f"[JOINT_{i}]",
            f"HOME = {home[i] * scale:.9f}",
            f"MIN_LIMIT = {low:.9f}",
            f"MAX_LIMIT = {high:.9f}",
            *([f"BACKLASH = {source.gaps[i] * scale:.9f}"] if source.gaps[i] else []),
        ]
    lines += [
        "",
        "A pose that is refused returns below 0 and changes no joint. Pins: rigkins.inverse-status, .forward-status,",
        ".forward-steps of the latest calls; rigkins.refused, .refused-strut (1 to 6, 0 for none) of the latest",
        "refusal, .refusals, their number. Statuses are those below, and 6 RIG_SINGULAR. Pins in, with their medians:",
        *([f"  rigkins.{name} {value:g}" for name, value in source.channels.items()] or ["  none"]),
    ]
    return "/*\n" + "\n".join(f" * {line}".rstrip() for line in lines) + "\n */"


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
