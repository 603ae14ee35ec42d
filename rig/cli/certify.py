"""rig certify: certify a calibration.

By held-out recordings.
It writes the certificate as HTML, JSON, PDF or XML.
"""

from __future__ import annotations

import math
import re
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import escaped_output_progress_error_table_and_refutations
from rig.cli.shared.argument_parser_option_value_parsing_and_shell_completion import parse_tolerance
from rig.cli.shared.escaped_output_progress_error_table_and_refutations import Progress, print_frames_without_pose
from rig.cli.shared.input_file_options_and_loading import read_recording
from rig.cli.shared.shared_output_controller_hand_and_worker_options import (
    SEED,
    add_hand_option,
    add_json_result_option,
    add_overwrite_option,
    file_or_stdout,
    missing_matplotlib_reason,
    page_links,
    recording_of_chosen_hand,
    require_matplotlib,
)
from rig.errors import RigError
from rig.formats.numbers_and_units import parse_number
from rig.report.verdict_refutations_and_result_display import exit_status

if TYPE_CHECKING:
    from calib.api.certify import CertificationResult
    from calib.certificate.certificate_content_dataclasses import CertifyOptions
    from calib.certificate.digital_certificate_xml import Issuer


KINDS = (".json", ".html", ".pdf", ".xml")


def parse_share_between_half_and_one(text: str) -> float:
    """Parse a share from 0.5 to 0.9999.

    Raises ArgumentTypeError
    """
    return _within(text, 0.5, 0.9999, "a share from 0.5 to 0.9999")


def parse_relative_uncertainty(text: str) -> float:
    """Parse a relative uncertainty.

    Raises ArgumentTypeError
    """
    return _within(
        text, 0.0, math.nextafter(0.1, 0.0), "a relative standard uncertainty from 0 to 0.1, as 20e-6 for 20 um/m"
    )


def parse_rated_load_kg(text: str) -> float:
    """Parse a rated load, kg.

    Raises ArgumentTypeError
    """
    return _within(text, 0.0, math.nextafter(1e6, 0.0), "a load in kg, 0 or more")


def _within(text: str, least: float, most: float, expected: str) -> float:
    """The number that a text is. Raises ArgumentTypeError for none and for one outside these bounds. expected : what it
    must be, in words
    """
    try:
        value = parse_number(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise ArgumentTypeError(f"{text!r} must be {expected}")
    return value


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments of `rig certify` to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument(
        "recordings", metavar="REC", type=Path, nargs="+", help="recordings not used for the calibration"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="certificate.html, .json, .pdf or .xml (a digital calibration certificate); without a suffix a "
        "folder with all",
    )
    parser.add_argument(
        "--tolerance",
        metavar="T",
        type=parse_tolerance,
        nargs="+",
        default=[],
        help="for acceptance, as 20um or 50urad",
    )
    parser.add_argument(
        "--coverage",
        metavar="SHARE",
        type=parse_share_between_half_and_one,
        default=0.95,
        help="of poses that the promise covers (0.95)",
    )
    parser.add_argument(
        "--confidence",
        metavar="SHARE",
        type=parse_share_between_half_and_one,
        default=0.95,
        help="with which it is met (0.95)",
    )
    parser.add_argument(
        "--scale-uncertainty",
        metavar="R",
        type=parse_relative_uncertainty,
        help="relative standard uncertainty of the base targets' scale, as 20e-6",
    )
    parser.add_argument("--scale-source", metavar="TEXT", help="who certified it, as a certificate's number")
    parser.add_argument(
        "--rated-load", metavar="KG", type=parse_rated_load_kg, help="that the machine is rated for, for ISO 9283"
    )
    for name, who in (
        ("laboratory", "who calibrated"),
        ("person", "who is responsible for it"),
        ("customer", "for whom"),
        ("manufacturer", "who made the machine"),
    ):
        parser.add_argument(
            f"--{name}", metavar="NAME", default="not stated", help=f"{who}, for the digital calibration certificate"
        )
    parser.add_argument("--country", metavar="XX", default="ZZ", help="where, two capital letters (ISO 3166-1)")
    parser.add_argument("--skip-unreadable", action="store_true", help="exclude, and list, unusable images")
    parser.add_argument(
        "--mask",
        metavar="FRAMES",
        help="exclude these frames of the one recording, for example 0-11: those that `rig calibrate --mask` left in",
    )
    add_hand_option(parser)
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> int:
    """Run `rig certify`.

    Certify a calibration by held-out recordings and write the certificate.

    Exit status 3 where the verdict is bad.
    """
    suffix, options = _suffix(arguments.out), _options(arguments)
    if arguments.mask is not None and len(arguments.recordings) > 1:
        raise RigError("--mask names frames of one recording; certify with that one only")
    progress = Progress()
    progress("reading the calibration", 0, 1)
    from calib.api.certify import certify
    from calib.certificate.certificate_computation_verdict_and_provenance import certificate_provenance
    from calib.files import calibration_file
    from rig.report.verdict_refutations_and_result_display import refutations_of_file

    calibration = calibration_file.load(arguments.calibration, several_hands=True)
    whole = arguments.outputs.folder(arguments.out) if suffix == "" else arguments.outputs.file(arguments.out)
    recordings = [recording_of_chosen_hand(arguments, read_recording(arguments, p)) for p in arguments.recordings]
    refuted = refutations_of_file(arguments.calibration)
    source = certificate_provenance(arguments.calibration, calibration, recordings, arguments.argv, SEED)
    result = certify(calibration, recordings, options, refuted, source, str(arguments.calibration), progress)
    progress.close()
    escaped_output_progress_error_table_and_refutations.print_refutations(arguments.calibration, refuted)
    for name, sentence in result.refutations:
        escaped_output_progress_error_table_and_refutations.write_refutation(
            arguments, arguments.calibration, name, sentence
        )
    left_out = missing_matplotlib_reason() if suffix == "" else None
    if suffix and suffix not in result.kinds:
        raise RigError(f"{arguments.out}: a certificate of directions is written as {' or '.join(result.kinds)}")
    left_out = left_out if ".pdf" in result.kinds else None
    kinds = [kind for kind in result.kinds if kind != ".pdf" or not left_out]
    for place in [whole / f"certificate{kind}" for kind in kinds] if suffix == "" else [whole]:
        shown = arguments.out if suffix else arguments.out / place.name
        result.write(place, page_links(arguments, shown), _issuer(arguments))
    _print_certificate(result)
    arguments.result = result.tree()
    if left_out:
        print(f"certificate.pdf is omitted: certificates as PDF {left_out}", file=sys.stderr)
    print(f"written: {arguments.out}")
    return exit_status(result.verdict)


def _suffix(out: Path) -> str:
    """The suffix of the file that is written, "" for a folder. Raises RigError for one that no certificate has"""
    if out.suffix not in (*KINDS, ""):
        raise RigError(f"{out}: a certificate is written as {', '.join(KINDS)}, or to a folder with all of them")
    if out.suffix == ".pdf":
        require_matplotlib("certificates as PDF")
    return out.suffix


def _options(arguments: Namespace) -> CertifyOptions:
    """Settings of a certificate, from the arguments. Raises RigError for incompatible arguments"""
    tolerances = dict(arguments.tolerance)
    if len(tolerances) < len(arguments.tolerance):
        raise RigError("--tolerance takes one length and one angle at most")
    if arguments.scale_source and arguments.scale_uncertainty is None:
        raise RigError("--scale-source names who certified the scale; --scale-uncertainty says how well")
    if not re.fullmatch("[A-Z]{2}", arguments.country):
        raise RigError(f"--country takes two capital letters (ISO 3166-1), not {arguments.country!r}")
    from calib.certificate.certificate_content_dataclasses import CertifyOptions

    return CertifyOptions(
        arguments.coverage,
        arguments.confidence,
        tuple(tolerances.items()),
        arguments.scale_uncertainty,
        arguments.scale_source,
        arguments.rated_load,
    )


def _issuer(arguments: Namespace) -> Issuer:
    from calib.certificate.digital_certificate_xml import Issuer

    return Issuer(arguments.laboratory, arguments.person, arguments.customer, arguments.country, arguments.manufacturer)


def _print_certificate(result: CertificationResult) -> None:
    """Print what is certified, the verdict first."""
    print("\n".join([result.verdict.line, *result.lines()]))
    for _, sampled in result.held_out:
        print_frames_without_pose(sampled.measurement)
