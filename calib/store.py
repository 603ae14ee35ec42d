"""calibration.json <-> Calibration, with where it came from."""

import hashlib
import json
import os
import platform
from dataclasses import asdict, dataclass
from datetime import datetime, UTC
from importlib.metadata import version
from pathlib import Path

import numpy as np

from calib.arms.correction import ArmCorrection
from calib.arms.model import names
from calib.arms.profile import Profile
from calib.certificate import Figures, HeldOut
from calib.correction import Correction
from calib.interpolate.radial import Radial
from rig.design import Arm, Hexapod
from rig.errors import FileError
from rig.recording import Recording
from rig.pose import pose, vector
from rig.provenance import flat, marks, shared
from rig.files import write_text

SCHEMA = "calibration/1"
UNITS = "m, rad, s; covariances in their products"
FRAMES = ("T_base_platform maps platform coordinates to the base; base and platform frame as the stated targets hold them; "
          "tangent x y z rx ry rz on the right, in the platform frame; commanded length = joint distance - strut zero")
ARM_FRAMES = ("T_base_platform maps the target on the hand to the frame of poses.csv = base A_1(theta_1 + q_1) .. A_n tool, "
              "A = Rz Tz(d) Tx(a) Rx(alpha) Ry(beta); base and tool of the nominal arm are fitted where [instrument] says free; "
              "a joint turns to q - remainder(q); tangents x y z rx ry rz on the right")
PARAMETERS = "base joints 1..6 (x y z), platform joints 1..6 (x y z), strut zeros 1..6"
PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "rig")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """correction : Correction, of an arm an ArmCorrection; covariance : (42, 42) m^2 of the fitted parameters, of an arm
    (12 + 5 n, 12 + 5 n) in the order of calib.arms.model; scatter : (6,) m of each strut beyond the poses' noise, of an arm
    (6,) m and rad of the pose; frames : numbers of the frames fitted; left_out : of those that did not agree; held_out : HeldOut
    provenance : what went in, by which versions and arguments"""

    correction: Correction
    covariance: np.ndarray
    scatter: np.ndarray
    frames: tuple[int, ...]
    left_out: tuple[int, ...]
    held_out: HeldOut
    provenance: dict


def provenance(recording, arguments, seed, used_images):
    """dict of the inputs' SHA-256, the marks of their data (see rig.provenance), versions, arguments and seed.

    recording : Recording; used_images : whether they were read
    """
    folder = recording.folder
    files = {name: _hash([folder / name]) for name in sorted(os.listdir(folder)) if name.endswith((".toml", ".csv"))}
    if used_images:
        names = sorted(name for name in recording.exposures.image if name)
        files[f"images ({len(names)})"] = _hash([folder / name for name in names])
    return {"recording": folder.resolve().name, "inputs_sha256": files, "data": flat(marks(recording)),
            "arguments": list(arguments), "seed": seed,
            "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
            "created": datetime.now(UTC).isoformat(timespec="seconds")}


def seen_before(calibration: Calibration, recording: Recording) -> list[int]:
    """The frames of a recording that a calibration was made from, be it by way of what was measured from it, or it from them."""
    return shared(marks(recording), calibration.provenance.get("data", ()))


def _hash(paths):
    digest = hashlib.sha256()
    for path in paths:
        digest.update(Path(path).read_bytes())
    return digest.hexdigest()


def save(path, calibration):
    """Write a calibration.json, whole or not at all."""
    correction = calibration.correction
    arm = correction.nominal.kind == "arm"
    tree = {
        "schema": SCHEMA, "units": UNITS, "frames": ARM_FRAMES if arm else FRAMES,
        "nominal": mechanism_out(correction.nominal), "fitted": mechanism_out(correction.fitted),
        "parameter_order": ", ".join(names(correction.nominal)) if arm else PARAMETERS,
        "parameter_covariance": calibration.covariance.tolist(), ("pose_scatter" if arm else "strut_scatter"): calibration.scatter.tolist(),
        "remainder": [None if part is None else _part_out(part) for part in correction.remainder],
        **({"visited": correction.visited.tolist()} if arm else {}),
        "fit": {"frames": list(calibration.frames), "left_out": list(calibration.left_out)},
        "held_out": nulls(asdict(calibration.held_out)), "provenance": calibration.provenance,
    }
    write_text(path, json.dumps(tree, indent=1) + "\n")


def load(path):
    """Calibration of a calibration.json. Raises FileError for a file that is missing, cut off, or of another schema."""
    try:
        tree = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except json.JSONDecodeError as error:
        raise FileError(path, f"not valid JSON: {error.msg} (cut off?)", error.lineno, error.colno) from None
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(path, f"cannot be read: {error}") from None
    if not isinstance(tree, dict) or tree.get("schema") != SCHEMA:
        found = tree.get("schema") if isinstance(tree, dict) else type(tree).__name__
        raise FileError(path, f'is no calibration: its schema is {found!r}, not "{SCHEMA}"')
    try:
        nominal, fitted = mechanism_in(tree["nominal"]), mechanism_in(tree["fitted"])
        arm = nominal.kind == "arm"
        parts = tuple(None if part is None else _part_in(part, Profile if arm else Radial) for part in tree["remainder"])
        correction = ArmCorrection(nominal, fitted, parts, np.array(tree["visited"], float)) if arm else Correction(nominal, fitted, parts)
        held = tree["held_out"]
        held_out = HeldOut(_figures_in(held["before"]), _figures_in(held["after"]), _numbers_in(held["floor"]), tuple(held["ratio"]))
        scatter = np.array(tree["pose_scatter" if arm else "strut_scatter"], float)
        return Calibration(correction, np.array(tree["parameter_covariance"], float), scatter,
                           tuple(tree["fit"]["frames"]), tuple(tree["fit"]["left_out"]), held_out, tree["provenance"])
    except KeyError as error:
        raise FileError(path, f"is incomplete: {error} is missing") from None
    except (TypeError, ValueError) as error:
        raise FileError(path, f"holds a value of the wrong kind: {error}") from None


def mechanism_out(mechanism):
    """dict of a Hexapod or an Arm, as JSON holds it."""
    if mechanism.kind == "arm":
        return {"kind": "arm", "joints": mechanism.rows.tolist(), "limits": mechanism.limits.tolist(), "base": _pose_out(mechanism.base),
                "tool": _pose_out(mechanism.tool)}
    return {"kind": mechanism.kind, "base_joints": mechanism.base_joints.tolist(), "platform_joints": mechanism.platform_joints.tolist(),
            "strut_range": mechanism.strut_range.tolist(), "strut_zeros": mechanism.strut_zeros.tolist(), "home": _pose_out(mechanism.home)}


def mechanism_in(tree):
    """Hexapod or Arm of what `mechanism_out` gave. Raises KeyError, TypeError or ValueError for anything else."""
    if tree["kind"] == "arm":
        return Arm(tree["joints"], tree["limits"], _pose_in(tree["base"]), _pose_in(tree["tool"]))
    return Hexapod(tree["base_joints"], tree["platform_joints"], tree["strut_range"], _pose_in(tree["home"]), tree["strut_zeros"])


def _pose_out(T):
    position, rotvec = np.split(vector(T), 2)
    return {"position": position.tolist(), "rotvec": rotvec.tolist()}


def _pose_in(tree):
    return pose(tree["position"], tree["rotvec"])


def _part_out(part):
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in
            ((name, getattr(part, name)) for name in type(part).__slots__)}


def _part_in(tree, kind):
    return kind(**{name: np.array(value, float) if isinstance(value, list) else value for name, value in tree.items()})


def _figures_in(tree):
    return Figures(tree["n"], *(_numbers_in(tree[name]) for name in ("position", "rotation", "bias", "mean")))


def _numbers_in(values):
    return tuple(np.nan if value is None else value for value in values)


def nulls(tree):
    """The same with null for figures of what was not measured: JSON has no NaN."""
    if isinstance(tree, dict):
        return {name: nulls(value) for name, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [nulls(value) for value in tree]
    return None if isinstance(tree, float) and not np.isfinite(tree) else tree
