"""Every effect of the catalogue at every place where it can sit, and the shapes among which its nonlinear parameters are sought."""

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from rig.effects import ALL
from rig.effects.base import Effect
from rig.effects.lens_distortion import count
from rig.errors import RigError

LOG_STEPS, EVEN_STEP = 14, 0.01  # values of a "log" parameter over its usual range; steps of an "even" one
SIZES = 16  # values of a "size" parameter over its usual range
EDGE = 4  # frames at either end that a moment leaves
KNOTS = (5, 9, 14)  # of a profile of any length
LENS = {"thin prism": (8, 9, 10, 11), "radial": (5, 6, 7), "both": (5, 6, 7, 8, 9, 10, 11)}  # terms that a lens may lack
WARP = (3, 5, 7)  # degrees of a smooth warp
DISCRETE = ("marker_swap",)  # found by looking at what corners were set aside, not by its derivative


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """An effect at a place with the values of its nonlinear parameters among which to search.

    kind : class of the effect; place; shapes : [{parameter: value}], in the order of the search
    linear : [(parameter, index or None, step)] of the columns, none where the effect's size is part of its shape
    label : which variant; extra : how many nonlinear parameters the search chooses
    """

    kind: type
    place: str
    shapes: list
    linear: list
    label: str = ""
    extra: int = 0

    @property
    def plane(self):
        """"struts" for what moves the platform, "view" for what changes only what is seen."""
        return "view" if self.kind.stage in ("targets", "view") else "struts"

    def effect(self, shape, coefficients):
        """The effect of a shape with coefficients (q,) of its linear parameters."""
        values, by = dict(shape), {p.name: p for p in self.kind.parameters}
        vectors = {name: np.zeros(by[name].size or shape["_count"]) for name, index, _ in self.linear if index is not None}
        for (name, index, _), c in zip(self.linear, coefficients):
            if name == "_quadrature":
                amplitude = next(p.name for p in self.kind.parameters if p.role == "linear")
                phase = next(p.name for p in self.kind.parameters if p.role == "phase")
                values[amplitude], values[phase] = float(np.hypot(values[amplitude], c)), float(np.arctan2(c, values[amplitude]))
            elif index is not None:
                vectors[name][index] = c
            elif by[name].role == "inverse":
                values[name] = 1 / c if c else np.inf
            else:
                values[name] = float(c)
        values.pop("_count", None)
        return self.kind(self.place, **values, **{name: tuple(v.tolist()) for name, v in vectors.items()})


@dataclass(frozen=True, slots=True)
class Skipped:
    """An effect that this recording cannot show, and why."""

    effect: str
    reason: str


def families(knowledge, only=None, without=()):
    """([Family], [Skipped]) for a Knowledge. only, without : names of effects, or "effect place"; all by default."""
    out, skipped = [], []
    for kind in ALL:
        if kind.name in DISCRETE or (only and not any(text.split(" ")[0] == kind.name for text in only)) or kind.name in without:
            continue
        if kind.stage not in ("targets", "view") and not knowledge.axes:
            skipped.append(Skipped(kind.name, "nothing was commanded"))
            continue
        if kind.stage in ("targets", "view") and knowledge.seen is None:
            skipped.append(Skipped(kind.name, "there are no corners"))
            continue
        try:
            for place in _places(kind, knowledge):
                if f"{kind.name} {place}" in without or (only and not {kind.name, f"{kind.name} {place}"} & set(only)):
                    continue
                out += _variants(kind, place, knowledge)
        except RigError as error:
            skipped.append(Skipped(kind.name, str(error)))
    return out, skipped


def _places(kind, k):
    """The places at which an effect can be asked for in this recording. Raises RigError where the recording lacks what it needs."""
    _trial(kind, k)
    places = []
    for place in kind.places:
        if place == "strut":
            places += [f"strut {i + 1}" for i in range(k.axes)]
        elif place == "camera":
            places += [f"camera {c.name}" for i, c in enumerate(k.design.cameras) if i in set(k.seen.observations.camera.tolist())]
        elif place == "cameras":
            places += ["cameras"] if len(k.design.cameras) > 1 else []
        elif place == "marker":
            places += [f"marker {k.seen.markers.id[m]}" for m in np.unique(k.seen.observations.marker)]
        elif place == "target":
            seen = {k.seen.markers.target[m] for m in np.unique(k.seen.observations.marker)}
            places += [f"target {t.name}" for t in k.stated.targets if t.name in seen]
        else:
            places.append(place)
    if kind.name in ("camera_drift", "camera_bump"):
        places = [p for p in places if not any(p == f"camera {k.design.cameras[i].name}" for i in k.moving)]
    return places


def _trial(kind, k):
    """Run a motion effect once, so that what it lacks is said before it is asked for at every place."""
    if kind.stage in ("targets", "view"):
        if kind.name == "focal_drift":
            k.sensors_or_fail().at(k.t, "ambient_temperature_C")
        return
    place = {"strut": "strut 1"}.get(kind.places[0], kind.places[0])
    motion = k.motion(())
    if kind.on_pose or kind.name == "thermal_expansion":
        kind("rig" if "rig" in kind.places else place).deviation(motion)


def _variants(kind, place, k):
    """Families of an effect at a place."""
    parameters = kind.parameters
    linear = [(p.name, None if p.size == 1 else j, _step(p)) for p in parameters if p.role in ("linear", "inverse") and p.size
              for j in range(p.size)]
    linear += [("_quadrature", None, _step(next(q for q in parameters if q.role == "linear"))) for p in parameters if p.role == "phase"]
    if kind.name == "lens_distortion":
        have = len(k.stated.camera(place.split(" ")[1]).distortion)
        lacking = [Family(kind, place, [{}], [("terms", j, 1e-4) for j in terms], label) for label, terms in LENS.items() if min(terms) >= have]
        return lacking + [Family(kind, place, [{"_count": count(d)}], [("warp", j, 1e-2) for j in range(count(d))], f"warp {d}") for d in WARP]
    if kind.name == "transmission_error":
        p = parameters[0]
        return [Family(kind, place, [{"_count": n}], [(p.name, j, _step(p)) for j in range(n)], f"{n} knots") for n in KNOTS]
    if kind.name == "vibration":
        return [Family(kind, place, [{"mode": float(m)}], linear, f"mode {m}", 2) for m in range(6)]
    grids = {p.name: _grid(p, k) for p in parameters if p.role in ("size", "log", "even", "moment")}
    if kind.name == "time_offset":
        return [Family(kind, place, [{}], linear), Family(kind, place, [{"since": v} for v in grids["since"]], linear, "jump", 1)]
    shapes = [dict(zip(grids, values)) for values in product(*grids.values())]
    return [Family(kind, place, shapes, linear, extra=len(grids))]


def _step(p):
    """A small value of a parameter, for its derivative."""
    size = np.sqrt(p.usual[0] * p.usual[1]) if p.usual[0] > 0 else 1e-2 * max(map(abs, p.usual))
    return 1 / size if p.role == "inverse" else 0.1 * size


def _grid(p, k):
    low, high = p.usual
    if p.role in ("size", "log"):
        return np.geomspace(low, high, SIZES if p.role == "size" else LOG_STEPS).tolist()
    if p.role == "even":
        return np.arange(max(low * 0.3, p.bounds[0]), min(high * 2.5, p.bounds[1]), EVEN_STEP).tolist()
    t = k.t
    return ((t[EDGE - 1 : -EDGE] + t[EDGE : len(t) - EDGE + 1]) / 2).tolist()


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

    def seen(self, family):
        """(sighting rows (s,), (s, 4, 2, q) px per unit of each linear parameter) of a view family; rows that cannot change are left out."""
        parts = [self.derivative(family.kind, family.place, name, index, step, family.shapes[0].get("_count")) for name, index, step in family.linear]
        return parts[0][0], np.stack([quads for _, quads in parts], axis=-1)

    def derivative(self, kind, place, name, index, step, length=None):
        """(sighting rows (s,), (s, 4, 2) px per unit) of one linear parameter of a view effect, about nothing.

        index : of a vector or None; length : of a vector of any length
        """
        key = (kind.name, place, name, index, length)
        if key not in self.pixels:
            k, rows, effects = self.knowledge, self._rows(place), []
            parameter = next(p for p in kind.parameters if p.name == name)
            for sign in (1, -1) if parameter.bounds[0] < 0 else (2, 0):
                value = sign * step
                if index is not None:
                    value = tuple(value if j == index else 0.0 for j in range(parameter.size or length))
                effects.append(kind(place, **{name: value}))
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
