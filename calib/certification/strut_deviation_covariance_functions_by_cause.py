"""Covariance functions of strut deviations, one for each cause.

Each component has a mean square of 1 in use: over the workspace, moves between its configurations, and the
recording's own times, temperatures and loads. Its size (m) is then what it adds to a strut's error there.
docs/mathematics.md (21)
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.certification.held_out_pose_errors_and_distinct_configurations import axis_travel_limits
from calib.correction.machine_correction import indices_and_poses_of_solvable_commands
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats, Integers
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Parallel
from rig.planning.configuration_generators import FILL, evenly_spread_configurations
from rig.recording.recording_folder import PAYLOAD

PLACES = 64  # of the workspace, at which signs are looked at
NOTHING = 1e-9  # of the greatest load, below which a strut is not loaded

Use = Callable[[Floats], tuple[Floats, Floats]]


def strut_load_signs_with_sign_mean_and_variance(
    samples: Samples, nominal: Parallel
) -> list[tuple[Floats, Use] | None]:
    """Signs (n,) of each strut's load at the samples, with the sign's mean and variance.

    Positive where it pushes, each with a `Component.use` of it.

    None where no sign changes over the workspace or nothing is known of weights. By the owner's geometry; payloads are
    those of the recording, each as likely as it was there.
    """
    if samples.conditions is None or samples.conditions.weight is None:
        return [None] * len(nominal.axes)
    weight, nothing = samples.conditions.weight, np.zeros(len(samples))
    carried = samples.conditions.channels.get(PAYLOAD, nothing)
    each, count = np.unique(np.round(carried, 3), return_counts=True)
    ranges = axis_travel_limits(nominal)
    middle, half = ranges.mean(axis=1), np.ptp(ranges, axis=1) / 2

    def seen(T: RigidTransform, commands: Floats, payload: Floats) -> Floats:
        loads = mechanisms.kinematics_of(nominal).axis_forces_and_torques(
            T, commands, nominal, weight.wrench(T, payload)
        )
        return np.asarray(np.sign(loads) * (np.abs(loads) > NOTHING * np.abs(loads).max(initial=0.0)))

    @cache
    def mean_signs(
        places: bytes,
    ) -> Floats:  # (m, axes), mean over the payloads, 0 of lengths that close on no pose; cached for all struts
        commands = middle + half * np.frombuffer(places).reshape(-1, len(middle))
        index, T = indices_and_poses_of_solvable_commands(
            commands, lambda values: mechanisms.kinematics_of(nominal).forward(values, nominal)
        )
        signs = np.zeros(commands.shape)
        signs[index] = np.average(
            [seen(T, commands[index], np.full(len(index), kg)) for kg in each], axis=0, weights=count
        )
        return signs

    def use(i: int) -> Use:
        def mean_and_variance(places: Floats) -> tuple[Floats, Floats]:
            mean = mean_signs(np.ascontiguousarray(places, float).tobytes())[:, i]
            return mean, np.maximum(1 - mean**2, 0.0)

        return mean_and_variance

    recorded = seen(samples.T_base_platform, samples.effective, carried)
    anywhere = mean_signs(((evenly_spread_configurations(nominal, PLACES) - middle) / half).tobytes())
    both = np.concatenate([recorded, anywhere])
    turning = recorded.any(axis=0) & (both.min(axis=0) < 1) & (both.max(axis=0) > -1)
    return [(recorded[:, i], use(i)) if turns else None for i, turns in enumerate(turning)]


OWN, WHOLE = (
    (0.15, 0.5, 1.5),
    (1.8, 4.0),
)  # half strokes over which a function of the strut's own command, of the whole configuration, changes
TIMES = (0.1, 0.4)  # of the recording's duration, over which a function of time changes
SAMPLE, CONFIGURATION, PLACE, CONDITION = "sample", "configuration", "place", "condition"
RANK = 1e-3  # of a kernel's greatest eigenvalue, below which its directions count as scatter
SIDED = 0.03  # probability, before the poses, of a strut whose joints have a clearance
WARM, HEAVY = 0.05, 1e-3  # K and kg, spread of a logged temperature and load from which they have varied

Kernel = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """One function of a strut's deviations at n samples. name : on what it depends; likely : probability, before the
    poses, that a machine has it

    over : SAMPLE or CONFIGURATION, each by itself, PLACE or CONDITION; basis : (n, r), function = basis @ N(0, size^2
        I)
    kernel, inputs : (n, axes) of a function of place, else None; use : of a condition with one number, places (m, axes)
    in half strokes -> ((m,) what it is multiplied by there in the mean, (m,) variance about that), as moves between
    places drawn at random have it; else None
    """

    name: str
    likely: float
    over: str
    basis: Floats
    kernel: Kernel | None = None
    inputs: Floats | None = None
    use: Callable[[Floats], tuple[Floats, Floats]] | None = None

    @property
    def word(self) -> str:
        """On what it depends, in a word that several components may share."""
        return self.name.split(",")[0]

    def at(self, places: Floats) -> tuple[Floats, Floats]:
        """((m, r) basis at places (m, axes) in half strokes, (m,) variance that it does not hold) of a function of
        place of size 1.
        """
        assert self.kernel is not None and self.inputs is not None
        K = self.kernel(places, self.inputs)
        basis = K @ np.linalg.pinv(self.basis).T
        own = np.array([self.kernel(one[None], one[None])[0, 0] for one in places])
        return basis, np.maximum(own - (basis**2).sum(axis=1), 0.0)


def scaled_commands(commands: Floats, strokes: Floats) -> Floats:
    """Commands (n, axes) m scaled to half strokes from the middle.

    strokes : (axes, 2) m
    """
    return np.asarray((commands - strokes.mean(axis=1)) / (np.ptp(strokes, axis=1) / 2))


def candidate_covariance_functions_of_strut_deviations(
    samples: Samples, label: Integers, nominal: Parallel
) -> list[list[Component]]:
    """Components (covariance functions) of each strut's deviations that the samples may show.

    label : (n,)
    """
    x, n = scaled_commands(samples.effective, axis_travel_limits(nominal)), len(samples)
    spread = FILL / np.sqrt(3)  # of a strut's place over the workspace, half strokes
    shared = [_scatter(n), *_repeated(label), *_times(samples), *_loads(samples, x)]
    whole = [_of_place(f"the configuration, over {length:g} half strokes", x, _whole(length)) for length in WHOLE]
    whole.append(_of_place("the configuration, in proportion", x, _linear(slice(None))))
    out = []
    for i, side in enumerate(strut_load_signs_with_sign_mean_and_variance(samples, nominal)):
        step = np.diff(x[:, i], prepend=x[0, i]) / (spread * np.sqrt(2))
        own = [
            replace(_line("the last step", 0.04, step), use=_stepped(i)),
            *(_of_place(f"the strut's own length, over {length:g} half strokes", x, _own(i, length)) for length in OWN),
            _of_place("the strut's own length, in proportion", x, _linear(slice(i, i + 1))),
            *whole,
            *_warmth(samples, i),
        ]
        if samples.conditions is not None:
            direction = samples.conditions.direction[:, i]
            own += [
                replace(_line("the direction of approach", 0.12, direction), use=_approached(i)),
                replace(
                    _line("the direction of approach, along the stroke", 0.04, direction * x[:, i] / spread),
                    use=_along(i),
                ),
            ]
        if side is not None:
            own.append(replace(_line("the sign of its load", SIDED, side[0]), use=side[1]))
        out.append([*shared, *(one for one in own if one.basis.any())])
    return out


def _approached(i: int) -> Callable[[Floats], tuple[Floats, Floats]]:
    """A place is come to from below the more often the higher it lies."""
    return lambda x: (x[:, i] / FILL, np.maximum(1 - (x[:, i] / FILL) ** 2, 0.0))


def _along(i: int) -> Callable[[Floats], tuple[Floats, Floats]]:
    def use(x: Floats) -> tuple[Floats, Floats]:
        mean, variance = _approached(i)(x)
        factor = x[:, i] * np.sqrt(3) / FILL
        return mean * factor, variance * factor**2

    return use


def _stepped(i: int) -> Callable[[Floats], tuple[Floats, Floats]]:
    return lambda x: (x[:, i] * np.sqrt(1.5) / FILL, np.full(len(x), 0.5))


def _scatter(n: int) -> Component:
    return Component("scatter", 0.2, SAMPLE, np.eye(n))


def _repeated(label: Integers) -> list[Component]:
    """What comes again at a configuration and yields nothing of others: known apart from scatter only where some are
    visited again.
    """
    seen = (label[:, None] == np.unique(label)).astype(float)
    return (
        [Component("the configuration, at short distances", 0.1, CONFIGURATION, seen)]
        if seen.shape[1] < len(label)
        else []
    )


def _line(name: str, likely: float, values: Floats) -> Component:
    return Component(name, likely, CONDITION, values[:, None].astype(float))


def _times(samples: Samples) -> list[Component]:
    span = float(np.ptp(samples.t))
    if not span > 0:
        return []
    t = (samples.t - samples.t.min()) / span
    apart = t[:, None] - t
    K = np.mean([np.exp(-0.5 * (apart / length) ** 2) for length in TIMES], axis=0)
    return [Component("time", 0.08, CONDITION, _root(K))]


def _warmth(samples: Samples, i: int) -> list[Component]:
    """Linear in the strut's own temperature and in the room's, where these are logged and vary."""
    if samples.conditions is None:
        return []
    channels = samples.conditions.channels
    names = [
        f"strut{i + 1}_temperature_C",
        *(name for name in channels if not name.startswith("strut") and name.endswith("temperature_C")),
    ]
    return [
        _line(
            "temperature, the strut's" if name.startswith("strut") else "temperature, the room's",
            0.08,
            _standard(channels[name]),
        )
        for name in names
        if name in channels and np.std(channels[name]) > WARM
    ]


def _loads(samples: Samples, x: Floats) -> list[Component]:
    """The load times a function of the configuration, as it is shared out to the struts."""
    if (
        samples.conditions is None
        or PAYLOAD not in samples.conditions.channels
        or not np.std(samples.conditions.channels[PAYLOAD]) > HEAVY
    ):
        return []
    load = _standard(samples.conditions.channels[PAYLOAD])
    return [Component("load", 0.2, CONDITION, load[:, None] * _root(0.5 + 0.5 * _whole(WHOLE[0])(x, x)))]


def _standard(values: Floats) -> Floats:
    return np.asarray((values - values.mean()) / values.std())


def _of_place(name: str, x: Floats, kernel: Kernel) -> Component:
    return Component(name, 0.03, PLACE, _root(kernel(x, x)), kernel, x)


def _whole(length: float) -> Kernel:
    def kernel(a: Floats, b: Floats) -> Floats:
        square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
        return np.asarray(np.exp(-0.5 * np.maximum(square, 0) / length**2))

    return kernel


def _linear(some: slice) -> Kernel:
    """Linear in the places along some struts."""

    def kernel(a: Floats, b: Floats) -> Floats:
        return np.asarray(a[:, some] @ b[:, some].T * 3 / FILL**2 / a[:, some].shape[1])

    return kernel


def _own(i: int, length: float) -> Kernel:
    return lambda a, b: np.asarray(np.exp(-0.5 * ((a[:, None, i] - b[:, i]) / length) ** 2))


def _root(K: Floats) -> Floats:
    """(n, r) root of a kernel (n, n) without its faintest directions."""
    values, vectors = np.linalg.eigh(K)
    some = values > RANK * values[-1]
    return np.asarray(vectors[:, some] * np.sqrt(values[some]))
