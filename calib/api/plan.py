"""Which configurations to visit so that what is asked becomes visible: parameters, a promise, one effect or another."""

from itertools import combinations

import numpy as np

from calib.api.parameter_plan import plan_for_parameters
from calib.api.plan_result import (
    FOR_PARAMETERS,
    LEAST,
    MOVES,
    SEED,
    SHOWN,
    PlanOptions,
    PlanResult,
    geometry_and_excluded_configurations,
)
from calib.certification.platform_certification import Progress, silent_progress
from calib.diagnosis.effect_signal import Separation, effect_separation
from calib.models.platform.optimal_configurations import fewest_configurations
from calib.samples.confounded_conditions import confounds_of_configurations
from rig import api
from rig.effects.framework.effect import Effect
from rig.effects.texts.effect_notation import parse_effect, require_existing_place
from rig.errors import RigError
from rig.formats.number_parsing_and_rounding import quantity_text
from rig.model.design import Design
from rig.model.mechanism_kinds import has_plates
from rig.planning.plan import axis_strokes, build_plan, sensors_with_payload
from rig.planning.plan_construction_and_table import Plan
from rig.recording.recording_folder import Sensors


def plan(design: Design, options: PlanOptions = FOR_PARAMETERS, progress: Progress = silent_progress) -> PlanResult:
    """PlanResult of a design, as `rig plan` makes it. progress : called with (label, done, of)

    Raises RigError for what a design's machine cannot be planned for, and where nothing allowed shows what is asked

    >>> import calib, rig
    >>> design = rig.load_design("tests/data/bench/check/rig.toml")
    >>> calib.plan(design, calib.PlanOptions(parts="sobol:3")).values.shape
    (3, 6)
    """
    if options.promise is not None:
        found = _keeping_promise(design, options.promise, options, progress)
    elif options.separate is not None:
        return _separating(design, options.separate, options)
    elif options.parts is not None:
        done = api.plan(design, options.parts, SEED)
        found = PlanResult(design, done.values, True, str(done), done.lines())
    else:
        found = plan_for_parameters(design, options, progress)
    if not len(found.values):
        return found
    confounds = confounds_of_configurations(found.values, axis_strokes(design).mean(axis=1), design.mechanism)
    return PlanResult(design, found.values, found.seen, found.why, found.said, confounds)


def _keeping_promise(design: Design, promise: float, options: PlanOptions, progress: Progress) -> PlanResult:
    """PlanResult of the fewest configurations that keep a promise (m); of none where it is met without any."""
    if not has_plates(design.mechanism):
        raise RigError(f"plans for a promise are for hexapods, not for a mechanism of kind {design.mechanism.kind!r}")
    mechanism, avoided = geometry_and_excluded_configurations(options, design.mechanism)
    found = fewest_configurations(
        mechanism, promise, options.sigma, options.given, SEED, lambda done, of: progress("choosing", done, of), avoided
    )
    count, visited = len(found.commands), 0 if options.given is None else len(options.given)
    if not count:
        met = (
            f"by the {visited} configurations given"
            if visited
            else "by the geometry as it is stated, with no configuration visited"
        )
        said = [
            f"the promise of {quantity_text(promise, 'm')} is met {met}: "
            f"{quantity_text(found.left[0], 'm')} left; there is nothing to "
            f"visit"
        ]
    else:
        said = [
            f"{count} configurations beside {visited} given keep {promise * 1e6:.4g} um: "
            f"{found.left[0] * 1e6:.4g} -> "
            f"{found.left[-1] * 1e6:.4g} um RMS over the workspace, which 97.5 % of machines keep to; errors "
            "that all poses share come on top",
            "left after each: " + " ".join(f"{value * 1e6:.3g}" for value in found.left[1:]) + " um",
        ]
    return PlanResult(design, found.commands, True, said[0], said)


def _separating(design: Design, texts: tuple[str, str], options: PlanOptions) -> PlanResult:
    """PlanResult of the parts of plans, alone or two, by which two effects differ most."""
    effects = [require_existing_place(parse_effect(text), design) for text in texts]
    seen = [effect.name for effect in effects if effect.stage in ("targets", "view")]
    if seen:
        raise RigError(
            f"{', '.join(seen)} changes what is seen, not how the platform moves: no plan of moves tells it; "
            "see its own experiment in "
            "rig diagnose's page"
        )
    if not design.mechanism.axes:
        raise RigError(
            "plans to separate effects are for what is commanded, not for a mechanism of kind "
            f"{design.mechanism.kind!r}"
        )
    trials = _separations(design, effects, options)
    trials.sort(key=lambda trial: -trial[0].misfit / np.sqrt(trial[0].frames))
    said = ["misfit, in standard deviations, of the wrong model at its best (and for 100 exposures):"]
    said += [
        f"  {found.misfit:9.1f} {found.misfit * 10 / np.sqrt(found.frames):9.1f}   cosine "
        f"{found.cosine:6.3f}   {found.plan}"
        for found, _ in trials[:SHOWN]
    ]
    best, chosen = trials[0]
    if best.misfit < LEAST:
        said.append("no plan tried tells them apart at that size")
    said.append(f"best: {best.plan} (rig simulate --plan {best.plan} tries it)")
    why = f"{' and '.join(texts)} are told apart by {best.misfit:.1f} standard deviations with {best.plan}"
    return PlanResult(design, chosen.commands.values, best.misfit >= LEAST, why, said, t=chosen.commands.t)


def _separations(design: Design, effects: list[Effect], options: PlanOptions) -> list[tuple[Separation, Plan]]:
    """[(Separation of two effects, Plan)] of the parts of plans alone and two by two."""
    struts = has_plates(design.mechanism)
    moves = [text for text in MOVES if struts or not text.startswith("axes")]
    out = []
    for text in (*moves, *(",".join(pair) for pair in combinations(moves, 2))):
        tried = build_plan(design, text, SEED)
        end = tried.commands.t[-1]
        sensors = options.log(end) if options.log is not None else Sensors(np.array([0.0, end]), {})
        with_payload = sensors_with_payload(tried, sensors)
        found = effect_separation(text, design, tried.commands, tried.t, with_payload, effects, options.sigma)
        out.append((found, tried))
    return out
