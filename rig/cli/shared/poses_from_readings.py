"""Poses from readings: of accepted measuring limbs (--limbs), or of a measuring machine (rig correct --forward)."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_whole_number

if TYPE_CHECKING:
    from calib.online.limb_pose_source import LimbSource
    from calib.online.measuring_limbs_file import Accepted
    from rig.model.design import Design

EVERY = 5  # poses between two looks of vision


def add_limb_options(parser: ArgumentParser) -> None:
    """Add the limb options to a parser: --limbs FILE as the source of poses, --check N for vision checks."""
    parser.add_argument(
        "--limbs",
        metavar="FILE",
        type=Path,
        help="poses from measuring limbs that `rig insitu` accepted and saved here; "
        "vision checks some, and the acceptance is withdrawn where they no longer agree",
    )
    parser.add_argument(
        "--check",
        type=parse_whole_number,
        metavar="N",
        help=f"with --limbs: vision looks at every Nth pose at least (default {EVERY})",
    )


def vision_check_interval(arguments: Namespace) -> int:
    """Vision check interval, poses between two checks. Raises RigError for --check without --limbs, or below 1."""
    if arguments.check is not None and (arguments.limbs is None or arguments.check < 1):
        raise RigError("--check takes a number of poses, at least 1, and --limbs")
    return arguments.check or EVERY


def limb_source(arguments: Namespace) -> LimbSource | None:
    """The limbs that are to stand for vision, None where none are named. Raises RigError as `vision_check_interval`
    does
    """
    every = vision_check_interval(arguments)
    if arguments.limbs is None:
        return None
    from calib.online.limb_pose_source import LimbSource

    return LimbSource(arguments.limbs, every)


def accepted_limbs_for_run(arguments: Namespace, design: Design) -> Accepted:
    """Accepted limbs for a run, in place of vision. Raises RigError where nothing reads them or vision cannot check."""
    from calib.certification import measuring_limbs
    from calib.online import measuring_limbs_file

    if arguments.no_measure:
        raise RigError(
            "--limbs with --no-measure: vision must look at some poses, or a limb that slips is never noticed"
        )
    found = measuring_limbs_file.accepted_limbs(arguments.limbs, design)
    channels = measuring_limbs.stated_limbs(design).channels
    if design.sensors is None or set(channels) - set(design.sensors.channels):
        raise RigError(f"--limbs takes a [sensors] table in rig.toml with the channels {channels[0]} .. {channels[-1]}")
    return found
