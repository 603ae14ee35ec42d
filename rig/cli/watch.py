"""rig watch: watch a calibration's drift by small visits: whether it still holds, what changed."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rig.cli.shared import calibration_and_effect_files
from rig.cli.shared.command_options import (
    SEED,
    Progress,
    add_json_option,
    add_overwrite_option,
    add_page_option,
    page_links,
    page_path,
    print_json,
)
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import parse_whole_number
from rig.report.verdict import State, exit_status

if TYPE_CHECKING:
    from calib.certify.calibration import Calibration
    from calib.certify.claim_verification import Verification
    from calib.drift.change_evidence import Verdict
    from calib.drift.visit_history import History
    from rig.recording.recording_folder import Recording

MEASURING = ("camera", "target", "instrument")  # kinds of changes of what measures: the calibration itself stands
POSES = 12


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument(
        "visits", metavar="VISIT", type=Path, nargs="*", help="small recordings, in the order in which they were taken"
    )
    parser.add_argument(
        "--history",
        metavar="FILE",
        type=Path,
        help="go on from the visits kept there where the file is there, and keep these too",
    )
    add_json_option(parser)
    parser.add_argument("--skip-unreadable", action="store_true", help="leave out images that cannot be used")
    parser.add_argument("--plan", action="store_true", help="choose what a visit visits, instead of looking at visits")
    parser.add_argument(
        "--rig", metavar="RIG.toml", type=Path, help="for --plan: whose platform and gravity tell what a load does"
    )
    parser.add_argument(
        "--count", type=parse_whole_number, default=POSES, help=f"for --plan: poses of a visit (default {POSES})"
    )
    add_page_option(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        help="for --plan: frame,l1..l6; `rig run RIG.toml --plan commands:FILE` visits them",
    )
    add_overwrite_option(parser)


def run(arguments: Namespace) -> int:
    """Choose a visit's poses, or hold visits against a calibration and say what changed; 3 where the verdict is bad."""
    if arguments.plan:
        if arguments.visits or arguments.history or arguments.page or arguments.out is None:
            raise RigError("--plan takes --out FILE, and neither visits nor a --history nor a --page")
        _plan(arguments)
        return 0
    if arguments.out is not None or arguments.rig is not None:
        raise RigError("--out and --rig are for --plan")
    if not arguments.visits:
        raise RigError(
            "name the visits, recordings in the order in which they were taken; or --plan, for the poses "
            "that one visits"
        )
    return _watch(arguments)


def _watch(arguments: Namespace) -> int:
    from calib.certify.calibration_evidence import calibration_evidence
    from calib.drift import change_sentences, visit_history
    from calib.drift.visit_history import History, add_visit
    from calib.files import calibration_file
    from calib.report.verification_and_visit_pages import (
        Visit,
        change_alarm_sentence,
        first_visit_sentence,
        last_visit_verdict,
        write_visits_page,
    )
    from calib.samples.confounded_conditions import confounds_of_recordings
    from rig.recording import recording_folder as recordings

    progress = Progress()
    calibration, own = (
        calibration_file.load(arguments.calibration),
        visit_history.calibration_digest(arguments.calibration),
    )
    kept = None if arguments.history is None else arguments.outputs.file(arguments.history, own=True)
    page = page_path(arguments)
    known = arguments.history is not None and arguments.history.exists()
    history = visit_history.read_history(arguments.history, own) if known else History(own)
    loaded = [recordings.load_recording(path, arguments.skip_unreadable) for path in arguments.visits]
    told: list[dict] = []
    shown: list[str] = []
    seen: list[Visit] = []
    for k, recording in enumerate(loaded):
        progress("visits", k, len(loaded))
        scale = history.scale()
        history, verdict = add_visit(history, recording, calibration)
        progress.close()
        assert history.reference is not None
        confounds = confounds_of_recordings([recording])
        found = _verified(calibration, recording, verdict)
        claim = None if found is None else {"kept": not found.refutes, "of_limit": found.of_limit}
        told.append(_tree(verdict, history, scale) | {"claim": claim, "confounds": confounds and confounds.tree()})
        seen.append(Visit(history.visits[-1].name, verdict, (), scale, found))
        lines = change_sentences.change_verdict_lines(
            verdict, seen[-1].name, _names(history), history.reference, scale, seen[-1].allowed
        )
        seen[-1] = replace(seen[-1], lines=lines)
        shown += [*lines, *([] if confounds is None else [f"  {confounds.line()}"])]
    judgement = last_visit_verdict(
        seen, calibration_evidence(calibration, calibration_and_effect_files.read_refutations(arguments.calibration))
    )
    if kept is not None:
        visit_history.write_history(kept, history)
    if page is not None:
        write_visits_page(page, arguments.calibration.name, seen, judgement, page_links(arguments, arguments.page))
    last = seen[-1].evidence
    if seen[-1].allowed:
        calibration_and_effect_files.write_refutation(
            arguments, arguments.calibration, seen[-1].name, first_visit_sentence(seen[-1]), State.CHECK
        )
    elif last.alarm and (last.named is None or last.named.kind not in MEASURING):
        calibration_and_effect_files.write_refutation(
            arguments, arguments.calibration, seen[-1].name, change_alarm_sentence(last)
        )
    if not arguments.json:
        print("\n".join([judgement.line, *shown]))
    if arguments.json:
        print_json({"schema": "verdict/1", "verdict": judgement.tree(), "visits": told})
    elif kept is not None:
        print(f"{history.number} visits in {arguments.history}")
    return exit_status(judgement)


def _verified(calibration: Calibration, recording: Recording, verdict: Verdict) -> Verification | None:
    """The claim held against a first visit that disagrees with the calibration, as `rig verify` holds it; None of other
    visits.
    """
    import numpy as np

    from calib.certify.calibration_evidence import verify_claim_on_samples
    from calib.samples.recording_samples import sample_recording

    if not verdict.alarm or verdict.chance is None:
        return None
    return verify_claim_on_samples(
        calibration,
        calibration.with_physics(recording, sample_recording(recording).samples),
        np.random.default_rng(SEED),
    )


def _names(history: History) -> list[str]:
    """The name of each visit, the oldest ones' by what they are kept as."""
    return [visit.name for visit in history.visits for _ in range(visit.visits)]


def _tree(verdict: Verdict, history: History, scale: float) -> dict:
    """What JSON holds of a visit's verdict."""
    named = verdict.named
    return {
        "visit": history.visits[-1].name,
        "number": history.number,
        "changed": verdict.alarm,
        "log_sum": verdict.log_sum,
        "misfit": {"square": verdict.square, "count": verdict.count, "repeats": scale},
        "named": None if named is None or not verdict.alarm else named.name,
        "suspects": [
            {
                "kind": one.kind,
                "name": one.name,
                "since": one.since + 1,
                "odds": one.odds,
                "value": one.value.tolist(),
                "sigma": one.sigma.tolist(),
            }
            for one in verdict.suspects
            if one.odds > 1e-6
        ],
    }


def _plan(arguments: Namespace) -> None:
    from calib.drift.visit_configurations import SIGMAS, choose_visit_configurations
    from calib.files import calibration_file
    from rig.formats.rig_toml import design_file
    from rig.recording import recording_tables

    calibration = calibration_file.load(arguments.calibration)
    design = design_file.load_design(arguments.rig) if arguments.rig else None
    out = arguments.outputs.file(arguments.out)
    progress = Progress()
    chosen = choose_visit_configurations(
        calibration, design, arguments.count, SEED, lambda done, of: progress("choosing", done, of)
    )
    progress.close()
    recording_tables.write_configurations(out, calibration.correction.fitted.axes, chosen.commands)
    print(
        f"{arguments.count} poses; a pose measured to {SIGMAS[0] * 1e6:g} um and {SIGMAS[1] * 1e6:g} urad, "
        "one visit knows, all "
        "other changes allowed for (k=1; beside it as many poses evenly spread):"
    )
    for name, sigma, even, unit in chosen.expected_accuracy():
        print(f"  {name:24} {sigma:9.3g} {even:9.3g} {unit}")
    print(f"written: {arguments.out}")
