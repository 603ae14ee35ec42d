"""--limbs FILE: accepted measuring limbs as the source of a recording's poses, vision looking at some of them."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.errors import RigError
from rig.formats.number_parsing import parse_whole_number

if TYPE_CHECKING:
    from collections.abc import Callable

    from calib.online.measuring_limb_poses import LimbPoses
    from calib.online.measuring_limbs_file import Accepted
    from calib.samples.recording_samples import Sampled
    from rig.cli.shared.output_options import Progress
    from rig.model.design import Design
    from rig.recording.corner_and_pose_tables import Corners
    from rig.recording.recording_folder import Recording

EVERY = 5  # poses between two looks of vision


def arguments(parser: ArgumentParser) -> None:
    """Add the source of poses to a command that takes vision's by default."""
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


def check_interval(arguments: Namespace) -> int:
    """How many poses lie between two looks. Raises RigError for --check without --limbs, or below 1."""
    if arguments.check is not None and (arguments.limbs is None or arguments.check < 1):
        raise RigError("--check takes a number of poses, at least 1, and --limbs")
    return arguments.check or EVERY


def samples_by_limbs_or_vision(
    arguments: Namespace, recording: Recording, progress: Progress, look: Callable[[Corners], None] | None = None
) -> Sampled:
    """Sampled of a recording, from the limbs where these are named, else by vision. look : as for `sample_recording`

    Raises RigError for limbs that were not accepted, that are others than rig.toml states, or with which vision no
        longer agrees
    """
    from calib.online import measuring_limb_poses
    from calib.samples.recording_samples import sample_recording

    if arguments.limbs is None:
        check_interval(arguments)
        return sample_recording(recording, progress=progress, look=look)
    found, accepted = checked_limb_poses(arguments, recording, progress)
    return replace(
        measuring_limb_poses.samples_of_limb_poses(recording, found),
        files=(arguments.limbs,),
        data=tuple(accepted.provenance.get("data", ())),
    )


def checked_limb_poses(arguments: Namespace, recording: Recording, progress: Progress) -> tuple[LimbPoses, Accepted]:
    """(LimbPoses of a recording, checked and said; the Accepted they are from). Raises as `samples_by_limbs_or_vision`
    does: the acceptance is withdrawn first."""
    from calib.online import measuring_limb_poses, measuring_limbs_file

    every = check_interval(arguments)
    accepted = measuring_limbs_file.accepted_limbs(arguments.limbs, recording.design)
    found = measuring_limb_poses.limb_poses(recording, accepted)
    checked = measuring_limb_poses.check_limb_poses(recording, accepted, found, every, progress)
    progress.close()
    if checked.disagreement is not None and checked.frame is not None:
        write_withdrawal(arguments.limbs, accepted, str(recording.folder), checked.frame, checked.disagreement.reason)
        raise RigError(
            f"frame {checked.frame}: {checked.disagreement.reason}. {checked.disagreement.who}: their "
            "acceptance is withdrawn "
            f"in {arguments.limbs}, and nothing was computed; without --limbs vision measures"
        )
    spare = 0 if accepted.limbs.checks is None else len(accepted.limbs.checks.limbs)
    told = f", at each of which {spare} more limb{'s close' if spare > 1 else ' closes'}" if spare else ""
    print(
        f"{len(found.frames)} poses from the measuring limbs{told}; "
        + (
            f"vision looked at {checked.count} of them and agrees"
            if checked.count
            else "the recording has nothing for vision to look at, so that none was checked by it"
        )
    )
    return found, accepted


def accepted_limbs_for_run(arguments: Namespace, design: Design) -> Accepted:
    """Limbs that stand for vision in a run, which reads them. Raises RigError where they do not, and where vision is
    not to check them.
    """
    from calib.certify import measuring_limbs
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


def write_withdrawal(path: Path, accepted: Accepted, recording: str, frame: int, reason: str) -> None:
    """Write that an acceptance no longer stands, in its own file. Raises FileError where that cannot be written."""
    from calib.online import measuring_limbs_file

    measuring_limbs_file.save(path, measuring_limbs_file.withdraw_acceptance(accepted, recording, frame, reason))
