"""Options of a plan, and a plan as result.

Its configurations, what they make visible, and the verdict.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.models.platform.d_optimal_hexapod_configurations import ConfigurationExclusion
from calib.report.recording_and_plan_pages import write_plan_page
from calib.samples.position_confounds_and_poses_on_one_clock import Confounds, confound_sentences
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import are_nominal_poses_out_of_corrected_reach
from rig.array_and_json_types import Floats, Json
from rig.errors import RigError
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_hexapod
from rig.recording.corner_and_pose_csv_tables import write_configurations, write_table
from rig.recording.recording_folder import Sensors
from rig.report.pages.page_templates_and_index_page import Link
from rig.report.verdict_refutations_and_result_display import (
    Evidence,
    MissingEvidence,
    OneLineRepr,
    Verdict,
    judge_evidence,
    result_html,
)

SEED = 0
SHOWN = 8  # combinations that are listed
LEAST = 3.0  # standard deviations by which effects must differ to be told apart
MOVES = (
    "sobol:40",
    "ladder:12",
    "moving:40",
    "zigzag:40",
    "payload:16",
    "axes:5",
    "repeat:40",
)  # parts of plans that may tell effects apart
CRITERIA = ("determinant", "noise")
Log = Callable[[float], Sensors]  # duration (s) -> what the machine's sensors show over it


@dataclass(frozen=True, slots=True, eq=False)
class PlanOptions:
    """What a plan is for, one of these, else for the machine's parameters. promise : m RMS over the workspace, to which
    the corrected machine is to keep; separate : two effects as for `rig simulate --effect`, to be told apart; parts :
    parts of a plan, visited as they are
    count : configurations to choose; criterion : one of CRITERIA; sigma : (m, rad) standard deviation of a measured
    pose, per axis
    given : (k, axes) m or rad visited already, or None; calibration : whose geometry counts, and whose unreached poses
    are avoided, or None; name : of that, in words; log : for separate, the sensors over a plan
    """

    promise: float | None = None
    separate: tuple[str, str] | None = None
    parts: str | None = None
    count: int = 60
    criterion: str = "determinant"
    sigma: tuple[float, float] = (1e-5, 1e-4)
    given: Floats | None = None
    calibration: Calibration | None = None
    name: str = "the calibration"
    log: Log | None = None

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise ValueError(f"criterion takes {CRITERIA}, got {self.criterion!r}")
        if self.parts is not None and (self.calibration is not None or self.given is not None):
            raise RigError("--parts are visited as given; --calibration and --given apply to optimised plans")
        if self.separate is not None and self.calibration is not None:
            raise RigError(
                "--calibration applies to --for and --promise; effects are distinguished by the geometry of RIG.toml"
            )
        if self.count < 1 or min(self.sigma) <= 0:
            raise RigError(
                f"--count and --sigma must be positive, got {self.count} and {self.sigma[0]:g} m {self.sigma[1]:g} rad"
            )


FOR_PARAMETERS = PlanOptions()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlanResult(OneLineRepr):
    """A plan. design; values : (n, axes) m or rad in their order; seen : whether all that is asked becomes visible; why
    : in a line; visibility_lines : lines on what it makes visible; confounds : of its configurations, None where it is
    in time
    t : (n,) s of a plan in time, else None; reached_from : (n, axes) m or rad from which each configuration is
    approached, None where they are visited straight
    """

    design: Design
    values: Floats
    seen: bool
    why: str
    visibility_lines: Sequence[str]
    confounds: Confounds | None = None
    t: Floats | None = None
    reached_from: Floats | None = None

    @property
    def verdict(self) -> Verdict:
        """The verdict on it."""
        unseen = () if self.seen else (MissingEvidence("not everything requested becomes visible"),)
        return judge_evidence(Evidence(self.why, missing=unseen, confounds=confound_sentences(self.confounds)))

    def __str__(self) -> str:
        return self.verdict.line

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines())

    def lines(self) -> list[str]:
        """What it makes visible, and what its configurations confound."""
        return [*self.visibility_lines, *([] if self.confounds is None else [self.confounds.line()])]

    def tree(self) -> Json:
        """What `rig plan --json` prints."""
        return {
            "schema": "planned/1",
            "verdict": self.verdict.tree(),
            "state": "good" if self.seen else "check",
            "why": self.why,
            "said": [line for line in self.visibility_lines if line],
            "axes": list(self.design.mechanism.axes),
            "values": self.values.tolist(),
            "reached_from": None if self.reached_from is None else self.reached_from.tolist(),
            "confounds": self.confounds and self.confounds.tree(),
        }

    def write(self, path: Path) -> None:
        """Write it as a table that `rig simulate --plan commands:FILE` takes; nothing where nothing is visited."""
        axes = self.design.mechanism.axes
        if self.t is not None:
            rows = [f"{t:.4f}," + ",".join(f"{v:.7f}" for v in values) for t, values in zip(self.t, self.values)]
            write_table(path, ("t", *axes), rows)
        elif len(self.values):
            write_configurations(path, axes, self.values, self.reached_from)

    def write_page(self, path: Path, file: str, links: Sequence[Link] = ()) -> None:
        """Write the page of it. file : name of the table, in words"""
        write_plan_page(path, file, self, links)


def plan_geometry_and_exclusion_of_lost_poses(
    options: PlanOptions, mechanism: Hexapod
) -> tuple[Hexapod, ConfigurationExclusion | None]:
    """Geometry for a plan, and the configurations excluded from it, by the calibration that its options name.

    The mechanism as it is where none is named. Raises RigError for a calibration of another kind of mechanism
    """
    if options.calibration is None:
        return mechanism, None
    correction = options.calibration.correction
    if not is_hexapod(correction.fitted):
        raise RigError(
            f"{options.name} is a calibration of a mechanism of kind {correction.fitted.kind!r}, not of a hexapod"
        )
    return correction.fitted, partial(are_nominal_poses_out_of_corrected_reach, correction)
