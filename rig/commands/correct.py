"""rig correct calibration.json --poses poses.csv --out commands.csv."""

import sys
from pathlib import Path

from rig.commands.output import fresh_file
from rig.errors import Unreachable


def arguments(parser):
    """Add this command's arguments to a parser."""
    parser.add_argument("calibration", metavar="CALIBRATION", type=Path)
    parser.add_argument("--poses", metavar="FILE", type=Path, required=True, help="frame,x,y,z,rx,ry,rz of the wanted poses")
    parser.add_argument("--out", metavar="FILE", type=Path, required=True, help="frame,l1..l6 to command")
    parser.add_argument("--skip-unreachable", action="store_true", help="leave out, and list, poses beyond the strut range")
    parser.add_argument("--uncorrected", action="store_true", help="command what the owner's model says, for comparison")


def run(arguments):
    """Write the commands that give the wanted poses."""
    import numpy as np

    from calib import store
    from calib.correction import reachable
    from rig import mechanisms, writing
    from rig import recording as recordings

    correction = store.load(arguments.calibration).correction
    wanted = recordings.load_poses(arguments.poses)
    out = fresh_file(arguments.out)
    if arguments.uncorrected:
        commands = mechanisms.of(correction.nominal).inverse(wanted.T_base_platform, correction.nominal)
    else:
        commands = correction.inverse(wanted.T_base_platform)
    keep = np.ones(len(commands), bool)
    try:
        reachable(commands, correction.nominal, [f"frame {frame}" for frame in wanted.frame])
    except Unreachable as error:
        if not arguments.skip_unreachable:
            raise
        keep[error.index] = False
        print(f"rig correct: {error}\nleft out, as asked", file=sys.stderr)
    rows = [",".join([str(frame), *(f"{length:.10f}" for length in lengths)]) for frame, lengths in zip(wanted.frame[keep], commands[keep])]
    writing.write_table(out, ("frame", *correction.nominal.axes), rows)
    print(f"{keep.sum()} of {len(keep)} poses written to {out}")
