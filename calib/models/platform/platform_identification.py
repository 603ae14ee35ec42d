"""Identification of a platform's geometry.

Joint positions and strut zeros, from measured poses.

Each strut closes a vector loop: commanded length + zero = |R a + t - b|. The measured pose less the one that the loops
predict is weighted by the poses' covariance; the errors that all poses share (cameras and lenses) are solved for
together with the parameters, so that the struts' known lengths steady the cameras. Source: Masory, Wang and Zhuang, On
the accuracy of a Stewart platform, ICRA 1993 (the loop); the shared errors as nuisance parameters are the linear form
of one solve of cameras, lenses and geometry (calib/correction/simultaneous_camera_and_geometry_fit.py). A hexapod has
42 parameters, two struts in a plane have 6.
"""

from dataclasses import dataclass
from typing import cast

import numpy as np
import scipy
from scipy.spatial.transform import RigidTransform

from calib.identify.bounded_and_robust_least_squares_fit import MOST, Fit, Linear, fit_least_squares, robust_fit
from calib.models.platform import strut_loop_closure_equations
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats
from rig.errors import NotEnoughData, RigError
from rig.model import mechanisms
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms import hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    geometric_parameters,
    is_redundant,
    loop_closure_parameter_jacobian,
    mechanism_with_parameters,
    strut_or_axis_jacobian_by_pose,
)

PRIOR = 5e-3  # m; how far a joint or a zero may be from where its owner states it: ten times what rigs show
ROUNDS = 8  # of weighing struts and poses anew; one that still wavers then remains unchanged
LEAST = 7  # poses from which struts may scatter, and on which a geometry must stand where there are so many
GATE = 6.0  # standard deviations of one strut's closure beyond which a pose is left out
ROWS = 4  # poses for each parameter of a strut's loop, from which a robust start is taken
EXCESS = 3.0  # standard deviations of chance that scatter must exceed before it counts as the struts'


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What a fit of a machine on struts found, its p parameters as in `geometric_parameters` (42 of a hexapod).

    mechanism : with the fitted geometry; covariance : (p, p) m^2; shared : (k,) the draw of the poses'
    shared errors; root : (p, p) 1/m, square root of the information in the poses alone
    residuals : (n, axes) m, what each strut's loop leaves once the shared errors are taken out; their covariance : (n,
        axes, axes) m^2
    scatter : (axes,) m, scatter of each strut beyond the poses' own; inliers : (n,) bool
    prior : (p,) m, standard deviation that the owner's figures were given; cost : whitened squares of data, shared draw
        and prior
    """

    mechanism: Parallel
    covariance: Floats
    shared: Floats
    root: Floats
    residuals: Floats
    residual_covariance: Floats
    scatter: Floats
    inliers: Booleans
    prior: Floats
    cost: float


def identify_platform(
    samples: Samples,
    nominal: Parallel,
    strut_deviations: Floats | None = None,
    prior: Floats | None = None,
    similar_fit: Identified | None = None,
) -> Identified:
    """Identified platform.

    Joint positions and strut zeros that explain the poses, docs/mathematics.md (7).
    samples : Samples; nominal : where the fit starts and where its prior holds what the poses do not tell
    similar_fit : Identified of nearly the same, to start from instead: the same optimum in fewer steps
    strut_deviations : (n, axes) m or None, known deviations of the struts (commanded less effective), taken off the
        commands first
    prior : (p,) m, standard deviation that the owner's figures are given, 5 mm each by default
    Returns Identified. Raises NotEnoughData where too few poses agree, RigError where the fit does not settle.
    """
    require_followers_of_redundant_platform(nominal)
    lengths = samples.effective - (0 if strut_deviations is None else strut_deviations)
    p = geometric_parameters(nominal if similar_fit is None else similar_fit.mechanism)
    prior = np.full(len(p), PRIOR) if prior is None else np.asarray(prior, float)
    loops = Loops(samples, lengths, nominal, prior)
    inliers, spent = np.ones(len(samples), bool), len(p) // len(nominal.axes)
    scatter = np.zeros(len(nominal.axes)) if similar_fit is None else similar_fit.scatter
    for turn in range(ROUNDS):
        try:
            found = loops.fit(p, inliers, scatter)
        except RigError:
            # wild poses may lead where no loop closes; a start without them leaves out what a few poses alone show as
            # well
            inliers = loops.agreeing(p)
            if turn or inliers.all():
                raise
            found = loops.fit(p, inliers, scatter)
        p = found.parameters
        left, S = loops.closure(found)
        new_scatter = (
            strut_loop_closure_equations.scatter_of_redundant_struts(
                left[inliers], loops.jacobian(found)[inliers], spent
            )
            if is_redundant(nominal)
            else _scatter(left, S, inliers, spent)
        )
        new_inliers = _inliers(left, S, scatter)
        if new_inliers.sum() < min(LEAST, len(samples) / 2):
            raise NotEnoughData(f"only {new_inliers.sum()} of {len(samples)} poses agree with one geometry")
        if (new_inliers == inliers).all() and np.abs(new_scatter - scatter).max() < 1e-9:
            break
        inliers, scatter = new_inliers, new_scatter
    return Identified(
        mechanism_with_parameters(nominal, p),
        found.covariance,
        found.shared,
        found.root,
        left,
        S,
        scatter,
        inliers,
        prior,
        found.cost,
    )


class Loops:
    """The samples of a machine as a problem of least squares, for given weights; keeps the predicted poses to start
    from again.
    """

    def __init__(self, samples: Samples, lengths: Floats, nominal: Parallel, prior: Floats) -> None:
        """samples : Samples; lengths : (n, axes) m, commanded; nominal : the prior's middle; prior : (p,) m, its
        width
        """
        self.prior, self.samples, self.lengths, self.nominal = (
            prior,
            samples,
            np.ascontiguousarray(lengths, float),
            nominal,
        )
        measured = samples.T_base_platform.as_matrix()
        self.measured = strut_loop_closure_equations.Measured(
            *(
                np.ascontiguousarray(part, float)
                for part in (measured[:, :3, :3], measured[:, :3, 3], samples.covariance)
            )
        )
        home = (nominal.home if isinstance(nominal, Hexapod) else RigidTransform.identity()).as_matrix()
        self.R, self.t = np.tile(home[:3, :3], (len(samples), 1, 1)), np.tile(home[:3, 3], (len(samples), 1))

    def fit(self, start: Floats, inliers: Booleans, scatter: Floats) -> Fit:
        """Fit from parameters start (p,). inliers : (n,) bool; scatter : (axes,) m"""
        return fit_least_squares(
            lambda p: self.linearise(p, scatter), start, geometric_parameters(self.nominal), self.prior, inliers=inliers
        )

    def linearise(self, p: Floats, scatter: Floats) -> Linear:
        """Linear at parameters p (p,). Raises RigError naming the first pose that has no solution
        there.
        """
        common = self.samples.common
        if is_redundant(self.nominal):
            return strut_loop_closure_equations.linearised_loops_of_more_than_six_struts(
                self.samples, self.lengths, mechanism_with_parameters(self.nominal, p), scatter
            )
        if not isinstance(self.nominal, Hexapod):
            return strut_loop_closure_equations.linearised_pose_coordinate_equations(
                self.samples, self.lengths, mechanism_with_parameters(self.nominal, p), scatter
            )
        right, J = np.empty((len(self.lengths), 6, 1 + common.shape[2])), np.zeros((len(self.lengths), 6, 42))
        right[..., 1:] = common
        bad = strut_loop_closure_equations.fill_whitened_rows_of_all_poses(
            self.lengths, self.R, self.t, p, self.measured, scatter**2, right, J
        )
        if bad >= 0:
            raise RigError(
                f"frame {self.samples.frame[bad]}: the commanded lengths "
                f"{self.lengths[bad].round(6).tolist()} m close on no pose, "
                "or covariance is invalid"
            )
        return Linear(right[..., 0], J, right[..., 1:])

    def agreeing(self, p: Floats) -> Booleans:
        """(n,) bool, poses that a robust fit of each strut's loop about parameters p (p,) does not find far off, from
        which a fit may start; all where poses are too few for that, or too many are far off. What parameters may do is
        asked at the poses that commands give, of which none is wild. Raises NotConverged for commands that no pose
        closes."""
        T, geometry, every = (
            self.samples.T_base_platform,
            mechanism_with_parameters(self.nominal, p),
            np.ones(len(self.lengths), bool),
        )
        commanded = mechanisms.kinematics_of(geometry).forward(self.lengths, geometry)
        A, loops = (
            strut_or_axis_jacobian_by_pose(commanded, geometry),
            loop_closure_parameter_jacobian(commanded, geometry),
        )
        left = self.lengths - mechanisms.kinematics_of(geometry).inverse(T, geometry)
        sigma = np.sqrt(np.einsum("nii->ni", strut_loop_closure_equations.loop_covariance(A, self.samples.covariance)))
        own = [loops[:, i, loops[:, i].any(axis=0)] for i in range(left.shape[1])]
        if len(every) < ROWS * max(columns.shape[1] for columns in own):
            return every
        found = robust_fit(
            [
                ((left[:, i] / sigma[:, i])[:, None], (columns / sigma[:, i, None])[:, None])
                for i, columns in enumerate(own)
            ]
        )
        near = (np.abs(found.residual) < GATE * np.maximum(1.0, found.scale)).all(axis=1)
        return cast(Booleans, near if (~near).mean() <= MOST else every)

    def closure(self, found: Fit) -> tuple[Floats, Floats]:
        """(n, axes) m what each strut's loop leaves at the fit, shared errors taken out, and its covariance (n, axes,
        axes) m^2 from the poses'.
        """
        T, geometry = self.samples.T_base_platform, mechanism_with_parameters(self.nominal, found.parameters)
        A = strut_or_axis_jacobian_by_pose(T, geometry)
        left = (
            self.lengths
            - mechanisms.kinematics_of(geometry).inverse(T, geometry)
            + np.einsum("nij,njk,k->ni", A, self.samples.common, found.shared)
        )
        return left, strut_loop_closure_equations.loop_covariance(A, self.samples.covariance)

    def jacobian(self, found: Fit) -> Floats:
        """(n, axes, 6) the struts' Jacobian at the measured poses, of the geometry fitted."""
        return strut_or_axis_jacobian_by_pose(
            self.samples.T_base_platform, mechanism_with_parameters(self.nominal, found.parameters)
        )


def inverse_strut_length_jacobian(T_base_platform: RigidTransform, mechanism: Parallel) -> Floats:
    """Inverse strut length Jacobian (..., 6, axes).

    Change of the pose's tangent with strut lengths.
    """
    A = strut_or_axis_jacobian_by_pose(T_base_platform, mechanism)
    return cast(Floats, np.linalg.inv(A) if A.shape[-2] == 6 else np.linalg.pinv(A))


def pose_parameter_jacobian(T_base_platform: RigidTransform, mechanism: Parallel) -> Floats:
    """Pose Jacobian J_p (..., 6, p) by the parameters (m), at constant command.

    delta_e = J_p delta_x, docs/mathematics.md (7); source: the on-line learning patent for Stewart platforms, eq. 1
    [0024]
    """
    if not isinstance(mechanism, Hexapod) or is_redundant(mechanism):
        return inverse_strut_length_jacobian(T_base_platform, mechanism) @ loop_closure_parameter_jacobian(
            T_base_platform, mechanism
        )
    return cast(
        Floats,
        np.linalg.solve(
            hexapod.jacobian(T_base_platform, mechanism), loop_closure_parameter_jacobian(T_base_platform, mechanism)
        ),
    )


def _scatter(left: Floats, S: Floats, inliers: Booleans, spent: int) -> Floats:
    """(axes,) m: what each strut scatters beyond the poses' own covariance, 0 where that suffices. spent : poses' worth
    of parameters
    """
    count = inliers.sum()
    if count <= LEAST:
        return np.zeros(left.shape[1])
    own = np.einsum("nii->ni", S)[inliers].mean(axis=0) * max(1 - spent / count, 0.1)
    seen = (left[inliers] ** 2).mean(axis=0)
    freedom = count - spent
    return np.where(
        seen > own * scipy.special.chdtri(freedom, scipy.special.ndtr(-EXCESS)) / freedom,
        np.sqrt(np.maximum(seen - own, 0)),
        0.0,
    )


def require_followers_of_redundant_platform(mechanism: Parallel) -> None:
    """Require followers of a platform on more than six struts.

    Raise RigError where all of them are driven: poses say too little of it.
    """
    if is_redundant(mechanism) and not mechanism.followers:
        raise RigError(
            f"all {len(mechanism.axes)} struts are driven, so that their lengths differ from those commanded by what "
            "they press against each other, and poses do not determine it: record with "
            f"{len(mechanism.axes) - 6} of them released, named as followers in rig.toml, docs/more-struts.md"
        )


def _inliers(left: Floats, S: Floats, scatter: Floats) -> Floats:
    sigma = np.sqrt(np.einsum("nii->ni", S) + scatter**2)
    scale = np.maximum(1.0, 1.4826 * np.median(np.abs(left / sigma), axis=0))
    return (np.abs(left) < GATE * scale * sigma).all(axis=1)
