"""Two-strut example of a patent, and its figures.

It has four samples.

A worked example of two struts and a hinge; the figures are SVG.

Source: configuration-space patent, [0079] to [0091]: two lengths L1 and L2 of either strut make the sample set (L1,
L1), (L1, L2), (L2, L1), (L2, L2); each gives a theoretical and a measured pose; IK of the measured one gives (L1',
L2'). It states no figures in metres: those here are ours.
"""

import html
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.correction.correction_field_methods_fitting_combination_and_json import (
    fit_correction_summand_field,
    measured_correction_summands,
)
from calib.correction.machine_correction import AnyCorrection, Correction
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.array_and_json_types import Floats
from rig.model.mechanism_geometry_classes import Planar2
from rig.model.mechanisms import two_strut_planar_mechanism
from rig.planning.configuration_generators import FILL, divided_grid_configurations
from rig.report.pages.html_and_svg_elements import svg_text

L1, L2 = 0.42, 0.58  # m
NOMINAL = Planar2(np.array([[-0.3, 0.0], [0.3, 0.0]]), np.array([[L1, L2], [L1, L2]]))
REAL = Planar2(
    np.array([[-0.3021, 0.0014], [0.3012, -0.0018]]), NOMINAL.strut_range, np.array([0.0011, 0.0016])
)  # nobody knows it


@dataclass(frozen=True, slots=True, eq=False)
class WorkedExample:
    """x : (4, 2) m, the sample set PM; theory, measured : DK(x), GDK(x), RigidTransform (4,); second : (4, 2) m,
    IK(GDK(x))
    summand : (4, 2) m, KSF_PM = x - second; correction : Correction by these alone, linear between them (KSF_KR)."""

    x: Floats
    theory: RigidTransform
    measured: RigidTransform
    second: Floats
    summand: Floats
    correction: AnyCorrection


def two_strut_worked_example() -> WorkedExample:
    """Worked example of two struts, computed with all its steps."""
    x = divided_grid_configurations(NOMINAL.strut_range, "1@1")
    x = x[np.lexsort((x[:, 1], x[:, 0]))]
    measured = two_strut_planar_mechanism.forward(x, REAL)
    samples = Samples(np.arange(4), np.arange(4.0), x, measured, np.zeros((4, 6, 6)), np.zeros((4, 6, 0)))
    known = measured_correction_summands(samples, NOMINAL)
    correction: AnyCorrection = Correction(
        NOMINAL, NOMINAL, (None, None), extension=fit_correction_summand_field(known, "linear")
    )
    return WorkedExample(
        x,
        two_strut_planar_mechanism.forward(x, NOMINAL),
        measured,
        two_strut_planar_mechanism.inverse(measured, NOMINAL),
        known.values,
        correction,
    )


def reached_hinge_positions(correction: AnyCorrection | None, wanted_positions: Floats) -> Floats:
    """Hinge positions (n, 2) m reached for wanted ones.

    They are by the nominal model or one corrected step.
    """
    T = RigidTransform.from_translation(np.pad(wanted_positions, ((0, 0), (0, 1))))
    commands = two_strut_planar_mechanism.inverse(T, NOMINAL) if correction is None else correction.single_step(T)
    return two_strut_planar_mechanism.forward(commands, REAL).translation[:, :2]


def _workspace_edge(mechanism: Planar2, count: int = 24) -> Floats:
    """(4 count, 2) m, the hinge along the edge of the configuration space: the workspace's own edge."""
    low, high = mechanism.strut_range.T
    s = np.linspace(0, 1, count)
    sides = [(s, 0 * s), (0 * s + 1, s), (s[::-1], 0 * s + 1), (0 * s, s[::-1])]
    x = np.concatenate([low + (high - low) * np.stack(side, axis=1) for side in sides])
    return two_strut_planar_mechanism.forward(x, mechanism).translation[:, :2]


def hinge_positions_of_command_grid(per_axis: int = 9) -> Floats:
    """Hinge positions (per_axis^2, 2) m of a grid of commands.

    It is over the middle of the strokes.
    """
    levels = (
        NOMINAL.strut_range.mean(axis=1)
        + FILL * np.ptp(NOMINAL.strut_range, axis=1) / 2 * np.linspace(-1, 1, per_axis)[:, None]
    )
    x = np.stack(np.meshgrid(*levels.T, indexing="ij"), axis=-1).reshape(-1, 2)
    return two_strut_planar_mechanism.forward(x, NOMINAL).translation[:, :2]


WIDTH, HEIGHT = 480, 400
SCALE, LEFT, FLOOR = 560.0, 240.0, 350.0  # px/m; px of the plane's origin
LARGER = 12.0  # times, by which the real machine's differences are drawn
NEARER = 2.4  # times, the workspace alone
STYLE = (
    "svg{font:13px "
    "system-ui,sans-serif}.base{stroke:#888;fill:none}.strut{stroke:#333;stroke-width:4;stroke-linecap:round}"
    ".real{stroke:#c2722a;stroke-width:3;stroke-dasharray:7 4}.edge{fill:#2a78c2;fill-opacity:.15;stroke:#2a78c2}"
    ".there{fill:none;stroke:#c2722a}.mesh{stroke:#2a78c2;fill:none}.dot{fill:#c22a4e}.before{stroke:#c2722a;"
    "stroke-width:1.5}"
    ".after{stroke:#2a78c2;stroke-width:1.5}.radius{stroke:#bbb;fill:none}"
)


def two_strut_example_figures() -> dict[str, str]:
    """Figures of the worked example {name: SVG}.

    1 to 7 of the source, and the corrected workspace.
    """
    w = two_strut_worked_example()
    names = ("L1, L1", "L1, L2", "L2, L1", "L2, L2")
    found = {"fig1": _workspace(w)}
    found |= {f"fig{2 + i}": _sample(w, i, name) for i, name in enumerate(names)}
    found |= {f"fig{6 + i}": _summand(w, i) for i in range(2)}
    return found | {"corrected": _corrected(w)}


def _svg(title: str, parts: list[str]) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
        f'height="{HEIGHT}"><title>{html.escape(title)}'
        f'</title><style>{STYLE}</style><rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>'
        + "\n".join(parts)
        + "</svg>\n"
    )


def _at(place: Floats) -> tuple[float, float]:
    """px of a place (2,) m."""
    return LEFT + SCALE * float(place[0]), FLOOR - SCALE * float(place[1])


def _text(x: float, y: float, words: str) -> str:
    return svg_text(x, y, words, "middle")


def _path(points: Floats, kind: str, closed: bool = False, at: Callable[[Floats], tuple[float, float]] = _at) -> str:
    return (
        f'<path class="{kind}" d="M'
        + "L".join("{:.2f},{:.2f}".format(*at(p)) for p in points)
        + ("Z" if closed else "")
        + '"/>'
    )


def _machine(hinge: Floats, joints: Floats, kind: str) -> list[str]:
    return [_path(np.stack([joint, hinge]), kind) for joint in joints]


def _radii() -> list[str]:
    """Circles of both lengths about both joints."""
    return [
        '<circle class="radius" cx="{:.2f}" cy="{:.2f}" r="{:.2f}"/>'.format(*_at(joint), SCALE * radius)
        for joint in NOMINAL.base_joints
        for radius in (L1, L2)
    ]


def _workspace(w: WorkedExample) -> str:
    hinge = _workspace_edge(NOMINAL).mean(axis=0)
    parts = [*_radii(), _path(_workspace_edge(NOMINAL), "edge", True), *_machine(hinge, NOMINAL.base_joints, "strut")]
    for name, joint in zip(("strut 1", "strut 2"), NOMINAL.base_joints):
        x, y = _at(joint)
        parts += [f'<circle class="dot" cx="{x:.2f}" cy="{y:.2f}" r="5"/>', _text(x, y + 22, name)]
    for place, name in zip(w.theory.translation, ("L1, L1", "L1, L2", "L2, L1", "L2, L2")):
        x, y = _at(place)
        parts += [f'<circle class="dot" cx="{x:.2f}" cy="{y:.2f}" r="3"/>', _text(x, y - 8, name)]
    return _svg("Fig. 1: two struts, their hinge, and the workspace of lengths from L1 to L2", parts)


def _enlarged(nominal: Floats, real: Floats) -> Floats:
    return nominal + LARGER * (real - nominal)


def _sample(w: WorkedExample, i: int, name: str) -> str:
    theory, measured = w.theory.translation[i, :2], w.measured.translation[i, :2]
    seen = _enlarged(theory, measured)
    second = " and ".join(f"{value * 1e3:.2f}" for value in w.second[i])
    parts = [
        *_radii(),
        *_machine(theory, NOMINAL.base_joints, "strut"),
        *_machine(seen, _enlarged(NOMINAL.base_joints, REAL.base_joints), "real"),
    ]
    parts += [f'<circle class="dot" cx="{_at(p)[0]:.2f}" cy="{_at(p)[1]:.2f}" r="4"/>' for p in (theory, seen)]
    parts += [
        _text(240, 20, f"commanded ({name}) = {w.x[i, 0] * 1e3:.0f} and {w.x[i, 1] * 1e3:.0f} mm"),
        _text(240, 38, f"IK of the measured pose: {second} mm"),
        _text(240, 392, f"differences drawn {LARGER:.0f} times larger"),
    ]
    return _svg(f"Fig. {2 + i}: sample pose ({name}), theoretical and measured", parts)


def _summand(w: WorkedExample, axis: int) -> str:
    """A surface over the configuration space, seen from aslant."""
    values = w.summand[:, axis]
    low, high = values.min() - np.ptp(values) / 2, values.max()

    def at(p: Floats) -> tuple[float, float]:
        u, v = (p[:2] - L1) / (L2 - L1)
        return 70 + 220 * u + 110 * v, 330 - 90 * v - 200 * (p[2] - low) / (high - low)

    def point(x: float, y: float, height: float | None = None) -> Floats:
        x_ = np.array([x, y])
        return np.r_[x_, _between(w, x_)[axis] if height is None else height]

    levels = np.linspace(L1, L2, 9)
    edge = [point(*x, low) for x in ((L1, L1), (L2, L1), (L2, L2), (L1, L2))]
    parts = [_path(np.array(edge), "base", True, at)]
    parts += [_path(np.array([point(a, b) for b in levels]), "mesh", at=at) for a in levels]
    parts += [_path(np.array([point(a, b) for a in levels]), "mesh", at=at) for b in levels]
    for x, value, name in zip(w.x, values, ("L1, L1", "L1, L2", "L2, L1", "L2, L2")):
        here = at(np.r_[x, value])
        parts += [
            _path(np.array([np.r_[x, low], np.r_[x, value]]), "base", at=at),
            f'<circle class="dot" cx="{here[0]:.2f}" cy="{here[1]:.2f}" r="4"/>',
            _text(here[0], here[1] - 9, f"{name}: {value * 1e3:+.3f} mm"),
        ]
    parts += [_text(180, 362, "strut 1, L1 to L2"), _text(415, 310, "strut 2, L1 to L2")]
    return _svg(f"Fig. {6 + axis}: correction summand of strut {axis + 1} over the configuration space", parts)


def _between(w: WorkedExample, x: Floats) -> Floats:
    """(..., 2) m, KSF_KR at configurations x (..., 2) m: at a sample what was measured there, between them by
    interpolation, [0088].
    """
    return np.asarray(w.correction.rho(x))


def _corrected(w: WorkedExample) -> str:
    wanted = hinge_positions_of_command_grid()
    before, after = reached_hinge_positions(None, wanted), reached_hinge_positions(w.correction, wanted)
    middle = _workspace_edge(NOMINAL).mean(axis=0)

    def at(p: Floats) -> tuple[float, float]:
        return 240 + NEARER * SCALE * float(p[0] - middle[0]), 185 - NEARER * SCALE * float(p[1] - middle[1])

    parts = [_path(_workspace_edge(NOMINAL), "edge", True, at)]
    for kind, reached in (("before", before), ("after", after)):
        parts += [
            _path(np.stack([place, _enlarged(place, actual)]), kind, at=at) for place, actual in zip(wanted, reached)
        ]
    for place, actual in zip(wanted, after):
        parts.append(
            '<circle class="after" fill="none" cx="{:.2f}" cy="{:.2f}" r="2"/>'.format(*at(_enlarged(place, actual)))
        )
    rms = [np.sqrt(((reached - wanted) ** 2).sum(axis=1).mean()) * 1e3 for reached in (before, after)]
    parts += [
        _text(240, 374, f"from wanted to reached, {LARGER:.0f} times larger:"),
        _text(240, 391, f"{rms[0]:.2f} mm RMS as it was (lines), {rms[1]:.4f} mm corrected (circles)"),
    ]
    return _svg("The workspace, before and after correction by four samples", parts)
