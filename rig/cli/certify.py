"""rig certify: certify a calibration by held-out recordings; writes the certificate as HTML, JSON, PDF or XML."""

from __future__ import annotations

import math
import re
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files
from rig.cli.shared.command_options import (
    SEED,
    Progress,
    add_json_result_option,
    add_overwrite_option,
    file_or_stdout,
    missing_matplotlib_reason,
    page_links,
    print_frames_without_pose,
    read_recording,
    require_matplotlib,
)
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_number
from rig.report.verdict import Evidence, exit_status

if TYPE_CHECKING:
    from calib.certificate import digital_certificate_xml
    from calib.certificate.certificate import Certificate
    from calib.certify.calibration_evidence import AgainstClaim
    from calib.files.calibration_file import Calibration
    from calib.samples.recording_samples import Sampled
    from rig.recording.recording_folder import Recording

UNITS = {
    "um": ("position", 1e-6),
    "mm": ("position", 1e-3),
    "m": ("position", 1.0),
    "urad": ("rotation", 1e-6),
    "mrad": ("rotation", 1e-3),
    "rad": ("rotation", 1.0),
}
KINDS = (".json", ".html", ".pdf", ".xml")


def parse_tolerance(text: str) -> tuple[str, float]:
    r"""Parse a tolerance such as 20um or 0.1mrad: (\"position\", m) or (\"rotation\", rad). Raises ArgumentTypeError"""
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([a-z]+)\s*", text)
    if found is None or found[2] not in UNITS or not 0 < float(found[1]) < 1e9:
        raise ArgumentTypeError(f"{text!r} is no tolerance; write a positive number and {', '.join(UNITS)}, as in 20um")
    return UNITS[found[2]][0], float(found[1]) * UNITS[found[2]][1]


def parse_share(text: str) -> float:
    """Parse a share between 0 and 1. Raises ArgumentTypeError"""
    return _within(text, 0.5, 0.9999, "a share from 0.5 to 0.9999")


def parse_relative_uncertainty(text: str) -> float:
    """Parse a relative uncertainty. Raises ArgumentTypeError"""
    return _within(
        text, 0.0, math.nextafter(0.1, 0.0), "a relative standard uncertainty from 0 to 0.1, as 20e-6 for 20 um/m"
    )


def parse_load(text: str) -> float:
    """Parse a rated load, kg. Raises ArgumentTypeError"""
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
    """Add this command's arguments to a parser."""
    parser.epilog = (
        "Ends with 0 where the verdict is good or check, with 3 where it is bad: a tolerance is exceeded, or the "
        "claim is NOT kept."
    )
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument(
        "recordings", metavar="REC", type=Path, nargs="+", help="recordings that the calibration was not made from"
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
        help="to accept or refuse against, as 20um or 50urad",
    )
    parser.add_argument(
        "--coverage", metavar="SHARE", type=parse_share, default=0.95, help="of poses that the promise is about (0.95)"
    )
    parser.add_argument(
        "--confidence", metavar="SHARE", type=parse_share, default=0.95, help="with which it is kept (0.95)"
    )
    parser.add_argument(
        "--scale-uncertainty",
        metavar="R",
        type=parse_relative_uncertainty,
        help="relative standard uncertainty of the base targets' scale, as 20e-6",
    )
    parser.add_argument("--scale-source", metavar="TEXT", help="who certified it, as a certificate's number")
    parser.add_argument(
        "--rated-load", metavar="KG", type=parse_load, help="that the machine is made for, for ISO 9283"
    )
    for name, who in (
        ("laboratory", "who calibrated"),
        ("person", "who answers for it"),
        ("customer", "for whom"),
        ("manufacturer", "who made the machine"),
    ):
        parser.add_argument(
            f"--{name}", metavar="NAME", default="not stated", help=f"{who}, for the digital calibration certificate"
        )
    parser.add_argument("--country", metavar="XX", default="ZZ", help="where, two capital letters (ISO 3166-1)")
    parser.add_argument(
        "--skip-unreadable", action="store_true", help="leave out, and list, images that cannot be used"
    )
    parser.add_argument(
        "--mask",
        metavar="FRAMES",
        help="leave these frames of the one recording out, for example 0-11: those that `rig calibrate --mask` left in",
    )
    add_overwrite_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> int:
    """Certify a calibration by held-out recordings and write what is promised; 3 where the verdict is bad."""
    asked = dict(arguments.tolerance)
    if len(asked) < len(arguments.tolerance):
        raise RigError("--tolerance takes one length and one angle at the most")
    if arguments.scale_source and arguments.scale_uncertainty is None:
        raise RigError("--scale-source names who certified the scale; --scale-uncertainty says how well")
    if not re.fullmatch("[A-Z]{2}", arguments.country):
        raise RigError(f"--country takes two capital letters (ISO 3166-1), not {arguments.country!r}")
    suffix = arguments.out.suffix
    if suffix not in (*KINDS, ""):
        raise RigError(
            f"{arguments.out}: a certificate is written as {', '.join(KINDS)}, or to a folder with all of them"
        )
    if suffix == ".pdf":
        require_matplotlib("certificates as PDF")
    progress = Progress()
    progress("reading the calibration", 0, 1)
    from calib.files import calibration_file

    calibration = calibration_file.load(arguments.calibration)
    whole = arguments.outputs.folder(arguments.out) if suffix == "" else arguments.outputs.file(arguments.out)
    held = _held_out(calibration, arguments, progress)
    progress("certifying", 0, 1)

    import numpy as np

    from calib.certificate import certificate, certificate_json
    from calib.certificate.certificate import calibration_certificate, certificate_verdict
    from calib.certificate.certificate_contents import Asked

    wanted = Asked(
        arguments.coverage,
        arguments.confidence,
        tuple(asked.items()),
        arguments.scale_uncertainty,
        arguments.scale_source,
        arguments.rated_load,
    )
    made = calibration_certificate(
        calibration,
        held,
        wanted,
        certificate.certificate_provenance(
            arguments.calibration, calibration, [r for r, _ in held], arguments.argv, SEED
        ),
        np.random.default_rng(SEED),
    )
    known, claims = _against_claim(calibration, held, arguments)
    made = replace(made, known=known, claims=claims)
    verdict = certificate_verdict(made)
    progress.close()
    left_out = missing_matplotlib_reason() if suffix == "" else None
    places = (
        [whole / f"certificate{kind}" for kind in KINDS if kind != ".pdf" or not left_out] if suffix == "" else [whole]
    )
    for place in places:
        _write(place, place.suffix, made, arguments)
    print(verdict.line)
    _say(made)
    for _, sampled in held:
        print_frames_without_pose(sampled.measurement)
    arguments.result = certificate_json.certificate_dict(made)
    if left_out:
        print(f"certificate.pdf is left out: certificates as PDF {left_out}", file=sys.stderr)
    print(f"written: {arguments.out}")
    return exit_status(verdict)


def _against_claim(
    calibration: Calibration, held: list[tuple[Recording, Sampled]], arguments: Namespace
) -> tuple[Evidence, tuple[AgainstClaim, ...]]:
    """(Evidence of a calibration with what held-out recordings say of its claim, AgainstClaim of each); its file is
    marked where they refute it.
    """
    import numpy as np

    from calib.certify import calibration as words
    from calib.certify.calibration_evidence import (
        calibration_evidence,
        check_claim_on_recording,
        evidence_with_confounds,
        evidence_with_verification,
    )
    from calib.samples.confounded_conditions import confounds_of_recordings

    known, claims = (
        calibration_evidence(calibration, calibration_and_effect_files.read_refutations(arguments.calibration)),
        [],
    )
    known = evidence_with_confounds(
        known, calibration, [confounds_of_recordings([recording for recording, _ in held])], "these recordings"
    )
    for recording, sampled in held:
        one = check_claim_on_recording(
            calibration,
            recording.name,
            calibration.with_physics(recording, sampled.samples),
            np.random.default_rng(SEED),
        )
        if one is None:
            continue
        claims.append(one)
        known = evidence_with_verification(known, one.found, recording.name)
        if one.found.refutes:
            calibration_and_effect_files.write_refutation(
                arguments, arguments.calibration, recording.name, words.refutation_sentence(one.found)
            )
    return known, tuple(claims)


def _held_out(calibration: Calibration, arguments: Namespace, progress: Progress) -> list[tuple[Recording, Sampled]]:
    """[(Recording, Sampled)], none of whose data took part in fitting or is there twice. Raises RigError naming what
    did.
    """
    from calib.recording_calibration import held_out_recordings

    if arguments.mask is not None and len(arguments.recordings) > 1:
        raise RigError("--mask names frames of one recording; certify by that one alone")
    loaded = [read_recording(arguments, path) for path in arguments.recordings]
    return held_out_recordings(calibration, loaded, progress, str(arguments.calibration))


def _write(path: Path, suffix: str, made: Certificate, arguments: Namespace) -> None:
    from calib.certificate import certificate_json
    from calib.certificate import digital_certificate_xml as xml
    from rig.formats.output_files import write_text

    if suffix == ".html":
        from calib.certificate.certificate_page import write_certificate_page

        write_certificate_page(
            path, made, page_links(arguments, arguments.out if arguments.out.suffix else arguments.out / path.name)
        )
    elif suffix == ".pdf":
        from calib.certificate import certificate_pdf

        certificate_pdf.write_certificate_pdf(path, made)
    elif suffix == ".xml":
        write_text(path, xml.digital_certificate_xml(made, _issuer(arguments)))
    else:
        write_text(path, certificate_json.certificate_text(made))


def _issuer(arguments: Namespace) -> digital_certificate_xml.Issuer:
    from calib.certificate.digital_certificate_xml import Issuer

    return Issuer(arguments.laboratory, arguments.person, arguments.customer, arguments.country, arguments.manufacturer)


def _say(made: Certificate) -> None:
    """Print what is certified."""
    from calib.certificate import certificate_sentences as words

    print(
        "\n".join(
            [
                words.length_scale_line(made),
                words.promise_line(made),
                words.measured_volume_line(made),
                *words.basis_lines(made),
                *words.conformity_lines(made),
            ]
        )
    )
