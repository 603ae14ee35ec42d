"""Kinematics of a platform, nominal and calibrated: poses of axis values, axis values of poses.

It is of a platform on struts, or of a kinematics file.

The iterations of the forward solution are given on request.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.machine_correction import Correction
from rig.array_and_json_types import Floats, Integers, Json
from rig.errors import NotConverged, RigError, Unreachable
from rig.model import mechanisms
from rig.model.mechanisms.forward_solution_steps import SolutionStep, forward_solution_steps, unknowns
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    axis_place_texts,
    axis_units,
    nearest_reachable_poses,
    strut_or_axis_jacobian_by_pose,
)
from rig.model.pose import pose_difference, pose_to_vector


@dataclass(frozen=True, slots=True, eq=False)
class PlatformKinematics:
    """platform : as its owner believes it; correction : of its calibration, or None; left_out : what of the calibration
    this leaves out, a sentence, or None
    """

    platform: Parallel
    correction: Correction[Any, Any] | None = None
    left_out: str | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes, as a table of values heads its columns."""
        return self.platform.axes

    def forward(self, frames: Integers, q: Floats, steps: bool = False, trace: bool = False) -> Json:
        """Poses that axis values q (n, axes) m or rad give, as `rig arm kinematics --forward --json` prints them.

        frames : (n,) their numbers; trace : whether the iterations of each solution are given
        Raises RigError for steps, which are an arm's
        """
        if steps:
            raise RigError(
                f"--steps moves an arm's joints one after the other; a {self.platform.kind} takes --trace, which "
                "prints the iterations of its forward kinematics"
            )
        kinematics, out = mechanisms.kinematics_of(self.platform), []
        beyond = kinematics.signed_limit_excess(q, self.platform)
        for frame, values, excess in zip(frames.tolist(), q, beyond):
            entry: Json = {
                "frame": frame,
                "q": values.tolist(),
                "beyond_limits": [p for p, b in zip(axis_place_texts(self.platform), excess) if b],
            }
            try:
                T = kinematics.forward(values, self.platform)
            except NotConverged as error:
                entry |= {"pose": None, "refused": str(error)}
            else:
                entry |= {"pose": pose_to_vector(T).tolist(), "near_singular": _near_singular(T, self.platform)}
                if self.correction is not None:
                    entry |= self._corrected(values)
            out.append(entry | (self._trace(values) if trace else {}))
        return {"schema": "kinematics/1", "units": list(axis_units(self.platform)), "frames": out}

    def inverse(self, frames: Integers, T_base_platform: RigidTransform, steps: bool = False) -> Json:
        """Axis values of poses (n,), as `rig arm kinematics --inverse --json` prints them.

        Raises RigError for steps, which are an arm's, and for a calibration, whose commands `rig correct` writes
        """
        if steps:
            raise RigError(f"--steps moves an arm's joints one after the other; a {self.platform.kind} has none")
        if self.correction is not None:
            raise RigError("rig correct writes the commands of wanted poses by a calibration; give the rig.toml here")
        kinematics, out = mechanisms.kinematics_of(self.platform), []
        for frame, T in zip(frames.tolist(), T_base_platform):
            found, state = [], "regular"
            try:
                q = kinematics.inverse(T, self.platform)
            except Unreachable as error:
                state = str(error)
            else:
                excess = kinematics.signed_limit_excess(q, self.platform)
                beyond = [p for p, b in zip(axis_place_texts(self.platform), excess) if b]
                rest = pose_difference(T, nearest_reachable_poses(T, self.platform))
                found = [{"q": q.tolist(), "singular": "", "rest": rest.tolist(), "beyond_limits": beyond}]
            out.append({"frame": frame, "state": state, "solutions": found})
        return {
            "schema": "kinematics/1",
            "units": list(axis_units(self.platform)),
            "form": "each axis by an equation of its own",
            "frames": out,
        }

    def _corrected(self, values: Floats) -> Json:
        """The pose of axis values (axes,) as calibrated, or why there is none."""
        assert self.correction is not None
        try:
            return {"corrected": pose_to_vector(self.correction.predict(values)).tolist()}
        except NotConverged as error:
            return {"corrected": None, "refused": str(error)}

    def _trace(self, values: Floats) -> Json:
        mechanism, steps = forward_solution_steps(values, self.platform)
        names, frame = unknowns(mechanism)
        return {"unknowns": list(names), "along": frame, "trace": [_step(k + 1, step) for k, step in enumerate(steps)]}


def _step(number: int, step: SolutionStep) -> Json:
    """One iteration as JSON; a number that the kinematics file does not give is null."""
    pose = pose_to_vector(RigidTransform.from_matrix(step.pose))
    return {
        "iteration": number,
        "pose": pose.tolist(),
        "B": [[_finite(one) for one in row] for row in step.B.tolist()],
        "b": [_finite(one) for one in step.b.tolist()],
        "x": step.x.tolist(),
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _near_singular(T: RigidTransform, platform: Parallel) -> float:
    """Least over greatest singular value of the Jacobian, over the coordinates of a pose that the platform changes."""
    values = np.linalg.svd(strut_or_axis_jacobian_by_pose(T, platform), compute_uv=False)
    return float(values[len(platform.pose_coordinates) - 1] / values[0])
