"""rig plan RIG.toml --for parameters --out FILE."""

from pathlib import Path

from rig.commands.output import SEED, Progress, fresh_file
from rig.errors import RigError

SHOWN = 8  # combinations that are listed


def arguments(parser):
    """Add this command's arguments to a parser."""
    parser.add_argument("design", metavar="RIG.toml", type=Path)
    parser.add_argument("--for", dest="purpose", choices=tuple(PURPOSES), required=True, help="what the plan is to find out")
    parser.add_argument("--count", type=int, default=60, help="configurations to choose (default 60)")
    parser.add_argument("--criterion", choices=("determinant", "noise"), default="determinant",
                        help="smallest volume of uncertainty (default), or smallest amplification of noise")
    parser.add_argument("--given", metavar="PATH", type=Path, help="what is visited already: a recording, or a table frame,l1..l6")
    parser.add_argument("--sigma", nargs=2, type=float, default=(1e-5, 1e-4), metavar=("M", "RAD"),
                        help="standard deviation of a measured pose, per axis (default 1e-5 1e-4)")
    parser.add_argument("--calibration", metavar="FILE", type=Path, help="take the geometry from here, not from RIG.toml")
    parser.add_argument("--out", metavar="FILE", type=Path, required=True, help="frame,l1..l6; `rig simulate --plan commands:FILE` runs it")


def run(arguments):
    """Choose configurations, write them, and say what they make visible."""
    PURPOSES[arguments.purpose](arguments)


def _parameters(arguments):
    from rig import design_file, writing

    mechanism = design_file.load(arguments.design).mechanism
    if mechanism.kind != "hexapod":
        raise RigError(f"plans for parameters are for hexapods, not for a mechanism of kind {mechanism.kind!r}")
    if arguments.count < 1 or min(arguments.sigma) <= 0:
        raise RigError(f"--count and --sigma take positive numbers, got {arguments.count} and {arguments.sigma[0]:g} {arguments.sigma[1]:g}")
    out = fresh_file(arguments.out)

    from calib import store
    from calib.exchange import choose
    from calib.observability import PLAUSIBLE, combinations

    if arguments.calibration:
        mechanism = store.load(arguments.calibration).correction.fitted
        if mechanism.kind != "hexapod":
            raise RigError(f"{arguments.calibration} is a calibration of a mechanism of kind {mechanism.kind!r}, not of a hexapod")
    given = _given(arguments.given, mechanism) if arguments.given else None
    progress = Progress()
    chosen = choose(mechanism, arguments.count, arguments.sigma, arguments.criterion, given, SEED,
                    lambda done, of: progress("choosing", done, of))
    writing.write_table(out, ("frame", *mechanism.axes),
                        [f"{k}," + ",".join(f"{value:.7f}" for value in values) for k, values in enumerate(chosen.commands)])
    (before, _), (after, seen), (_, even) = (combinations(root, mechanism) for root in (chosen.before, chosen.root, chosen.even))
    visited = 0 if given is None else len(given)
    print(f"{arguments.count} configurations beside {visited} given: condition number of the 42 parameters {seen.condition:.0f}, "
          f"with as many evenly spread {even.condition:.0f}")
    print(f"worst determined combination {after[0].sigma * 1e6:.2f} um, evenly spread {PLAUSIBLE / even.singular[-1] * 1e6:.2f} um; "
          f"all 42 together {(seen.singular.prod() / even.singular.prod()) ** (1 / 42):.2f} times as precise as evenly spread")
    hidden = [part for part in before if not part.determined]
    if visited and not hidden:
        print("what was given determines all 42 already; the worst, before and after:")
    elif visited:
        print(f"{len(hidden)} combinations that what was given does not tell from {PLAUSIBLE * 1e3:g} mm become visible; the worst:")
    else:
        print("the worst determined combinations:")
    for part in (before if visited else after)[:SHOWN]:
        print(f"  {_sigma(part.sigma)} -> {_sigma(_along(chosen.root, part.direction))}  {part.name}" if visited else
              f"  {_sigma(part.sigma)}  {part.name}")
    print(f"written: {out}")


def _along(root, direction):
    """m, standard error along a direction (42,) for the information's square root."""
    import numpy as np

    return float(np.linalg.norm(np.linalg.solve(root.T, direction)))


def _sigma(value):
    return f"{value * 1e6:9.2f} um" if value < 1e-2 else "   unseen   "


def _given(path, mechanism):
    """(k, 6) m configurations visited: of a recording's frames, or of a table."""
    from rig import recording, table

    if path.is_dir():
        read = recording.load(path)
        if read.design.mechanism.kind != "hexapod":
            raise RigError(f"{path} is a recording of a mechanism of kind {read.design.mechanism.kind!r}")
        return read.commanded()[2]
    return table.read(path, ("frame", *mechanism.axes)).matrix(mechanism.axes)


PURPOSES = {"parameters": _parameters}
