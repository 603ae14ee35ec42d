"""The configurations that determine a machine's parameters best."""

from functools import partial

from calib.api.plan_result import SEED, SHOWN, PlanOptions, PlanResult, geometry_and_excluded_configurations
from calib.certification.platform_certification import Progress
from calib.experiment.informative_configurations import FEWEST, informative_configurations
from calib.models.platform.optimal_configurations import choose_d_optimal_configurations
from calib.models.platform.parameter_accuracy import PLAUSIBLE, parameter_combinations, standard_error_along
from rig.errors import RigError
from rig.model.design import Design
from rig.model.mechanism_geometry import Arm, Chain, Planar2
from rig.model.mechanism_kinds import has_axes, has_plates
from vision.predict import visible_marker_counts
from vision.targets import marker_map


def plan_for_parameters(design: Design, options: PlanOptions, progress: Progress) -> PlanResult:
    """PlanResult of the configurations that determine a machine's parameters best. progress : called with (label, done,
    of)

    Raises RigError for a body that nothing commands, and for options that are of hexapods alone
    """
    mechanism = design.mechanism
    if not has_axes(mechanism):
        raise RigError(
            f"plans for parameters are for what is commanded, not for a mechanism of kind {mechanism.kind!r}"
        )
    if not has_plates(mechanism):
        return _plan_of_any(design, mechanism, options, progress)
    mechanism, avoided = geometry_and_excluded_configurations(options, mechanism)
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
        parameter_combinations(root, mechanism) for root in (chosen.before, chosen.root, chosen.even)
    )
    visited = 0 if options.given is None else len(options.given)
    said = [
        f"{options.count} configurations beside {visited} given: condition number of the 42 parameters "
        f"{seen.condition:.0f}, "
        f"with as many evenly spread {even.condition:.0f}",
        f"worst determined combination {after[0].sigma * 1e6:.2f} um, evenly spread "
        f"{PLAUSIBLE / even.singular[-1] * 1e6:.2f} um; "
        f"all 42 together {(seen.singular.prod() / even.singular.prod()) ** (1 / 42):.2f} times as precise "
        "as evenly spread",
    ]
    hidden = [part for part in before if not part.determined]
    if visited and not hidden:
        said.append("what was given determines all 42 already; the worst, before and after:")
    elif visited:
        said.append(
            f"{len(hidden)} combinations that what was given does not tell from {PLAUSIBLE * 1e3:g} mm "
            "become visible; the worst:"
        )
    else:
        said.append("the worst determined combinations:")
    said += [
        f"  {_sigma(part.sigma)} -> {_sigma(standard_error_along(chosen.root, part.direction))}  {part.name}"
        if visited
        else f"  {_sigma(part.sigma)}  {part.name}"
        for part in (before if visited else after)[:SHOWN]
    ]
    unseen = sum(not part.determined for part in after)
    why = said[0] + (f"; {unseen} combinations stay unseen" if unseen else "")
    return PlanResult(design, chosen.commands, not unseen, why, said)


def _plan_of_any(
    design: Design, mechanism: Arm | Chain | Planar2, options: PlanOptions, progress: Progress
) -> PlanResult:
    """PlanResult of the configurations that determine a machine's parameters best, of those in which cameras see it."""
    if options.calibration is not None or options.given is not None or options.criterion != "determinant":
        raise RigError("--calibration, --given and --criterion noise are for hexapods")
    looked = (
        partial(visible_marker_counts, design.cameras, markers=marker_map(design.without_stages()))
        if design.cameras and design.targets
        else None
    )
    found = informative_configurations(
        mechanism, options.count, options.sigma, looked, SEED, lambda done, of: progress("choosing", done, of)
    )
    said = []
    if looked is not None:
        said.append(
            f"{FEWEST} markers or more are seen in {found.seen:.0%} of the configurations all over the "
            "limits; chosen among these"
        )
    if found.undetermined:
        said.append(
            f"{found.undetermined} combinations of them no pose tells: they stay as stated, and are left aside here"
        )
    said.append(
        f"{options.count} configurations for {len(found.names)} parameters; standard errors, and by as "
        "many spread evenly, the least "
        "gain first:"
    )
    worst = (found.sigma / found.even).argsort()[::-1]
    said += [
        f"  {found.sigma[k] * 1e6:9.2f} {found.even[k] * 1e6:9.2f} u{found.units[k]}  {found.names[k]}"
        for k in worst[:SHOWN]
    ]
    why = f"{options.count} configurations for {len(found.names)} parameters"
    return PlanResult(design, found.values, True, why, ["", *said])


def _sigma(value: float) -> str:
    return f"{value * 1e6:9.2f} um" if value < 1e-2 else "   unseen   "
