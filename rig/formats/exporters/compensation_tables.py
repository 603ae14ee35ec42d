"""Compensation tables for controllers: LinuxCNC's file for each joint, and a plain grid with its sign and units said.

LinuxCNC adds to a joint's position what its table has there, nominal less actual, joined by straight lines; a file of
COMP_FILE_TYPE 0 has a line for each nominal position: it, the actual position going up, and going down. Source:
LinuxCNC, INI configuration, [JOINT_n] COMP_FILE
"""

import numpy as np

MOST = 256  # entries that LinuxCNC takes
SCALE = {"mm": 1e3, "m": 1.0}


def linuxcnc(levels: np.ndarray, trims: np.ndarray, units: str = "mm") -> str:
    """The file of one joint: levels (n,) m, ascending, whole lengths as genhexkins has them; trims (n,) m to be added
    there.

    units : of the machine, "mm" or "m". Raises ValueError for more entries than it takes, or none that grow
    """
    if not 2 <= len(levels) <= MOST or not (np.diff(levels) > 0).all():
        raise ValueError(f"a joint's table has 2 to {MOST} positions that grow, got {len(levels)}")
    rows = np.column_stack([levels, levels - trims, levels - trims]) * SCALE[units]
    return "\n".join(" ".join(f"{value:.9f}" for value in row) for row in rows) + "\n"


def grid(x: np.ndarray, k: np.ndarray, axes: tuple[str, ...], unit: str) -> str:
    """CSV of corrections k (n, axes) at x (n, axes), with what they mean in lines that begin with #. unit : of both,
    "m" or "rad".
    """
    lines = [
        f"# command = x + k: where the owner's model says x, x + k is to be commanded; unit of both {unit}; "
        "between rows n-linear",
        f"# x: {' '.join(axes)} as commands.csv has them; the last axis runs fastest",
        ",".join([*(f"x_{axis}" for axis in axes), *(f"k_{axis}" for axis in axes)]),
    ]
    lines += [",".join(f"{value:.12f}" for value in row) for row in np.column_stack([x, k])]
    return "\n".join(lines) + "\n"
