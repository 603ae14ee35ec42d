"""Candidate effects of a platform, and sensitivities to them.

Candidates are every effect of the catalogue at every place that the recording can test. Sensitivities of axes and
corners to effects and their parameters are the columns of the linear model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cache
from typing import cast

import numpy as np

from calib.diagnosis.engine.candidate_scores_and_their_significance import Score
from calib.diagnosis.engine.candidate_selection_policy_and_outlier_data_types import (
    Candidate,
    Node,
    NotTested,
    Role,
    UsualRange,
)
from calib.diagnosis.engine.linear_residual_model import Column, join_columns
from calib.diagnosis.problems.evidence_interface_and_requested_effects import EffectSites, RequestedEffects
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import LinearisedModel
from rig.array_and_json_types import Floats, Integers
from rig.effects.framework.effect_base_class import Candidate as EffectCandidate
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import Coordinate, fit_coordinates_of_effects
from rig.effects.framework.machine_motion_and_play import Motion
from rig.effects.framework.parameters_covariates_and_marker_table import COUNT, QUADRATURE, Context, Linear
from rig.model.arm_hands_effect_places_and_tolerances import Place

SIZED = ("linear", "inverse", "size")  # roles of the numbers that tell how large an effect is
ROUNDED = 1e-12  # share by which a sinusoid stays below its amplitude's bound, so that rounding does not take it beyond
SEARCHED = ("log", "even", "moment", "form", "choice")  # roles of parameters that mean nothing without the effect


class Reach(Enum):
    """What an effect changes, and so how its columns are made: axes' lengths, a camera's mount, what is seen, a
    spectrum of frequencies.
    """

    AXES = "axes"
    MOUNT = "mount"
    VIEW = "view"
    SPECTRUM = "spectrum"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class PlatformCandidate(Candidate):
    """An effect at a place. spec : as the effect states it."""

    spec: EffectCandidate

    @property
    def kind(self) -> type[Effect]:
        """The class of the effect."""
        return self.spec.kind

    @property
    def seen_alone(self) -> bool:
        """Whether it changes only what is seen, and moves nothing."""
        return is_image_only_effect(self.kind)

    @property
    def reach(self) -> Reach:
        """What it changes."""
        if any(p.role == "frequency" for p in self.kind.parameters):
            return Reach.SPECTRUM
        if not self.seen_alone:
            return Reach.AXES
        whole = [column.entry for column in self.spec.linear] == list(range(6))  # its columns are the six of one motion
        return Reach.MOUNT if self.kind.mount is not Effect.mount and whole else Reach.VIEW

    def effect(self, node: Node, coefficients: Floats) -> Effect:
        """The effect of a node with coefficients (q,) of its linear parameters."""
        return self.spec.effect(node, coefficients)

    def allowed(self, coefficients: Floats) -> Floats:
        """Coefficients (q,) within the bounds; a sinusoid's all together within its amplitude's."""
        if not len(coefficients) or not any(column.name == QUADRATURE for column in self.spec.linear):
            return Candidate.allowed(self, coefficients)
        amplitude = next(p for p in self.kind.parameters_at(self.place) if p.role == "linear")
        high, size = amplitude.bounds[1], abs(float(getattr(self.effect({}, coefficients), amplitude.name)))
        return coefficients * ((1 - ROUNDED) * high / size if size > high else 1.0)

    def numbers(self, node: Node, coefficients: Floats) -> dict[str, float]:
        """{name: value} of what `usual` speaks of."""
        effect = self.effect(node, coefficients)
        return {u.name: getattr(effect, u.name) for u in self.usual or ()}


PlatformScore = Score[PlatformCandidate]


def is_image_only_effect(kind: type[Effect] | Effect) -> bool:
    """Whether an effect affects the images only, and moves nothing."""
    return kind.stage in ("targets", "view")


def platform_candidates_and_untested_effects(
    point: OperatingPoint, requested_effects: RequestedEffects
) -> tuple[list[PlatformCandidate], list[NotTested]]:
    """Platform candidates of the requested effects at an OperatingPoint, and effects that it cannot test."""
    context = effect_context(point)

    def sites_of(kind: type[Effect]) -> EffectSites:
        sites = kind.sites(context)
        if not kind.discrete:
            return EffectSites(sites, sites)
        ids = dict.fromkeys(point.observed.markers.id)  # a face that nobody saw may have been exchanged as well
        return EffectSites(tuple(str(Place("marker", str(number))) for number in ids), ())

    return requested_effects.candidates(
        sites_of, lambda kind, place: [platform_candidate(spec) for spec in kind.candidates(place, context)]
    )


def effect_context(point: OperatingPoint) -> Context:
    """The effects' Context of an OperatingPoint."""
    k, seen = point, {}
    if k.seen is not None:
        rows, markers = np.unique(k.observed.observations.marker), k.observed.markers
        targets = {markers.target[m] for m in rows}
        seen = {
            "cameras": tuple(k.design.cameras[i].name for i in np.unique(k.observed.observations.camera)),
            "markers": tuple(dict.fromkeys(markers.id[rows].tolist())),
            "targets": tuple(t.name for t in k.stated.targets if t.name in targets and t.turned is None),
        }
    return Context(
        k.stated,
        k.t,
        k.sensors,
        k.motion(()) if k.axes else None,
        moving=tuple(k.design.cameras[i].name for i in k.moving),
        **seen,
    )


def lacks_temperature_log(point: OperatingPoint, needed_channels: tuple[tuple[str, ...], ...]) -> bool:
    """Whether the recording lacks a needed temperature log.

    An effect needs it, each served by any of several channels.
    """
    logged = set(point.sensors.channels) if point.sensors is not None else set()
    return not all(logged & set(channels) for channels in needed_channels)


def platform_candidate(effect_candidate: EffectCandidate) -> PlatformCandidate:
    """PlatformCandidate of an effect's candidate, with the usual ranges of its parameters."""
    node, parameters = effect_candidate.grid[0], effect_candidate.kind.parameters_at(effect_candidate.place)
    named = {column.name for column in effect_candidate.linear} | set(node)
    usual = tuple(
        UsualRange(p.name, *p.usual, p.signed, Role(p.role))
        for p in parameters
        if p.size == 1 and p.name in named and p.role in SIZED
    )
    return PlatformCandidate(
        name=effect_candidate.kind.name,
        place=effect_candidate.place,
        grid=effect_candidate.grid,
        label=effect_candidate.label,
        extra=effect_candidate.extra,
        tied=effect_candidate.tied,
        usual=usual,
        searched=any(p.role in SEARCHED and p.name in node for p in parameters),
        bounds=coefficient_bounds(effect_candidate),
        vector=any(column.entry is not None for column in effect_candidate.linear),
        free_form=COUNT in node and not is_image_only_effect(effect_candidate.kind),
        spec=effect_candidate,
    )


def coefficient_bounds(effect_candidate: EffectCandidate) -> tuple[Floats, Floats]:
    """Bounds (low (q,), high (q,)) of the linear coefficients, from the parameters' bounds."""
    by, ends = {p.name: p for p in effect_candidate.kind.parameters_at(effect_candidate.place)}, []
    for column in effect_candidate.linear:
        if any(c.name == QUADRATURE for c in effect_candidate.linear):
            ends.append((-np.inf, np.inf))
        elif by[column.name].role == "inverse":
            low, high = by[column.name].bounds
            ends.append((1 / high if high else np.inf, 1 / low if low > 0 else np.inf))
        else:
            ends.append(by[column.name].bounds)
    both = np.array(ends, float).reshape(-1, 2)
    return both[:, 0], both[:, 1]


@dataclass(slots=True, eq=False)
class Sensitivities:
    """What effects do, at one OperatingPoint; derivatives in pixels are kept, since they cost most and hardly
    change.
    """

    point: OperatingPoint
    pixels: dict[tuple[object, ...], tuple[Integers, Floats]] = field(default_factory=dict)
    # {(effect, place, columns, other values): (CornerDerivatives, in frames' own poses (F, L, q), rest (2n, q))}
    split: dict[tuple[object, ...], tuple[object, Floats, Floats]] = field(default_factory=dict)
    without: dict[str, Floats] = field(default_factory=dict)  # by place, what is seen at this very point
    commanded: Floats | None = None  # what is effectively commanded there, once it is known

    def at(self, point: OperatingPoint) -> "Sensitivities":
        """The same for another OperatingPoint of the same corners; what was kept stays."""
        same = point.seen is self.point.seen
        return Sensitivities(point, self.pixels if same else {}, self.split if same else {})

    def deviation(self, candidate: PlatformCandidate, node: Node, motion: Motion) -> Floats:
        """(F, axes, q) m per unit of each linear parameter; (F, axes, 1) m whole where the size is in the node.

        motion : Motion with the admitted effects, so that it need not be made again
        """
        if self._is_plain(candidate):
            return candidate.spec.deviation(node, motion)
        if not candidate.spec.linear:
            return self._change(candidate.effect(node, np.zeros(0)), motion)[..., None]
        out = []
        for j, (_, _, step) in enumerate(candidate.spec.linear):
            unit = np.zeros(len(candidate.spec.linear))
            unit[j] = step
            out.append(self._change(candidate.effect(node, unit), motion) / step)
        return np.stack(out, axis=-1)

    def deviations(self, candidate: PlatformCandidate, nodes: Sequence[Node], motion: Motion) -> Floats:
        """(k, F, axes, q) the same of several nodes (k,)."""
        if self._is_plain(candidate):
            return candidate.kind.columns_of_nodes(candidate.spec, nodes, motion)
        return np.stack([self.deviation(candidate, node, motion) for node in nodes])

    def _is_plain(self, candidate: PlatformCandidate) -> bool:
        """Whether a candidate lengthens axes, and does nothing else."""
        return not candidate.kind.retimes() and candidate.kind.sway is Effect.sway

    def _change(self, effect: Effect, motion: Motion) -> Floats:
        kind, k = type(effect), self.point
        if not kind.retimes():
            return k.elongation(effect, motion)
        if self.commanded is None:
            self.commanded = k.effective()
        together = (*k.effects, effect)
        if kind.times is not Effect.times:
            return k.effective(together) - self.commanded
        moved = replace(motion, path=effect.follow(motion.path, motion.places))
        return moved.lengths + sum(k.elongation(one, moved) for one in together) - self.commanded

    def seen(self, candidate: PlatformCandidate, node: Node) -> tuple[Integers, Floats]:
        """(sighting rows (s,), (s, 4, 2, q) px per unit of each linear parameter) of what is seen at a node; rows that
        cannot change are left out.
        """
        direct = self.bent(candidate.kind, candidate.place, candidate.spec.linear)
        if direct is not None:
            return direct
        parts = [self.derivative(candidate.kind, candidate.place, column, node) for column in candidate.spec.linear]
        return parts[0][0], np.stack([quads for _, quads in parts], axis=-1)

    def bent(self, kind: type[Effect], place: str, columns: Sequence[Linear]) -> tuple[Integers, Floats] | None:
        """(sighting rows (s,), (s, 4, 2, q) px per unit of each column) of what bends one camera's image and says how,
        None for anything else.
        """
        if (at := Place.parse(place)).kind != "camera":
            return None
        rows = self._rows(place)
        found = kind.bending(self.point.design.camera(at.name), self._quads(rows)[0], columns)
        return None if found is None else (rows, found)

    def derivative(self, kind: type[Effect], place: str, column: Linear, node: Node) -> tuple[Integers, Floats]:
        """(sighting rows (s,), (s, 4, 2) px per unit) of one linear parameter of a view effect, about nothing.

        node : {parameter: value} of the others, and how many numbers a vector of any length has
        """
        name, index, step = column
        length, others = node.get(COUNT), {n: value for n, value in node.items() if n != COUNT}
        key = (kind.name, place, name, index, length, *sorted(others.items()))
        if key not in self.pixels:
            k, rows, effects = self.point, self._rows(place), []
            parameter = next(p for p in kind.parameters if p.name == name)
            for sign in (1, -1) if parameter.bounds[0] < 0 else (2, 0):
                numbers = range(parameter.size or length or 0)
                value = sign * step if index is None else tuple(sign * step if j == index else 0.0 for j in numbers)
                effects.append(kind(place, **{**others, name: value}))
            if kind.print_ is not Effect.print_ and name != "terms":  # what happens to pixels alone needs no camera
                quads, camera = self._quads(rows)
                both = [
                    np.concatenate([e.print_(k.design.cameras[i], quads[camera == i]) for i in np.unique(camera)])
                    for e in effects
                ]
                back = np.argsort(np.argsort(camera, kind="stable"), kind="stable")
                both = [b[back] for b in both]
            else:
                run = k.run((*k.effects, effects[0]))
                signed = parameter.bounds[0] < 0  # else the other end is the machine without it
                both = [
                    k.pixels((*k.effects, effects[0]), rows, run),
                    k.pixels((*k.effects, effects[1]), rows, run) if signed else self._without(place, rows),
                ]
            self.pixels[key] = rows, (both[0] - both[1]) / (2 * step)
        return self.pixels[key]

    def _without(self, place: str, rows: Integers) -> Floats:
        if place not in self.without:
            self.without[place] = self.point.pixels(None, rows)
        return self.without[place]

    def _quads(self, rows: Integers) -> tuple[Floats, Integers]:
        key = ("quads", len(rows), int(rows[0]) if len(rows) else 0)
        if key not in self.pixels:
            self.pixels[key] = cast(
                tuple[Integers, Floats], (self.point.pixels(None, rows), self.point.observed.sightings.camera[rows])
            )
        return cast(tuple[Floats, Integers], self.pixels[key])

    def _rows(self, place: str) -> Integers:
        s, at = self.point.observed.sightings, Place.parse(place)
        if at.kind == "camera":
            names = [c.name for c in self.point.design.cameras]
            return np.flatnonzero(s.camera == names.index(at.name))
        if at.kind == "marker":
            return np.flatnonzero(self.point.observed.markers.id[s.marker] == at.number)
        if at.kind == "target":
            return np.flatnonzero(np.array([t == at.name for t in self.point.observed.markers.target])[s.marker])
        return np.arange(len(s.frame))

    def corners(self, rows: Integers, quads: Floats) -> Floats:
        """(n, 2, q) px of all observed corners from those of some sightings."""
        hit, moved = self.touched(rows, quads)
        out = np.zeros((len(self.point.observed.row), 2, quads.shape[-1]))
        out[hit] = moved
        return out

    def touched(self, rows: Integers, quads: Floats) -> tuple[Integers, Floats]:
        """(observed corners (h,), (h, 2, q) px of them) of some sightings rows (s,), whose four are quads (s, 4, 2, q)
        px.
        """
        seen = self.point.observed
        at = np.full(len(seen.sightings.frame), -1)
        at[rows] = np.arange(len(rows))
        hit = np.flatnonzero(at[seen.row] >= 0)
        return hit, quads[at[seen.row[hit]], seen.observations.corner[hit]]


def effect_coordinates_and_directions(
    model: LinearisedModel, sensitivities: Sensitivities
) -> tuple[list[Coordinate], Column | None]:
    """Coordinates of the admitted effects' continuous parameters, and their directions in the residuals.

    Returns (coordinates, Column)
    """
    k, parts = model.point, []
    sensitivities, coordinates = sensitivities.at(k), fit_coordinates_of_effects(k.effects)
    motion = cache(lambda: k.motion(k.effects))
    for number, effect in enumerate(k.effects):
        own = [c for c in coordinates if c.effect == number]
        if (
            is_image_only_effect(effect)
            and type(effect).mount is Effect.mount
            and own
            and all(c.role == "linear" for c in own)
        ):
            parts.append(_still(model, effect, own, sensitivities))
            continue
        for c in own:
            ends = c.around(effect)
            moved, apart = [c.written(effect, end) for end in ends], ends[0] - ends[1]
            if not is_image_only_effect(effect) and not effect.retimes():
                high, low = (k.elongation(one, motion()) for one in moved)
            else:
                change = k.pixels if is_image_only_effect(effect) else k.effective
                high, low = (change((*k.effects[:number], one, *k.effects[number + 1 :])) for one in moved)
            column = model.fold if is_image_only_effect(effect) else model.lengthened
            parts.append(column(((high - low) / apart)[..., None]))
    return coordinates, join_columns(parts) if parts else None


def _still(model: LinearisedModel, effect: Effect, own: list[Coordinate], sensitivities: Sensitivities) -> Column:
    """Column of linear parameters of a view effect that is the same in every frame.

    It is split by the frames' own poses once for all models that share the derivatives of their corners.
    """
    columns = [Linear(c.name, c.index, c.step) for c in own]
    key = (type(effect).name, effect.place, *columns, *_others(effect).items())
    known = sensitivities.split.get(key)
    if known is None or known[0] is not model.derivatives:
        inner, rest = model.split_by_frames(_moved_corners(effect, columns, sensitivities))
        known = sensitivities.split[key] = model.derivatives, inner, rest
    return model.folded(*known[1:])


def _others(effect: Effect) -> Node:
    """{parameter: value} of an effect, but for the linear ones."""
    return {p.name: getattr(effect, p.name) for p in effect.parameters if p.role != "linear"}


def _moved_corners(effect: Effect, columns: list[Linear], sensitivities: Sensitivities) -> Floats:
    """(n, 2, q) px of all observed corners per unit of linear parameters of a view effect."""
    size = 0 if columns[0].entry is None else len(getattr(effect, columns[0].name))
    if [c.entry for c in columns] == list(range(size)):
        bent = sensitivities.bent(type(effect), effect.place, columns)
        if bent is not None:
            return sensitivities.corners(*bent)
    parts = []
    for column in columns:
        length = {} if column.entry is None else {COUNT: len(getattr(effect, column.name))}
        rows, quads = sensitivities.derivative(type(effect), effect.place, column, {**_others(effect), **length})
        parts.append(sensitivities.corners(rows, quads[..., None]))
    return np.concatenate(parts, axis=2)
