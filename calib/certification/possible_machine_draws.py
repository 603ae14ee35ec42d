"""Draws of possible machines that the recorded poses allow.

Parameters, strut deviations, shared errors.

What the design of a recording confounds is drawn together: where play, time or a function of the configuration stand
for a parameter, one draw has the one and the next the other. docs/mathematics.md (21)
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib.certification.held_out_pose_errors_and_distinct_configurations import axis_travel_limits
from calib.certification.strut_deviation_covariance_functions_by_cause import (
    CONDITION,
    CONFIGURATION,
    PLACE,
    SAMPLE,
    Component,
    candidate_covariance_functions_of_strut_deviations,
    scaled_commands,
)
from calib.certification.strut_deviation_size_sampler_and_possible_machine_errors import (
    Closures,
    Machines,
    draw_strut_deviation_component_sizes,
)
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import Tolerance, expand_parameter_widths
from calib.models.platform.platform_identification import Identified
from calib.models.platform.strut_loop_closure_equations import loop_covariance
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Booleans, Floats, Integers
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Parallel,
    geometric_parameters,
    is_redundant,
    loop_closure_parameter_jacobian,
    strut_or_axis_jacobian_by_pose,
)

ALIKE = 0.12  # by which share what a law leaves in use is more or less than these functions of it have it
# share of poses that may be left out as wild; where more agree with no geometry, the machine is counted as doing so
WILD = 0.05
SEEN, SEEING = (
    ("time", "temperature"),
    0.5,
)  # what is rather seen than done, where cameras look, and the probability of that
COUNT, EACH = 128, 8  # draws of sizes, and machines drawn for each


@dataclass(frozen=True, slots=True, eq=False)
class StrutDeviationSizes:
    """inliers : (n,) bool, the samples that are counted; components : per strut its Components; draws : per strut
    (COUNT, its components) m, of their sizes; the same row of all struts is one machine."""

    inliers: Booleans
    components: list[list[Component]]
    draws: list[Floats]

    def of_place(self) -> Floats:
        """(axes,) probability that a strut's deviation has a function of place, as these samples tell it from
        everything else.
        """
        return np.array(
            [
                (draws[:, [part.over == PLACE for part in own]] > 0).any(axis=1).mean()
                for own, draws in zip(self.components, self.draws)
            ]
        )


def draw_strut_deviation_sizes(
    identified: Identified,
    tolerance: Tolerance,
    samples: Samples,
    label: Integers,
    nominal: Parallel,
    rng: np.random.Generator,
) -> StrutDeviationSizes:
    """Draws of the sizes of strut deviations beyond the geometry, from samples.

    identified : Identified, of a geometry alone; tolerance : Tolerance; samples : Samples, each visit one; label : (n,)
        configurations
    """
    counted = identified.inliers if (~identified.inliers).mean() <= WILD else np.ones(len(samples), bool)
    samples, label = samples.take(counted), np.unique(label[counted], return_inverse=True)[1]
    model, struts = _Closures(identified, samples), []
    parts, y = candidate_covariance_functions_of_strut_deviations(samples, label, nominal), model.about(nominal)
    for i, own in enumerate(parts):
        D, C = model.D[:, i], model.common[:, i]
        V = np.diag(model.own[:, i, i]) + C @ C.T + (D * tolerance.prior**2) @ D.T
        struts.append(Closures(y[:, i], V, float(np.sqrt(np.mean(model.own[:, i, i] + (C**2).sum(axis=1)))), own))
    draws = draw_strut_deviation_component_sizes(struts, _scattered(identified, counted), COUNT, rng)
    if is_redundant(nominal):  # the loops that no pose moves show how much all struts scatter
        for own, drawn, scatter in zip(parts, draws, identified.scatter):
            scattering = [part.over == SAMPLE for part in own]
            drawn[:, scattering] = np.maximum(drawn[:, scattering], scatter)
    return StrutDeviationSizes(counted, parts, draws)


def _scattered(found: Identified, counted: Booleans) -> Callable[[Floats], Floats]:
    """(k,) sizes, m -> (k,) by how much the log likelihood of all struts' closures together grows where each scatters
    by so much.

    What all poses together exclude, no strut by itself may: the poses' errors are shared by the struts.
    """
    S, left = found.residual_covariance[counted], found.residuals[counted]
    free = 1 - (len(found.prior) - (np.diag(found.covariance) / found.prior**2).sum()) / left.size
    free = max(float(free), 0.1)

    def likelihood(size: Floats) -> Floats:
        V = S + size[:, None, None, None] ** 2 * np.eye(S.shape[1])
        square = np.einsum(
            "ni,kni->k", left, np.linalg.solve(V, np.broadcast_to(left[..., None], (len(size), *left.shape, 1)))[..., 0]
        )
        return np.asarray(-0.5 * (free * np.linalg.slogdet(V)[1].sum(axis=1) + square))

    return lambda size: likelihood(size) - likelihood(np.zeros(1))


def draw_possible_machines(
    identified: Identified,
    tolerance: Tolerance,
    samples: Samples,
    sizes: StrutDeviationSizes,
    nominal: Parallel,
    workspace_commands: Floats,
    noise: Floats,
    rng: np.random.Generator,
) -> Machines:
    """Draws of possible machines about a fit, at places of the workspace.
    identified : Identified, whose mechanism the parameters are about; tolerance : Tolerance; samples : Samples, each
        visit
    one

    sizes : Sizes by the same samples; workspace_commands : (m, axes) m commands; noise : (COUNT,) factors on the
        poses' covariance
    """
    model, parts, x = (
        _Closures(identified, samples.take(sizes.inliers)),
        sizes.components,
        scaled_commands(workspace_commands, axis_travel_limits(nominal)),
    )
    at = [
        [part.at(x) if part.kernel is not None else part.use(x) if part.use is not None else None for part in own]
        for own in parts
    ]
    middle, y, count = (
        geometric_parameters(nominal) - geometric_parameters(identified.mechanism),
        model.about(nominal),
        COUNT,
    )
    width = expand_parameter_widths(tolerance.widths, tolerance.counts)[
        rng.choice(len(tolerance.weight), count, p=tolerance.weight)
    ]
    size = sizes.draws
    together, seen = np.zeros((2, count, EACH, len(parts), len(parts)))
    looks = model.common.shape[2] > 0  # whoever measures with errors that all poses share may drift and scatter as well
    off = np.empty((count, EACH, len(middle)))
    squares = [np.zeros((count, EACH, len(own))) for own in parts]
    mean, variance = np.zeros((2, count, EACH, len(x), len(parts)))
    for k in range(count):
        off[k], coefficients = model.draw(y, parts, [one[k] for one in size], width[k], float(noise[k]), rng)
        course, watched = np.zeros(
            (2, EACH, len(y), len(parts))
        )  # of what goes as it went while the poses were recorded
        for i, own in enumerate(parts):
            for j, part in enumerate(own):
                s = size[i][k, j]
                if not s:
                    continue
                m, v = _used(part, s, coefficients.get((i, j)), at[i][j], x)
                if part.over == CONDITION and part.use is None:
                    values = coefficients[i, j] @ part.basis.T
                    (watched if looks and part.word in SEEN else course)[:, :, i] += values
                    squares[i][k, :, j] = (values**2).mean(axis=1)
                elif looks and part.over in (SAMPLE, CONFIGURATION):
                    squares[i][k, :, j] = v.mean(axis=1)
                    seen[k, :, i, i] += v.mean(axis=1)
                    continue
                else:
                    squares[i][k, :, j] = (m**2 + v).mean(axis=1)
                mean[k, :, :, i] += m
                variance[k, :, :, i] += v
        mean[k] += course.mean(axis=1)[:, None]
        course -= course.mean(axis=1, keepdims=True)
        together[k] = np.swapaxes(course, 1, 2) @ course / len(y)
        seen[k] += np.swapaxes(watched, 1, 2) @ watched / len(y)
    less = np.exp(2 * ALIKE * rng.normal(size=(count, EACH, 1, 1)))
    flat = [
        part.reshape(count * EACH, *part.shape[2:]) for part in (mean, less * variance, less * together, less * seen)
    ]
    means = [one.reshape(count * EACH, -1) for one in squares]
    return Machines(
        off.reshape(count * EACH, -1) + middle,
        parts,
        means,
        flat[0],
        flat[1],
        flat[2],
        flat[3],
        rng.random(count * EACH) < SEEING,
    )


def _used(
    part: Component, size: float, c: Floats | None, at: tuple[Floats, Floats] | None, x: Floats
) -> tuple[Floats, Floats]:
    """(mean (EACH, m) m, variance (EACH, m) m^2) of a component of a size over places x (m, axes).

    c : (EACH, r) its coefficients, or None; at : what `Component.at` or `Component.use` says of the places
    """
    nothing = np.zeros((EACH, len(x)))
    if c is None or part.over not in (CONDITION, PLACE):  # other visits and configurations have their own
        return nothing, nothing + size**2
    if at is None:
        return nothing, nothing
    if part.over == PLACE:
        return c @ at[0].T, nothing + size**2 * at[1]
    return c * at[0], c**2 * at[1]


class _Closures:
    """The struts' closures at a fit as a linear model: left = -D (p - p_fit) - deviation + common z + own."""

    def __init__(self, found: Identified, samples: Samples) -> None:
        T, self.fitted = samples.T_base_platform, found.mechanism
        A = strut_or_axis_jacobian_by_pose(T, self.fitted)
        self.D, self.common = loop_closure_parameter_jacobian(T, self.fitted), A @ samples.common
        self.left = samples.effective - mechanisms.kinematics_of(self.fitted).inverse(T, self.fitted)
        self.own = loop_covariance(A, samples.covariance)

    def about(self, nominal: Parallel) -> Floats:
        """(n, axes) m, the closures as the owner's figures have them, to first order."""
        return np.asarray(self.left + self.D @ (geometric_parameters(nominal) - geometric_parameters(self.fitted)))

    def draw(
        self,
        y: Floats,
        parts: list[list[Component]],
        size: list[Floats],
        width: Floats,
        noise: float,
        rng: np.random.Generator,
    ) -> tuple[Floats, dict[tuple[int, int], Floats]]:
        """((EACH, p) parameters less the owner's, {(strut, component): (EACH, r) coefficients}), m, drawn together.

        y : (n, axes) m, from `about`; size : per strut (components,) m; width : (p,) m; noise : factor
        """
        n, axes = y.shape
        own = noise * self.own
        columns, priors, which = [-self.D, self.common], [width, np.full(self.common.shape[2], np.sqrt(noise))], []
        for i, mine in enumerate(parts):
            for j, part in enumerate(mine):
                if part.over == SAMPLE:
                    own = own + size[i][j] ** 2 * np.diag(np.eye(axes)[i])
                elif size[i][j]:
                    column = np.zeros((n, axes, part.basis.shape[1]))
                    column[:, i] = -part.basis
                    columns.append(column)
                    priors.append(np.full(part.basis.shape[1], size[i][j]))
                    which.append((i, j))
        X, prior = np.concatenate(columns, axis=2), np.concatenate(priors)
        whiten = np.linalg.inv(np.linalg.cholesky(own))
        white = (whiten @ np.concatenate([X * prior, y[..., None]], axis=2)).reshape(n * axes, -1)
        H = white[:, :-1].T @ white[:, :-1] + np.eye(len(prior))
        mean = np.linalg.solve(H, white[:, :-1].T @ white[:, -1])
        c = prior * (mean + np.linalg.solve(np.linalg.cholesky(H).T, rng.normal(size=(len(prior), EACH))).T)
        ends = np.cumsum([len(one) for one in priors])
        return c[:, : ends[0]], {at: c[:, start:end] for at, start, end in zip(which, ends[1:-1], ends[2:])}
