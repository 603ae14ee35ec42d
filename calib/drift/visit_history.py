"""History of visits (watch.json).

Each visit is compared with those before, and the oldest are summed.
"""

import json
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.drift.machine_change_hypotheses_verdict_and_sentences import (
    Verdict,
    change_hypotheses,
    change_verdict,
    prior_information_of_constants_between_visits,
    whitened_squares_unexplained_by_constants,
)
from calib.drift.visit_equations_and_reference import (
    Equations,
    Reference,
    require_watchable_calibrated_machine,
    visit_equations_and_reference,
)
from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.output_files import write_text
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import DISTORTION_TERMS, Camera
from rig.model.pose import pose_file_entry
from rig.recording.frame_selection_and_content_hashes import (
    content_hashes_of_frames,
    frames_with_known_hashes,
    sorted_hashes_of_frames,
)
from rig.recording.recording_folder import Recording
from vision.rolling_shutter_row_time_and_readout_result import rolling_shutter_row_time

LATEST = 8  # latest visits that a change may have begun with; older ones are one
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


def add_visit_and_judge_change(
    history: History, recording: Recording, calibration: Calibration
) -> tuple[History, Verdict]:
    """Add a visit to a History, and judge whether the machine changed.

    Returns (History, Verdict of the visit)
    Raises RigError for data that were taken already or that the calibration was made from, and as
        `visit_equations_and_reference` does
    """
    of = content_hashes_of_frames(recording)
    for known, what in (
        (history.data, "are already in the history"),
        (calibration.provenance.get("data", ()), "were used for the calibration"),
    ):
        same = frames_with_known_hashes(of, known)
        if same:
            raise RigError(
                f"{recording.folder}: {len(same)} of {len(recording.exposures.times()[0])} frames (the "
                f"first: {same[0]}) {what}; a visit "
                "is a new recording"
            )
    equations, reference = visit_equations_and_reference(recording, calibration, history.reference)
    mechanism, before = require_watchable_calibrated_machine(calibration), [visit.equations for visit in history.visits]
    constants = prior_information_of_constants_between_visits(reference, calibration.covariance, mechanism)
    if len(equations.right) != len(constants) or any(len(one.right) != len(constants) for one in before):
        raise RigError("the history has another number of unknowns than this calibration; begin a new history")
    square = whitened_squares_unexplained_by_constants([*before, equations], constants) - (
        whitened_squares_unexplained_by_constants(before, constants) if before else 0.0
    )
    squares = [*((visit.square, visit.count) for visit in history.visits), (square, equations.count)]
    first = history.visits[0].visits if history.visits else 1
    verdict = change_verdict(
        [*before, equations], squares, history.scale(), constants, change_hypotheses(reference, mechanism), first
    )
    visit = Visit(
        recording.folder.resolve().name, equations, square, equations.count, verdict.log_sum, 1, not verdict.alarm
    )
    made = replace(
        history,
        reference=reference,
        visits=_summed((*history.visits, visit)),
        data=history.data | set(sorted_hashes_of_frames(of)),
    )
    return made, verdict


def _summed(visits: tuple[Visit, ...]) -> tuple[Visit, ...]:
    """The visits, of which the oldest are one where there are more than LATEST."""
    if len(visits) <= LATEST + 1:
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


SCHEMA = "watch/1"
MOST_PLACES = 200


def calibration_file_sha256(calibration_path: Path) -> str:
    """SHA-256 digest of a calibration's file."""
    return sha256(calibration_path.read_bytes()).hexdigest()


def write_history(path: Path | str, history: History) -> None:
    """Write a History.

    It has visits, and is written whole or not at all.
    Raises ValueError for one without.
    """
    r = history.reference
    if r is None:
        raise ValueError("expected a history with visits, got one without")
    cameras = [
        {
            "name": c.name,
            "width": c.width,
            "height": c.height,
            "matrix": c.matrix.tolist(),
            "distortion": c.distortion.tolist(),
            "pose": pose_file_entry(c.pose),
            "shutter": c.shutter,
            "row_time": rolling_shutter_row_time(c),
        }
        for c in r.cameras
    ]
    visits = [
        {
            "name": v.name,
            "visits": v.visits,
            "quiet": v.quiet,
            "square": v.square,
            "count": v.count,
            "log_sum": v.log_sum,
            "information": v.equations.information[np.triu_indices(len(v.equations.right))].tolist(),
            "right": v.equations.right.tolist(),
            "own_square": v.equations.square,
        }
        for v in history.visits
    ]
    tree = {
        "schema": SCHEMA,
        "calibration_sha256": history.calibration,
        "places": [str(place) for place in r.places],
        "base": r.base,
        "targets": r.targets,
        "cameras": cameras,
        "visits": visits,
        "data": sorted(history.data),
    }
    write_text(path, json.dumps(tree) + "\n")


def read_history(path: Path | str, calibration_sha256: str) -> History:
    """History of visits read from its file.

    calibration_sha256 : SHA-256 of the file that it must be about
    Raises FileError for a file that is missing, cut off, none of these, or of another calibration
    """
    tree = json_toml_and_yaml_loading.load_json(Path(path), "history of a watch", SCHEMA)
    if tree.text("calibration_sha256") != calibration_sha256:
        raise FileError(path, "is the history of another calibration; name another file, and a new history begins")
    places = tree.texts("places")
    if not 0 < len(places) <= MOST_PLACES:
        tree.fail(f"places has {len(places)} names; a rig has 1 to {MOST_PLACES}", "places")
    stored = tree.tables("visits")
    unknowns = len(stored[0].array("right", (None,))) if stored else 0
    reference = Reference(
        tuple(_camera(table) for table in tree.tables("cameras")),
        tuple(map(Place.parse, places)),
        tree.texts("base"),
        tree.text("targets"),
    )
    return History(
        calibration_sha256, reference, tuple(_visit(table, unknowns) for table in stored), frozenset(tree.texts("data"))
    )


def _camera(table: Entries) -> Camera:
    distortion = table.array("distortion", (None,))
    if len(distortion) not in DISTORTION_TERMS:
        table.fail(
            f"{table.name('distortion')} has {len(distortion)} terms, not {', '.join(map(str, DISTORTION_TERMS))}",
            "distortion",
        )
    return Camera(
        table.identifier("name"),
        table.whole("width", 1),
        table.whole("height", 1),
        table.array("matrix", (3, 3)),
        distortion,
        table.pose("pose"),
        table.text("shutter", ("global", "rolling")),
        table.number("row_time"),
    )


def _visit(table: Entries, unknowns: int) -> Visit:
    upper = np.triu_indices(unknowns)
    values = table.array("information", (len(upper[0]),))
    information = np.zeros((unknowns, unknowns))
    information[upper] = values
    information.T[upper] = values
    least, *_, most = np.linalg.eigvalsh(information)
    if least < -1e-6 * abs(most):
        table.fail(f"{table.name('information')} is not a valid information matrix", "information")
    equations = Equations(
        information, table.array("right", (unknowns,)), table.number("own_square"), table.whole("count", 1)
    )
    return Visit(
        table.text("name"),
        equations,
        table.number("square"),
        equations.count,
        table.number("log_sum"),
        table.whole("visits", 1),
        table.flag("quiet"),
    )
