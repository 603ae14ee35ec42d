"""rig calibrate: calibrate a machine from recordings; writes calibration.json with held-out errors, and a page."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.cli.shared import calibration_and_effect_files, correction_extension, poses_from_readings, recording_checks
from rig.cli.shared.calibration_summary import (
    draw_page_and_print_verdict,
    print_arm_correction,
    print_calibration_summary,
    print_compensated_physics,
    print_pose_counts,
)
from rig.cli.shared.command_options import (
    SEED,
    Progress,
    add_json_result_option,
    add_overwrite_option,
    add_recordings_argument,
    file_or_stdout,
    page_links,
    parse_length,
    print_frames_without_pose,
    print_held_out_errors,
)
from rig.errors import RigError

if TYPE_CHECKING:
    import numpy as np

    from calib.diagnose.arm_findings_refit import ArmRefit
    from calib.diagnose.platform_findings_refit import Findings, PlatformRefit
    from calib.files.calibration_file import Calibration
    from calib.samples.pose_samples import Samples
    from calib.samples.recording_samples import Sampled
    from rig.effects.texts.effect_text import Kinds
    from rig.recording.recording_folder import Recording
    from rig.report.pages.page_and_svg_templates import Link

    Places = tuple[Any, Path | None, list[Link]]  # of the file, of its page, and the page's links


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recordings_argument(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=file_or_stdout,
        required=True,
        help="calibration.json; the report is written beside it",
    )
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--diagnosis",
        metavar="DIR",
        type=Path,
        help="take in the physics that `rig diagnose` found and wrote there, refined with the "
        "geometry; rig correct undoes it",
    )
    kind.add_argument("--find", action="store_true", help="diagnose this recording first and take in what is found")
    calibration_and_effect_files.add_effects_option(parser)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="do not look for what the geometry leaves out, as `rig diagnose` does: the verdict is "
        "then check at the best",
    )
    parser.add_argument(
        "--joint", action="store_true", help="solve cameras, lenses and geometry once more from all corners together"
    )
    correction_extension.add_extension_options(parser)
    parser.add_argument(
        "--promise",
        type=parse_length,
        metavar="20um",
        help="say whether so much is kept, position error RMS over the workspace",
    )
    poses_from_readings.add_limb_options(parser)
    add_overwrite_option(parser)
    recording_checks.add_anyway_option(parser)
    add_json_result_option(parser)


def run(arguments: Namespace) -> None:
    """Calibrate a recording and write the calibration and its report."""
    progress = Progress()
    progress("reading the recording", 0, 1)
    recording, look, several = recording_checks.load_and_check_recordings(arguments, progress)
    if several is not None and arguments.limbs is not None:
        raise RigError("--limbs takes the poses of one recording from measuring limbs; name one")

    out = arguments.outputs.file(arguments.out)
    page = arguments.outputs.stage_file(out, ".html")
    links = page_links(arguments, arguments.out.with_suffix(".html")) if page else []
    nominal = recording.design.mechanism
    told = page is not None and not nominal.bodies
    values = arguments.outputs.file(arguments.out.with_name(_values_name(arguments.out))) if told else None

    import numpy as np

    own = calibration_and_effect_files.known_effects(calibration_and_effect_files.load_effect_files(arguments))
    findings = _findings(arguments, recording, own)
    sampled = poses_from_readings.samples_by_limbs_or_vision(arguments, recording, progress, look)
    sampled = replace(sampled, files=(*sampled.files, *arguments.effects))
    rng = np.random.default_rng(SEED)
    correction_extension.refuse_incompatible_extension_options(arguments, nominal.kind)
    if arguments.extend:
        calibration = _extended(recording, sampled, (out, page, links), arguments, rng, progress)
    elif arguments.joint and nominal.strut_joints is None:
        raise RigError(
            f"--joint solves a hexapod's cameras and struts together; a mechanism of kind {nominal.kind!r} "
            "takes none of it"
        )
    elif nominal.bodies:
        calibration = _chain(recording, sampled, (out, page, links), arguments, rng, progress)
    elif nominal.link_rows is not None:
        known = (
            _taken_arm(recording, sampled, findings, own, progress) if arguments.find or findings is not None else None
        )
        calibration = _arm(recording, sampled, (out, page, links), arguments, rng, progress, known)
    else:
        taken = _taken(recording, sampled, findings, own, progress) if arguments.find or findings is not None else None
        calibration = _struts(recording, sampled, (out, page, links), arguments, rng, progress, taken)
    if values is not None:
        _write_summands(values, sampled.samples, calibration)
    print_calibration_summary(arguments, calibration, len(sampled.samples))
    print_frames_without_pose(sampled.measurement)
    print(f"written: {arguments.out}" + (f"; look at {arguments.out.with_suffix('.html')}" if page else ""))


def _findings(arguments: Namespace, recording: Recording, own: Kinds) -> Findings | None:
    """Findings of the diagnosis that is named, None where none is. Raises RigError for what cannot take any in."""
    asked = "--find" if arguments.find else "--diagnosis" if arguments.diagnosis is not None else None
    if asked and recording.design.mechanism.bodies:
        raise RigError(f"{asked} is for platforms on struts and for arms; a chain is corrected by its geometry")
    if asked and arguments.joint:
        raise RigError(
            f"{asked} solves cameras, lenses, geometry and physics from all corners together; leave out --joint"
        )
    if asked and arguments.limbs:
        raise RigError(f"{asked} looks at what cameras saw of every pose; leave out --limbs")
    if asked and arguments.extend:
        raise RigError(f"{asked} corrects what it finds by its own models, --extend by none; give one of them")
    if arguments.effects and not asked:
        raise RigError("--effects adds to what a diagnosis is asked for: give --find or --diagnosis as well")
    if arguments.diagnosis is None:
        return None
    from calib.diagnose.platform_findings_refit import load_findings

    return load_findings(arguments.diagnosis, recording, own)


def _taken(
    recording: Recording, sampled: Sampled, findings: Findings | None, own: Kinds, progress: Progress
) -> PlatformRefit:
    """PlatformRefit of findings; of what a diagnosis of the recording itself finds where these are None."""
    from calib.diagnose.platform_findings_refit import findings_of_platform_diagnosis, refit_platform_with_findings
    from calib.diagnose.recording_diagnosis import DiagnosisOptions, diagnose

    if findings is None:
        options = DiagnosisOptions(sampled=sampled, kinds=tuple(own.values()))
        findings = findings_of_platform_diagnosis(diagnose(recording, options, progress))
    return refit_platform_with_findings(recording, sampled, findings, progress)


def _taken_arm(
    recording: Recording, sampled: Sampled, findings: Findings | None, own: Kinds, progress: Progress
) -> ArmRefit:
    """ArmRefit of findings; of what a diagnosis of the recording itself finds where these are None."""
    from calib.diagnose.arm_findings_refit import refit_arm_with_findings
    from calib.diagnose.platform_findings_refit import findings_of_platform_diagnosis
    from calib.diagnose.recording_diagnosis import DiagnosisOptions, diagnose

    if findings is None:
        options = DiagnosisOptions(sampled=sampled, kinds=tuple(own.values()))
        findings = findings_of_platform_diagnosis(diagnose(recording, options, progress))
    return refit_arm_with_findings(recording, sampled, findings, progress)


def _write_summands(path: Path, samples: Samples, calibration: Calibration) -> None:
    """Write ksf.csv, or say why there is none: of an arm there is none where its poses do not tell its joints."""
    from calib.correct.correction_tables import strut_summands, summand_columns, summand_rows
    from rig.recording.recording_tables import write_table

    nominal = calibration.correction.nominal
    if nominal.link_rows is not None:
        from calib.models.arm.certification import UNPLACED
        from calib.models.arm.extension_certification import stated_model_summands

        try:
            if samples.measured in UNPLACED:
                raise RigError(UNPLACED[samples.measured])
            found = stated_model_summands(samples, nominal)
        except RigError as error:  # the calibration stands without them
            print(f"no correction values: {error}")
            return
    else:
        found = strut_summands(samples, nominal)
    write_table(path, summand_columns(len(nominal.axes)), summand_rows(samples, found))


def _values_name(out: Path) -> str:
    """ksf.csv beside a calibration.json, NAME.ksf.csv beside another NAME.json."""
    return "ksf.csv" if out.stem == "calibration" else f"{out.stem}.ksf.csv"


def _struts(
    recording: Recording,
    sampled: Sampled,
    out: Places,
    arguments: Namespace,
    rng: np.random.Generator,
    progress: Progress,
    taken: PlatformRefit | None,
) -> Calibration:
    from calib.certify.platform_certification import (
        certify_platform,
        platform_workspace_claim,
        with_refitted_correction,
    )
    from calib.files.calibration_from_recording import calibration_with_provenance
    from calib.report.calibration_page import write_calibration_page
    from rig.model.mechanism_kinds import require_hexapod, require_struts

    if arguments.joint:
        require_hexapod(recording.design.mechanism)
    samples = sampled.samples if taken is None else taken.samples
    done = certify_platform(samples, require_struts(recording.design.mechanism), rng, progress)
    if arguments.joint:
        from calib.correct.joint_camera_fit import refine_correction_with_cameras

        progress("solving cameras and geometry together", 0, 1)
        correction, found = refine_correction_with_cameras(sampled, recording.design, done.correction, done.found)
        done = with_refitted_correction(done, correction, found)
    if taken is not None:
        done = taken.drawn(done, rng)
    claim = platform_workspace_claim(samples, done, rng)
    made = calibration_with_provenance(
        recording, sampled, done, claim, arguments.argv, None if taken is None else taken.with_geometry(done)
    )
    calibration = _stored(out[0], made, arguments, (recording, sampled, progress) if taken is None else None)
    draw_page_and_print_verdict(
        out[1],
        lambda page: write_calibration_page(page, recording, calibration, samples, done.found, out[2]),
        calibration,
        progress,
    )
    if done.held_out:
        print_held_out_errors(done.held_out, "held-out poses (whole stretches of configurations in turn)")
    struts = [i + 1 for i, part in enumerate(done.correction.remainder) if part is not None]
    print(
        "beyond the geometry: "
        + (
            f"struts {', '.join(map(str, struts))} corrected over the configuration space"
            if struts
            else "nothing that pays on held-out poses"
            if done.held_out
            else "not asked, for want of held-out poses"
        )
    )
    print_compensated_physics(calibration.physics)
    print_pose_counts(sampled, done)
    return calibration


def _extended(
    recording: Recording,
    sampled: Sampled,
    out: Places,
    arguments: Namespace,
    rng: np.random.Generator,
    progress: Progress,
) -> Calibration:
    from calib.files.calibration_from_recording import calibration_with_provenance

    mechanism = recording.design.mechanism
    before = _before(arguments.onto, mechanism) if arguments.onto else None
    found = correction_extension.certify_correction_extension(arguments, mechanism, sampled, before, rng, progress)
    done = found.done
    made = calibration_with_provenance(
        recording,
        sampled,
        done,
        found.claim,
        arguments.argv,
        previous_calibration=None if before is None else (before, found.kept),
    )
    calibration = _stored(out[0], made, arguments, None)
    draw_page_and_print_verdict(
        out[1], lambda page: found.draw(page, recording, calibration, out[2]), calibration, progress
    )
    if done.held_out:
        print_held_out_errors(
            done.held_out, "held-out poses (whole levels of a grid, poses beside it, or whole stretches in turn)"
        )
    correction_extension.print_correction_extension(
        found,
        f"{arguments.onto}, pass {len(calibration.provenance['passes']) + 1}"
        if before is not None
        else ("the owner's model alone" if arguments.alone else "the fitted geometry"),
    )
    print_pose_counts(sampled, done)
    return calibration


def _before(path: Path, nominal: Any) -> Calibration:
    """The Calibration on which a pass stands. Raises RigError for one of another machine, or one that knows physics."""
    from calib.files import calibration_file

    before = calibration_file.load(path)
    if calibration_file.mechanism_dict(before.correction.nominal) != calibration_file.mechanism_dict(nominal):
        raise RigError(f"{path} is a calibration of another machine than this recording's rig.toml states")
    if before.physics is not None:
        raise RigError(
            f"{path} knows physics besides the configuration; a pass goes on top of corrections by configuration alone"
        )
    return before


def _arm(
    recording: Recording,
    sampled: Sampled,
    out: Places,
    arguments: Namespace,
    rng: np.random.Generator,
    progress: Progress,
    taken: ArmRefit | None,
) -> Calibration:
    from calib.files.calibration_from_recording import calibration_with_provenance
    from calib.models.arm.calibration_page import write_arm_calibration_page
    from calib.models.arm.certification import arm_workspace_claim, certify_arm
    from rig.model.mechanism_kinds import require_arm

    together = None if taken is None else taken.together
    samples = sampled.samples if together is None else together.samples
    done = certify_arm(
        sampled.samples, require_arm(recording.design.mechanism), sampled.instrument, rng, progress, together
    )
    claim = arm_workspace_claim(samples, done, rng)
    made = calibration_with_provenance(
        recording, sampled, done, claim, arguments.argv, None if taken is None else taken.with_geometry(done)
    )
    calibration = _stored(out[0], made, arguments, (recording, sampled, progress) if taken is None else None)
    draw_page_and_print_verdict(
        out[1],
        lambda page: write_arm_calibration_page(page, recording, calibration, samples, done, out[2]),
        calibration,
        progress,
    )
    if done.held_out:
        print_held_out_errors(
            done.held_out, "held-out poses (a third at a time or less, whole stretches of configurations)"
        )
    print_arm_correction(done, calibration.physics)
    print("\n".join(done.found.rank.report()))
    print_pose_counts(sampled, done)
    return calibration


def _chain(
    recording: Recording,
    sampled: Sampled,
    out: Places,
    arguments: Namespace,
    rng: np.random.Generator,
    progress: Progress,
) -> Calibration:
    from calib.files.calibration_from_recording import calibration_with_provenance
    from calib.models.chain.calibration_page import write_chain_calibration_page
    from calib.models.chain.certification import certify_chain, chain_workspace_claim
    from rig.model.mechanism_kinds import require_chain

    done = certify_chain(sampled.samples, require_chain(recording.design.mechanism), rng, progress)
    claim = chain_workspace_claim(sampled.samples, done, rng)
    calibration = _stored(
        out[0],
        calibration_with_provenance(recording, sampled, done, claim, arguments.argv),
        arguments,
        (recording, sampled, progress),
    )
    draw_page_and_print_verdict(
        out[1],
        lambda page: write_chain_calibration_page(page, recording, calibration, sampled.samples, done, out[2]),
        calibration,
        progress,
    )
    if done.held_out:
        print_held_out_errors(done.held_out, "held-out poses (whole stretches of configurations in turn)")
    print("\n".join(done.found.report()))
    print_pose_counts(sampled, done)
    return calibration


def _stored(
    out: Any, calibration: Calibration, arguments: Namespace, look: tuple[Recording, Sampled, Progress] | None
) -> Calibration:
    """The Calibration, written. look : what is searched for what it leaves out, and what is called meanwhile; None
    where no model corrects that, or where it is known"""
    from calib.diagnose.calibration_left_out_physics import mark_as_not_searched, search_left_out_physics
    from calib.files import calibration_file

    if look is not None and arguments.limbs is None:
        calibration = (
            mark_as_not_searched(calibration) if arguments.quick else search_left_out_physics(calibration, *look)
        )
    calibration_file.save(out, calibration)
    return calibration
