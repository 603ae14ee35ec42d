"""Diagrams of which folder imports which, as SVG, layer upon layer: python -m docs.make.dependency_diagram FOLDER."""

import sys
from collections.abc import Mapping
from html import escape
from pathlib import Path

from docs.make.imports_between_folders import Counts, downward, folder_counts, layers, names, package_counts, unimplied

DIAGRAMS = ("packages", "rig", "vision", "calib")  # one a file; synthetic has no folders
WIDTH, STEP, BOX, MARGIN, GAP = (
    680,
    84,
    30,
    16,
    18,
)  # px: whole width, from layer to layer, height of a box, rim, least gap between boxes
LETTER, ROUNDS = 7.3, 8  # px of a letter at 13 px; how often the places within layers are sorted
HEAD = """# Which folder imports which

`make docs` draws these diagrams from the imports in the code. The number at an arrow counts the imports of modules.
It includes imports inside functions.

Between packages, an arrow is drawn for every pair. Between folders, an arrow is left out where a longer chain of
arrows implies it. A dashed arrow runs upward: these two folders import each other, in most cases through different
files. Open a diagram alone and point at a box to see all that it imports.
"""
STYLE = """:root{color-scheme:light dark;
--ground:#fff;--card:#eef1f6;--ink:#16181d;--soft:#555c69;--rule:#767d8a;--against:#b35c00}
@media (prefers-color-scheme:dark){:root{
--ground:#191c22;--card:#2c313b;--ink:#e8eaee;--soft:#b4bbc8;--rule:#8b93a2;--against:#ffae57}}
text{font:13px system-ui,sans-serif;fill:var(--ink);text-anchor:middle}
.count{font-size:11px;fill:var(--soft);stroke:var(--ground);stroke-width:4px;paint-order:stroke}
rect{fill:var(--card);stroke:var(--rule)}.ground{fill:var(--ground);stroke:none}
path{fill:none;stroke:var(--rule);stroke-width:1.3}.against{stroke:var(--against);stroke-dasharray:5 4}
.against.count{stroke-dasharray:none}
.count.against{fill:var(--against);stroke:var(--ground)}
.head{fill:var(--rule);stroke:none}.head.against{fill:var(--against)}"""

Place = tuple[float, float]  # px, the middle of a box
Node = tuple[str, ...]  # a folder, or (importing, imported, layer) where an arrow passes a layer


def diagram(name: str) -> str:
    """The SVG of one of DIAGRAMS."""
    if name == "packages":
        counts = package_counts()
        return drawn(counts, downward(counts), "Imports between the packages")
    counts = folder_counts(name)
    return drawn(counts, unimplied(counts), f"Imports between the folders of {name}", top=name)


def page() -> str:
    """The page of all diagrams in Markdown."""
    parts = [HEAD]
    for name in DIAGRAMS:
        heading = "The packages" if name == "packages" else f"Inside {name}"
        picture = f"[![{heading}: imports](dependencies/{name}.svg)](dependencies/{name}.svg)"
        parts.append(f'\n## {heading}\n\n<div class="diagram" markdown>{picture}</div>\n')
    return "".join(parts)


def drawn(counts: Counts, shown: Counts, title: str, top: str = "") -> str:
    """The SVG of some imports. shown : the downward ones that get an arrow; all that run upward get one; top : the
    package whose folders they are
    """
    level = layers(counts)
    against = {pair: n for pair, n in counts.items() if pair not in downward(counts)}
    routes = {pair: _route(pair, level) for pair in (*shown, *against)}
    label = {name: _label(name, top) for name in names(counts)}
    width = {(name,): LETTER * len(label[name]) + 20 for name in names(counts)}
    at = placed(routes, level, width)
    high = MARGIN * 2 + BOX + STEP * max(level.values())
    arrows = [
        _arrow([at[node] for node in routes[pair]], n, f"{pair[0]} imports {pair[1]}") for pair, n in shown.items()
    ]
    arrows += [
        _arrow([at[node] for node in routes[a, b]], n, f"{a} imports {b}, upward", "against")
        for (a, b), n in against.items()
    ]
    boxes = [_box(at[(name,)], width[(name,)], label[name], _imports_text(name, counts)) for name in names(counts)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" viewBox="0 0 {WIDTH} {high}" width="{WIDTH}" '
        f'height="{high}"><title>{escape(title)}'
        f'</title><style>{STYLE}</style><rect class="ground" width="{WIDTH}" height="{high}"/>'
        + "".join(line for line, _ in arrows)
        + "".join(boxes)
        + "".join(count for _, count in arrows)
        + "</svg>\n"
    )


def placed(
    routes: Mapping[tuple[str, str], list[Node]], level: Mapping[str, int], width: Mapping[Node, float]
) -> dict[Node, Place]:
    """{node: its middle}. Within a layer nodes stand where their neighbours in other layers do, as far as boxes leave
    room.

    routes : the nodes of every arrow; level : the layer of every folder, 0 at the bottom; width : px of every box
    """
    layer = {(name,): at for name, at in level.items()}
    layer |= {node: int(node[2]) for route in routes.values() for node in route[1:-1]}
    near: dict[Node, list[Node]] = {node: [] for node in layer}
    for route in routes.values():
        for a, b in zip(route, route[1:]):
            near[a].append(b)
            near[b].append(a)
    high = max(layer.values())
    x: dict[Node, float] = {}
    for at in range(high + 1):
        row = sorted(node for node in layer if layer[node] == at)
        x |= _spread(row, {node: k for k, node in enumerate(row)}, width)
    for turn in range(ROUNDS):
        for at in range(high + 1) if turn % 2 else range(high, -1, -1):
            row = [node for node in layer if layer[node] == at]
            x |= _spread(
                row,
                {
                    node: sum(x[other] for other in near[node]) / len(near[node]) if near[node] else x[node]
                    for node in row
                },
                width,
            )
    return {node: (x[node], MARGIN + BOX / 2 + STEP * (high - layer[node])) for node in layer}


def _spread(row: list[Node], wish: Mapping[Node, float], width: Mapping[Node, float]) -> dict[Node, float]:
    """Places along a layer, in the order wished, boxes evenly apart over the whole width."""
    row = sorted(row, key=lambda node: (wish[node], node))
    wide = [width.get(node, GAP) for node in row]
    gap = max((WIDTH - 2 * MARGIN - sum(wide)) / (len(row) + 1), 0)
    start, found = MARGIN + gap, {}
    for node, across in zip(row, wide):
        found[node] = start + across / 2
        start += across + gap
    return found


def _route(pair: tuple[str, str], level: Mapping[str, int]) -> list[Node]:
    """The nodes of an arrow: its ends, and a place in every layer that it passes."""
    a, b = pair
    step = -1 if level[a] > level[b] else 1
    return [(a,), *((a, b, str(at)) for at in range(level[a] + step, level[b], step)), (b,)]


def _label(name: str, top: str) -> str:
    return f"files of {name}/" if name == top else f"{name.removeprefix(f'{top}/')}/"


def _imports_text(name: str, counts: Counts) -> str:
    """All that a folder imports and is imported by, in words."""
    out = ", ".join(f"{b} ({n})" for (a, b), n in counts.items() if a == name)
    into = ", ".join(f"{a} ({n})" for (a, b), n in counts.items() if b == name)
    return f"{name} imports {out or 'none of these'}; it is imported by {into or 'none of these'}"


def _box(at: Place, wide: float, label: str, tooltip: str) -> str:
    x, y = at
    return (
        f'<g><title>{escape(tooltip)}</title><rect x="{x - wide / 2:.1f}" y="{y - BOX / 2:.1f}" '
        f'width="{wide:.1f}" height="{BOX}" rx="5"/>'
        f'<text x="{x:.1f}" y="{y + 4.5:.1f}">{escape(label)}</text></g>'
    )


def _arrow(places: list[Place], count: int, tooltip: str, kind: str = "") -> tuple[str, str]:
    """The curve through some places with its head, and its number."""
    down = 1 if places[-1][1] >= places[0][1] else -1
    shift = 12 if kind and len(places) == 2 else 0  # beside an arrow that runs down between the same boxes
    points = [(x + shift, y) for x, y in places]
    points[0], points[-1] = (
        (points[0][0], points[0][1] + down * BOX / 2),
        (points[-1][0], points[-1][1] - down * (BOX / 2 + 6)),
    )
    curve = f"M{points[0][0]:.1f},{points[0][1]:.1f}"
    for (x, y), (u, v) in zip(points, points[1:]):
        curve += f" C{x:.1f},{(y + v) / 2:.1f} {u:.1f},{(y + v) / 2:.1f} {u:.1f},{v:.1f}"
    u, v = points[-1]
    head = f"M{u:.1f},{v + down * 6:.1f} l-4,{-down * 8} h8 z"
    (x, y), (u, v) = points[0], points[1]
    line = (
        f'<g><title>{escape(tooltip)} ({count})</title><path class="{kind}" d="{curve}"/><path class="head {kind}" '
        f'd="{head}"/></g>'
    )
    return line, f'<text class="count {kind}" x="{(x + u) / 2:.1f}" y="{(y + v) / 2 + 4:.1f}">{count}</text>'


def main() -> None:
    """Write the diagrams into the folder named."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name in DIAGRAMS:
        (folder / f"{name}.svg").write_text(diagram(name), encoding="utf-8")


if __name__ == "__main__":
    main()
