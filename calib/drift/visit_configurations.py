"""Configurations of a visit.

They are chosen and ordered to show and separate changes of the machine.

D-optimal for the zeros, the nuts, growth and sag together, whatever the frame of measurement does meanwhile; a nut
shows by the side from which its strut came, so the order is chosen with the places.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.drift.visit_equations_and_reference import (
    AT_ORIGIN,
    GAP,
    OWN,
    UNITS,
    base_motion_columns,
    fitted_hexapod,
    machine_change_columns,
)
from calib.models.platform.identification import pose_parameter_jacobian
from calib.models.platform.optimal_calibration_poses import configurations_outside_exclusion
from calib.workspace.workspace_map_and_lost_poses import is_pose_lost
from rig.array_and_json_types import Floats, Integers
from rig.errors import RigError
from rig.model.design import Actuator, Design
from rig.planning import configuration_generators
from rig.recording.recording_folder import Commands

CANDIDATES = 400
FILL = 0.8  # of the strokes: farther out fewer cameras see the platform's targets
SIGMAS = (1e-5, 5e-5)  # m, rad; of a measured pose
LEAST = 4  # poses of a visit
PASSES = 4  # of exchanging
GAINS = 1e-3  # of the logarithm of the volume, below which a pass was the last
FAINT = 1e-3  # information in a change before any visit, per unit squared: only conditions the first poses
ZERO = 1e-4  # m, unit of the zeros' columns
FRAME = (1e-2, 1e-2)  # m, rad; how far the frame of measurement may move meanwhile
BEFORE = np.diag(
    np.r_[np.full(14, FAINT), 1 / np.repeat(FRAME, 3) ** 2]
)  # (20, 20) information in changes, then the frame
DOWN = np.array([0.0, 0.0, -9.80665])  # m/s^2, where no rig.toml says otherwise


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """commands : (n, 6) m in order; sigma, even : (14,) standard errors of a visit in own units, and of as many evenly
    spread.
    """

    commands: Floats
    sigma: Floats
    even: Floats

    def expected_accuracy(self) -> list[tuple[str, float, float, str]]:
        """[(name, standard error, that of evenly spread poses, unit)] of what may change; of the struts the worst
        one.
        """
        out = []
        for name, rows, scale, unit in (
            ("a strut's zero", slice(0, 6), 1e6, "um"),
            ("a strut's nut", slice(6, 12), 1e6, "um"),
            (OWN[6], slice(12, 13), 1e6, "um/m"),
            (OWN[7], slice(13, 14), 1e6, "kg/(N/um)"),
        ):
            out.append((name, float(self.sigma[rows].max() * scale), float(self.even[rows].max() * scale), unit))
        return out


def choose_visit_configurations(
    calibration: Calibration,
    design: Design | None,
    count: int,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Chosen:
    """Choose the configurations of a visit of a calibrated hexapod.

    design : whose platform and gravity tell loads, or None; progress : called with (done, of)
    Raises RigError for another mechanism or too few poses
    """
    mechanism = fitted_hexapod(calibration)
    if not LEAST <= count <= CANDIDATES:
        raise RigError(f"--count takes {LEAST} to {CANDIDATES} poses, got {count}")
    candidates = configurations_outside_exclusion(
        configuration_generators.sobol_configurations(mechanism.strut_range, CANDIDATES, FILL, seed),
        lambda c: is_pose_lost(calibration.correction, c),
    )
    information = _VisitInformation(
        candidates, mechanism.strut_range.mean(axis=1), *_columns(calibration, design, candidates)
    )
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
    return Chosen(
        candidates[order], _sigma(information.information(order)), _sigma(information.information(list(range(count))))
    )


@dataclass(frozen=True, slots=True, eq=False)
class _VisitInformation:
    """What poses at candidates (n, 6) m, visited one after the other from start (6,) m, tell. steady : (n, 6, 14) and
    turned : (n, 6, 6) as `_columns` gives them."""

    candidates: Floats
    start: Floats
    steady: Floats
    turned: Floats

    def rows(self, at: Integers, come_from: Floats) -> Floats:
        """(k, 6, 20) whitened columns of zeros, nuts, growth, sag, frame at candidates `at` (k,), come to from (k, 6)
        m.
        """
        side = np.sign(self.candidates[at] - come_from)[:, None, :]
        return np.concatenate(
            [self.steady[at][..., :6], -self.turned[at] * side / 2, self.steady[at][..., 6:]], axis=-1
        )

    def information(self, order: list[int]) -> Floats:
        """(20, 20) of the candidates visited in an order."""
        previous = np.concatenate([self.start[None], self.candidates[order[:-1]]])
        rows = self.rows(np.array(order), previous).reshape(-1, 20)
        return np.asarray(rows.T @ rows + BEFORE)

    def log_volumes(self, order: list[int], k: int) -> Floats:
        """(n,) logarithm of the volume in which changes are known, were each candidate the k-th of the order."""
        n, every = len(self.candidates), np.arange(len(self.candidates))
        retained = [i for i in range(len(order)) if i not in (k, k + 1)]
        before = self.start if k == 0 else self.candidates[order[k - 1]]
        rest = np.array([self.start, *self.candidates[order]])[retained]
        held = self.rows(np.array([order[i] for i in retained], int), rest).reshape(-1, 20)
        new = self.rows(every, np.broadcast_to(before, (n, 6)))
        if k + 1 < len(order):
            new = np.concatenate([new, self.rows(np.full(n, order[k + 1]), self.candidates)], axis=1)
        M = np.swapaxes(new, 1, 2) @ new + held.T @ held + BEFORE
        whole, frame = np.linalg.slogdet(M)[1], np.linalg.slogdet(M[:, 14:, 14:])[1]
        return np.asarray(whole - frame)


def _sigma(M: Floats) -> Floats:
    """(14,) standard errors in own units of information M in what changes, then the frame."""
    own = np.array([*(ZERO,) * 6, *UNITS])
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(M))[:14]) * own)


def _columns(calibration: Calibration, design: Design | None, candidates: Floats) -> tuple[Floats, Floats]:
    """(n, 6, 14) whitened columns of zeros, growth, sag and the frame's motion, and (n, 6, 6) of the struts' lengths
    per GAP.
    """
    mechanism, n = fitted_hexapod(calibration), len(candidates)
    T, t = calibration.correction.predict(candidates), np.arange(float(n))
    stated = (
        Design("", DOWN, mechanism, None, Actuator(None, None, None), AT_ORIGIN, (), ()) if design is None else design
    )
    changed = machine_change_columns(mechanism, stated, Commands(t, candidates), t, T)[..., 6:]
    zeros = pose_parameter_jacobian(T, mechanism)[..., 36:]
    white = 1 / np.repeat(SIGMAS, 3)[:, None]
    return np.concatenate([zeros * ZERO, changed, base_motion_columns(T)], axis=2) * white, zeros * GAP * white
