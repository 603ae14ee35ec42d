"""docs/figures: figures of the pages that the tutorial's commands write, and sheets to print.

`python -m docs.make.figures` runs the commands of docs/tutorial-simulated.md in an empty folder: some minutes.
"""

import html
import re
import shlex
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

from matplotlib.figure import Figure

from docs.make.project import rig
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.report.pages.page_templates_and_index_page import standalone_svg
from synthetic.printable_target_sheets import (
    PAPER,
    blank_sheet_figure_and_axes,
    draw_cube_assembly_page,
    draw_sheet,
    sheets_of_target,
)

DOCS = Path(__file__).parents[1]
TUTORIAL, FOLDER = DOCS / "tutorial-simulated.md", DOCS / "figures"
DRAWN = re.compile(r'<svg class="figure" role="img".*?</svg>', re.DOTALL)
FIGURES = {  # name: (page, beginnings of the figures' names, what is drawn in words)
    "residuals": ("poses/report.html", ("cam0: ",), "Mean residuals over the image of cam0, enlarged, on the RMS."),
    "uncertainty": ("poses/report.html", ("position: ",), "Standard uncertainty of each measured position, in µm."),
    "errors": (
        "calibration.html",
        ("error of position: ",),
        "Position error of each pose, before and after correction.",
    ),
    "promise": ("certificate.html", ("",), "Share of poses within a measured error; dashed: the promise."),
    "outline": ("found/diagnosis.html", ("the rig in outline",), "The rig, with the place of the finding marked."),
    "backlash": (
        "found/diagnosis.html",
        ("without it: ", "without it, against"),
        "Residuals of strut 3 without the backlash in the model.",
    ),
}
OWN = ("--radius", "0.3", "--cameras", "3", "--cubes", "4")
DPI = 70  # of sheets to print, as pictures
WANTED = re.compile(r"^    frame,x,y,z,rx,ry,rz\n(?:    [-\d.,]+\n)+", re.MULTILINE)


def main() -> None:
    """Run the tutorial and write the figures."""
    text = TUTORIAL.read_text(encoding="utf-8")
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as name, chdir(name):
        found = WANTED.search(text)
        if found is None:
            raise ValueError(f"{TUTORIAL.name} shows no table of wanted poses")
        Path("wanted.csv").write_text(found[0].replace("    ", ""), encoding="utf-8")
        for command in re.findall(r"^    rig (.+)$", text, re.MULTILINE):
            rig(*shlex.split(command))
        for figure, (page, names, words) in FIGURES.items():
            drawn = drawings(Path(page).read_text(encoding="utf-8"), names)
            (FOLDER / f"{figure}.svg").write_text(standalone_svg(words, words, drawn), encoding="utf-8")
        for figure, sheet in printed():
            sheet.savefig(FOLDER / f"{figure}.png", dpi=DPI)


def printed() -> Iterator[tuple[str, Figure]]:
    """Yield (name, the sheet) of the first sheet and of the last one of the rig of the tutorial on an own rig. It is
    designed in the working folder.
    """
    rig("new", "design", *OWN, "--out", "own.toml")
    design = load_design(Path("own.toml"))
    pages = [page for target in design.targets for page in sheets_of_target(target, "A4")]
    figure, axes = blank_sheet_figure_and_axes(pages[0].paper)
    draw_sheet(axes, pages[0])
    yield "sheet", figure
    figure, axes = blank_sheet_figure_and_axes(PAPER["A4"])
    draw_cube_assembly_page(axes, design, PAPER["A4"], len(pages))
    yield "assembly", figure


def drawings(page: str, names: tuple[str, ...]) -> list[str]:
    """The first drawing of a page for each name with which a drawing's label begins. Raises ValueError for none"""
    labelled = [(html.unescape(re.search(r'aria-label="([^"]*)"', one)[1]), one) for one in DRAWN.findall(page)]
    chosen = []
    for name in names:
        fits = [one for label, one in labelled if label.startswith(name)]
        if not fits:
            raise ValueError(f"no drawing {name!r} among {', '.join(label for label, _ in labelled)}")
        chosen.append(fits[0])
    return chosen


if __name__ == "__main__":
    main()
