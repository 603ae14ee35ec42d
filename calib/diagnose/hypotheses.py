"""Every effect of the catalogue at every place where a recording can be asked for it, and what each of them does there."""

from dataclasses import dataclass, field

import numpy as np

from rig.effects import ALL
from rig.effects.base import Context, Effect
from rig.effects.candidate import COUNT
from rig.effects.candidate import Candidate as Family
from rig.errors import RigError

@dataclass(frozen=True, slots=True)
class Skipped:
    """An effect that this recording cannot show, and why."""

    effect: str
    reason: str


def families(knowledge, only=None, without=()):
    """([Family], [Skipped]) for a Knowledge. only, without : names of effects, or "effect place"; all by default."""
    out, skipped, context = [], [], context_of(knowledge)
    for kind in ALL:
        if kind.discrete or (only and not any(text.split(" ")[0] == kind.name for text in only)) or kind.name in without:
            continue
        try:
            for place in kind.sites(context):
                if f"{kind.name} {place}" in without or (only and not {kind.name, f"{kind.name} {place}"} & set(only)):
                    continue
                out += kind.candidates(place, context)
        except RigError as error:
            skipped.append(Skipped(kind.name, str(error)))
    return out, skipped


def context_of(knowledge):
    """The effects' Context of a Knowledge."""
    k, seen = knowledge, {}
    if k.seen is not None:
        rows, markers = np.unique(k.seen.observations.marker), k.seen.markers
        targets = {markers.target[m] for m in rows}
        seen = {"cameras": tuple(k.design.cameras[i].name for i in np.unique(k.seen.observations.camera)),
                "markers": tuple(int(markers.id[m]) for m in rows), "targets": tuple(t.name for t in k.stated.targets if t.name in targets)}
    return Context(k.stated, k.t, k.sensors, k.motion(()) if k.axes else None, moving=tuple(k.design.cameras[i].name for i in k.moving), **seen)


@dataclass(slots=True, eq=False)
class Signatures:
    """What effects do, at one Knowledge; derivatives in pixels are kept, since they cost most and hardly change."""

    knowledge: object
    pixels: dict = field(default_factory=dict)

    def at(self, knowledge):
        """The same for another Knowledge of the same corners; what was kept stays."""
        return Signatures(knowledge, self.pixels if knowledge.seen is self.knowledge.seen else {})

    def deviation(self, family, shape, motion):
        """(F, axes, q) m per unit of each linear parameter; (F, axes, 1) m whole where the size is in the shape.

        motion : Motion with the admitted effects, so that it need not be made again
        """
        kind = family.kind
        if kind.times is Effect.times and kind.follow is Effect.follow and kind.sway is Effect.sway:
            return family.deviation(shape, motion)
        if not family.linear:
            return self._change(family.effect(shape, ()), motion)[..., None]
        out = []
        for j, (_, _, step) in enumerate(family.linear):
            unit = np.zeros(len(family.linear))
            unit[j] = step
            out.append(self._change(family.effect(shape, unit), motion) / step)
        return np.stack(out, axis=-1)

    def _change(self, effect, motion):
        kind, k = type(effect), self.knowledge
        if kind.times is Effect.times and kind.follow is Effect.follow:
            out = effect.deviation(motion)
            sway = effect.sway(motion)
            return out + k.swayed(sway) if sway.any() else out
        return k.effective((*k.effects, effect)) - k.effective()

    def seen(self, family, shape):
        """(sighting rows (s,), (s, 4, 2, q) px per unit of each linear parameter) of a view family at a shape; rows that cannot change are left out."""
        more = {name: value for name, value in shape.items() if name != COUNT}
        parts = [self.derivative(family.kind, family.place, name, index, step, shape.get(COUNT), more) for name, index, step in family.linear]
        return parts[0][0], np.stack([quads for _, quads in parts], axis=-1)

    def derivative(self, kind, place, name, index, step, length=None, shape=None):
        """(sighting rows (s,), (s, 4, 2) px per unit) of one linear parameter of a view effect, about nothing.

        index : of a vector or None; length : of a vector of any length; shape : {parameter: value} of the others
        """
        shape = shape or {}
        key = (kind.name, place, name, index, length, *sorted(shape.items()))
        if key not in self.pixels:
            k, rows, effects = self.knowledge, self._rows(place), []
            parameter = next(p for p in kind.parameters if p.name == name)
            for sign in (1, -1) if parameter.bounds[0] < 0 else (2, 0):
                value = sign * step
                if index is not None:
                    value = tuple(value if j == index else 0.0 for j in range(parameter.size or length))
                effects.append(kind(place, **{**shape, name: value}))
            if kind.print_ is not Effect.print_ and name != "terms":  # what happens to pixels alone needs no camera
                quads, camera = self._quads(rows)
                both = [np.concatenate([e.print_(k.design.cameras[i], quads[camera == i]) for i in np.unique(camera)]) for e in effects]
                back = np.argsort(np.argsort(camera, kind="stable"), kind="stable")
                both = [b[back] for b in both]
            else:
                run = k.run((*k.effects, effects[0]))
                both = [k.pixels((*k.effects, e), rows, run) for e in effects]
            self.pixels[key] = rows, (both[0] - both[1]) / (2 * step)
        return self.pixels[key]

    def _quads(self, rows):
        key = ("quads", len(rows), int(rows[0]) if len(rows) else 0)
        if key not in self.pixels:
            self.pixels[key] = self.knowledge.pixels(None, rows), self.knowledge.seen.sightings.camera[rows]
        return self.pixels[key]

    def _rows(self, place):
        s, (kind, _, name) = self.knowledge.seen.sightings, place.partition(" ")
        if kind == "camera":
            names = [c.name for c in self.knowledge.design.cameras]
            return np.flatnonzero(s.camera == names.index(name))
        if kind == "marker":
            return np.flatnonzero(self.knowledge.seen.markers.id[s.marker] == int(name))
        if kind == "target":
            return np.flatnonzero(np.array([t == name for t in self.knowledge.seen.markers.target])[s.marker])
        return np.arange(len(s.frame))

    def corners(self, rows, quads):
        """(n, 2, q) px of all observed corners from those of some sightings."""
        seen = self.knowledge.seen
        at = np.full(len(seen.sightings.frame), -1)
        at[rows] = np.arange(len(rows))
        hit = np.flatnonzero(at[seen.row] >= 0)
        out = np.zeros((len(seen.row), 2, quads.shape[-1]))
        out[hit] = quads[at[seen.row[hit]], seen.observations.corner[hit]]
        return out


__all__ = ["Family", "Signatures", "Skipped", "families"]
