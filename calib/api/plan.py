"""Plan of configurations to visit.

They determine parameters best, keep a promise, or separate effects.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import cast

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.api.plan_for_promise import FEWEST, make_visible_marker_counter, plan_keeping_promise
from calib.api.plan_options_and_result import (
    FOR_PARAMETERS,
    LEAST,
    MOVES,
    SEED,
    SHOWN,
    PlanOptions,
    PlanResult,
    plan_geometry_and_exclusion_of_lost_poses,
)
from calib.certification.platform_certification import Progress, ignore_progress
from calib.correction.machine_correction import indices_and_poses_of_solvable_commands
from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import (
    Separation,
    separation_of_two_effects_by_plan,
)
from calib.models.arm.arm_error_model_and_instrument_observations import PLAUSIBLE as PLAUSIBLE_ERRORS
from calib.models.arm.arm_error_model_and_instrument_observations import parameter_jacobian, parameter_names
from calib.models.arm.mount_pointing_terms import pointing_term_jacobian_and_names
from calib.models.arm.tilt_observations import planned_tilt_jacobian
from calib.models.machine_parameters_and_file_entries import (
    IndependentParameters,
    independent_parameter_names_units_sizes_and_jacobian,
)
from calib.models.platform.d_optimal_hexapod_configurations import (
    choose_configurations_by_exchange,
    choose_d_optimal_configurations,
    total_information,
)
from calib.models.platform.determined_parameters_and_stated_geometry_tolerance import (
    PLAUSIBLE,
    parameter_combinations_and_visibility,
    standard_error_along,
)
from calib.samples.position_confounds_and_poses_on_one_clock import confounds_of_configurations
from rig import api
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import effect_with_existing_place, parse_effect
from rig.errors import RigError
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import require_single_hand_mechanism
from rig.model.base_and_link_tilt_sensors import GRAVITY_SIGMA
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    has_axes,
    has_links,
    is_hexapod,
    require_arm,
    require_hexapod,
)
from rig.planning.configuration_generators import evenly_spread_configurations
from rig.planning.recording_plan import axis_strokes, build_plan, nearest_compatible_commands, sensors_with_payload
from rig.planning.timed_plan_and_visiting_order import Plan, balanced_approach_lengths, time_balanced_order
from rig.recording.recording_folder import Sensors

CANDIDATES = 1500
FILL = 0.95  # of the travels
DETERMINED = 4.0  # information, that of the prior being 1, from which a combination of parameters is told


@dataclass(frozen=True, slots=True, eq=False)
class InformativeConfigurations:
    """values : (n, axes) m or rad, chosen, ordered so that neither time nor direction is a function of place
    names, units : of the parameters asked for, "m" or "rad"; sigma, even : (p,) their standard errors by
    these, and by as many spread evenly, along what these tell at all; undetermined : how many combinations keep half of
    what they may be off by or more
    seen : share of all configurations tried in which the machine is seen"""

    values: Floats
    names: tuple[str, ...]
    units: tuple[str, ...]
    sigma: Floats
    even: Floats
    undetermined: int
    seen: float


def informative_configurations(
    mechanism: Commanded,
    count: int,
    sigmas: tuple[float, float],
    visible_marker_count: Callable[[RigidTransform], Integers] | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    parameters: IndependentParameters | None = None,
    row_sigmas: Floats | None = None,
) -> InformativeConfigurations:
    """Most informative configurations for a mechanism's parameters, `count` of them.

    sigmas : (m, rad) standard deviations of a measured pose, per axis
    visible_marker_count : how many markers of what moves are seen at poses (n,), or None where an instrument sees it
        anywhere;
        progress : called with (done, of)
    parameters : the parameters, by default those that whole poses tell; row_sigmas : of each row of its Jacobian, by
        default sigmas of a pose's six
    Raises RigError for too few configurations to hold the parameters, or where too few candidates close on a pose or
        are seen
    """
    kinematics = mechanisms.kinematics_of(mechanism)
    values = evenly_spread_configurations(mechanism, CANDIDATES, FILL, seed)
    index, T = indices_and_poses_of_solvable_commands(values, lambda some: kinematics.forward(some, mechanism))
    values = values[index]
    seen = np.ones(len(values), bool) if visible_marker_count is None else visible_marker_count(T) >= FEWEST
    parameters = independent_parameter_names_units_sizes_and_jacobian(mechanism) if parameters is None else parameters
    size = parameters.size
    if not seen.any():
        raise RigError(
            f"in none of {len(values)} configurations within the limits {FEWEST} markers are fully visible: "
            "turn the cameras"
        )
    noise = np.repeat(sigmas, 3) if row_sigmas is None else row_sigmas
    rows = parameters.jacobian(values[seen]) / noise[:, None] * size
    affected_coordinates = int(rows.any(axis=2).any(axis=0).sum())  # numbers of a pose that the parameters move at all
    if affected_coordinates * count <= len(size):
        raise RigError(
            f"{count} configurations cannot determine {len(size)} parameters; minimum "
            f"{len(size) // affected_coordinates + 1}, better {3 * len(size) // affected_coordinates}"
        )
    if seen.sum() < 2 * count:
        raise RigError(
            f"in {seen.sum()} of {len(values)} configurations within the limits {FEWEST} markers are seen "
            f"whole; choosing {count} takes "
            "more: narrow the limits, or turn the cameras"
        )
    start = np.eye(len(size)) if parameters.alike else np.zeros((len(size), len(size)))
    picked = choose_configurations_by_exchange(rows, start, count, "determinant", progress)
    even = np.linspace(0, len(rows) - 1, count).astype(int)
    information, vectors = np.linalg.eigh(np.eye(len(size)) + total_information(rows, picked))
    sharp = vectors[:, information > DETERMINED]
    sigma, plain = (
        size
        * np.sqrt(
            np.einsum(
                "pi,ij,pj->p",
                sharp,
                sharp.T @ np.linalg.inv(np.eye(len(size)) + total_information(rows, chosen)) @ sharp,
                sharp,
            )
        )
        for chosen in (picked, even)
    )
    chosen = values[seen][picked]
    order = time_balanced_order(chosen, np.random.default_rng(seed))
    return InformativeConfigurations(
        chosen[order], parameters.names, parameters.units, sigma, plain, len(size) - sharp.shape[1], float(seen.mean())
    )


def plan_for_parameters(design: Design, options: PlanOptions, progress: Progress) -> PlanResult:
    """PlanResult of the configurations that determine a machine's parameters best.

    progress : called with (label, done, of)
    Raises RigError for a body that nothing commands, and for options that are of hexapods alone
    """
    mechanism = design.mechanism
    if not has_axes(mechanism):
        raise RigError(f"plans for parameters require a commanded mechanism, not one of kind {mechanism.kind!r}")
    if not is_hexapod(mechanism):
        return _plan_of_any(design, mechanism, options, progress)
    mechanism, avoided = plan_geometry_and_exclusion_of_lost_poses(options, require_hexapod(mechanism))
    chosen = choose_d_optimal_configurations(
        mechanism,
        options.count,
        options.sigma,
        options.criterion,
        options.given,
        SEED,
        lambda done, of: progress("choosing", done, of),
        avoided,
    )
    (before, _), (after, seen), (_, even) = (
        parameter_combinations_and_visibility(root, mechanism) for root in (chosen.before, chosen.root, chosen.even)
    )
    visited = 0 if options.given is None else len(options.given)
    gain = (seen.singular.prod() / even.singular.prod()) ** (1 / 42)
    counted = f"{options.count} configurations" + (f" besides {visited} given" if visited else "")
    lines = [
        f"{counted}: condition number of the 42 parameters "
        f"{seen.condition:.0f}, "
        f"with the same number evenly spread {even.condition:.0f}",
        f"worst determined combination {after[0].sigma * 1e6:.2f} um, evenly spread "
        f"{PLAUSIBLE / even.singular[-1] * 1e6:.2f} um; "
        f"all 42 together {gain:.2f} times as precise as evenly spread",
    ]
    hidden = [part for part in before if not part.determined]
    if visited and not hidden:
        lines.append("the given configurations already determine all 42; the worst, before and after:")
    elif visited:
        lines.append(
            f"{len(hidden)} combinations that the given configurations do not determine to {PLAUSIBLE * 1e3:g} mm "
            "become visible; the worst:"
        )
    else:
        lines.append("the worst determined combinations:")
    lines += [
        f"  {_sigma(part.sigma)} -> {_sigma(standard_error_along(chosen.root, part.direction))}  {part.name}"
        if visited
        else f"  {_sigma(part.sigma)}  {part.name}"
        for part in (before if visited else after)[:SHOWN]
    ]
    unseen = sum(not part.determined for part in after)
    why = (
        f"{counted} leave {unseen} of 42 combinations of the parameters undetermined: visit more"
        if unseen
        else f"{counted} determine all 42 parameters, {gain:.1f} times as precisely as evenly spread ones"
    )
    return PlanResult(design, chosen.commands, not unseen, why, lines)


def _plan_of_any(design: Design, mechanism: Commanded, options: PlanOptions, progress: Progress) -> PlanResult:
    """PlanResult of the configurations that determine a machine's parameters best, of those in which cameras see it."""
    if options.calibration is not None or options.given is not None or options.criterion != "determinant":
        raise RigError("--calibration, --given and --criterion noise are for hexapods")
    looked = make_visible_marker_counter(design)
    lines, requested, sigma = [], None, options.sigma
    if design.instrument is not None and design.instrument.kind == "direction":
        requested = _pointing_parameters(require_arm(mechanism))
        if sigma == FOR_PARAMETERS.sigma:
            sigma = (sigma[0], cast(float, design.instrument.rotation_sigma))
        lines.append(f"standard errors are the Cramer-Rao bound for directions of {sigma[1] * 1e6:.4g} urad per axis")
    noise = None
    if design.tilt_sensors and has_links(mechanism) and requested is None:
        requested, noise = _parameters_seen_by_tilt_sensors(design, mechanism), np.repeat(sigma, 3)
        noise = np.r_[noise, np.repeat([sensor.sigma for sensor in design.tilt_sensors], 2)]
        lines.append(f"{len(design.tilt_sensors)} tilt sensors are counted, and how they are mounted is determined too")
    found = informative_configurations(
        mechanism, options.count, sigma, looked, SEED, lambda done, of: progress("choosing", done, of), requested, noise
    )
    if looked is not None:
        lines.append(
            f"{FEWEST} markers or more are seen in {found.seen:.0%} of the configurations all over the "
            "limits; chosen among these"
        )
    if found.undetermined:
        lines.append(
            f"{found.undetermined} combinations are determined by no pose: they remain as stated and are not considered"
        )
    lines.append(
        f"{options.count} configurations for {len(found.names)} parameters; standard errors, and by as "
        "many spread evenly, the least "
        "gain first:"
    )
    worst = (found.sigma / found.even).argsort()[::-1]
    lines += [
        f"  {found.sigma[k] * 1e6:9.2f} {found.even[k] * 1e6:9.2f} u{found.units[k]}  {found.names[k]}"
        for k in worst[:SHOWN]
    ]
    why = f"{options.count} configurations for {len(found.names)} parameters"
    return PlanResult(design, found.values, True, why, ["", *lines])


def _parameters_seen_by_tilt_sensors(design: Design, arm: Arm) -> IndependentParameters:
    """An arm's parameters, then how its tilt sensors are mounted, by poses and what the sensors show beside them."""
    plain, sensors = independent_parameter_names_units_sizes_and_jacobian(arm), design.tilt_sensors
    retained = [parameter_names(arm).index(name) for name in plain.names]
    places = ["gravity", *(f"tilt sensor {sensor.name}" for sensor in sensors)]
    more = [f"{place} {axis}" for place in places for axis in ("rx", "ry", "rz")]
    sizes = np.r_[plain.size, np.full(3, GRAVITY_SIGMA), np.repeat([sensor.mount_sigma for sensor in sensors], 3)]

    def jacobian(q: Floats) -> Floats:
        whole = parameter_jacobian(q, arm)
        tilted = planned_tilt_jacobian(sensors, design.gravity, q, arm, whole)
        tilted = np.concatenate([tilted[..., : whole.shape[2]][..., retained], tilted[..., whole.shape[2] :]], axis=2)
        posed = np.pad(whole[..., retained], ((0, 0), (0, 0), (0, len(more))))
        return np.concatenate([posed, tilted], axis=1)

    return IndependentParameters((*plain.names, *more), (*plain.units, *["rad"] * len(more)), sizes, jacobian, True)


def _pointing_parameters(arm: Arm) -> IndependentParameters:
    """The pointing terms of a mount of which directions are measured."""
    names, _ = pointing_term_jacobian_and_names(arm.limits.mean(axis=1)[None], arm)
    size = np.full(len(names), PLAUSIBLE_ERRORS["rad"])
    return IndependentParameters(
        names, ("rad",) * len(names), size, lambda q: pointing_term_jacobian_and_names(q, arm)[1], False
    )


def _sigma(value: float) -> str:
    return f"{value * 1e6:9.2f} um" if value < 1e-2 else "   unseen   "


def plan(design: Design, options: PlanOptions = FOR_PARAMETERS, progress: Progress = ignore_progress) -> PlanResult:
    """PlanResult of a design, as `rig plan` makes it.

    progress : called with (label, done, of)
    Raises RigError for what a design's machine cannot be planned for, and where nothing allowed shows what is asked

    >>> import calib, rig
    >>> design = rig.load_design("tests/data/bench/check/rig.toml")
    >>> calib.plan(design, calib.PlanOptions(parts="sobol:3")).values.shape
    (3, 6)
    """
    if options.parts is None:
        require_single_hand_mechanism(design.mechanism, "configurations are chosen")
    if options.promise is not None:
        found = plan_keeping_promise(design, options.promise, options, progress)
    elif options.separate is not None:
        return _separating(design, options.separate, options)
    elif options.parts is not None:
        done = api.plan(design, options.parts, SEED)
        found = PlanResult(design, done.values, True, str(done), done.lines())
    else:
        found = plan_for_parameters(design, options, progress)
    strokes, reached_from = axis_strokes(design), None
    if not len(found.values):
        return found
    if options.parts is None:  # visited straight, the outermost configurations are always reached from within
        lengths = balanced_approach_lengths(found.values, np.random.default_rng(SEED), strokes)
        if options.calibration is not None:
            avoided = plan_geometry_and_exclusion_of_lost_poses(options, require_hexapod(design.mechanism))[1]
            while avoided is not None and (lost := avoided(found.values - lengths)).any():  # the goals are allowed
                lengths[lost] /= 2
        reached_from = nearest_compatible_commands(found.values - lengths, design)
    before = np.vstack([strokes.mean(axis=1), found.values[:-1]]) if reached_from is None else reached_from
    confounds = confounds_of_configurations(found.values, before, design.mechanism)
    return replace(found, confounds=confounds, reached_from=reached_from)


def _separating(design: Design, texts: tuple[str, str], options: PlanOptions) -> PlanResult:
    """PlanResult of the parts of plans, alone or two, by which two effects differ most."""
    effects = [effect_with_existing_place(parse_effect(text), design) for text in texts]
    seen = [effect.name for effect in effects if effect.stage in ("targets", "view")]
    if seen:
        raise RigError(
            f"{', '.join(seen)} changes the images, not the platform's motion: no plan of moves determines it; "
            "see its own experiment in "
            "rig diagnose's page"
        )
    if not design.mechanism.axes:
        raise RigError(
            f"plans to separate effects require a commanded mechanism, not one of kind {design.mechanism.kind!r}"
        )
    trials = _separations(design, effects, options)
    trials.sort(key=lambda trial: -trial[0].misfit / np.sqrt(trial[0].frames))
    lines = ["misfit of the best-fitting wrong model, in standard deviations (and for 100 exposures):"]
    lines += [
        f"  {found.misfit:9.1f} {found.misfit * 10 / np.sqrt(found.frames):9.1f}   cosine "
        f"{found.cosine:6.3f}   {found.plan}"
        for found, _ in trials[:SHOWN]
    ]
    best, chosen = trials[0]
    if best.misfit < LEAST:
        lines.append("no plan tried distinguishes them at that size")
    lines.append(f"best: {best.plan} (rig simulate --plan {best.plan} simulates it)")
    why = f"{' and '.join(texts)} are distinguished by {best.misfit:.1f} standard deviations with {best.plan}"
    return PlanResult(design, chosen.commands.values, best.misfit >= LEAST, why, lines, t=chosen.commands.t)


def _separations(design: Design, effects: list[Effect], options: PlanOptions) -> list[tuple[Separation, Plan]]:
    """[(Separation of two effects, Plan)] of the parts of plans alone and two by two."""
    struts = is_hexapod(design.mechanism)
    moves = [text for text in MOVES if struts or not text.startswith("axes")]
    out = []
    for text in (*moves, *(",".join(pair) for pair in combinations(moves, 2))):
        tried = build_plan(design, text, SEED)
        end = tried.commands.t[-1]
        sensors = options.log(end) if options.log is not None else Sensors(np.array([0.0, end]), {})
        with_payload = sensors_with_payload(tried, sensors)
        found = separation_of_two_effects_by_plan(
            text, design, tried.commands, tried.t, with_payload, effects, options.sigma
        )
        out.append((found, tried))
    return out
