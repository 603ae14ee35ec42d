"""Option --hand of commands: which hand of an arm with several is meant."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from rig.errors import RigError

if TYPE_CHECKING:
    from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
    from rig.recording.recording_folder import Recording


def add_hand_option(parser: ArgumentParser) -> None:
    """Add the option --hand to a parser."""
    parser.add_argument("--hand", metavar="NAME", help="of an arm with several hands: which of them")


def recording_of_chosen_hand(arguments: Namespace, recording: Recording) -> Recording:
    """The Recording of the hand that is chosen; as it is where none is. Raises RigError for a hand that there is not"""
    from rig.recording.frame_selection_and_content_hashes import select_hand

    return recording if arguments.hand is None else select_hand(recording, arguments.hand)


def calibration_of_chosen_hand(arguments: Namespace, calibration: Calibration) -> Calibration:
    """The Calibration of the hand that is chosen. Raises RigError where there are several hands and none is chosen."""
    from rig.model.arm_branches_and_hands import hand_names

    names = hand_names(calibration.correction.nominal)
    if names and arguments.hand is None:
        raise RigError(f"{arguments.calibration} is of several hands; choose one with --hand: {', '.join(names)}")
    return calibration if arguments.hand is None else calibration.of_hand(arguments.hand)
