"""Certificate of where a mount points.

It comes from held-out directions: what is promised, what it rests on, JSON and page.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from calib.certificate.certificate_computation_verdict_and_provenance import (
    CHECK_PERIODICALLY,
    TWICE,
    combined_held_out_poses,
)
from calib.certificate.certificate_content_dataclasses import CertifyOptions, Conditions, measuring_conditions
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration, claim_check_result_text
from calib.certification.calibration_evidence_verdict_and_claim_check import AgainstClaim
from calib.certification.held_out_pose_errors_and_distinct_configurations import HeldPoses, pose_repeatability
from calib.certification.noise_free_errors_and_tolerance_limits import (
    Limits,
    least_sample_size,
    require_sample_size,
    tolerance_limits_of_true_errors,
    upper_tolerance_limit,
)
from calib.certification.pose_error_promise_and_conformity import CONFORMS, FAILS, GUARD, OPEN
from calib.models.arm.mount_pointing_terms import ARCSEC
from calib.samples.commanded_and_measured_pose_samples import Sampled
from calib.samples.position_confounds_and_poses_on_one_clock import confound_sentences, confounds_of_recordings
from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.formats.json_toml_and_yaml_loading import nan_to_null
from rig.formats.output_files import write_text
from rig.model.mechanisms import axis_units
from rig.recording.recording_folder import Recording
from rig.report.pages.html_and_svg_elements import heading_html, paragraph_html, table_html
from rig.report.pages.page_templates_and_index_page import Link, Page, write_page
from rig.report.verdict_refutations_and_result_display import Evidence, MissingEvidence, Verdict, judge_evidence

SCHEMA = "pointing-certificate/1"
ACROSS = slice(3, 5)  # of a pose's error, what turns the direction
DIMENSIONS = 2
FAR = 10.0  # times the median error, from which a direction is named as perhaps another star
MOST_NAMED = 5


@dataclass(frozen=True, slots=True)
class Figure:
    """RMS, 95th percentile and greatest error of n directions, rad."""

    n: int
    rms: float
    p95: float
    greatest: float


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Decision on a tolerance, rad: its verdict by limits of the confidence GUARD, the share `coverage` considered.

    beyond : how many held-out directions lie beyond it, as measured
    """

    tolerance: float
    verdict: str
    lower: float
    upper: float
    beyond: int


@dataclass(frozen=True, slots=True, eq=False)
class PointingCertificate:
    """limits : Limits of the directions' errors, noise taken off, rad; measured : rad, the upper limit, noise included
    n : distinct configurations; axes : ((name, least, greatest, unit), ..) of their commands
    before, after : Figures by the mount as stated and as calibrated; noise : rad, of a measured direction
    repeatability : (rad RMS, visits, configurations) or None; far : (frame, rad) of directions far off all others
    """

    options: CertifyOptions
    limits: Limits
    measured: float
    n: int
    axes: tuple[tuple[str, float, float, str], ...]
    before: Figure
    after: Figure
    noise: float
    repeatability: tuple[float, int, int] | None
    far: tuple[tuple[int, float], ...]
    tolerance: Tolerance | None
    conditions: Conditions
    provenance: Json
    confounds: tuple[str, ...]
    known: Evidence | None = None
    claims: tuple[AgainstClaim, ...] = ()
    displacement: tuple[str, ...] = ()

    def promise_line(self) -> str:
        """What is promised, in a sentence."""
        options = self.options
        return (
            f"With {100 * options.confidence:.4g} % confidence, {100 * options.coverage:.4g} % of directions in this "
            f"part of the sky lie within {angle_text(self.limits.upper)} of those wanted."
        )

    def lines(self) -> list[str]:
        """Sentences of the certificate, what is promised first."""
        names = [f"{name} {low:.1f} to {high:.1f} {unit}" for name, low, high, unit in self.axes]
        out = [
            self.promise_line(),
            f"The part of the sky: commands {', '.join(names)}.",
            f"From {self.n} distinct configurations, none of which was used in fitting; as measured, noise included, "
            f"the limit is {angle_text(self.measured)}.",
            f"Error of these directions: {_figure_text(self.before)} before, {_figure_text(self.after)} after; a "
            f"measured direction is uncertain by {angle_text(self.noise)} across each axis.",
        ]
        if self.repeatability is None:
            out.append("Repeatability is unknown: no configuration was visited twice.")
        else:
            size, visits, count = self.repeatability
            out.append(
                f"Repeatability: {angle_text(size)} RMS over {visits} visits to {count} configurations, measuring "
                "included."
            )
        if self.far:
            named = ", ".join(f"{frame} by {angle_text(off)}" for frame, off in self.far[:MOST_NAMED])
            out.append(
                f"{len(self.far)} directions lie {FAR:g} times farther off than half of all, and count: frame {named}; "
                "exclude with --mask what was another star."
            )
        if self.tolerance is not None:
            out.append(_tolerance_line(self.tolerance, self.options.coverage))
        out += [
            f"The calibration's claim is {claim_check_result_text(one.found)} by {one.recording}."
            for one in self.claims
            if one.parts
        ]
        return [*out, *(f"{line[0].upper()}{line[1:]}." for line in self.displacement)]

    def verdict(self) -> Verdict:
        """Verdict: against the tolerance, or what is promised where there is none."""
        known = Evidence("") if self.known is None else self.known
        missing, refuted = list[MissingEvidence](), list(known.refuted)  # what the calibration lacks is held out here
        if self.tolerance is not None and self.tolerance.verdict == FAILS:
            refuted.append("the directions do not conform to their tolerance")
        if self.tolerance is not None and self.tolerance.verdict == OPEN:
            missing.append(MissingEvidence("these directions do not determine whether the tolerance is met"))
        if self.far:
            missing.append(MissingEvidence(f"{len(self.far)} directions lie far off all others", "Look at their stars"))
        evidence = Evidence(
            self.promise_line().removesuffix("."),
            (*([TWICE] if self.repeatability is None else []), CHECK_PERIODICALLY),
            known.held_out,
            known.unexplained,
            known.confounds if self.known is not None else self.confounds,
            tuple(missing),
            tuple(refuted),
        )
        return judge_evidence(evidence)

    def tree(self) -> Json:
        """What certificate.json holds."""
        out = {
            "schema": SCHEMA,
            "statement": self.lines(),
            "promise": {
                "direction_rad": self.limits.upper,
                "direction": asdict(self.limits) | {"measured": self.measured},
                "coverage": self.options.coverage,
                "confidence": self.options.confidence,
                "n": self.n,
            },
            "commands": [dict(zip(("axis", "least", "greatest", "unit"), row)) for row in self.axes],
            "held_out": {"before": asdict(self.before), "after": asdict(self.after)},
            "noise_rad": self.noise,
            "repeatability": self.repeatability
            and dict(zip(("rms_rad", "visits", "configurations"), self.repeatability)),
            "far": [{"frame": frame, "error_rad": off} for frame, off in self.far],
            "conformity": self.tolerance and asdict(self.tolerance),
            "conditions": asdict(self.conditions),
            "verdict": self.verdict().tree(),
            **self.provenance,
        }
        return {name: nan_to_null(value) for name, value in out.items()}

    def write(self, path: Path, links: Sequence[Link] = ()) -> None:
        """Write it as JSON or as a page. Raises RigError for another suffix than .json and .html"""
        if path.suffix == ".json":
            write_text(path, json.dumps(self.tree(), indent=1, allow_nan=False) + "\n")
            return
        if path.suffix != ".html":
            raise RigError(f"{path}: a certificate of directions is written as .json or .html")
        rows = [
            (name, one.n, *(f"{value / ARCSEC:.2f}" for value in (one.rms, one.p95, one.greatest)))
            for name, one in (("as stated", self.before), ("as calibrated", self.after))
        ]
        conditions = [(name.replace("_", " "), str(value)) for name, value in asdict(self.conditions).items()]
        parts = [
            *map(paragraph_html, self.lines()),
            heading_html("Errors of the held-out directions, arcsec"),
            table_html(("mount", "n", "RMS", "95 %", "greatest"), rows),
            heading_html("Conditions"),
            table_html(("", ""), conditions),
        ]
        verdict, title = self.verdict(), f"Certificate of a mount's pointing, {self.provenance['created'][:10]}"
        write_page(path, Page("certify", title, verdict, parts, verdict.next, links))


def angle_text(value: float) -> str:
    """Text of an angle.

    It is in arcsec or arcmin; the angle is small.
    """
    return f"{value / ARCSEC:.2f} arcsec" if value < 600 * ARCSEC else f"{value / ARCSEC / 60:.1f} arcmin"


def _tolerance_line(one: Tolerance, coverage: float) -> str:
    """Sentence on the decision."""
    least = least_sample_size(coverage, GUARD)
    why = (
        f"the limits are {angle_text(one.lower)} and {angle_text(one.upper)}"
        if np.isfinite(one.upper)
        else f"a decision that is wrong in at most 2.5 % of cases requires {least} configurations"
    )
    share = f"{100 * coverage:.4g} %"
    return (
        f"Within {angle_text(one.tolerance)} for {share} of directions: {one.verdict}; {why}; {one.beyond} lie beyond."
    )


def _figure_text(one: Figure) -> str:
    return f"{angle_text(one.rms)} RMS, {angle_text(one.greatest)} at most"


def mount_pointing_certificate(
    calibration: Calibration,
    held_out_recordings: Sequence[tuple[Recording, Sampled]],
    request: CertifyOptions,
    provenance: Json,
) -> PointingCertificate:
    """PointingCertificate of a calibration from held-out recordings of directions.

    Every direction counts, each configuration once, at its first visit; none is left out as wrong.
    Raises NotEnoughData where these have too few configurations at rest, RigError for a tolerance of positions
    """
    if request.scale is not None or any(quantity == "position" for quantity, _ in request.tolerances):
        raise RigError("directions have no length: a tolerance is an angle, as 50urad, and no scale is certified")
    poses = combined_held_out_poses(calibration, held_out_recordings)
    at = poses.first
    require_sample_size(len(at), request.coverage, request.confidence)
    lengths, sigma = np.linalg.norm(poses.errors[at, ACROSS], axis=1), poses.sigma(ACROSS)[at]
    limits = tolerance_limits_of_true_errors(lengths, sigma, request.coverage, request.confidence, DIMENSIONS)
    repeatability = pose_repeatability(poses)
    recordings = [recording for recording, _ in held_out_recordings]
    confounds = confounds_of_recordings(recordings)
    off = lengths > FAR * max(float(np.median(lengths)), float(sigma.mean()))
    return PointingCertificate(
        request,
        limits,
        upper_tolerance_limit(lengths, request.coverage, request.confidence),
        len(at),
        _axes(calibration, poses),
        _figure(poses.plain[at]),
        _figure(poses.errors[at]),
        float(np.sqrt((sigma**2).mean())),
        None if repeatability.rotation is None else (repeatability.rotation, repeatability.visits, repeatability.poses),
        tuple((int(poses.frame[at[i]]), float(lengths[i])) for i in np.flatnonzero(off)),
        _judged(lengths, sigma, request),
        measuring_conditions(poses, recordings, [sampled.source for _, sampled in held_out_recordings]),
        provenance,
        tuple(f"these recordings: {text}" for text in confound_sentences(confounds)),
    )


def _axes(calibration: Calibration, poses: HeldPoses) -> tuple[tuple[str, float, float, str], ...]:
    nominal, commands = calibration.correction.nominal, poses.commanded[poses.first]
    units = [(180 / np.pi, "degrees") if unit == "rad" else (1e3, "mm") for unit in axis_units(nominal)]
    return tuple(
        (name, float(low * size), float(high * size), unit)
        for name, low, high, (size, unit) in zip(nominal.axes, commands.min(axis=0), commands.max(axis=0), units)
    )


def _figure(errors: Floats) -> Figure:
    length = np.linalg.norm(errors[:, ACROSS], axis=1)
    return Figure(
        len(length), float(np.sqrt((length**2).mean())), float(np.quantile(length, 0.95)), float(length.max())
    )


def _judged(lengths: Floats, sigma: Floats, request: CertifyOptions) -> Tolerance | None:
    """Decision on the tolerance that was requested, wrong in 2.5 % of cases at the most; None without one."""
    if not request.tolerances:
        return None
    (_, size), *_ = request.tolerances
    beyond = int((lengths > size).sum())
    if len(lengths) < least_sample_size(request.coverage, GUARD):
        return Tolerance(size, OPEN, 0.0, float("inf"), beyond)
    limits = tolerance_limits_of_true_errors(lengths, sigma, request.coverage, GUARD, DIMENSIONS)
    verdict = CONFORMS if limits.upper <= size else FAILS if limits.lower > size else OPEN
    return Tolerance(size, verdict, limits.lower, limits.upper, beyond)
