"""rig correct calibration.json --poses poses.csv --out commands.csv."""

import sys
from argparse import ArgumentParser, Namespace
from pathlib import Path

from rig.commands.output import add_force, file_or_stdout
from rig.errors import Unreachable


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument("--poses", metavar="FILE", type=Path, required=True, help="frame,x,y,z,rx,ry,rz of the wanted poses")
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, required=True, help="frame,l1..l6 (an arm: q1..qn) to command")
    parser.add_argument("--skip-unreachable", action="store_true", help="leave out, and list, poses out of reach")
    parser.add_argument("--uncorrected", action="store_true", help="command what the owner's model says, for comparison")
    parser.add_argument("--single-step", action="store_true", help="command X + KSF(X), the method's first step, not the fixed point that is exact")
    add_force(parser)


def run(arguments: Namespace) -> None:
    """Write the commands that give the wanted poses."""
    import numpy as np

    from calib import store
    from calib.correct.correction import reachable
    from rig import recording as recordings
    from rig import writing

    correction = store.load(arguments.calibration).correction
    wanted = recordings.load_poses(arguments.poses)
    out = arguments.outputs.file(arguments.out)
    way = correction.uncorrected if arguments.uncorrected else correction.single_step if arguments.single_step else correction.inverse
    keep, refused = np.arange(len(wanted.frame)), []
    while len(keep):  # first what no command reaches, then what lies beyond the limits
        T = wanted.T_base_platform[keep]
        try:
            commands = way(T)
            reachable(commands, correction.nominal, [f"pose {i}" for i in range(len(keep))])
            break
        except Unreachable as error:
            refused += [(int(wanted.frame[keep[i]]), line.split(": ", 1)[1]) for i, line in zip(error.index, error.violations)]
            keep = np.delete(keep, error.index)
    if refused:
        message = Unreachable(f"{len(refused)} of {len(wanted.frame)} wanted poses cannot be reached:", [frame for frame, _ in refused],
                              [f"frame {frame}: {line}" for frame, line in sorted(refused)])
        if not arguments.skip_unreachable or not len(keep):
            raise message
        print(f"rig correct: {message}\nleft out, as asked", file=sys.stderr)
    rows = [",".join([str(frame), *(f"{length:.10f}" for length in lengths)]) for frame, lengths in zip(wanted.frame[keep], commands)]
    writing.write_table(out, ("frame", *correction.nominal.axes), rows)
    print(f"{len(keep)} of {len(wanted.frame)} poses written to {arguments.out}")
    field = correction.extension
    if field is not None and not field.inside(commands).all():
        print(f"{(~field.inside(commands)).sum()} of them lie beyond the samples of the correction: there it is extrapolated, continuously")
    if arguments.single_step:
        off = commands - correction.inverse(wanted.T_base_platform[keep])
        print(f"the single step misses the fixed point by {np.abs(off).max():.3g} {'rad' if correction.nominal.kind == 'arm' else 'm'} at most")
