"""Steps of the forward solution of a mechanism.

Of a hexapod or of a kinematics file: each iteration's matrix, unknowns and pose.
The scheme is the same for all: from a start, the linear equations B x = b are set up and solved, what x says is moved,
until x is small. b is what the axes miss, B their change with the pose, x the move of the platform.
"""

from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Floats
from rig.errors import NotConverged, RigError
from rig.model.mechanism_geometry_classes import FileMechanism, Hexapod
from rig.model.mechanisms import hexapod_newton_and_least_squares_forward_solution
from rig.model.mechanisms import user_kinematics_file_mechanism as file_mechanism
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, is_redundant
from rig.model.user_kinematics_file import FREEDOMS


@dataclass(frozen=True, slots=True, eq=False)
class SolutionStep:
    """One iteration. pose : (4, 4) T_base_platform before it; B : (axes, k) change of the axes with the unknowns, m or
    rad of an axis by m or rad; b : (axes,) wanted less present axis values; x : (k,) m and rad, the step that was made,
    shortened where it was long
    """

    pose: Floats
    B: Floats
    b: Floats
    x: Floats


def unknowns(mechanism: Hexapod | FileMechanism) -> tuple[tuple[str, ...], str]:
    """Names of the unknowns x of a forward solution, and their frame, "platform" or "base"."""
    if isinstance(mechanism, Hexapod):
        return FREEDOMS, "platform"
    return tuple(FREEDOMS[k] for k in mechanism.pose_coordinates), "base"


def forward_solution_steps(
    values: Floats, mechanism: Mechanism
) -> tuple[Hexapod | FileMechanism, tuple[SolutionStep, ...]]:
    """Steps of the forward solution for axis values (axes,) m or rad, and the mechanism.

    From home to their pose, as far as they went.
    A hexapod's are those with pivots, which stand behind the compiled ones. A kinematics file's solve its `inverse`,
    also where it states a `forward`.
    Raises RigError for a kind whose pose follows from its axes by a formula, so that nothing is iterated
    """
    if not isinstance(mechanism, Hexapod | FileMechanism):
        raise RigError(
            f"the forward kinematics of a mechanism of kind {mechanism.kind!r} is a formula: nothing is iterated, so "
            "--trace has nothing to print; an arm's --steps prints its joints one after the other"
        )
    steps: list[SolutionStep] = []

    def observe(poses: Floats, B: Floats, b: Floats, x: Floats) -> None:
        steps.append(SolutionStep(poses[0].copy(), B[0].copy(), b[0].copy(), x[0].copy()))

    try:
        if isinstance(mechanism, FileMechanism):
            file_mechanism.solve_poses_by_newton_with_file_inverse(
                mechanism.stated.home[None], values[None], mechanism, observe
            )
        elif is_redundant(mechanism):
            lengths = values[None] + mechanism.strut_zeros
            hexapod_newton_and_least_squares_forward_solution.poses_of_redundant_lengths_by_gauss_newton(
                values[None], lengths, mechanism.home, mechanism, observe
            )
        else:
            start = np.array(mechanism.home.as_matrix()[None])
            hexapod_newton_and_least_squares_forward_solution.solve_poses_in_place_by_pivoted_newton(
                start, values[None] + mechanism.strut_zeros, mechanism, observe
            )
    except NotConverged:  # its steps are what is asked for; that they lead nowhere is for `forward` to say
        pass
    return mechanism, tuple(steps)
