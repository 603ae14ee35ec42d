"""Certification of a calibration by held-out recordings.

The certificate states what is promised in a volume.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.certificate import (
    certificate_json_and_pdf_writers,
    certificate_page,
    certificate_sentences_and_quantity_texts,
    digital_certificate_xml,
)
from calib.certificate.certificate_computation_verdict_and_provenance import (
    Certificate,
    calibration_certificate,
    certificate_provenance,
    certificate_verdict,
)
from calib.certificate.certificate_content_dataclasses import CertifyOptions
from calib.certificate.digital_certificate_xml import Issuer
from calib.certificate.mount_pointing_certificate import PointingCertificate, mount_pointing_certificate
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration, refutation_sentence
from calib.certification.calibration_evidence_verdict_and_claim_check import (
    AgainstClaim,
    calibration_evidence,
    claim_verification_and_excess_errors_of_recording,
    evidence_with_confounds,
    evidence_with_displaced_base_or_tool,
    evidence_with_verification,
)
from calib.certification.platform_certification import Progress
from calib.files import calibration_file
from calib.files.calibration_file import SEED
from calib.models.base_and_tool_displacement_between_recordings import samples_without_displacement
from calib.samples.commanded_and_measured_pose_samples import Sampled, sample_recording
from calib.samples.position_confounds_and_poses_on_one_clock import confounds_of_recordings
from rig.array_and_json_types import Json
from rig.errors import RigError
from rig.formats.output_files import write_text
from rig.model.arm_hands_effect_places_and_tolerances import selected_hand_name
from rig.recording.frame_selection_and_content_hashes import (
    content_hashes_of_frames,
    frames_with_known_hashes,
    sorted_hashes_of_frames,
)
from rig.recording.recording_folder import Recording
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import Evidence, OneLineRepr, Refutation, Verdict, result_html

UNSTATED, STANDARD = Issuer(), CertifyOptions()  # nobody is named; 95 % of poses with 95 %
KINDS, POINTING_KINDS = (".json", ".html", ".pdf", ".xml"), (".json", ".html")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class CertificationResult(OneLineRepr):
    """A certificate and what it rests on. certificate; held_out : (Recording, Sampled) of each recording; refutations :
    (recording's name, sentence) of each that refutes the calibration's claim
    """

    certificate: Certificate | PointingCertificate
    held_out: tuple[tuple[Recording, Sampled], ...]
    refutations: tuple[tuple[str, str], ...]

    @property
    def verdict(self) -> Verdict:
        """The verdict on the calibration."""
        made = self.certificate
        return made.verdict() if isinstance(made, PointingCertificate) else certificate_verdict(made)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Suffixes of the files in which it can be written."""
        return POINTING_KINDS if isinstance(self.certificate, PointingCertificate) else KINDS

    def lines(self) -> list[str]:
        """Sentences of the certificate."""
        made = self.certificate
        if isinstance(made, PointingCertificate):
            return made.lines()
        return [
            certificate_sentences_and_quantity_texts.length_scale_line(made),
            certificate_sentences_and_quantity_texts.promise_line(made),
            certificate_sentences_and_quantity_texts.measured_volume_line(made),
            *certificate_sentences_and_quantity_texts.promise_basis_lines(made),
            *certificate_sentences_and_quantity_texts.conformity_lines(made),
        ]

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        made = self.certificate
        if isinstance(made, PointingCertificate):
            return result_html(made.promise_line(), made.lines()[1:])
        return made._repr_html_()

    def tree(self) -> Json:
        """What certificate.json holds."""
        made = self.certificate
        if isinstance(made, PointingCertificate):
            return made.tree()
        return certificate_json_and_pdf_writers.certificate_dict(made)

    def write(self, path: Path, links: Sequence[Link] = (), issuer: Issuer = UNSTATED) -> None:
        """Write the certificate, in the form that the path's suffix names, one of KINDS.

        links : of the page; issuer : of the digital calibration certificate
        """
        made = self.certificate
        if isinstance(made, PointingCertificate):
            made.write(path, links)
        elif path.suffix == ".html":
            certificate_page.write_certificate_page(path, made, links)
        elif path.suffix == ".pdf":
            certificate_json_and_pdf_writers.write_certificate_pdf(path, made)
        elif path.suffix == ".xml":
            write_text(path, digital_certificate_xml.digital_certificate_xml(made, issuer))
        else:
            write_text(path, certificate_json_and_pdf_writers.certificate_text(made))


def certify(
    calibration: Calibration,
    recordings: Recording | Sequence[Recording],
    options: CertifyOptions = STANDARD,
    refutations: Sequence[Refutation] = (),
    provenance: Json | None = None,
    name: str = "the calibration",
    progress: Progress | None = None,
) -> CertificationResult:
    """CertificationResult of a calibration by recordings that it was not made from, as `rig certify` states it.

    options : what of, 95 % with 95 % by default; refutations : what later recordings found against the calibration;
    provenance : of the certificate, None for that of what is certified, without a file or arguments; name : of the
    calibration, in words; progress : called with (label, done, of), or None
    Raises RigError for a recording that took part in fitting, NotEnoughData where these have too few configurations
    """
    every = [recordings] if isinstance(recordings, Recording) else list(recordings)
    hands = dict.fromkeys(selected_hand_name(recording.design.mechanism) for recording in every)
    if len(hands) > 1:
        raise RigError(f"a certificate is of one hand, and these recordings are of {' and '.join(map(str, hands))}")
    calibration = calibration.of_recorded_hand(every[0].design.mechanism)
    held, lines, unexpected = _in_calibrated_frames(
        calibration, _held_out_recordings(calibration, every, name, progress)
    )
    if progress is not None:
        progress("certifying", 0, 1)
    source = provenance or certificate_provenance(None, calibration, every, (), SEED)
    found: Certificate | PointingCertificate
    if all(sampled.samples.measured == "direction" for _, sampled in held):
        found = mount_pointing_certificate(calibration, held, options, source)
    else:
        found = calibration_certificate(calibration, held, options, source, np.random.default_rng(SEED))
    known, claims = _against_claim(calibration, held, refutations)
    for recording_name, ends in unexpected:
        known = evidence_with_displaced_base_or_tool(known, ends, recording_name)
    refuting = tuple((one.recording, refutation_sentence(one.found)) for one in claims if one.found.refutes)
    lines = (*(f"this certificate is of the hand {name!r} alone" for name in hands if name is not None), *lines)
    return CertificationResult(replace(found, known=known, claims=claims, displacement=lines), tuple(held), refuting)


def _in_calibrated_frames(
    calibration: Calibration, held: Sequence[tuple[Recording, Sampled]]
) -> tuple[list[tuple[Recording, Sampled]], tuple[str, ...], list[tuple[str, tuple[str, ...]]]]:
    """(held-out recordings on the commands' clock and without the place of base and tool, what is stated of these,
    [(recording's name, ends that stand elsewhere though their place is stated)]).
    """
    out, lines, unexpected = [], [], []
    for recording, sampled, clocks in (calibration.on_one_clock(*one) for one in held):
        placed = samples_without_displacement(calibration, recording, sampled.samples)
        out.append((recording, replace(sampled, samples=replace(placed.samples, known=sampled.samples.known))))
        lines += [f"{recording.name}: {line}" for line in (*placed.lines, *clocks)]
        unexpected.append((recording.name, placed.unexpected))
    return out, tuple(lines), unexpected


def _against_claim(
    calibration: Calibration, held: Sequence[tuple[Recording, Sampled]], refutations: Sequence[Refutation]
) -> tuple[Evidence, tuple[AgainstClaim, ...]]:
    """(Evidence of a calibration with what held-out recordings say of its claim, AgainstClaim of each)."""
    known, claims = calibration_evidence(calibration, refutations), []
    known = evidence_with_confounds(
        known, calibration, [confounds_of_recordings([recording for recording, _ in held])], "these recordings"
    )
    for recording, sampled in held:
        samples = calibration.with_physics(recording, sampled.samples)
        one = claim_verification_and_excess_errors_of_recording(
            calibration, recording.name, samples, np.random.default_rng(SEED)
        )
        if one is not None:
            claims.append(one)
            known = evidence_with_verification(known, one.found, recording.name)
    return known, tuple(claims)


def _held_out_recordings(
    calibration: Calibration, recordings: Sequence[Recording], name: str, progress: Progress | None
) -> list[tuple[Recording, Sampled]]:
    """[(Recording, Sampled)], none of whose data took part in fitting a calibration or occurs twice. Raises RigError
    naming what did
    """
    if not calibration.provenance.get("data"):
        raise RigError(f"{name} does not state its source data, so no data can be shown to be held out; recalibrate")
    known: set[str] = set()
    for recording in recordings:
        path, frames = recording.folder, len(recording.exposures.times()[0])
        same = calibration_file.frames_used_in_calibration(calibration, recording)
        if same:
            raise RigError(
                f"{path}: {len(same)} of {frames} frames (the first: {same[0]}) took part in fitting {name}, "
                "directly or as poses measured from them; a certificate requires poses that did not. For a "
                "single recording, --mask excludes "
                "some frames from rig calibrate, then the others from rig certify"
            )
        calibration.refuse_other_machine(recording.design.mechanism, str(path))
        of = content_hashes_of_frames(recording)
        twice = frames_with_known_hashes(of, known)
        if twice:
            raise RigError(
                f"{path}: {len(twice)} of {frames} frames are in another of the recordings; the same pose "
                "does not count twice"
            )
        known |= set(sorted_hashes_of_frames(of))
    return [(recording, sample_recording(recording, progress=progress)) for recording in recordings]
