"""Figures of effects on motion: a strut's command and travel through time, the displaced platform, covariates."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.arrays import Floats
from rig.effects.framework.effect import Effect
from rig.effects.framework.place import Place
from rig.effects.sketches.effect_example import AXIS, FAR, ExampleRun, Sketch, effect_example, place_and_values_text
from rig.model import motion_simulation
from rig.model.pose import exp, pose_difference
from rig.report.pages.plots import Series, plot_panel
from rig.report.pages.svg_elements import TEXT, WIDTH, svg_figure, svg_text

SHARE = 0.5  # of what is told, that errors are drawn as large as at the most
HIGH = 120.0  # of a panel's drawing
TURNED, RAISED = np.radians(25), np.radians(12)  # from where the platform is looked at
SIZE = 0.52 * WIDTH  # of the machine in its figure
OUT = 0.12  # m by which the platform is drawn displaced
FLOOR = 1e-12  # m; less is no error
UNITS = {1e-9: "nm", 1e-6: "µm", 1e-3: "mm"}
TIMES = {1e-3: "ms", 1.0: "s", 60.0: "min", 3600.0: "h"}


def draw_sketch(kind: type[Effect], factor: float = 1.0) -> Sketch:
    """Sketch drawn of an effect of a kind, `factor` times its largest usual size."""
    place = str(Place.axis("strut", AXIS)) if "axis" in kind.places else kind.places[0]
    way = effect_example(kind, place, factor)
    error = _strut_errors(way)
    first = _displaced(way) if kind.stage == "structure" or kind.on_pose else _through_time(way, error)
    return Sketch(place_and_values_text(way.effect), (first, _over_covariate(way, error)))


def _strut_errors(way: ExampleRun) -> Floats:
    """(n,) m by which the strut that is looked at stands beyond its command, at the exposures of a Way."""
    T = way.motion.T
    assert T is not None
    found = motion_simulation.effective_commands(way.design, way.commands, way.t, T, [way.effect], way.sensors)
    return found[:, AXIS] - way.motion.lengths[:, AXIS]


def _through_time(way: ExampleRun, error: Floats) -> str:
    """Where the strut is told to be, and where it is, its error enlarged."""
    told = way.motion.stroke[:, AXIS]
    much = enlargement_factor(np.abs(error).max(), SHARE * FAR)
    scale, unit = largest_suitable_unit(way.t[-1], TIMES)
    series = [
        Series(way.t / scale, told * 1e3, "told", "line", -1),
        Series(way.t / scale, (told + much * error) * 1e3, enlargement_text("done", much), "line", 1),
    ]
    return plot_panel(f"Strut {AXIS + 1}", (f"time, {unit}", "stroke, mm"), series, high=HIGH)


def _over_covariate(way: ExampleRun, error: Floats) -> str:
    """The error over what gives the effect away."""
    shown = way.effect.covariate(way.motion)
    across = np.asarray(shown.values)
    scale, unit = largest_suitable_unit(np.abs(error).max(), UNITS)
    values = across[:, AXIS] if across.ndim == 2 else across
    return plot_panel(
        "What gives it away",
        (shown.label, f"error of strut {AXIS + 1}, {unit}"),
        [Series(values, error / scale, "", "dots", 1)],
        high=HIGH,
    )


def _displaced(way: ExampleRun) -> str:
    """The platform where it should stand and where it does, at the exposure at which these lie farthest apart,
    enlarged.
    """
    T = way.motion.T
    assert T is not None
    found = motion_simulation.run_machine(way.design, way.commands, way.t, [way.effect], way.sensors).T_base_platform
    shift = pose_difference(T, found)
    far = np.linalg.norm(shift[:, :3], axis=1)
    at = int(np.argmax(far))
    much = enlargement_factor(float(far[at]), OUT)
    pair = RigidTransform.concatenate([T[at], T[at] * exp(much * shift[at])])
    ends = way.motion.kind.ends(pair, way.motion.mechanism)
    assert ends is not None
    base, tips = (_seen(np.broadcast_to(points, (2, 6, 3))) for points in ends)
    low, high = (pick(np.concatenate([base, tips]).reshape(-1, 2), axis=0) for pick in (np.min, np.max))
    scale = SIZE / max(high - low)
    top, left = 2 * TEXT + 22.0, (WIDTH - scale * (high - low)[0]) / 2
    base, tips = ((points - low) * scale + [left, top] for points in (base, tips))
    parts = [
        svg_text(4, 14, "The platform", style="name"),
        svg_text(4, 34, f"grey: told; {enlargement_text('orange: done', much)}"),
    ]
    for k, style in enumerate(("line grey", "line c1")):
        struts = "".join(
            f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(base[k].tolist(), tips[k].tolist())
        )
        parts.append(f'<path class="{style}" d="{struts}{_ring(tips[k])}"/>')
    parts.append(f'<path class="axis" d="{_ring(base[0])}"/>')
    return svg_figure(
        int(top + scale * (high - low)[1] + 12), f"the platform displaced, {place_and_values_text(way.effect)}", parts
    )


def _ring(points: Floats) -> str:
    return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in points.tolist()) + "Z"


def _seen(points: Floats) -> Floats:
    """Points (..., 3) m of the base as they are looked at, (..., 2) m to the right and down."""
    x, y, z = np.moveaxis(points, -1, 0)
    across, away = x * np.cos(TURNED) - y * np.sin(TURNED), x * np.sin(TURNED) + y * np.cos(TURNED)
    return np.stack([across, -z * np.cos(RAISED) - away * np.sin(RAISED)], axis=-1)


def enlargement_factor(size: float, target: float) -> float:
    """Enlargement factor (1, 2, 5 times a power of ten, at least 1) from a size to about a target size."""
    if size <= FLOOR:
        return 1.0
    power = 10.0 ** np.floor(np.log10(target / size))
    return max(1.0, float(next(k * power for k in (5, 2, 1) if k * power <= target / size)))


def enlargement_text(words: str, factor: float) -> str:
    """Text of words with the enlargement factor of the drawn error added."""
    times = f"{factor:,.0f}".replace(",", " ")
    return words if factor == 1 else f"{words}, error {times} times"


def largest_suitable_unit(size: float, units: dict[float, str]) -> tuple[float, str]:
    """(value, unit) of a size in the largest of the units in which it is 2 or more."""
    return next(
        ((value, name) for value, name in sorted(units.items(), reverse=True) if size >= 2 * value), min(units.items())
    )
