"""Learners: least squares with forgetting, a Kalman filter, and gradient descent.

They learn the parameters of any machine pose by pose, and are kept in a JSON file.

They watch for nothing: each says how far a pose was from what it expected, and follows it.
"""

import json
from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.files.mechanism_and_physics_entries import mechanism_dict, mechanism_from_entries
from calib.models.calibration_covariance_parameters import covariance_parameters
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import PLAUSIBLE
from rig.array_and_json_types import Floats
from rig.errors import RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG
from rig.formats.output_files import write_text
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded, has_axes, kinematics_of, require_axes
from rig.model.pose import pose_difference


class Learner(ABC):
    """nominal : the mechanism that it starts from; the estimate is `mechanism`; p : (p,) its parameters, as
    calib.models.calibration_covariance_parameters counts them; free : indices of the f that are learnt; `memory` :
    what is kept of the poses beside it; `setting` : its one choice, named SETTING.

    number : poses so far; data : marks of what was learnt (see rig.recording.frame_selection_and_content_hashes), so
        that it is not learnt again
    """

    SETTING: ClassVar[str]
    setting: float
    memory: Floats

    def __init__(self, nominal: Commanded) -> None:
        self.nominal, self.parameters = nominal, covariance_parameters(nominal)
        self.p, self.free = self.parameters.values, np.flatnonzero(self.parameters.tolerance)
        self.number, self.data = 0, set[str]()

    @property
    def covariance(self) -> Floats | None:
        """(f, f) of the estimate of what is free; None of a learner that keeps none."""
        return None

    def start_from(self, covariance: Floats) -> None:
        """Begin with what a calibration knows; what it did not fit is held. covariance : (p, p) of the nominal's
        parameters
        """
        self.free = np.flatnonzero((self.parameters.tolerance > 0) & (np.diag(covariance) > 0))
        self._begin(covariance[np.ix_(self.free, self.free)])

    @property
    def scale(self) -> Floats:
        """(f,) m or rad of one count of what is free."""
        return self.parameters.scale[self.free]

    @abstractmethod
    def _begin(self, covariance: Floats) -> None:
        """Forget all poses. covariance : (f, f) of what is free"""

    def update(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        """One pose, x (axes,) commanded, covariance (6, 6); returns its whitened error (k,). Raises RigError as `rows`
        does.
        """
        e = self._followed(x, T_base_platform, covariance)
        self.number += 1
        return e

    @abstractmethod
    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        """The estimate follows one pose, as `update` says."""

    @property
    def mechanism(self) -> Commanded:
        """The mechanism as estimated now."""
        return require_axes(self.parameters.with_values(self.p))

    def rows(self, x: Floats, T: RigidTransform, covariance: Floats, p: Floats) -> tuple[Floats, Floats]:
        """Whitened error (k,) of the k coordinates of a pose that were measured and J (k, f) at parameters p.

        covariance : (6, 6), infinite of what was not measured, 0 of what no axis moves
        Raises RigError for a command that closes on no pose, and an invalid covariance
        """
        x, mechanism = np.asarray(x, float), require_axes(self.parameters.with_values(p))
        variance = np.diag(covariance)
        seen = np.flatnonzero((variance != 0) & np.isfinite(variance))
        try:
            predicted = kinematics_of(mechanism).forward(x, mechanism)
            half = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(seen, seen)]))
        except (RigError, np.linalg.LinAlgError):
            raise RigError(f"the command {x.round(6).tolist()} closes on no pose, or covariance is invalid") from None
        at = RigidTransform.from_matrix(predicted.as_matrix()[None])
        J = covariance_parameters(mechanism).jacobian(x[None], at)[0][np.ix_(seen, self.free)]
        return half @ pose_difference(predicted, T)[seen], half @ J

    def _stepped(self, step: Floats) -> Floats:
        """(p,) the parameters, what is free changed by a step (f,)."""
        p = self.p.copy()
        p[self.free] += step
        return p


class Forgetting(Learner):
    """Recursive least squares that forgets only along what a pose tells, so that nothing winds up where nothing excites
    it.

    Its memory is the information (f, f). Source: Cao and Schwartz, A directional forgetting algorithm,
    Automatica 36, 2000
    """

    SETTING = "kept"

    def __init__(self, nominal: Commanded, kept: float = 0.99) -> None:
        """kept : share of what was known along a pose's directions that stays"""
        super().__init__(nominal)
        if not 0 < kept <= 1:
            raise ValueError(f"kept must be a share above 0 and at most 1, got {kept}")
        self.setting, self.memory = kept, np.diag(self.parameters.tolerance[self.free] ** -2)

    @property
    def covariance(self) -> Floats:
        """(f, f) of the estimate."""
        return cast(Floats, np.linalg.inv(self.memory))

    def _begin(self, covariance: Floats) -> None:
        self.memory = cast(Floats, np.linalg.inv(covariance))

    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        e, J = self.rows(x, T_base_platform, covariance, self.p)
        gain_rows = J @ self.memory
        self.memory = (
            self.memory + J.T @ J - (1 - self.setting) * gain_rows.T @ np.linalg.solve(gain_rows @ J.T, gain_rows)
        )
        self.p = self._stepped(cast(Floats, np.linalg.solve(self.memory, J.T @ e)))
        return e


class Drifting(Learner):
    """Iterated extended Kalman filter for parameters that wander: a random walk between poses. Its memory is the
    covariance (f, f).

    Source: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, ch. 10.5
    """

    SETTING = "drift"

    def __init__(self, nominal: Commanded, drift: float = 1e-7, iterations: int = 3) -> None:
        """drift : m or rad per pose by which a parameter wanders, standard deviation; iterations : linearisations per
        pose
        """
        super().__init__(nominal)
        if not 0 <= drift < 1:
            raise ValueError(f"drift must be at least 0 m, got {drift}")
        self.setting, self.iterations = drift, iterations
        self.memory = np.diag(self.parameters.tolerance[self.free] ** 2)

    @property
    def covariance(self) -> Floats:
        """(f, f) of the estimate."""
        return self.memory

    def _begin(self, covariance: Floats) -> None:
        self.memory = np.array(covariance)

    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        unit = np.eye(len(self.free))
        P = self.memory + np.diag((self.setting / self.scale) ** 2)
        step, innovation = np.zeros(len(self.free)), np.zeros(0)
        for _ in range(self.iterations):
            e, J = self.rows(x, T_base_platform, covariance, self._stepped(step))
            S = J @ P @ J.T + np.eye(len(e))
            left = e + J @ step
            if not len(innovation):
                innovation = np.linalg.solve(np.linalg.cholesky(S), left)
            gain = np.linalg.solve(S, J @ P).T
            step, earlier = gain @ left, step
            if np.abs(step - earlier).max() < 1e-9:
                break
        keep = unit - gain @ J
        self.p, self.memory = self._stepped(step), keep @ P @ keep.T + gain @ gain.T
        return innovation


class FirstOrder(Learner):
    """On-line gradient steps, each coordinate's as long as its gradients so far allow; no matrix is kept, and no
    covariance.

    The regret against the best fixed parameters grows with the root of the number of poses. Its memory is the sum (f,)
    of the gradients' squares. Source: Duchi, Hazan and Singer, Adaptive subgradient methods, JMLR 12, 2011
    """

    SETTING = "step"

    def __init__(self, nominal: Commanded, step: float = PLAUSIBLE) -> None:
        """step : m or rad, how far a parameter may plausibly have to go"""
        super().__init__(nominal)
        if not 0 < step < 1:
            raise ValueError(f"step must be above 0 m, got {step}")
        self.setting, self.memory = step, np.zeros(len(self.free))

    def _begin(self, covariance: Floats) -> None:
        self.memory = np.zeros(len(self.free))  # steps no longer than what is known is uncertain
        self.setting = min(self.setting, float(np.sqrt(np.mean(np.diag(covariance) * self.scale**2))))

    def _followed(self, x: Floats, T_base_platform: RigidTransform, covariance: Floats) -> Floats:
        e, J = self.rows(x, T_base_platform, covariance, self.p)
        gradient = -J.T @ e
        self.memory = self.memory + gradient**2
        self.p = self._stepped(-self.setting / self.scale * gradient / np.sqrt(np.maximum(self.memory, 1e-300)))
        return e


LEARNERS: dict[str, type[Forgetting | Drifting | FirstOrder]] = {
    "forgetting": Forgetting,
    "drifting": Drifting,
    "first-order": FirstOrder,
}

SCHEMA = "learner/1"


def save_learner(path: Path | str, learner: Learner) -> None:
    """Save a Learner to a file.

    It is written whole or not at all.
    """
    name = next(name for name, kind in LEARNERS.items() if type(learner) is kind)
    tree = {
        "schema": SCHEMA,
        "learner": name,
        learner.SETTING: learner.setting,
        "nominal": mechanism_dict(learner.nominal),
        "p": learner.p.tolist(),
        "free": learner.free.tolist(),
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
    if not has_axes(nominal):
        tree.fail("nominal has no axes", "nominal")
    try:
        learner = kind(nominal, tree.number(kind.SETTING))
    except ValueError as error:
        tree.fail(str(error), kind.SETTING)
    if "free" in tree.tree:  # states of before others than hexapods were learnt have all
        learner.free = np.array(tree.wholes("free"), int)
    if len(learner.free) and learner.free.max() >= len(learner.p):
        tree.fail(f"free has the index {learner.free.max()} of {len(learner.p)} parameters", "free")
    count = len(learner.free)
    learner.p = tree.array("p", learner.p.shape, length_limit=LARGEST_RIG)
    learner.memory = tree.array("memory", (count,) * learner.memory.ndim)
    learner.number, learner.data = tree.whole("number", 0), set(tree.texts("data"))
    return learner
