"""rig calibrate REC --extend WAY [--alone | --onto CALIBRATION [--space SPACE] [--within PART]]: summands extended over a space."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.errors import RigError

if TYPE_CHECKING:
    import numpy as np

    from calib.certify.calibration import Calibration
    from calib.certify.certificate import Certified, Progress
    from calib.certify.extended import Tried
    from calib.correct.interpolate.part import Part
    from calib.samples import Samples
    from rig.kinds import Struts

WAYS = ("linear", "simplex", "delaunay", "axes", "radial", "polynomial", "auto")
SPACES = ("configuration", "pose", "both")


def arguments(parser: ArgumentParser) -> None:
    """Add the arguments about --extend to a parser."""
    parser.add_argument("--extend", choices=WAYS, metavar="WAY", help="extend the corrections at the recorded configurations over all of them: "
                        f"{', '.join(WAYS[:-1])} (linear and simplex take a grid, as the plan division:2 visits one), or auto, by held-out error")
    parser.add_argument("--alone", action="store_true", help="of --extend: correct the owner's model itself, with no geometry fitted first")
    parser.add_argument("--onto", metavar="CALIBRATION", type=Path, help="of --extend: one more pass, on the rig that this calibration corrects: "
                        "what it leaves in the recording is corrected on top; order and count are kept")
    parser.add_argument("--space", choices=SPACES, help="of --onto: where the pass maps what is left: over configurations (default), "
                        "over poses, or over both, poses then holding what the first leaves")
    parser.add_argument("--within", metavar="PART", help="of --onto: the part in which the pass holds, fading beyond: bounds of axes (m or rad) "
                        "and of poses (x y z in m, rx ry rz in rad from home), as l1=0.40:0.46,z=0.41: ")


def refuse_mixed(arguments: Namespace) -> None:
    """Raise RigError for arguments about --extend that do not go together."""
    if (arguments.alone or arguments.onto) and not arguments.extend or (arguments.alone and arguments.onto):
        raise RigError("--alone and --onto each say on what --extend stands; it takes one of them")
    if (arguments.space or arguments.within) and not arguments.onto:
        raise RigError("--space and --within are of a pass; name with --onto what it stands on")
    if arguments.extend and arguments.joint:
        raise RigError("--extend is not for --joint: give one of them")


def passed(arguments: Namespace, samples: Samples, before: Calibration, rng: np.random.Generator,
           progress: Progress) -> tuple[Certified, tuple[Tried, ...], dict[str, Any]]:
    """(Certified, what was tried, what the provenance keeps of it) of one more pass. Raises RigError for a part that cannot be."""
    from calib.certify.onto import CONFIGURATION, POSE, Pass, certify_onto

    space = arguments.space or CONFIGURATION
    configurations, poses = _parts(arguments.within, before.correction.nominal)
    if configurations is not None and space == POSE or poses is not None and space == CONFIGURATION:
        raise RigError(f"--within {arguments.within}: a pass over {'poses' if space == POSE else 'configurations'} is bounded by "
                       f"{'x y z rx ry rz' if space == POSE else 'the axes'}; --space both takes either")
    done, tried, count = certify_onto(samples, before, Pass(arguments.extend, space, configurations, poses), rng, progress)
    number = len(before.provenance.get("passes", ())) + 2
    return done, tried, {"number": number, "way": arguments.extend, "space": space, "within": arguments.within, "samples": count,
                         "chosen": [one.kind for one in tried if one.chosen]}


def _parts(text: str | None, mechanism: Struts) -> tuple[Part | None, Part | None]:
    """(Part of the configuration space, Part of pose space), None for all of it, of a text. Raises RigError for one that bounds nothing."""
    if text is None:
        return None, None
    import numpy as np

    from calib.correct.extend import coordinates
    from calib.correct.interpolate.part import Part
    from calib.correct.posed import NAMES

    spaces = [mechanism.axes, tuple(NAMES[i] for i in coordinates(mechanism))]
    bounds = [np.tile([-np.inf, np.inf], (len(names), 1)) for names in spaces]
    for word in text.split(","):
        name, _, span = word.strip().partition("=")
        low, colon, high = span.partition(":")
        try:
            pair = float(low or "-inf"), float(high or "inf")
        except ValueError:
            pair = np.nan, np.nan
        at = [(k, names.index(name)) for k, names in enumerate(spaces) if name in names]
        if not at or not colon or not pair[0] < pair[1] or pair == (-np.inf, np.inf):
            raise RigError(f"--within takes NAME=LOW:HIGH joined by commas, names {' '.join(spaces[0] + spaces[1])}, low below high and either left "
                           f"out where free, not {word.strip()!r}")
        bounds[at[0][0]][at[0][1]] = pair
    found = [Part(*pair.T) if np.isfinite(pair).any() else None for pair in bounds]
    return found[0], found[1]
