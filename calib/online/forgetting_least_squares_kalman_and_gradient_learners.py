"""Learners: least squares with forgetting, a Kalman filter, and gradient descent.

They learn the 42 parameters pose by pose, and are kept in a JSON file.

They watch for nothing: each says how far a pose was from what it expected, and follows it.
"""

import json
from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.files.mechanism_and_physics_entries import mechanism_dict, mechanism_from_entries
from calib.models.platform import closed_loop_equations
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import PLAUSIBLE
from calib.models.platform.identification import PRIOR
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_entries import LARGEST_RIG
from rig.formats.output_files import write_text
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    geometric_parameters,
    is_hexapod,
    mechanism_with_parameters,
)

NO_SCATTER = np.zeros(6)


class Learner(ABC):
    """nominal : Hexapod; the estimate is `hexapod`; `memory` : what is kept of the poses beside it; `setting` : its one
    choice, named SETTING.

    number : poses so far; data : marks of what was learnt (see rig.recording.frame_selection_and_content_hashes), so
        that it is not learnt again
    """

    SETTING: ClassVar[str]
    setting: float
    memory: Floats

    def __init__(self, nominal: Hexapod) -> None:
        self.nominal, self.p = nominal, geometric_parameters(nominal)
        self.home = np.ascontiguousarray(nominal.home.as_matrix())
        self.number, self.data = 0, set[str]()

    @property
    def covariance(self) -> Floats | None:
        """(42, 42) m^2 of the estimate; None of a learner that keeps none."""
        return None

    @abstractmethod
    def start_from(self, covariance: Floats) -> None:
        """Begin with what a calibration knows. covariance : (42, 42) m^2 of the nominal's parameters"""

    def update(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        """One pose, x (6,) m commanded, covariance (6, 6); returns its whitened error (6,). Raises RigError as `rows`
        does.
        """
        e = self._followed(x, T_base_platform, covariance)
        self.number += 1
        return e

    @abstractmethod
    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        """The estimate follows one pose, as `update` says."""

    @property
    def hexapod(self) -> Hexapod:
        """The Hexapod as estimated now."""
        return mechanism_with_parameters(self.nominal, self.p)

    def rows(self, x: Floats, matrix: Floats, covariance: Floats, p: Floats) -> tuple[Floats, Floats]:
        """Whitened error (6,) and J_p (6, 42) at parameters p. Raises RigError for a command that closes on no pose."""
        R, t = self.home[:3, :3].copy(), self.home[:3, 3].copy()
        right, J = np.empty((6, 1)), np.zeros((6, 42))
        x, covariance = np.asarray(x, float), np.ascontiguousarray(covariance, float)
        measured = closed_loop_equations.Measured(
            np.ascontiguousarray(matrix[:3, :3]), np.ascontiguousarray(matrix[:3, 3]), covariance
        )
        if (
            not closed_loop_equations.forward_kinematics_kernel(x, p, R, t)
            or not closed_loop_equations.whitened_pose_row(R, t, p, measured, NO_SCATTER, right, J)[0]
        ):
            raise RigError(f"the commanded lengths {x.round(6).tolist()} m close on no pose, or covariance is invalid")
        return right[:, 0], J


class Forgetting(Learner):
    """Recursive least squares that forgets only along what a pose tells, so that nothing winds up where nothing excites
    it.

    Its memory is the information (42, 42) 1/m^2. Source: Cao and Schwartz, A directional forgetting algorithm,
    Automatica 36, 2000
    """

    SETTING = "kept"

    def __init__(self, nominal: Hexapod, kept: float = 0.99, prior: float = PRIOR) -> None:
        """kept : share of what was known along a pose's directions that stays; prior : m"""
        super().__init__(nominal)
        if not 0 < kept <= 1:
            raise ValueError(f"kept must be a share above 0 and at most 1, got {kept}")
        self.setting, self.memory = kept, np.eye(42) / prior**2

    @property
    def covariance(self) -> Floats:
        """(42, 42) m^2 of the estimate."""
        return cast(Floats, np.linalg.inv(self.memory))

    def start_from(self, covariance: Floats) -> None:
        """Begin with what a calibration knows. covariance : (42, 42) m^2"""
        self.memory = cast(Floats, np.linalg.inv(covariance))

    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        e, J = self.rows(x, T_base_platform.as_matrix(), covariance, self.p)
        gain_rows = J @ self.memory
        self.memory = (
            self.memory + J.T @ J - (1 - self.setting) * gain_rows.T @ np.linalg.solve(gain_rows @ J.T, gain_rows)
        )
        self.p = self.p + np.linalg.solve(self.memory, J.T @ e)
        return e


class Drifting(Learner):
    """Iterated extended Kalman filter for parameters that wander: a random walk between poses. Its memory is the
    covariance (42, 42) m^2.

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, ch. 10.5
    """

    SETTING = "drift"

    def __init__(self, nominal: Hexapod, drift: float = 1e-7, prior: float = PRIOR, iterations: int = 3) -> None:
        """drift : m per pose by which a parameter wanders, standard deviation; prior : m; iterations : linearisations
        per pose
        """
        super().__init__(nominal)
        if not 0 <= drift < 1:
            raise ValueError(f"drift must be at least 0 m, got {drift}")
        self.setting, self.iterations, self.memory = drift, iterations, np.eye(42) * prior**2

    @property
    def covariance(self) -> Floats:
        """(42, 42) m^2 of the estimate."""
        return self.memory

    def start_from(self, covariance: Floats) -> None:
        """Begin with what a calibration knows. covariance : (42, 42) m^2"""
        self.memory = np.array(covariance)

    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        matrix, before = T_base_platform.as_matrix(), self.p
        P = self.memory + self.setting**2 * np.eye(42)
        p, innovation = before, np.zeros(0)
        for _ in range(self.iterations):
            e, J = self.rows(x, matrix, covariance, p)
            S = J @ P @ J.T + np.eye(6)
            left = e + J @ (p - before)
            if not len(innovation):
                innovation = np.linalg.solve(np.linalg.cholesky(S), left)
            gain = np.linalg.solve(S, J @ P).T
            p, earlier = before + gain @ left, p
            if np.abs(p - earlier).max() < 1e-9:
                break
        keep = np.eye(42) - gain @ J
        self.p, self.memory = p, keep @ P @ keep.T + gain @ gain.T
        return innovation


class FirstOrder(Learner):
    """On-line gradient steps, each coordinate's as long as its gradients so far allow; no matrix is kept, and no
    covariance.

    The regret against the best fixed parameters grows with the root of the number of poses. Its memory is the sum (42,)
    of the gradients' squares. Source: Duchi, Hazan and Singer, Adaptive subgradient methods, JMLR 12, 2011
    """

    SETTING = "step"

    def __init__(self, nominal: Hexapod, step: float = PLAUSIBLE) -> None:
        """step : m, how far a parameter may plausibly have to go"""
        super().__init__(nominal)
        if not 0 < step < 1:
            raise ValueError(f"step must be above 0 m, got {step}")
        self.setting, self.memory = step, np.zeros(42)

    def start_from(self, covariance: Floats) -> None:
        """Begin with what a calibration knows: steps no longer than that is uncertain. covariance : (42, 42) m^2"""
        self.setting = min(self.setting, float(np.sqrt(np.mean(np.diag(covariance)))))

    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        e, J = self.rows(x, T_base_platform.as_matrix(), covariance, self.p)
        gradient = -J.T @ e
        self.memory = self.memory + gradient**2
        self.p = self.p - self.setting * gradient / np.sqrt(np.maximum(self.memory, 1e-300))
        return e


LEARNERS: dict[str, type[Forgetting | Drifting | FirstOrder]] = {
    "forgetting": Forgetting,
    "drifting": Drifting,
    "first-order": FirstOrder,
}

SCHEMA = "learner/1"


def save_learner(path: Path | str, learner: Learner) -> None:
    """Save a Learner to a file, whole or not at all."""
    name = next(name for name, kind in LEARNERS.items() if type(learner) is kind)
    tree = {
        "schema": SCHEMA,
        "learner": name,
        learner.SETTING: learner.setting,
        "nominal": mechanism_dict(learner.nominal),
        "p": learner.p.tolist(),
        "memory": learner.memory.tolist(),
        "number": learner.number,
        "data": sorted(learner.data),
    }
    write_text(path, json.dumps(tree) + "\n")


def load_learner(path: Path | str) -> Learner:
    """Load a Learner from its file.

    Raises FileError for a file that is missing, cut off or of another kind.
    """
    tree = json_toml_and_yaml_loading.load_json(Path(path), "state of a learner", SCHEMA)
    kind = LEARNERS[tree.text("learner", tuple(LEARNERS))]
    nominal = mechanism_from_entries(tree.table("nominal"))
    if not is_hexapod(nominal):
        tree.fail("nominal is not a hexapod", "nominal")
    try:
        learner = kind(nominal, tree.number(kind.SETTING))
    except ValueError as error:
        tree.fail(str(error), kind.SETTING)
    learner.p, learner.memory = (
        tree.array("p", (42,), length_limit=LARGEST_RIG),
        tree.array("memory", learner.memory.shape),
    )
    learner.number, learner.data = tree.whole("number", 0), set(tree.texts("data"))
    return learner
