"""Candidate effects at an arm's joints, and effects that its instruments show.

Candidates are every effect of the catalogue, at each place, on a grid of parameters. Effects that instruments show by
themselves are fitted with the geometry before anything is searched for.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy.special import chdtrc

from calib.diagnosis.engine.candidate_scores_and_their_significance import Score
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import ARM, Candidate, Node, NotTested
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import Z95
from calib.diagnosis.problems.arm.linearised_poses_and_whitened_columns import Arms
from calib.diagnosis.problems.arm.minimum_pose_count_for_candidates import (
    minimum_pose_count,
    most_parameters_of_candidate,
)
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    smoothed_temperatures_and_errors,
)
from calib.diagnosis.problems.evidence_interface_and_requested_effects import (
    EffectSites,
    MeasuredFinding,
    RequestedEffects,
    Value,
)
from calib.models.arm.arm_certification import UNPLACED, start_arm_of_fit
from calib.models.arm.arm_error_model_and_instrument_observations import observations_of_samples
from calib.models.arm.joint_effect_fit_and_held_out_scatter import History, JointFit, fit_geometry_and_effects
from calib.models.arm.mount_pointing_terms import shares_angle_with_another_effect, tube_flexure_effect
from calib.samples.commanded_and_measured_pose_samples import Sampled
from rig.array_and_json_types import Floats
from rig.effects.catalogue.effect_list import lean_under_link_weight
from rig.effects.framework.effect_base_class import Candidate as EffectCandidate
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.framework.parameters_covariates_and_marker_table import COUNT, QUADRATURE
from rig.errors import RigError
from rig.model.machine_motion_simulation import motion_of_commands
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_arm
from rig.recording.recording_folder import Recording


class Form(Enum):
    """What a candidate's turn of its joint is a function of: the joint's own angle (as a line, a sinusoid, or any
    curve), a moment in time, or anything else."""

    SLOPE = "slope"
    SINUSOID = "sinusoid"
    PROFILE = "profile"
    STEP = "step"
    OTHER = "other"


OWN_ANGLE = (Form.SLOPE, Form.SINUSOID, Form.PROFILE)
SIMPLICITY = {
    1: Form.SLOPE,
    2: Form.SINUSOID,
    3: Form.PROFILE,
}  # of what depends on the axis alone, as effects state it
MOST = 200  # nodes of a candidate whose weights are kept
POSES_ALONE = "for an arm or a chain, the measured poses are searched, not the corners behind them"
NO_CORNERS = "there are no corners"
SPAN = "span"  # in a profile's node: (low, high) rad


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class JointCandidate(Candidate):
    """An effect at a joint, or at the whole arm. joint : index, or None; specs : as the effect states it, one for each
    number of columns
    weights : node -> (n, a, q) per unit of what a pose can be moved in: rad of the joint (a = 1), or the tangent of the
        whole (a = k)
    prior : node -> (q,) sizes of the coefficients; step : between nodes that are even multiples of it, 0 for all
        others"""

    joint: int | None
    specs: tuple[EffectCandidate, ...]
    weights: Callable[[Node], Floats]
    prior: Callable[[Node], Floats]
    form: Form = Form.OTHER
    step: float = 0.0

    @property
    def kind(self) -> type[Effect]:
        """The class of the effect."""
        return self.specs[0].kind

    @property
    def sought(self) -> str:
        """The one parameter that the grid goes through."""
        return next(iter(self.grid[0]))

    def effect(self, node: Node, coefficients: Floats) -> Effect:
        """The effect of a node with coefficients (q,); where the size is in the node, the coefficient is it."""
        spec = effect_candidate_of_node(self.specs, node)
        return (
            spec.effect(node, coefficients)
            if spec.linear
            else spec.kind(spec.place, **{next(iter(node)): float(coefficients[0])})
        )


JointScore = Score[JointCandidate]


def joint_candidates_and_untested_effects(
    arms: Arms, requested_effects: RequestedEffects
) -> tuple[list[JointCandidate], list[NotTested]]:
    """Joint candidates of the requested effects on an arm's poses, and effects that it cannot test.

    A candidate of more parameters than `most_parameters_of_candidate` is not requested, and that is stated.
    Raises RigError for a place where what is asked for cannot sit.
    """
    requested: dict[str, list[JointCandidate]] = {}
    beyond: dict[str, list[tuple[int, bool]]] = {}
    poses, k, freedoms = arms.freedoms.shape

    def candidates_at(kind: type[Effect], place: str) -> list[JointCandidate]:
        every = _candidates(tuple(kind.candidates(place, arms.context)), arms)
        out = []
        for one in every:
            count = [_numbers(one, node) for node in one.grid]
            most = most_parameters_of_candidate(poses, k, freedoms, one.joint is None)
            grid = [node for node, numbers in zip(one.grid, count) if numbers <= most]
            if len(grid) < len(count):
                beyond.setdefault(kind.name, []).append((max(count), one.joint is None))
            if grid:
                out.append(one if len(grid) == len(count) else replace(one, grid=grid))
        requested.setdefault(kind.name, []).extend(out)
        return out

    def sites_of(kind: type[Effect]) -> EffectSites:
        if kind.discrete or kind.stage in ("targets", "view"):
            raise RigError(POSES_ALONE if arms.context.design.cameras else NO_CORNERS)
        found = kind.sites(arms.context)
        lacking = _lacking(kind, found, arms)
        if found and any(p.role == "frequency" for p in kind.parameters):
            reason = f"{kind.name}: the poses of an arm are not searched for a frequency"
            return EffectSites(None, (), [*lacking, NotTested(kind.name, reason)])
        return EffectSites(found, found, lacking)

    found, not_tested = requested_effects.candidates(sites_of, candidates_at)
    return found, [*not_tested, *_beyond_poses(requested, beyond, arms)]


def _numbers(candidate: JointCandidate, node: Node) -> int:
    """Numbers that a candidate is fitted by at a node of its grid, those that the search chooses included."""
    return len(candidate.prior(node)) + candidate.extra


def _beyond_poses(
    requested: dict[str, list[JointCandidate]], beyond: dict[str, list[tuple[int, bool]]], arms: Arms
) -> list[NotTested]:
    """What is not asked for because the poses are too few for its numbers, or for an effect as it states itself."""
    out: list[NotTested] = []
    count, k, freedoms = arms.freedoms.shape
    for name, found in requested.items():
        numbers, whole = max(beyond.get(name, [(0, False)]))
        if numbers:
            most = most_parameters_of_candidate(count, k, freedoms, whole)
            more = minimum_pose_count(k, freedoms, numbers, whole, count + 1)
            what = f"forms of more than {most} numbers are not asked for" if found else f"it takes {numbers} numbers"
            out.append(NotTested(name, f"{count} poses bear {most} numbers of an effect; {what}: record {more} poses"))
        elif not found:
            out.append(NotTested(name, f"it is not asked for with so few poses as {count}"))
    return out


def _lacking(kind: type[Effect], found: tuple[str, ...], arms: Arms) -> list[NotTested]:
    """What keeps an effect from being asked for at some of the axes, where it can be at others."""
    why: dict[str, list[str]] = {}
    for place, reason in kind.lacking(arms.context).items():
        if found and place not in found:
            why.setdefault(reason, []).append(place)
    return [NotTested(kind.name, f"at {', '.join(places)} it {reason}") for reason, places in why.items()]


def _candidates(specs: tuple[EffectCandidate, ...], arms: Arms) -> list[JointCandidate]:
    """The candidates of an effect at a place; its curves of more and fewer numbers are one."""
    if not specs:
        return []
    several = all(COUNT in node for spec in specs for node in spec.grid)
    return [joint_candidate(group, arms) for group in ([specs] if several else [(spec,) for spec in specs])]


def joint_candidate(effect_candidates: tuple[EffectCandidate, ...], arms: Arms) -> JointCandidate:
    """JointCandidate of one effect at one place, from its EffectCandidates, one for each number of columns."""
    first, places = effect_candidates[0], arms.context.moved().places
    sways = first.kind.sway is not Effect.sway
    joint = places.index(first.place) if first.place in places and not sways else None
    form = Form.STEP if first.kind.form == "step" else SIMPLICITY.get(first.kind.own_axis, Form.OTHER)
    positive = len(first.linear) < 2 and min((low for low, _ in _bounds(first)), default=0.0) >= 0
    grid = [node for spec in effect_candidates for node in spec.grid]
    # a node that is the size itself has one linear coefficient in its place, and so nothing that is sought besides
    return JointCandidate(
        name=first.kind.name,
        place=first.place,
        grid=grid,
        extra=first.extra if first.linear else 0,
        joint=joint,
        specs=effect_candidates,
        weights=_cached_function_of_node(
            lambda node: _weights(effect_candidate_of_node(effect_candidates, node), node, joint, arms)
        ),
        prior=lambda node: _prior(effect_candidate_of_node(effect_candidates, node)),
        form=form,
        vector=max(len(spec.linear) for spec in effect_candidates) > 2,
        step=first.spacing,
        bounds=(np.zeros(1), np.full(1, np.inf)) if positive else None,
    )


def effect_candidate_of_node(specs: tuple[EffectCandidate, ...], node: Node) -> EffectCandidate:
    """The effect's candidate of a node.

    It has as many columns as the node says.
    """
    return next((spec for spec in specs if spec.grid[0].get(COUNT) == node.get(COUNT)), specs[0])


def _bounds(spec: EffectCandidate) -> list[tuple[float, float]]:
    """Bounds of what the coefficients stand for."""
    by = {p.name: p for p in spec.kind.parameters_at(spec.place)}
    return [by[column.name].bounds for column in spec.linear if column.name != QUADRATURE] or [
        by[name].bounds for name in spec.grid[0]
    ]


def _prior(spec: EffectCandidate) -> Floats:
    """(q,) sizes that rigs show of the coefficients."""
    by = {p.name: p for p in spec.kind.parameters_at(spec.place)}
    names = [column.name for column in spec.linear] or [next(iter(spec.grid[0]))]
    amplitude = next((name for name in names if name != QUADRATURE), "")
    used = [by[amplitude if name == QUADRATURE else name] for name in names]
    return np.array([1 / p.usual[0] if p.role == "inverse" else p.usual[1] for p in used])


def _weights(spec: EffectCandidate, node: Node, joint: int | None, arms: Arms) -> Floats:
    """(n, a, q) of a node, see JointCandidate."""
    motion = arms.context.moved()
    if joint is None and spec.kind.retimes():
        return np.einsum("nkj,njq->nkq", arms.joints, _retimed(spec, node, arms))
    if joint is None:
        units = np.eye(len(spec.linear)) * [column.step for column in spec.linear]
        moved = [arms.displaced(spec.effect(node, unit)) / column.step for unit, column in zip(units, spec.linear)]
        return np.stack(moved, axis=-1)
    out = (_retimed(spec, node, arms) if spec.kind.retimes() else spec.deviation(node, motion))[
        :, joint
    ].copy()  # kept without the other joints
    return (out if spec.linear else out / next(iter(node.values())))[:, None, :]


def _retimed(spec: EffectCandidate, node: Node, arms: Arms) -> Floats:
    """(n, joints, q) rad by which the commands reached change, per unit of the coefficients."""
    steps = [column.step for column in spec.linear] or [1.0]
    units = np.eye(len(spec.linear)) * steps if spec.linear else [np.zeros(0)]
    return np.stack(
        [(arms.reached(spec.effect(node, unit)) - arms.q) / step for unit, step in zip(units, steps)], axis=-1
    )


def _cached_function_of_node(weights: Callable[[Node], Floats]) -> Callable[[Node], Floats]:
    """The function of a node, the last answers kept: histories are long, and asked for in every search."""
    known: dict[tuple[object, ...], Floats] = {}

    def answer(node: Node) -> Floats:
        key = tuple(sorted(node.items()))
        if key not in known:
            if len(known) > MOST:
                known.clear()
            known[key] = weights(node)
        return known[key]

    return answer


def effects_shown_by_instruments(recording: Recording, sampled: Sampled) -> tuple[Effect, ...]:
    """Effects that are fitted with an arm's geometry since its instruments show them.

    Small where the fit begins.

    The flexure of a tube, of which directions were measured; the lean of a base on which a tilt sensor was read.
    """
    arm, samples = recording.design.mechanism, sampled.samples
    if not isinstance(arm, Arm) or recording.commands is None:
        return ()
    flexure = tube_flexure_effect(arm) if samples.measured == "direction" else ()
    readings = samples.tilts
    if readings is None or samples.measured in UNPLACED or all(sensor.link for sensor in readings.sensors):
        return flexure
    logged, poses = recording.sensors, samples.T_base_platform
    lean = lean_under_link_weight(
        motion_of_commands(recording.design, recording.commands, samples.t, (), logged, poses)
    )
    return (*flexure, *([] if lean is None else [lean]))


def fit_of_effects_shown_by_instruments(recording: Recording, sampled: Sampled) -> JointFit | None:
    """JointFit of an arm's `effects_shown_by_instruments` with its geometry alone.

    All else is searched for beside it; None where there are none.
    """
    effects = effects_shown_by_instruments(recording, sampled)
    if not effects or recording.commands is None:
        return None
    samples, arm = sampled.samples, require_arm(recording.design.mechanism)
    history = History(recording.design, recording.commands, smoothed_temperatures_and_errors(recording.sensors)[0])
    start = start_arm_of_fit(observations_of_samples(samples), arm, sampled.instrument)
    return fit_geometry_and_effects(samples, history, start, effects)


def findings_of_effects_fitted_before_search(
    fit: JointFit, found: tuple[Effect, ...] = ()
) -> tuple[MeasuredFinding, ...]:
    """Findings of effects that were fitted before the search.

    They have 95 % intervals; of a lean its RMS is first. One of a size that chance explains is none, by the
    policy's alpha, as of what is searched for.
    found : effects that the search found, with which they are fitted anew: beside these they may be other ones. One
        that cannot be separated from these is left out
    """
    out, count = list[MeasuredFinding](), len(fit.effects)
    if found:
        fit = fit_geometry_and_effects(fit.measured, fit.history, fit.arm, (*fit.effects, *found), fit.before)
    coordinates, sigma = fit_coordinates_of_effects(fit.effects), np.sqrt(np.diag(fit.own))
    for number, effect in enumerate(fit.effects[:count]):
        if shares_angle_with_another_effect(effect, found):
            continue
        if _chance_of_sizes(fit, number) * count > ARM.alpha:
            continue
        parameters = dict[str, Value]()
        before, after = fit.measured.tilts, fit.samples.tilts
        if type(effect).lean is not Effect.lean and before is not None and after is not None:
            turned = np.linalg.norm(np.cross(before.down, after.down), axis=1)
            parameters["rms"] = Value(float(np.sqrt((turned**2).mean())), "rad")
        for parameter in effect.parameters:
            own = [k for k, c in enumerate(coordinates) if (c.effect, c.name) == (number, parameter.name)]
            if own:
                value = np.array([coordinates[k].read(effect) for k in own])
                ends = np.stack([value - Z95 * sigma[own], value + Z95 * sigma[own]])
                several = coordinates[own[0]].index is not None
                read, low_high = (value, ends) if several else (value[0], ends[:, 0])
                unit = parameter.unit.split(", ")[0]
                parameters[parameter.name] = Value(read.tolist(), unit, low_high.tolist())
        out.append(MeasuredFinding(type(effect), effect.place, parameters))
    return tuple(out)


def _chance_of_sizes(fit: JointFit, number: int) -> float:
    """Probability of the fitted sizes of an effect, by its number, where it has none: chi-squared by their covariance,
    in the directions that are determined. 1 of an effect whose sizes are all 0.
    """
    coordinates = fit_coordinates_of_effects(fit.effects)
    own = [k for k, c in enumerate(coordinates) if c.effect == number and c.is_size]
    values = np.array([coordinates[k].read(fit.effects[number]) for k in own])
    if not values.any():
        return 1.0
    covariance = fit.own[np.ix_(own, own)]
    sigma = np.sqrt(np.diag(covariance))
    scaled = covariance / sigma[:, None] / sigma
    rank = np.linalg.matrix_rank(scaled, hermitian=True)
    return float(chdtrc(rank, values / sigma @ np.linalg.pinv(scaled, hermitian=True) @ (values / sigma)))
