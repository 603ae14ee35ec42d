"""Investigation of a rig in rounds of experiments, with a certificate at its end.

Plan, record, diagnose, experiment, again and again; at its end a certificate.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from calib.experiment import FIRST, LOADED, STANDING
from calib.experiment.investigation_folder_and_report import (
    InvestigationRound,
    diagnosis_path,
    investigation_notebook_markdown,
    investigation_verdict,
    minutes_of_plan_file_with_setting_up,
    plan_path,
    read_investigation_rounds,
    recording_minutes_spent,
    recording_path,
    write_investigation_page,
)
from calib.experiment.investigation_plan_execution import Command, InvestigatedRig, InvestigateOptions, Waiting
from calib.files import calibration_file
from calib.models.arm import arm_error_model_and_instrument_observations
from rig.array_and_json_types import Json
from rig.errors import RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.output_files import write_bytes, write_text
from rig.formats.rig_toml import design_from_rig_toml
from rig.formats.rig_toml.mechanism_entries import write_kinematics_file
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_single_hand_mechanism
from rig.model.design import Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.planning.configuration_generators import sobol_configurations
from rig.planning.recording_plan import axis_strokes, build_plan
from rig.planning.timed_plan_and_visiting_order import write_plan_table
from rig.recording.corner_and_pose_csv_tables import Poses, write_poses
from rig.report.verdict_refutations_and_result_display import OneLineRepr, Verdict, result_html

REACH = 0.7  # of the strokes, over which new poses lie: what is corrected has to be reached as well
VERIFYING = 1000  # added to the seed for the new poses


def calibrate_verify_and_certify_investigated_rig(
    out: Path, rig: InvestigatedRig, rounds: Sequence[InvestigationRound]
) -> tuple[str, ...]:
    """Calibration, verification and certificate at the end of an investigation.

    Verified on new poses; the lines say too what could not be done. Raises Waiting as `InvestigatedRig.record` does
    Where a command refuses, what follows from it is left out, and that is a line

    Returns lines on what was done
    """
    lines = []
    recordings = [str(recording_path(out, look.number)) for look in rounds]
    calibration, number = out / "calibration.json", len(rounds)
    poses, commands, plan, verifying = (
        out / f"verify{number}{suffix}" for suffix in ("-poses.csv", "-commands.csv", ".csv", "")
    )
    done = plan.exists()
    try:
        if not done:
            rig.call(
                "calibrate", *recordings, "--diagnosis", str(diagnosis_path(out, number)), "--out", str(calibration)
            )
    except RigError as error:
        return (f"not calibrated: {error}",)
    found = ", ".join(rounds[-1].findings) or "no physics"
    lines.append(f"{calibration.name}: of {len(recordings)} recording{'s' * (len(recordings) > 1)}, with {found}")
    try:
        if not done:
            _wanted(poses, rig, calibration)
            rig.call(
                "correct",
                str(calibration),
                "--poses",
                str(poses),
                "--out",
                str(commands),
                "--skip-unreachable",
                "--force",
            )
            stands = build_plan(
                rig.design, f"commands:{plan_path(out, number)}"
            ).turned  # cubes stay as they were put back
            write_plan_table(
                plan, replace(build_plan(rig.design, f"commands:{commands}"), turned=stands), rig.design.mechanism.axes
            )
        rig.record(plan, verifying, rig.options.seed + VERIFYING)
        rig.call("verify", str(calibration), str(verifying))
        lines.append(f"verified on new poses, commanded through the correction: {verifying.name}")
    except RigError as error:
        return (*lines, f"not verified: {error}")
    try:
        rig.call("certify", str(calibration), str(verifying), "--out", str(out / "certificate"))
        lines.append("certificate")
    except RigError as error:
        lines.append(f"no certificate: {error}")
    return tuple(lines)


def _wanted(path: Path, rig: InvestigatedRig, calibration: Path) -> None:
    """Write new poses all over what the axes reach; of an arm as its calibration has it, in the instrument's own
    frame.
    """
    m = rig.design.mechanism
    lengths = sobol_configurations(axis_strokes(rig.design), rig.options.verify, REACH, rig.options.seed + VERIFYING)
    if m.kind == "arm":
        T = arm_error_model_and_instrument_observations.predicted_target_poses(
            lengths, require_arm(calibration_file.load(calibration).correction.fitted)
        )
    else:
        T = mechanisms.kinematics_of(m).forward(lengths, m)
    write_poses(path, Poses(np.arange(len(lengths)), T, None))


MOST = 8  # looks
STATE = "investigation.json"
AUTOMATIC = InvestigateOptions()


@dataclass(frozen=True, slots=True, repr=False)
class InvestigationResult(OneLineRepr):
    """What an investigation found. looks : after each recording; ended : why, "" while it goes on; after : what was
    made at the end, in lines; waiting : for whom and what, None where for nobody
    """

    looks: tuple[InvestigationRound, ...]
    ended: str
    after: tuple[str, ...] = ()
    waiting: str | None = None

    @property
    def verdict(self) -> Verdict | None:
        """The verdict on the rig, None before the first look."""
        return investigation_verdict(self.looks, self.ended) if self.looks else None

    def __str__(self) -> str:
        if self.waiting is not None:
            return self.waiting
        return self.verdict.line if self.verdict is not None else "check: nothing has been recorded"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), [text for text in (self.ended, *self.after) if text])

    def tree(self) -> Json:
        """What `rig investigate --json` prints."""
        return {
            "schema": "investigated/1",
            "verdict": self.verdict.tree() if self.verdict is not None else None,
            "ended": self.ended,
            "waiting": self.waiting,
            "looks": [asdict(look) for look in self.looks],
            "after": list(self.after),
        }


def investigate(
    rig_toml: Path | str, out: Path | str, command: Command, options: InvestigateOptions = AUTOMATIC
) -> InvestigationResult:
    """InvestigationResult of a rig, as `rig investigate` makes it.

    Plan, record, diagnose, and again, until nothing is ambiguous or the budget ends; then calibrate, verify and
    certify.
    out : a new folder, or with options.resume one to go on with; command : carries out a command of rig and returns
    its exit status, as `rig.cli.main` does
    Raises RigError for a machine that cannot be investigated and where a command refuses
    """
    path, folder = Path(rig_toml), Path(out)
    design = design_from_rig_toml.load_design(path)
    _require_observed(design)
    rig = InvestigatedRig(path, design, options, command)
    _begin(folder, rig)
    try:
        before = read_investigation_rounds(folder)
        if (
            before and before[-1].questions and not before[-1].proposed
        ):  # there was no time, or something was not allowed: it is asked again
            _diagnose(folder, rig, before[-1].number, before[:-1])
        while True:
            so_far = read_investigation_rounds(folder)
            _write_notebook(folder, rig, so_far, "")
            ended = _ended(options, so_far)
            if ended:
                break
            _look(folder, rig, len(so_far) + 1, so_far)
        _write_notebook(folder, rig, so_far, ended)
        after = calibrate_verify_and_certify_investigated_rig(folder, rig, so_far)
    except Waiting as waiting:
        return InvestigationResult(tuple(read_investigation_rounds(folder)), "", (), str(waiting))
    _write_notebook(folder, rig, so_far, ended, after)
    return InvestigationResult(tuple(so_far), ended, after)


def _require_observed(design: Design) -> None:
    """Raise RigError for a machine that cannot be investigated."""
    require_single_hand_mechanism(design.mechanism, "an investigation is")
    if len(design.mechanism.stages) != 1:
        raise RigError(
            "an investigation requires a platform on struts or an arm, not a mechanism of kind "
            f"{design.mechanism.kind!r}"
        )
    if design.mechanism.link_rows is not None and design.instrument is None and not (design.cameras and design.targets):
        raise RigError(
            "an investigation of an arm requires an [instrument] that measures its poses, or cameras and "
            "targets that determine them"
        )


def _begin(out: Path, rig: InvestigatedRig) -> None:
    """Make the folder, or see that it is of this rig. Raises RigError otherwise."""
    options = rig.options
    own = {"schema": "investigation/1", "rig": rig.digest, "by": rig.by, "seed": options.seed}
    if options.resume:
        stored = json_toml_and_yaml_loading.load_json(out / STATE, "investigation", "investigation/1")
        for name, value in own.items():
            if stored.tree.get(name) != value:
                stored.fail(f"is of another {name}: {stored.tree.get(name)!r}, not {value!r}", name)
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RigError(
            f"{out} already exists"
            + ("; --resume continues with it" if (out / STATE).exists() else "; name a new folder")
        )
    plan = build_plan(rig.design, options.plan or _first(rig), options.seed)
    rig.refuse(plan)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{out} cannot be created: {error.strerror}") from None
    write_bytes(out / "rig.toml", rig.path.read_bytes())
    write_kinematics_file(out, rig.design.mechanism)
    write_plan_table(plan_path(out, 1), plan, rig.design.mechanism.axes)
    write_text(out / STATE, json.dumps(own, indent=1) + "\n")


def _first(rig: InvestigatedRig) -> str:
    """The text of the first plan, where nobody states one."""
    if not rig.moving:
        return STANDING
    return f"{FIRST},{LOADED}" if "payload" in rig.design.experiment.may else FIRST


def _look(out: Path, rig: InvestigatedRig, number: int, so_far: Sequence[InvestigationRound]) -> None:
    """Record the plan of a look, and diagnose all recordings together."""
    rig.record(plan_path(out, number), recording_path(out, number), rig.options.seed + number)
    _diagnose(out, rig, number, so_far)


def _diagnose(out: Path, rig: InvestigatedRig, number: int, so_far: Sequence[InvestigationRound]) -> None:
    """Diagnose the recordings up to a number together; the next plan is written with it. so_far : the looks before"""
    minutes = recording_minutes_spent(so_far) + minutes_of_plan_file_with_setting_up(plan_path(out, number))
    left = max(rig.options.budget - minutes, 0.1)
    words = [
        "diagnose",
        *(str(recording_path(out, k + 1)) for k in range(number)),
        "--out",
        str(diagnosis_path(out, number)),
        "--next",
        str(plan_path(out, number + 1)),
        "--minutes",
        f"{left:.3f}",
        *([] if rig.moving else ["--standing"]),
        *(word for may in rig.design.experiment.may for word in ("--may", may)),
    ]
    rig.call(*words)


def _ended(options: InvestigateOptions, so_far: Sequence[InvestigationRound]) -> str:
    """Why the investigation ends, "" while it goes on."""
    if not so_far:
        return ""
    last = so_far[-1]
    if not last.questions:
        return (
            "nothing is ambiguous any more"
            if last.findings
            else ("the remaining effect is in no catalogue" if last.unknown else "nothing is unmodelled")
        )
    if not last.proposed:
        late = recording_minutes_spent(so_far) > options.budget / 2
        return (
            f"the budget of {options.budget:.0f} min leaves no time for a more informative experiment"
            if late
            else "no plan that is allowed distinguishes the rest"
        )
    return f"{MOST} recordings did not distinguish them" if last.number >= MOST else ""


def _write_notebook(
    out: Path, rig: InvestigatedRig, so_far: Sequence[InvestigationRound], ended: str, after: tuple[str, ...] = ()
) -> None:
    """Write the notebook and its page as they are now."""
    if so_far:
        name = rig.path.resolve().parent.name if rig.path.name == "rig.toml" else rig.path.stem
        budget = rig.options.budget
        write_text(out / "notebook.md", investigation_notebook_markdown(name, so_far, budget, ended, after))
        write_investigation_page(out / "notebook.html", name, so_far, budget, ended, after)
