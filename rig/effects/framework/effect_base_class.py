"""Effect, the base class of all effects.

Name, place, parameters with units and bounds, and a hook at the stage where it acts.

Stages, in the order in which a command becomes a corner: `command` (axis commands and their times), `struts` (what
the axes, struts or joints, do beyond that), `structure` (what the frame and platform do), `targets` (where markers
sit), `view` (how a camera images it). Every hook of the base class changes nothing; an effect overrides the ones
that it needs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import Field, dataclass, fields
from itertools import product
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np

from rig.array_and_json_types import Floats
from rig.effects.framework.machine_motion_and_play import SOON, Motion, Path
from rig.effects.framework.parameters_covariates_and_marker_table import (
    COUNT,
    QUADRATURE,
    SEARCHED,
    Context,
    ControllerTerm,
    Covariate,
    Drawing,
    Linear,
    Markers,
    Node,
    Parameter,
    draw_parameter,
    grid_nodes_of_both_signs,
    numerical_derivative_step,
    parameter_grid,
    parameter_values,
)
from rig.errors import RigError
from rig.model.arm_hands_effect_places_and_tolerances import AXES, Place, Tolerance, axis_mask
from rig.model.design import Camera

REFERENCE_TEMPERATURE = 20.0  # degrees Celsius, at which dimensions are as stated
MOTION_STAGES, LINEAR = ("command", "struts", "structure"), ("linear", "inverse")  # stages; roles of parameters
AT_REST, NEAR_MOTION = 1e-9, 0.1  # m/s or rad/s; s from motion, within which a late clock makes rest motion
SELDOM = 0.25  # share of draws in which an effect that may start at a moment does so


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """An effect at a place with the values of its nonlinear parameters among which to search.

    kind : class of the effect; place; grid : [{parameter: value}], in the order of the search
    linear : [Linear] of the columns, none where the effect's size is part of its node; label : which variant
    extra : how many nonlinear parameters the search chooses; tied : how many coefficients the others determine
    spacing : between values of the one parameter of the grid that are even multiples of it, 0 for all others
    """

    kind: "type[Effect]"
    place: str
    grid: list[Node]
    linear: list[Linear]
    label: str = ""
    extra: int = 0
    tied: int = 0
    spacing: float = 0.0

    def effect(self, node: Node, coefficients: Floats) -> "Effect":
        """The effect of a node with coefficients (q,) of its linear parameters."""
        return self.kind.composed(self, node, coefficients)

    def deviation(self, node: Node, motion: Motion) -> Floats:
        """Deviation of axes (n, axes, q) m or rad per unit of each linear parameter; whole where the node has the size.

        For effects that change neither time nor path, see Effect.follow.
        """
        return self.kind.columns_of_nodes(self, [node], motion)[0]


class Effect:
    """Base of all effects.

    places : kinds of place it can sit at ("axis": a strut or a joint); experiment : what would expose it
    joint_experiment : of a joint, if another; action : what an owner can do, with "{axis}" too; of_links : of an arm's
    on_pose : its deviation depends on the pose; sudden : it happens at one time; rolls : image rows exposed in turn
    discrete : found from corners set aside, not by its derivative; moving : shows only in exposures on the way
    form : what the model is a function of, if simple: own travel ("slope", "sinusoid", "profile"), "load" or "step"
    own_axis : depends on the axis' position alone, 1 for the simplest; once : a second at a place would be the first
    lasting : the machine does it again, so that commands can undo it; tolerance : within which it is no fault
    instrumented : an instrument of its own shows it, so that it is fitted, and neither searched for nor drawn
    fixed_mount : its camera stands still; cardans : kinds of joints at struts' ends that it needs one of
    whole_turns : it needs the travel of a turn; flat : markers stay flat, as drawn; warps : takes in all smooth ones
    view : how residuals in the image show it: "displacement", "map", "time", "scale", "outward", "markers" or "targets"
    """

    __slots__ = ()
    name: ClassVar[str] = ""
    stage: ClassVar[str] = ""
    places: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    experiment: ClassVar[str] = ""
    joint_experiment: ClassVar[str] = ""
    action: ClassVar[str] = ""
    on_pose: ClassVar[bool] = False
    sudden: ClassVar[bool] = False
    discrete: ClassVar[bool] = False
    moving: ClassVar[bool] = False
    rolls: ClassVar[bool] = False
    form: ClassVar[str | None] = None
    own_axis: ClassVar[int] = 0
    once: ClassVar[bool] = False
    lasting: ClassVar[bool] = True
    instrumented: ClassVar[bool] = False
    of_links: ClassVar[bool] = False
    tolerance: ClassVar[Tolerance | tuple[float, float] | None] = None
    cardans: ClassVar[tuple[str, ...]] = ()
    whole_turns: ClassVar[bool] = False
    fixed_mount: ClassVar[bool] = False
    flat: ClassVar[bool] = True
    warps: ClassVar[bool] = False
    view: ClassVar[str] = "displacement"

    if TYPE_CHECKING:  # every effect is a dataclass of its place and parameters
        __dataclass_fields__: ClassVar[dict[str, Field[object]]]
        place: str

        def __init__(self, place: str, **values: object) -> None: ...

    def needs(self, motion: Motion) -> str | None:
        """What a machine or its recording lacks for this effect, in words that follow its name; None for nothing."""
        lacks_cardan = motion.no_cardans(self.cardans) if self.cardans else None
        return lacks_cardan or (motion.no_turn(self.axes(motion.places)) if self.whole_turns else None)

    def times(self, t: Floats) -> Floats:
        """(n,) s on the commands' clock at which exposures logged at t (n,) really happened."""
        return t

    def follow(self, path: Path, places: tuple[str, ...]) -> Path:
        """Path that the axes (their places) follow when commanded to follow a path."""
        return path

    @classmethod
    def retimes(cls) -> bool:
        """Whether it changes when, or along which path, the axes move."""
        return cls.times is not Effect.times or cls.follow is not Effect.follow

    def forgets(self) -> float:
        """m or rad of travel one way after which it no longer matters how an axis stood before; 0 for no memory."""
        return 0.0

    def deviation(self, motion: Motion) -> Floats:
        """(n, axes) m or rad that the axes are beyond their command, by this effect."""
        return np.zeros(motion.lengths.shape)

    def sway(self, motion: Motion) -> Floats:
        """(n, 6) tangent by which the platform is displaced, on the right (m, rad)."""
        return np.zeros((len(motion.t), 6))

    def lean(self, motion: Motion) -> Floats:
        """(n, 3) rad, rotation vectors of the base in the frame of poses, as tilt sensors see."""
        return np.zeros((len(motion.t), 3))

    def attach(self, markers: Markers) -> Markers:
        """Markers (id (m,), T_body_marker (m,), side (m,), target names) as the markers really sit."""
        return markers

    def camera(self, camera: Camera) -> Camera:
        """The Camera that really looks."""
        return camera

    def mount(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        """(n, 6) tangent, on the right, by which a camera's mount has moved at t (n,) s; channel(name) -> (n,)."""
        return np.zeros((len(t), 6))

    def focal(self, camera: Camera, t: Floats, channel: Callable[..., Floats]) -> Floats:
        """(n,) factor on a camera's focal length."""
        return np.ones(len(t))

    def bend(self, camera: Camera, points: Floats) -> Floats:
        """Points (..., 3) m of a camera's frame where they appear to be."""
        return points

    def late(self, camera: Camera, v: Floats) -> Floats:
        """(...,) s by which image row v (...,) is exposed after the middle row."""
        return np.zeros(np.shape(v))

    def print_(self, camera: Camera, quads: Floats) -> Floats:
        """Marker corners (..., 4, 2) px as they appear, given where their edges are."""
        return quads

    @classmethod
    def bending(cls, camera: Camera, quads: Floats, columns: Sequence[Linear]) -> Floats | None:
        """(..., 4, 2, q) px that `print_` moves corners (..., 4, 2) px by, per unit of each column, or None."""
        return None

    def in_controller(self, motion: Motion) -> ControllerTerm | None:
        """What a controller computes of it at its axes, motion : of that machine; None where it has no such form."""
        return None

    def uncovered(self, motion: Motion) -> Floats:
        """(n, axes) m or rad by which axes may stand elsewhere (1 sigma) at exposures unlike all it was learnt from."""
        return np.zeros(motion.lengths.shape)

    def covariate(self, motion: Motion) -> Covariate:
        """What the residuals of the axes show it against; by default the prediction of the model."""
        words = " or ".join(dict.fromkeys(f"µ{unit}" for unit in motion.units))
        return Covariate(self.deviation(motion) * 1e6, f"what the model says, {words}")

    def direction(self, motion: Motion) -> Floats | None:
        """(n, 6) tangents along which the residuals show it; None where each axis shows it for itself."""
        return None

    def conserved_sums(self) -> tuple[dict[tuple[str, int | None], float], ...]:
        """Sums of its parameters that a fit must keep, {(name, index): weight}."""
        return ()

    def fitted(self, parameter: Parameter) -> tuple[int | None, ...]:
        """Which numbers of a parameter a fit may move: (None,) for a single one, indices of a vector, () for none."""
        value = getattr(self, parameter.name)
        standard = parameter.role == "form" and value == getattr(type(self)(self.place), parameter.name)
        if parameter.role in ("moment", "choice") or standard:
            return ()
        return tuple(range(len(value))) if isinstance(value, tuple) else (None,)

    def written(self) -> Self:
        """The same effect in its own notation, after its numbers have moved."""
        return self

    @classmethod
    def follows(cls, place: str, context: Context) -> tuple[tuple[str, ...], ...]:
        """Temperatures that it follows at a place: of each the channels that measure it; none without a temperature."""
        return ()

    @classmethod
    def sites(cls, context: Context) -> tuple[str, ...]:
        """Places at which a recording can show it. Raises RigError where the recording lacks what it needs."""
        commanded = cls.stage in MOTION_STAGES
        if commanded and context.motion is None:
            raise RigError("nothing was commanded")
        if not commanded and not context.cameras:
            raise RigError("there are no corners")
        if cls.moving and context.moved().path.from_motion.min(initial=np.inf) > NEAR_MOTION:
            raise RigError("every exposure was taken at rest")
        found = cls._places(context)
        if cls.fixed_mount:  # a mount that moves has no place to leave
            found = tuple(place for place in found if Place.parse(place).name not in context.moving)
        lacking = cls.lacking(context) if commanded else {}
        if found and len(lacking) == len(found):
            raise RigError(f"{cls.name} {lacking[found[0]]}")
        return tuple(place for place in found if place not in lacking)

    @classmethod
    def lacking(cls, context: Context) -> dict[str, str]:
        """{place: reason} where the recording lacks what it needs."""
        return {place: reason for place in cls._places(context) if (reason := cls(place).needs(context.moved()))}

    @classmethod
    def _places(cls, context: Context) -> tuple[str, ...]:
        joints = {"rig", "axis"} <= set(cls.places) and context.moved().kind.AXIS != "strut"
        kinds = [kind for kind in cls.places if kind != "rig" or not joints]  # joints differ: all alike is no physics
        return tuple(place for kind in kinds for place in context.places_of_kind(kind))

    @classmethod
    def candidates(cls, place: str, context: Context) -> list[Candidate]:
        """Candidates at a place: a column for each linear parameter, a grid of the others, with and without a moment.
        What shows in motion alone is tried at sizes of either sign where every exposure was taken at rest."""
        linear = cls.linear(place)
        if cls.moving and linear and np.abs(context.moved().path.speed).max(initial=0.0) < AT_REST:
            return [
                Candidate(cls, place, grid_nodes_of_both_signs(cls.parameters, linear[0].name), [], "at rest", extra=1)
            ]
        searched = [p.at(place) for p in cls.parameters if p.tried or p.role in SEARCHED]
        late = {p.name for p in searched if p.role == "moment" and np.isinf(getattr(cls(place), p.name))}
        out = []
        for without in (late, set()) if late else (late,):
            grids = {p.name: parameter_grid(p, context.t) for p in searched if p.name not in without}
            nodes = [dict(zip(grids, values)) for values in product(*grids.values())]
            out.append(Candidate(cls, place, nodes, linear, "jump" if late - without else "", extra=len(grids)))
        return out

    @classmethod
    def linear(cls, place: str) -> list[Linear]:
        """The columns of the model at a place: its linear and inverse parameters, and the quadrature of a phase."""
        parameters = [p.at(place) for p in cls.parameters]
        own = [(p, None if p.size == 1 else j) for p in parameters if p.role in LINEAR for j in range(p.size)]
        return [Linear(p.name, index, numerical_derivative_step(p)) for p, index in own] + [
            Linear(QUADRATURE, None, numerical_derivative_step(next(q for q in parameters if q.role == "linear")))
            for p in parameters
            if p.role == "phase"
        ]

    @classmethod
    def composed(cls, candidate: Candidate, node: Node, coefficients: Floats) -> "Effect":
        """The effect of a Candidate's node with coefficients (q,) of its linear parameters."""
        return cls(candidate.place, **parameter_values(candidate.linear, node, coefficients, cls.parameters))

    @classmethod
    def columns(cls, candidate: Candidate, node: Node, motion: Motion) -> Floats:
        """(n, axes, q): see Candidate.deviation. The model is linear in these, so a small step of each suffices."""
        if not candidate.linear:
            return candidate.effect(node, np.zeros(0)).deviation(motion)[..., None]
        steps = np.diag([column.step for column in candidate.linear])
        return np.stack([candidate.effect(node, u).deviation(motion) / u.sum() for u in steps], axis=-1)

    @classmethod
    def columns_of_nodes(cls, candidate: Candidate, nodes: Sequence[Node], motion: Motion) -> Floats:
        """(k, n, axes, q) `columns` of several nodes (k,); a grid of thousands is made at once where an effect can."""
        return np.stack([cls.columns(candidate, node, motion) for node in nodes])

    @classmethod
    def of_numbers(cls, place: str, numbers: Sequence[float] | Floats) -> Self:
        """The effect at a place with numbers (n,) of its parameters, all of a fixed size, one after the other."""
        ends = np.cumsum([p.size for p in cls.parameters])[:-1]
        parts = zip(cls.parameters, np.split(np.asarray(numbers, float), ends))
        return cls(place, **{p.name: tuple(part.tolist()) if p.size > 1 else float(part[0]) for p, part in parts})

    def numbers(self) -> Floats:
        """(n,) numbers of its parameters, one after the other."""
        return np.concatenate([np.atleast_1d(getattr(self, p.name)) for p in self.parameters])

    @classmethod
    def exchanges(cls, marker: Place, others: Sequence[Place]) -> list[Self]:
        """What may have happened to a marker, alone or with one of others, to be tried; for a discrete effect."""
        return []

    def sites_touched(self) -> tuple[Place, ...]:
        """The Places at which it changes something: its own, and the other of an exchange."""
        return (self.site,)

    @classmethod
    def drawn(cls, place: str, drawing: Drawing, rng: np.random.Generator) -> Self:
        """One of a plausible size at a place. What may start at a moment, and by default does not, seldom does."""
        values = {}
        for p in cls.parameters_at(place):
            default = getattr(cls(place), p.name)
            if (
                p.role in ("choice", "form")
                or p.size == 0
                or (p.role == "moment" and np.isinf(default) and rng.random() >= SELDOM)
            ):
                continue
            values[p.name] = draw_parameter(p, drawing, rng)
        return cls(place, **values)

    @classmethod
    def parameters_at(cls, place: str) -> tuple[Parameter, ...]:
        """The parameters with their units, bounds and usual sizes at a place."""
        return tuple(p.at(place) for p in cls.parameters)

    @classmethod
    def experiment_at(cls, place: str) -> str:
        """What would expose it at a place, in words."""
        at = Place.parse(place)
        joint = at.kind == "joint" and cls.joint_experiment
        return (cls.joint_experiment if joint else cls.experiment).format(axis=at.axis_word)

    @classmethod
    def unusual(cls, place: str, values: Mapping[str, object]) -> str | None:
        """Which of {parameter name: number} at a place is far beyond what rigs show, in a sentence; None for none."""
        return next((text for p in cls.parameters_at(place) if (text := p.unusual(values.get(p.name)))), None)

    @classmethod
    def action_at(cls, place: str) -> str:
        """What an owner can do about it at a place, in a sentence."""
        return cls.action.format(axis=Place.parse(place).axis_word)

    @classmethod
    def label(cls) -> str:
        """Its name in words."""
        return cls.name.replace("_", " ")

    def values(self) -> dict[str, float | tuple[float, ...]]:
        """{parameter name: number or tuple} of this effect."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "place"}

    def problem(self) -> str | None:
        """What is wrong with its parameters together, in words, or None."""
        return None

    @property
    def site(self) -> Place:
        """Its Place."""
        return Place.parse(self.place)

    def at(self, place: Place | str) -> bool:
        """Whether this effect sits at a Place or its text; "rig", "cameras" and "markers" take in all of their kind."""
        return self.site.includes(Place.parse(place) if isinstance(place, str) else place)

    def axes(self, places: tuple[str, ...]) -> Floats:
        """(axes,) 1.0 for the axes (their places) where it sits, else 0.0. Raises RigError for an axis not there."""
        if self.site.is_axis and self.place not in places:
            raise RigError(f"{self.name} sits at {self.place}, and the machine's axes are {places[0]} to {places[-1]}")
        return axis_mask(self.site, places).copy()


__all__ = [
    "AXES",
    "COUNT",
    "MOTION_STAGES",
    "QUADRATURE",
    "REFERENCE_TEMPERATURE",
    "SOON",
    "Candidate",
    "Context",
    "Covariate",
    "Effect",
    "Linear",
    "Motion",
    "Parameter",
    "Path",
]
