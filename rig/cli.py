"""The command line: it lists the commands and opens the one asked for; each imports what it needs when it runs."""

import argparse
import importlib
import os
import sys

from rig.errors import RigError

COMMANDS = {
    "measure": "Images or corners of a recording -> platform poses with covariance, cameras adjusted.",
    "calibrate": "A recording -> calibration.json: geometry and corrections, with held-out figures.",
    "diagnose": "A recording -> what physics its model leaves out: where, which, how large, and the proof.",
    "blind": "Sealed trials of the diagnosis on rigs that are not there, and their score.",
    "correct": "Wanted poses -> the strut lengths to command for them.",
    "posture": "A redundant arm's posture for feeling or making force, with the hand held still.",
    "verify": "A calibration held against a recording it was not made from: error before and after.",
    "lens": "Photographs of a board -> one camera's lens: models compared, a [[camera]] block.",
    "simulate": "A rig that is not there under a plan -> a recording, and its truth apart.",
    "plan": "Which configurations to visit so that what is asked becomes visible.",
    "online": "A recording's poses learnt from one at a time: what the machine is by now, and what jumped.",
    "insitu": "Measuring limbs held against vision; once they pass, the struts learnt from their poses.",
    "export": "A calibrated geometry for other programs: genhexkins, URDF, JSON, CSV.",
    "view": "One frame of a recording with markers, axes and residuals drawn in.",
    "design": "A sensible rig.toml from a radius: cubes and cameras placed.",
    "print": "The cubes of a rig.toml as nets to print, true to scale.",
}


def main(argv=None):
    """Run one command; returns the exit status: 0 done, 1 refused with a reason, 2 wrong usage, 130 interrupted."""
    argv = sys.argv[1:] if argv is None else list(argv)
    parser = argparse.ArgumentParser(prog="rig", description="Vision-measured calibration of robots that move a platform on struts.",
                                     epilog="A recording is a folder with rig.toml, frames.csv, commands.csv and images or corners.csv; "
                                            "SI units and radians throughout.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    chosen = next((word for word in argv if not word.startswith("-")), None)
    for name, text in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text)
        if name == chosen:  # the others' arguments do not matter, so their files stay shut
            module = importlib.import_module(f"rig.commands.{name}")
            module.arguments(sub)
            sub.set_defaults(run=module.run)
    arguments = parser.parse_args(argv)
    if arguments.command is None:
        parser.print_help()
        return 2
    arguments.argv = argv
    try:
        return arguments.run(arguments) or 0
    except RigError as error:
        print(f"rig {arguments.command}: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        print(f"rig {arguments.command}: interrupted", file=sys.stderr)
        return 130
