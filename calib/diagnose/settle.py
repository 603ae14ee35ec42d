"""All that is admitted fitted together: cameras, geometry, poses and effects' parameters, by Gauss-Newton on both planes."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from calib.diagnose.corners import edges_of, standing
from calib.diagnose.knowledge import Knowledge, moved
from calib.diagnose.planes import Column, Planes, linearise
from calib.diagnose.search import column_of
from rig.effects.base import Effect, check
from rig.pose import exp

MAX_ITERATIONS = 8
SMALL = 0.02  # standard deviations; a step below settles a parameter
HALVINGS = 8
ENOUGH, SLACK = 0.3, 0.05  # of the cost; an iteration that gains less is the last; what rounding and clipped corners make uneven
LOOSE = 3.0  # times the greatest usual size: what a number of a vector may be before anything is measured
SWALLOWED = 0.15  # the same for a lens, whose terms and warps a camera's pose and stated lens take up almost whole
Z95 = 1.959964  # normal quantile of a 95 % interval


@dataclass(frozen=True, slots=True)
class Coordinate:
    """One continuous parameter of one admitted effect, as the fit sees it: index of a vector or None; role as the parameter's."""

    effect: int
    name: str
    index: int | None
    role: str
    step: float

    def read(self, effect):
        """The coordinate's value: the parameter, its reciprocal or its logarithm."""
        value = getattr(effect, self.name)
        value = value if self.index is None else value[self.index]
        return {"inverse": lambda v: 1 / v, "log": np.log, "size": lambda v: v}.get(self.role, lambda v: v)(value)

    def parameter(self, value):
        """The parameter's value of the coordinate's."""
        return {"inverse": lambda v: 1 / v if v else np.inf, "log": np.exp}.get(self.role, lambda v: v)(value)

    def written(self, effect, value):
        """The effect with the coordinate at a value."""
        value = float(self.parameter(value))
        if self.index is not None:
            vector = list(getattr(effect, self.name))
            vector[self.index] = value
            value = tuple(vector)
        return replace(effect, **{self.name: value})


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """knowledge, planes : at the optimum; coordinates : of the effects' parameters; values : (c,); covariance : (c, c) of them
    given nothing else; column : Column of their directions"""

    knowledge: Knowledge
    planes: Planes
    coordinates: list
    values: np.ndarray
    covariance: np.ndarray
    column: Column | None

    def likelihood(self, standing=None):
        """Minus twice the log likelihood at the optimum, but for a constant; to compare with another, where standing corners repeat as many px."""
        if standing is None or standing == self.knowledge.standing:
            return _comparable(self.planes)
        return _comparable(linearise(replace(self.knowledge, standing=standing)))

    def wald(self, effect):
        """(statistic, parameters): how far effect number `effect` stands from nothing, in squared standard deviations, its shape held:
        a shape that its size leaves open says nothing against it."""
        own = [i for i, c in enumerate(self.coordinates) if c.effect == effect]
        size = np.array([self.coordinates[i].role in ("linear", "inverse", "size") for i in own])
        theta, block = self.values[own][size], self.covariance[np.ix_(own, own)]
        scale = np.sqrt(np.diag(block))
        precision = np.linalg.pinv(block / scale[:, None] / scale, rcond=1e-10, hermitian=True) / scale[:, None] / scale
        return float(theta @ precision[np.ix_(size, size)] @ theta), int(size.sum())

    def intervals(self, effect):
        """{parameter: (value, low, high)} at 95 % of effect number `effect`; vectors as tuples."""
        out = {}
        for i, c in enumerate(self.coordinates):
            if c.effect != effect:
                continue
            half = Z95 * np.sqrt(self.covariance[i, i])
            ends = [float(c.parameter(self.values[i] + s * half)) if c.role != "inverse" or self.values[i] + s * half > 0 else np.inf
                    for s in (0, -1, 1)]
            ends[1:] = sorted(ends[1:])
            if c.index is None:
                out[c.name] = tuple(ends)
            else:
                for k in range(3):
                    out.setdefault(c.name, ([], [], []))[k].append(ends[k])
        return out


def admit(settled, score, signatures):
    """Settled with a Score's effect besides: all that is free moves with it from the start, so that even a large one fits in."""
    planes, k = settled.planes, settled.knowledge
    column, theta = column_of(planes, score.family, score.shape, signatures), score.coefficients
    parts = joined([c for c in (settled.column, column) if c is not None], len(planes.image), planes.local.shape[1], planes.frames)
    if not len(theta):  # its size is its shape: the rest makes room
        step = np.r_[np.zeros(len(settled.coordinates)), 1.0]
    else:
        by = {p.name: p for p in score.family.kind.parameters}
        loose = [_loose(by[name], index) if name in by else 0.0 for name, index, _ in score.family.linear]
        step = _step(planes, parts, np.r_[_priors(settled.coordinates, k.effects), loose], np.r_[settled.values, np.zeros(len(loose))],
                     _kept(settled.coordinates, k.effects, len(loose)))[0]
        theta = step[len(settled.coordinates) :]
    effects = list(k.effects)
    for c, s in zip(settled.coordinates, step):
        effects[c.effect] = c.written(effects[c.effect], c.read(effects[c.effect]) + s)
    z = planes.at_rest - planes.project(parts)[0] @ step
    try:
        effects = [check(effect) for effect in (*effects, score.family.effect(score.shape, theta))]
        knowledge = _apply(planes, planes.solve @ z, step, parts, effects)
    except ValueError:  # so large a step leaves what makes sense: all starts from where it stands, the effect as scanned
        knowledge = k.with_effects((*k.effects, score.effect))
    return settle(knowledge, signatures)


def released(settled, number):
    """Knowledge without an admitted effect, all that is free moved to where it makes up for it: the reverse of `admit`."""
    planes, effects = settled.planes, settled.knowledge.effects
    step = np.array([-v if c.effect == number and c.role in ("linear", "inverse", "size") else 0.0
                     for c, v in zip(settled.coordinates, settled.values)])
    z = planes.at_rest - planes.project(settled.column)[0] @ step
    return _apply(planes, planes.solve @ z, step, settled.column, [e for i, e in enumerate(effects) if i != number])


def settle(knowledge, signatures):
    """Settled of the admitted effects from where their parameters stand. What cannot improve any more stays.

    Standing corners are first taken at their covariance; only what they then still miss together, in every frame, loosens them.
    """
    settled = resettle(replace(knowledge, standing=0.0), signatures)
    left = standing(settled.knowledge)
    return resettle(replace(settled.knowledge, standing=left), signatures) if left else settled


def resettle(knowledge, signatures):
    """Settled as by `settle`, standing corners repeating as many px as the Knowledge already says."""
    planes = linearise(knowledge)
    coordinates, column = tangents(planes, signatures)
    for _ in range(MAX_ITERATIONS):
        priors, values = _priors(coordinates, knowledge.effects), [c.read(knowledge.effects[c.effect]) for c in coordinates]
        step, covariance = _step(planes, column, priors, np.array(values), _kept(coordinates, knowledge.effects))
        new, planes_new = _try(planes, coordinates, step, column)
        if new is None:
            break
        gained = _comparable(planes) - _comparable(planes_new)
        knowledge, planes = new, planes_new
        coordinates, column = tangents(planes, signatures)
        if (np.abs(step) < SMALL * np.sqrt(np.diag(covariance))).all() and gained < 1 or gained < ENOUGH:
            break
    values = np.array([c.read(knowledge.effects[c.effect]) for c in coordinates])
    _, covariance = _step(planes, column, _priors(coordinates, knowledge.effects), values, _kept(coordinates, knowledge.effects))
    return Settled(knowledge, planes, coordinates, values, covariance, column)


def tangents(planes, signatures):
    """(coordinates, Column of their directions) of the admitted effects at a linearisation."""
    k, coordinates, parts = planes.knowledge, [], []
    signatures = signatures.at(k)
    for number, effect in enumerate(k.effects):
        for p in effect.parameters:
            for index in effect.fitted(p):
                size = np.sqrt(p.usual[0] * p.usual[1]) if p.usual[0] > 0 else 0.1
                step = {"inverse": 1e-3 / size, "log": 1e-3, "size": 1e-2 * size, "phase": 1e-3, "even": 1e-5, "frequency": 1e-8}.get(
                    p.role, 1e-2 * size)
                coordinates.append(Coordinate(number, p.name, index, p.role, step))
    for number, effect in enumerate(k.effects):
        own = [c for c in coordinates if c.effect == number]
        if effect.stage in ("targets", "view") and type(effect).mount is Effect.mount and own and all(c.role == "linear" for c in own):
            pixels = [signatures.corners(*_still(effect, c, signatures)) for c in own]
            parts.append(planes.fold(np.concatenate(pixels, axis=2)))
            continue
        for c in own:
            both = [k.effects[:number] + (c.written(effect, c.read(effect) + s * c.step),) + k.effects[number + 1 :] for s in (1, -1)]
            if effect.stage in ("targets", "view"):
                parts.append(planes.fold(((k.pixels(both[0]) - k.pixels(both[1])) / (2 * c.step))[..., None]))
            else:
                parts.append(Column(None, planes.whitened(((k.effective(both[0]) - k.effective(both[1])) / (2 * c.step))[..., None])))
    return coordinates, joined(parts, len(planes.image), planes.local.shape[1], planes.frames)


def _still(effect, c, signatures):
    """(sightings, (s, 4, 2, 1) px per unit) of a linear parameter of a view effect that is the same in every frame."""
    parameter = next(p for p in effect.parameters if p.name == c.name)
    length = len(getattr(effect, c.name)) if c.index is not None and not parameter.size else None
    shape = {p.name: getattr(effect, p.name) for p in effect.parameters if p.role != "linear"}
    rows, quads = signatures.derivative(type(effect), effect.place, c.name, c.index, c.step, length, shape)
    return rows, quads[..., None]


def joined(parts, rows, local, frames):
    """One Column of several, or None of none."""
    if not parts:
        return None
    image = None
    if any(part.image is not None for part in parts):
        image = np.column_stack([np.zeros((rows, part.struts.shape[1])) if part.image is None else part.image for part in parts])
    inner = np.concatenate([np.zeros((frames, local, part.struts.shape[1])) if part.inner is None else part.inner for part in parts], axis=2)
    return Column(image, np.column_stack([part.struts for part in parts]), inner)


def _step(planes, column, priors, values, kept):
    """Step (c,) of the effects' coordinates and its covariance (c, c). priors : (c,) 1 / standard deviation; values : (c,) now; kept : (k, c)"""
    if column is None:
        return np.zeros(0), np.zeros((0, 0))
    _, b, G = planes.project(column)
    b, G = b - priors**2 * values, G + np.diag(priors**2)
    scale = np.sqrt(np.maximum(np.diag(G), 1e-300))
    open_ = null_space(kept / scale) if len(kept) else np.eye(len(G))
    values, vectors = np.linalg.eigh(open_.T @ (G / scale[:, None] / scale) @ open_)
    there = values > 1e-11 * max(values[-1], 1e-300)
    half = open_ @ (vectors[:, there] / np.sqrt(values[there])) / scale[:, None]
    return half @ (half.T @ b), half @ half.T


def _priors(coordinates, effects):
    """(c,) 1 / standard deviation that coordinates are given beforehand: vectors have directions that nothing sees."""
    by = [next(p for p in effects[c.effect].parameters if p.name == c.name) for c in coordinates]
    return np.array([_loose(p, c.index) for p, c in zip(by, coordinates)])


def _kept(coordinates, effects, more=0):
    """(k, c + more) sums of coordinates that effects ask to be kept; more : columns of what is to be admitted."""
    own = [[row.get((c.name, c.index), 0.0) * (c.effect == number) for c in coordinates] + [0.0] * more
           for number, effect in enumerate(effects) for row in effect.kept()]
    own = [row for row in own if any(row)]
    return np.array(own).reshape(len(own), len(coordinates) + more)


def _held(effects):
    """What the priors on vectors cost."""
    return float(sum(np.sum((np.asarray(getattr(e, p.name)) * _loose(p, 0)) ** 2) for e in effects for p in e.parameters
                     if p.role == "linear" and isinstance(getattr(e, p.name), tuple) and len(getattr(e, p.name))))


def _loose(parameter, index):
    return 0.0 if index is None or parameter.role == "direction" else 1 / ((SWALLOWED if parameter.name in ("terms", "warp") else LOOSE) * parameter.usual[1])


def _try(planes, coordinates, step, column):
    """(Knowledge, Planes) after as much of the step as lowers the cost, or (None, None)."""
    k = planes.knowledge
    for halving in range(HALVINGS):
        share = 0.5**halving
        effects = list(k.effects)
        try:
            for c, s in zip(coordinates, step):
                effects[c.effect] = c.written(effects[c.effect], c.read(k.effects[c.effect]) + share * s)
            effects = [check(effect.written()) for effect in effects]
        except ValueError:
            continue
        z = planes.at_rest - (planes.project(column)[0] @ (share * step) if column is not None else 0)
        new = _apply(planes, planes.solve @ z, share * step, column, effects)
        after = linearise(new)
        if _comparable(after) <= _comparable(planes) + SLACK:
            return new, after
    return None, None


def _comparable(planes):
    """Minus twice the log likelihood, Huber's for corners, but for a constant: what noise and scatter make of it included."""
    cost = planes.cost() + planes.excess + 2 * len(planes.image) * np.log(planes.sigma) + _held(planes.knowledge.effects)
    return cost - 2 * np.linalg.slogdet(planes.W)[1].sum() if planes.knowledge.axes else cost


def _apply(planes, freedoms, step, column, effects):
    """Knowledge with freedoms (p,) and each frame's own poses moved to where the fit puts them."""
    k = planes.knowledge
    inner = planes.inner[..., 0] - planes.inner[..., 1:] @ freedoms[: planes.inner.shape[2] - 1]
    if column is not None:
        inner = inner - column.inner @ step
    local = np.einsum("fij,fj->fi", planes.to_local, inner)
    cameras = list(k.design.cameras)
    for i, at in planes.camera_columns.items():
        value = freedoms[at]
        if i not in k.moving:
            cameras[i] = replace(cameras[i], pose=cameras[i].pose * exp(value[:6]))
            value = value[6:]
        matrix = cameras[i].matrix.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += value[:4]
        cameras[i] = replace(cameras[i], matrix=matrix, distortion=cameras[i].distortion + value[4:])
    finder = list(k.finder or [0.0] * len(cameras))
    for i, j in edges_of(planes.names, k.design):
        finder[i] += float(freedoms[j])
    m = k.design.mechanism
    if k.axes:
        g = freedoms[len(planes.names) - 42 :]
        m = replace(m, base_joints=m.base_joints + g[:18].reshape(6, 3), platform_joints=m.platform_joints + g[18:36].reshape(6, 3),
                    strut_zeros=m.strut_zeros + g[36:])
    if k.seen is None:
        local = np.zeros((planes.frames, 6))
    return replace(moved(k, cameras, m, local), effects=tuple(effects), finder=tuple(finder))
