"""docs/validation.md: the figures of docs/results that answer a user's questions, those of other programs beside them:
`python -m docs.make.validation > docs/validation.md`.
"""

from docs.make import results

PAGE = results.PAGE.with_name("validation.md")
QUESTIONS = (
    (
        "Is a measured pose right?",
        "way",
        ("first-light: pose error", "first-light: stated", "open-quiet: pose error, RMS"),
    ),
    ("Is a calibrated machine better?", "way", ("open-quiet: before", "open-quiet: pose error after")),
    ("Is a real arm better?", "tour", ("nominal geometry", "geometry and joint profiles", "position error, RMS")),
    ("Is the stated accuracy true?", "truth", ("all: 95 %", "all: rotation", "all: poses within")),
    ("Is a wrong claim found?", "verify", ("true claims", "wrong claims")),
    ("Is a diagnosis quiet where nothing is wrong?", "false_findings", ("all: with a finding",)),
    ("Is a check quiet where nothing is wrong?", "accusations", ("accused of something",)),
    ("Are several faults found?", "several_faults", ("all named and placed", "faults named")),
    ("Does motion spoil the poses?", "motion", ("pose measured", "time offset found")),
)  # (question, benchmark, words that its figures contain)
PEERS = (
    ("Drawn photographs: rig, OpenCV and multical", "peers", ("corners found", "off the truth", "ran with")),
    ("Real photographs: OpenCV", "lens", ("corners found", "inliers of both", "250.jpg")),
    ("Least squares: SciPy", "lens", ("SciPy's least_squares",)),
    ("Forward kinematics: SciPy", "forward", ("ratio to scipy",)),
)
HEAD = """# Validation

This page answers the questions that a new user asks first, with measured figures. It is made from the files of \
`docs/results` by `python -m docs.make.validation`. All figures, machines and dates are on the page of \
[results](results.md). Errors are against simulated truth unless a row names a real arm or photographs. They are not \
traceable: see [uncertainty](uncertainty.md).

To repeat a table, run its command in a checkout after `make setup`. `make results BENCH=NAME` also stores the result.

"""
BETWEEN = """
## Other programs, measured here

The same data went through each program, on the same computer.

- **OpenCV** is measured with `cv2.aruco.CharucoDetector` and `cv2.calibrateCamera`.
- **multical** 0.4.0 installs with `pip install multical`, but did not start with the Python 3.11 of this project. It \
ran with Python 3.10 and `numpy<1.24`. It pins OpenCV 4.6. \
On the same photograph, that version puts every corner 0.50 px further right and down than \
OpenCV 5.0. The principal point follows.
- **Kalibr** was not measured. It is built with ROS and has no package on PyPI. `rig import --cameras` reads its files.

Photographs of a board do not tell how the camera is turned. So projections are compared after the turn that fits \
best. Each pair of figures is of the left and the right camera. It is one set of photographs: small differences are \
chance.

"""
PUBLISHED = """
## Other programs, as published

These figures are their authors'. Machines, instruments and poses differ, so no row ranks one program over another. \
They show which size of error is usual.

| program | machine | figure | source |
|---|---|---|---|
{rows}

TPOINT fits a pointing model to stars. Its figure is the RMS of the fit, not of stars kept away. \
[Mounts that point](pointing.md) shows the same method here. FIGAROH fits the geometry of an arm with Pinocchio. \
Its figure is of poses kept away, and is of the same kind as the held-out rows of the real arm above.
"""
SOURCES = (
    (
        "TPOINT", "ESO NTT, about 60 stars a fit", "residual 0.8 arcsec RMS (Nasmyth A, 2001-12-06)",
        "[ESO, NTT pointing model evolution](http://www.eso.org/sci/facilities/lasilla/telescopes/ntt/metrics/pom.html)",
    ),
    (
        "TPOINT", "the best observatory instruments", "pointing at the 1 to 2 arcsec level",
        "[Tpoint Software, What is TPOINT?](http://tpointsw.uk/tpoint.htm)",
    ),
    (
        "FIGAROH (Pinocchio 3.7.0)", "TIAGo arm, motion capture, 37 postures to fit, 62, 63 and 59 kept away",
        "position RMSE 4.87, 4.58, 4.22 mm before (frames only); 4.23, 4.09, 3.83 mm with joint offsets; "
        "3.07, 2.83, 2.44 mm with all geometry",
        "[figaroh-examples, held-out protocol, 2026-10-05](https://github.com/thanhndv212/figaroh-examples/blob/"
        "2e4058a45e683d8a458cee25014610ac9535e35c/docs/development/tiago-mocap-heldout-protocol.md)",
    ),
)  # fmt: skip


def page() -> str:
    """The page in Markdown. Raises ValueError where a question has no figure any more."""
    published = "\n".join(f"| {' | '.join(row)} |" for row in SOURCES)
    return (
        HEAD
        + "\n".join(_section(*entry, 2) for entry in QUESTIONS)
        + BETWEEN
        + "\n".join(_section(*entry, 3) for entry in PEERS)
        + PUBLISHED.format(rows=published)
    )


def _section(title: str, name: str, words: tuple[str, ...], level: int) -> str:
    record = next((record for record in results.newest() if record["name"] == name), None)
    if record is None:
        raise ValueError(f"{title}: docs/results has no {name}.json; make results BENCH={name}")
    rows = []
    for part in words:
        found = [row for row in record["figures"] if part in row["figure"]]
        if not found:
            raise ValueError(f"{title}: no figure of {name}.json contains {part!r}")
        rows += [row for row in found if row not in rows]
    lines = [results.line([row["figure"], row["reached"], row["wanted"]]) for row in rows]
    return (
        f"{'#' * level} {title}\n\n| figure | reached | wanted |\n|---|---|---|\n"
        + "\n".join(lines)
        + f"\n\n`{record['command']}`, version {record['version']}, {record['created'][:10]}: "
        f"[all of its figures](results.md#{name}).\n"
    )


if __name__ == "__main__":
    print(page(), end="")
