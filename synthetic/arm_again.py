"""A diagnosed arm's poses drawn anew: the same commands, the arm as it was found, with and without what its joints were found to do."""

from dataclasses import replace

import numpy as np

from rig import json_file, table
from rig.design_file import load
from rig.errors import FileError
from rig.files import complete, write_text
from rig.mechanisms import arm as mechanism
from rig.pose import exp, pose, vector
from rig.observed import POSE_COLUMNS
from rig.writing import write_table

KINDS = ("with", "without")
COPIED = ("rig.toml", "commands.csv", "frames.csv", "sensors.csv")


def drawn(folder):
    """({"with": RigidTransform (n,), "without": the same}, frames (n,), Entries of arm.json) of a folder that `rig diagnose` wrote for an arm.

    Raises FileError for files that are missing or malformed
    """
    complete(folder)
    tree, stated = json_file.load(folder / "arm.json", "diagnosed arm"), load(folder / "rig.toml").mechanism
    if stated.kind != "arm":
        raise FileError(folder / "rig.toml", f"arm.json stands beside a mechanism of kind {stated.kind!r}")
    base, tool = tree.array("base", (6,)), tree.array("tool", (6,))
    arm = replace(stated, joints=tree.array("joints", (len(stated.joints), 5)), base=pose(base[:3], base[3:]), tool=pose(tool[:3], tool[3:]))
    count = len(arm.joints)
    names = tuple(f"{letter}{j + 1}" for letter in "qe" for j in range(count))
    swayed = tuple(f"s{i + 1}" for i in range(6))
    rows = table.read(folder / "joints.csv", ("frame", *names, *swayed))
    values = rows.matrix((*names, *swayed))
    q, more, sway = np.split(values, [count, 2 * count], axis=1)
    return {"with": mechanism.forward(q + more, arm) * exp(sway), "without": mechanism.forward(q, arm)}, rows.whole("frame"), tree


def write(folder, out, rng):
    """(poses, effects' names): two recordings, out/with and out/without, with the instrument's own noise.

    Both have the same noise, so that they differ by the effects alone. Raises what `drawn` raises
    """
    made, frames, tree = drawn(folder)
    design = load(folder / "rig.toml")
    instrument = design.instrument
    sigma = np.repeat([0.0, 0.0] if instrument is None else [instrument.position_sigma, instrument.rotation_sigma or 0.0], 3)
    noise = rng.normal(size=(len(frames), 6)) * sigma
    columns = POSE_COLUMNS[: 6 if tree.flag("rotations") else 3]
    for kind in KINDS:
        (out / kind).mkdir(parents=True, exist_ok=True)
        for name in COPIED:
            if (folder / name).exists():
                write_text(out / kind / name, (folder / name).read_text(encoding="utf-8"))
        rows = vector(made[kind] * exp(noise))[:, : len(columns)]
        write_table(out / kind / "poses.csv", ("frame", *columns),
                    [",".join([str(frame), *(f"{x:.10f}" for x in row)]) for frame, row in zip(frames, rows)])
    return len(frames), tree.texts("effects")
