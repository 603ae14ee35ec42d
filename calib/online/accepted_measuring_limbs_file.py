"""File of accepted measuring limbs (limbs.json).

With their geometry, agreement and verdict, saved and loaded.
"""

import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from calib.certification.loop_closure_checks_of_redundant_measuring_limbs import Checks, Limbs
from calib.certification.measuring_limb_calibration_slips_and_vision_agreement import (
    Agreement,
    hexapod_of_six_limbs,
    stated_limbs,
)
from calib.files.calibration_file import covariance_from_entries
from calib.files.mechanism_and_physics_entries import mechanism_dict, mechanism_from_entries
from rig.array_and_json_types import Json
from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import Entries
from rig.formats.output_files import write_text
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Hexapod
from rig.model.mechanisms.mechanism_kinds_and_kinematics import is_hexapod

SCHEMA = "limbs/1"
UNITS = (
    "m, rad; covariance in their products, of base joints 1..6 (x y z), platform joints 1..6 (x y z), zeros "
    "1..6; axes x y z rx ry rz"
)
VERDICTS = ("accepted", "refused", "withdrawn")
SAME = 1e-9  # m; by so much may limbs differ from those that rig.toml states and still be the same


@dataclass(frozen=True, slots=True)
class Withdrawal:
    """Why an acceptance no longer stands. recording, frame : where it was found; reason : in words; created : when, ISO
    8601
    """

    recording: str
    frame: int
    reason: str
    created: str


@dataclass(frozen=True, slots=True, eq=False)
class Accepted:
    """limbs : Limbs as found; nominal : Hexapod of them as rig.toml states it; agreement : Agreement with vision on
    held-out poses
    withdrawn : Withdrawal, None while the verdict stands; provenance : {what: value} of what they were found from"""

    limbs: Limbs
    nominal: Hexapod
    agreement: Agreement
    withdrawn: Withdrawal | None
    provenance: Json

    @property
    def verdict(self) -> str:
        """One of VERDICTS."""
        return "refused" if not self.agreement.passed.all() else "accepted" if self.withdrawn is None else "withdrawn"


def save_limbs(path: Path | str, accepted: Accepted) -> None:
    """Save accepted limbs as limbs.json.

    It is written whole or not at all.
    """
    a, w = accepted.agreement, accepted.withdrawn
    tree = {
        "schema": SCHEMA,
        "units": UNITS,
        "verdict": accepted.verdict,
        "tolerance": a.tolerance.tolist(),
        "stated": mechanism_dict(accepted.nominal),
        "limbs": mechanism_dict(accepted.limbs.hexapod),
        "covariance": accepted.limbs.covariance.tolist(),
        "reading_sigma": accepted.limbs.sigma.tolist(),
        "chosen": (accepted.limbs.chosen + 1).tolist(),
        "checks": _checks_out(accepted.limbs.checks),
        "agreement": {
            "n": a.n,
            "bias": a.bias.tolist(),
            "scatter": a.scatter.tolist(),
            "limits": a.limits.tolist(),
            "surely": a.proven_limits.tolist(),
            "expected": a.expected.tolist(),
            "moved": a.moved.tolist(),
        },
        "withdrawn": None
        if w is None
        else {"recording": w.recording, "frame": w.frame, "reason": w.reason, "created": w.created},
        "provenance": accepted.provenance,
    }
    write_text(path, json.dumps(tree, indent=1) + "\n")


def load_limbs_of_any_verdict(path: Path | str) -> Accepted:
    """Load Accepted limbs from a limbs.json, whatever its verdict.

    Raises FileError
    """
    tree = json_toml_and_yaml_loading.load_json(Path(path), "limbs.json", SCHEMA)
    nominal, hexapod = _hexapod(tree, "stated"), _hexapod(tree, "limbs")
    sigma, table = tree.array("reading_sigma", (6,)), tree.table("agreement")
    if not (sigma > 0).all():
        tree.fail(f"reading_sigma must be positive, got {sigma.tolist()}", "reading_sigma")
    parts = {
        name: table.array(name, (2, 6) if name == "limits" else (6,))
        for name in ("bias", "scatter", "limits", "surely", "expected", "moved")
    }
    chosen = np.arange(6) if "chosen" not in tree.tree else tree.array("chosen", (6,)).astype(int) - 1
    if len(set(chosen.tolist())) != 6 or chosen.min() < 0:
        tree.fail(f"chosen must be six different limbs, counted from 1, got {(chosen + 1).tolist()}", "chosen")
    checks = _checks_in(tree)
    others = [] if checks is None else checks.limbs.tolist()
    if sorted([*chosen.tolist(), *others]) != list(range(6 + len(others))):
        tree.fail(
            f"chosen {(chosen + 1).tolist()} and the limbs of checks {[i + 1 for i in others]} must be all "
            "limbs, each once",
            "checks",
        )
    proven = parts.pop("surely")
    agreement = Agreement(table.whole("n", 1), tolerance=tree.array("tolerance", (6,)), proven_limits=proven, **parts)
    found = Accepted(
        Limbs(hexapod, covariance_from_entries(tree, 42, "covariance"), sigma, chosen, checks),
        nominal,
        agreement,
        _withdrawal(tree),
        dict(tree.table("provenance").tree),
    )
    verdict = tree.text("verdict", VERDICTS)
    if verdict != found.verdict:
        tree.fail(f"verdict is {verdict!r}, but its own figures give {found.verdict!r}", "verdict")
    return found


def load_accepted_limbs_for_design(path: Path | str, design: Design) -> Accepted:
    """Accepted limbs of a limbs.json that may replace vision on a rig.

    Raises RigError where they may not.
    """
    found = load_limbs_of_any_verdict(path)
    limbs, six = stated_limbs(design), found.limbs.chosen
    spare = 0 if found.limbs.checks is None else len(found.limbs.checks.limbs)
    if len(limbs.channels) != len(six) + spare:
        raise RigError(
            f"{path} is of other limbs than rig.toml states in [insitu]: of {len(six) + spare}, not of "
            f"{len(limbs.channels)}"
        )
    other = hexapod_of_six_limbs(design, six)
    if found.verdict == "refused":
        raise RigError(
            f"{path}: these limbs did not pass the comparison with vision; `rig limbs test` reports by how much"
        )
    if found.withdrawn is not None:
        w = found.withdrawn
        raise RigError(
            f"{path}: the acceptance of these limbs was withdrawn at frame {w.frame} of {w.recording}: "
            f"{w.reason}; `rig limbs test` accepts "
            "them anew"
        )
    for name in ("base_joints", "platform_joints", "strut_zeros"):
        apart = np.abs(getattr(other, name) - getattr(found.nominal, name)).reshape(6, -1).max(axis=1)
        if apart.max() > SAME:
            limb = int(apart.argmax())
            raise RigError(
                f"{path} is of other limbs than rig.toml states in [insitu]: {name} of limb {six[limb] + 1} differs by "
                f"{apart[limb] * 1e3:.6g} mm"
            )
    return found


def limbs_with_acceptance_withdrawn(accepted: Accepted, recording: str, frame: int, reason: str) -> Accepted:
    """Accepted limbs with their acceptance withdrawn.

    recording, frame : where it was found; reason : in words
    """
    return replace(
        accepted, withdrawn=Withdrawal(recording, frame, reason, datetime.now(UTC).isoformat(timespec="seconds"))
    )


def is_limbs_file(path: Path) -> bool:
    """Whether a file is a limbs.json.

    Raises FileError for any other file that is there.
    """
    if not path.exists():
        return False
    try:
        load_limbs_of_any_verdict(path)
    except FileError as error:
        raise FileError(path, f"exists and is not a limbs.json ({error}); name another file") from None
    return True


def _hexapod(tree: Entries, key: str) -> Hexapod:
    found = mechanism_from_entries(tree.table(key))
    if not is_hexapod(found):
        tree.fail(
            f"{key} is a mechanism of kind {found.kind!r}; limbs that determine poses are six, as in a hexapod", key
        )
    return found


def _checks_out(checks: Checks | None) -> list[Json]:
    """The limbs beyond six, one by one."""
    if checks is None:
        return []
    return [
        {
            "limb": int(i) + 1,
            "base_joint": checks.base[k].tolist(),
            "platform_joint": checks.platform[k].tolist(),
            "zero": float(checks.zeros[k]),
            "covariance": checks.covariance[k].tolist(),
            "reading_sigma": float(checks.sigma[k]),
        }
        for k, i in enumerate(checks.limbs)
    ]


def _checks_in(tree: Entries) -> Checks | None:
    rows = tree.tables("checks") if "checks" in tree.tree else []
    if not rows:
        return None
    return Checks(
        np.array([row.whole("limb", 1) - 1 for row in rows]),
        np.array([row.array("base_joint", (3,)) for row in rows]),
        np.array([row.array("platform_joint", (3,)) for row in rows]),
        np.array([row.number("zero") for row in rows]),
        np.array([covariance_from_entries(row, 7, "covariance") for row in rows]),
        np.array([row.number("reading_sigma", above=0) for row in rows]),
    )


def _withdrawal(tree: Entries) -> Withdrawal | None:
    if tree.get("withdrawn") is None:
        return None
    table = tree.table("withdrawn")
    return Withdrawal(table.text("recording"), table.whole("frame", 0), table.text("reason"), table.text("created"))
