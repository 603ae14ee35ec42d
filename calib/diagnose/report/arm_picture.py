"""The arm in outline, as it stood in the recording, with the joints marked that a diagnosis points at."""

import numpy as np

from rig import mechanisms
from rig.design import Arm
from rig.mechanisms import arm as mechanism
from rig.page.figure import panels
from rig.page.parts import listed
from rig.page.svg import WIDTH, hover, svg, text

GHOSTS = 14  # other configurations, drawn faintly
VIEWS = (((0, 2), "from the side"), ((0, 1), "from above"))
HIGH, MARGIN = 260.0, 24.0  # of a view, units of a figure


def picture(arm: Arm, q: np.ndarray, moved: dict[int, dict[str, float]]) -> str:
    """Figures of an Arm over its configurations q (n, joints) rad or m; moved : {joint: {effect: RMS in rad or, of a slide, m}} of what was found."""
    chain = mechanism.frames(q, arm)[..., :3, 3]
    at = (chain - chain[0, 0]) @ arm.base.rotation.as_matrix()  # seen in the arm's own base, whatever stands where
    typical = int(np.argmin(((q - np.median(q, axis=0)) ** 2).sum(axis=1)))
    ghosts = np.linspace(0, len(q) - 1, GHOSTS).astype(int)
    places, units = mechanisms.places(arm), mechanisms.units(arm)
    said = {j: f"{places[j]}: " + ", ".join(f"{name} {size * 1e3:.3f} m{units[j]}" for name, size in moved[j].items()) for j in sorted(moved)}
    views = [_view(title, at[ghosts][:, :, [a, b]], at[typical][:, [a, b]], moved, said) for (a, b), title in VIEWS]
    return panels(*views) + (listed(said.values()) if said else "")


def _view(title: str, ghosts: np.ndarray, points: np.ndarray, moved: dict[int, dict[str, float]], said: dict[int, str]) -> str:
    """One view. ghosts : (g, joints + 1, 2) m; points : (joints + 1, 2) m of the configuration drawn in full"""
    every = np.concatenate([ghosts.reshape(-1, 2), points])
    low, high = every.min(axis=0), every.max(axis=0)
    scale = min((WIDTH - 2 * MARGIN) / max(high[0] - low[0], 1e-9), (HIGH - 2 * MARGIN) / max(high[1] - low[1], 1e-9))

    def placed(way: np.ndarray) -> list[list[float]]:
        return np.stack([MARGIN + scale * (way[:, 0] - low[0]), 20 + HIGH - MARGIN - scale * (way[:, 1] - low[1])], axis=1).tolist()

    def drawn(way: np.ndarray, style: str) -> str:
        return f'<path class="{style}" d="M' + "L".join(f"{x:.1f} {y:.1f}" for x, y in placed(way)) + '"/>'

    largest = max((max(found.values()) for found in moved.values()), default=1.0)
    parts = [text(4, 14, title, style="name"), *(drawn(ghost, "tick") for ghost in ghosts), drawn(points, "link")]
    for j, (x, y) in enumerate(placed(points)[:-1]):
        size = max(moved[j].values()) / largest if j in moved else 0.0
        parts += [f'<circle class="joint{" marked" if j in moved else ""}" cx="{x:.1f}" cy="{y:.1f}" r="{8 + 5 * size:.1f}">'
                  f"{hover(said.get(j, f'joint {j + 1}'))}</circle>", text(x, y + 4, str(j + 1), "middle", "within")]
    return svg(int(HIGH) + 24, f"the arm {title}, marked: {', '.join(f'joint {j + 1}' for j in sorted(moved)) or 'nothing'}", parts)
