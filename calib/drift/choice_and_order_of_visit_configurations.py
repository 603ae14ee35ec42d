"""Choice and order of the configurations of a visit.

They are chosen and ordered to show and separate changes of the machine.

D-optimal for the zeros, the play, growth and sag together, whatever the frame of measurement does meanwhile; play
shows by the side from which its axis came, so the order is chosen with the places.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.drift.visit_equations_and_reference import (
    AT_ORIGIN,
    GAP,
    base_motion_columns,
    machine_change_names,
    machine_change_units,
    pose_jacobian_by_machine_changes,
    require_watchable_calibrated_machine,
)
from calib.models.calibration_covariance_parameters import covariance_parameters
from calib.models.platform.d_optimal_hexapod_configurations import configurations_outside_exclusion
from calib.workspace.workspace_cell_map_with_margins_and_lost_poses import are_nominal_poses_out_of_corrected_reach
from rig.array_and_json_types import Floats, Integers
from rig.errors import RigError
from rig.model.design import Actuator, Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, axis_units, has_struts, kinematics_of
from rig.planning.configuration_generators import evenly_spread_configurations
from rig.recording.recording_folder import Commands
from vision.marker_corner_prediction import marker_map, visible_marker_counts_over_all_cameras

CANDIDATES, SEARCHED = 400, 4000  # configurations, and among how many those are sought that cameras see
FEWEST = 2  # markers of what moves that a configuration must show
FILL = 0.8  # of the strokes: farther out fewer cameras see the platform's targets
SIGMAS = (1e-5, 5e-5)  # m, rad; of a measured pose
LEAST = 4  # poses of a visit
PASSES = 4  # of exchanging
GAINS = 1e-3  # of the logarithm of the volume, below which a pass was the last
FAINT = 1e-3  # information in a change before any visit, per unit squared: only conditions the first poses
ZERO = 1e-4  # m or rad, unit of the zeros' columns
FRAME = (1e-2, 1e-2)  # m, rad; how far the frame of measurement may move meanwhile
DOWN = np.array([0.0, 0.0, -9.80665])  # m/s^2, where no rig.toml says otherwise


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """mechanism; commands : (n, axes) m or rad in order; sigma, even : (2 axes + 2,) standard errors of a visit in own
    units, of zeros, play, growth and sag, and of as many evenly spread.
    """

    mechanism: Commanded
    commands: Floats
    sigma: Floats
    even: Floats

    def expected_accuracy(self) -> list[tuple[str, float, float, str]]:
        """[(name, standard error, that of evenly spread poses, unit)] of what may change; of axes of a unit the worst
        one.
        """
        axes, units = len(self.mechanism.axes), np.array(axis_units(self.mechanism))
        words = ("a strut's", "nut") if has_struts(self.mechanism) else ("an axis'", "play")
        *_, growth, sag = machine_change_names(self.mechanism)
        rows: list[tuple[str, Integers, str]] = []
        for what, first in (("zero", 0), (words[1], axes)):
            for unit in dict.fromkeys(units.tolist()):
                rows.append((f"{words[0]} {what}", first + np.flatnonzero(units == unit), f"u{unit}"))
        rows += [(growth, np.array([2 * axes]), "um/m"), (sag, np.array([2 * axes + 1]), "kg/(N/um)")]
        return [
            (name, float(self.sigma[some].max() * 1e6), float(self.even[some].max() * 1e6), unit)
            for name, some, unit in rows
        ]


def choose_visit_configurations(
    calibration: Calibration,
    design: Design | None,
    count: int,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Chosen:
    """Choose the configurations of a visit of a calibrated machine.

    design : whose platform and gravity tell loads, or None; progress : called with (done, of)
    Raises RigError for a machine that is not watched or too few poses
    """
    mechanism = require_watchable_calibrated_machine(calibration)
    ranges = kinematics_of(mechanism).travel_ranges(mechanism)
    if not LEAST <= count <= CANDIDATES:
        raise RigError(f"--count takes {LEAST} to {CANDIDATES} poses, got {count}")
    candidates = configurations_outside_exclusion(
        _candidates(calibration, design, seed),
        lambda c: are_nominal_poses_out_of_corrected_reach(calibration.correction, c),
    )
    information = _VisitInformation(candidates, ranges.mean(axis=1), *_columns(calibration, design, candidates))
    order: list[int] = []
    for k in range(count):
        order.append(int(np.argmax(information.log_volumes(order, k))))
        if progress:
            progress(k + 1, count * (1 + PASSES))
    best = -np.inf
    for turn in range(PASSES):
        before = best
        for k in range(count):
            log_volumes = information.log_volumes(order, k)
            order[k], best = int(np.argmax(log_volumes)), float(log_volumes.max())
            if progress:
                progress(count * (1 + turn) + k + 1, count * (1 + PASSES))
        if best - before < GAINS:
            break
    if progress:
        progress(1, 1)
    own = np.array([*(ZERO,) * len(mechanism.axes), *machine_change_units(mechanism)])
    chosen, even = (
        np.sqrt(np.diag(np.linalg.inv(information.information(some)))[: len(own)]) * own
        for some in (order, list(range(count)))
    )
    return Chosen(mechanism, candidates[order], chosen, even)


def _candidates(calibration: Calibration, design: Design | None, seed: int) -> Floats:
    """Low-discrepancy configurations (n, axes) m or rad; where cameras see a hand, those in which they do.

    Raises RigError where too few are seen
    """
    mechanism = require_watchable_calibrated_machine(calibration)
    looked = design is not None and design.cameras and design.targets and not has_struts(mechanism)
    spread = evenly_spread_configurations(mechanism, SEARCHED if looked else CANDIDATES, FILL, seed)
    if design is None or not looked:
        return spread
    T = calibration.correction.predict(spread)
    markers = marker_map(design.without_stages())
    seen = visible_marker_counts_over_all_cameras(design.cameras, T, markers=markers) >= FEWEST
    if seen.sum() < CANDIDATES / 10:
        raise RigError(
            f"in {seen.sum()} of {len(spread)} configurations within the limits {FEWEST} markers are seen whole: "
            "narrow the limits, or turn the cameras"
        )
    return spread[seen][:CANDIDATES]


@dataclass(frozen=True, slots=True, eq=False)
class _VisitInformation:
    """What poses at candidates (n, axes) m or rad, visited one after the other from start (axes,), tell.

    steady : (n, 6, axes + 8) and turned : (n, 6, axes) as `_columns` gives them
    """

    candidates: Floats
    start: Floats
    steady: Floats
    turned: Floats

    @property
    def before(self) -> Floats:
        """(2 axes + 8,) square information in zeros, play, growth and sag, then the frame, before any pose."""
        return np.diag(np.r_[np.full(2 * len(self.start) + 2, FAINT), 1 / np.repeat(FRAME, 3) ** 2])

    def rows(self, at: Integers, come_from: Floats) -> Floats:
        """(k, 6, 2 axes + 8) whitened columns of zeros, play, growth, sag, frame at candidates `at` (k,), come to from
        (k, axes).
        """
        axes = len(self.start)
        side = np.sign(self.candidates[at] - come_from)[:, None, :]
        return np.concatenate(
            [self.steady[at][..., :axes], -self.turned[at] * side / 2, self.steady[at][..., axes:]], axis=-1
        )

    def information(self, order: list[int]) -> Floats:
        """(2 axes + 8,) square, of the candidates visited in an order."""
        previous = np.concatenate([self.start[None], self.candidates[order[:-1]]])
        rows = self.rows(np.array(order), previous).reshape(-1, len(self.before))
        return np.asarray(rows.T @ rows + self.before)

    def log_volumes(self, order: list[int], k: int) -> Floats:
        """(n,) logarithm of the volume in which changes are known, were each candidate the k-th of the order."""
        n, every = len(self.candidates), np.arange(len(self.candidates))
        retained = [i for i in range(len(order)) if i not in (k, k + 1)]
        before = self.start if k == 0 else self.candidates[order[k - 1]]
        rest = np.array([self.start, *self.candidates[order]])[retained]
        held = self.rows(np.array([order[i] for i in retained], int), rest).reshape(-1, len(self.before))
        new = self.rows(every, np.broadcast_to(before, self.candidates.shape))
        if k + 1 < len(order):
            new = np.concatenate([new, self.rows(np.full(n, order[k + 1]), self.candidates)], axis=1)
        M = np.swapaxes(new, 1, 2) @ new + held.T @ held + self.before
        whole, frame = np.linalg.slogdet(M)[1], np.linalg.slogdet(M[:, -6:, -6:])[1]
        return np.asarray(whole - frame)


def _columns(calibration: Calibration, design: Design | None, candidates: Floats) -> tuple[Floats, Floats]:
    """(n, 6, axes + 8) whitened columns of zeros, growth, sag and the frame's motion, and (n, 6, axes) of the axes per
    GAP.
    """
    mechanism, n = require_watchable_calibrated_machine(calibration), len(candidates)
    T, t = calibration.correction.predict(candidates), np.arange(float(n))
    stated = (
        Design("", DOWN, mechanism, None, Actuator(None, None, None), AT_ORIGIN, (), ()) if design is None else design
    )
    changed = pose_jacobian_by_machine_changes(mechanism, stated, Commands(t, candidates), t, T)[..., -2:]
    axes = covariance_parameters(mechanism).axis_jacobian(candidates, T)
    white = 1 / np.repeat(SIGMAS, 3)[:, None]
    return np.concatenate([axes * ZERO, changed, base_motion_columns(T)], axis=2) * white, axes * GAP * white
