"""A learner that watches for nothing <-> a JSON file, whole or not at all, so that it goes on another day as if it had
never stopped.
"""

import json
from pathlib import Path

from calib.files.mechanism_json import mechanism_dict, mechanism_from_entries
from calib.online.learners import LEARNERS, Learner
from rig.formats import json_file
from rig.formats.checked_entries import LARGEST_RIG
from rig.formats.output_files import write_text
from rig.model.design import Hexapod

SCHEMA = "learner/1"


def save(path: Path | str, learner: Learner) -> None:
    """Write a Learner, whole or not at all."""
    name = next(name for name, kind in LEARNERS.items() if type(learner) is kind)
    tree = {
        "schema": SCHEMA,
        "learner": name,
        learner.SETTING: learner.setting,
        "nominal": mechanism_dict(learner.nominal),
        "p": learner.p.tolist(),
        "memory": learner.memory.tolist(),
        "number": learner.number,
        "data": sorted(learner.data),
    }
    write_text(path, json.dumps(tree) + "\n")


def load(path: Path | str) -> Learner:
    """The Learner as saved. Raises FileError for a file that is missing, cut off, of another kind, or that holds what
    cannot be.
    """
    tree = json_file.load(Path(path), "state of a learner", SCHEMA)
    kind = LEARNERS[tree.text("learner", tuple(LEARNERS))]
    nominal = mechanism_from_entries(tree.table("nominal"))
    if not isinstance(nominal, Hexapod):
        tree.fail("nominal is no hexapod", "nominal")
    try:
        learner = kind(nominal, tree.number(kind.SETTING))
    except ValueError as error:
        tree.fail(str(error), kind.SETTING)
    learner.p, learner.memory = (
        tree.array("p", (42,), length_limit=LARGEST_RIG),
        tree.array("memory", learner.memory.shape),
    )
    learner.number, learner.data = tree.whole("number", 0), set(tree.texts("data"))
    return learner
