"""Visits so far: each is held against those before it and kept; the oldest are summed into one."""

from dataclasses import dataclass, replace

from calib.certify.calibration import Calibration
from calib.drift.change_evidence import Verdict, change_verdict, unexplained_squares
from calib.drift.change_hypotheses import change_hypotheses, prior_information
from calib.drift.first_visit_reference import Reference
from calib.drift.visit_equations import Equations, visit_equations
from rig.errors import RigError
from rig.recording.data_provenance import content_marks, frames_with_known_data, marks_of_frames
from rig.recording.recording_folder import Recording

KEPT = 8  # latest visits that a change may have begun with; older ones are one
BELIEVED = 200  # numbers' worth of belief that covariances are right, against which quiet visits' scatter counts


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """name : of the recording; equations : Equations; square, count : its innovation, squared and whitened, and how
    many numbers it has
    log_sum : of the Shiryaev-Roberts sum after it; visits : how many it stands for, 1 but for the oldest; quiet : no
        alarm after it."""

    name: str
    equations: Equations
    square: float
    count: int
    log_sum: float
    visits: int
    quiet: bool


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """calibration : SHA-256 of the file that it is about; reference : None before the first visit; visits : the oldest
    first
    data : marks of what was taken."""

    calibration: str
    reference: Reference | None = None
    visits: tuple[Visit, ...] = ()
    data: frozenset[str] = frozenset()

    @property
    def number(self) -> int:
        """How many visits were taken."""
        return sum(visit.visits for visit in self.visits)

    def scale(self) -> float:
        """By which squares exceed what covariances say, 1 at least, as quiet visits show it: what measuring repeats
        to.
        """
        quiet = [visit for visit in self.visits if visit.quiet]
        return max(1.0, (BELIEVED + sum(v.square for v in quiet)) / (BELIEVED + sum(v.count for v in quiet)))


def add_visit(history: History, recording: Recording, calibration: Calibration) -> tuple[History, Verdict]:
    """(History with one more visit, what it says now).

    Raises RigError for data that were taken already or that the calibration was made from, and as `visit_equations`
        does
    """
    of = content_marks(recording)
    for known, what in (
        (history.data, "are in the history already"),
        (calibration.provenance.get("data", ()), "made the calibration"),
    ):
        same = frames_with_known_data(of, known)
        if same:
            raise RigError(
                f"{recording.folder}: {len(same)} of {len(recording.exposures.times()[0])} frames (the "
                f"first: {same[0]}) {what}; a visit "
                "is what was recorded anew"
            )
    equations, reference = visit_equations(recording, calibration, history.reference)
    before, constants = (
        [visit.equations for visit in history.visits],
        prior_information(reference, calibration.covariance),
    )
    square = unexplained_squares([*before, equations], constants) - (
        unexplained_squares(before, constants) if before else 0.0
    )
    squares = [*((visit.square, visit.count) for visit in history.visits), (square, equations.count)]
    first = history.visits[0].visits if history.visits else 1
    verdict = change_verdict(
        [*before, equations], squares, history.scale(), constants, change_hypotheses(reference), first
    )
    visit = Visit(
        recording.folder.resolve().name, equations, square, equations.count, verdict.log_sum, 1, not verdict.alarm
    )
    made = replace(
        history,
        reference=reference,
        visits=_summed((*history.visits, visit)),
        data=history.data | set(marks_of_frames(of)),
    )
    return made, verdict


def _summed(visits: tuple[Visit, ...]) -> tuple[Visit, ...]:
    """The visits, of which the oldest are one where there are more than KEPT."""
    if len(visits) <= KEPT + 1:
        return visits
    a, b, *rest = visits
    return (
        Visit(
            f"{a.name.split(' .. ')[0]} .. {b.name}",
            a.equations + b.equations,
            a.square + b.square,
            a.count + b.count,
            b.log_sum,
            a.visits + b.visits,
            a.quiet and b.quiet,
        ),
        *rest,
    )
