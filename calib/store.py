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

from calib.certificate import Figures, HeldOut
from calib.correction import Correction
from calib.interpolate.radial import Radial
from rig.design import Hexapod
from rig.errors import FileError
from rig.pose import pose, vector
from rig.writing import write_text

SCHEMA = "calibration/1"
UNITS = "m, rad, s; covariances in their products"
FRAMES = ("T_base_platform maps platform coordinates to the base; base and platform frame as the stated targets hold them; "
          "tangent x y z rx ry rz on the right, in the platform frame; commanded length = joint distance - strut zero")
PACKAGES = ("numpy", "scipy", "opencv-contrib-python-headless", "rig")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """correction : Correction; covariance : (42, 42) m^2 of the fitted parameters; scatter : (6,) m of each strut beyond the
    poses' noise; frames : numbers of the frames fitted; left_out : of those that did not agree; held_out : HeldOut
    provenance : what went in, by which versions and arguments"""

    correction: Correction
    covariance: np.ndarray
    scatter: np.ndarray
    frames: tuple[int, ...]
    left_out: tuple[int, ...]
    held_out: HeldOut
    provenance: dict


def provenance(recording, arguments, seed, used_images):
    """dict of the inputs' SHA-256, versions, arguments and seed. recording : Recording; used_images : whether they were read."""
    folder = recording.folder
    files = {name: _hash([folder / name]) for name in sorted(os.listdir(folder)) if name.endswith((".toml", ".csv"))}
    if used_images:
        names = sorted(name for name in recording.exposures.image if name)
        files[f"images ({len(names)})"] = _hash([folder / name for name in names])
    return {"recording": folder.resolve().name, "inputs_sha256": files, "arguments": list(arguments), "seed": seed,
            "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
            "created": datetime.now(UTC).isoformat(timespec="seconds")}


def _hash(paths):
    digest = hashlib.sha256()
    for path in paths:
        digest.update(Path(path).read_bytes())
    return digest.hexdigest()


def save(path, calibration):
    """Write a calibration.json, whole or not at all."""
    correction = calibration.correction
    tree = {
        "schema": SCHEMA, "units": UNITS, "frames": FRAMES,
        "nominal": _hexapod_out(correction.nominal), "fitted": _hexapod_out(correction.fitted),
        "parameter_order": "base joints 1..6 (x y z), platform joints 1..6 (x y z), strut zeros 1..6",
        "parameter_covariance": calibration.covariance.tolist(), "strut_scatter": calibration.scatter.tolist(),
        "remainder": [None if part is None else _radial_out(part) for part in correction.remainder],
        "fit": {"frames": list(calibration.frames), "left_out": list(calibration.left_out)},
        "held_out": asdict(calibration.held_out), "provenance": calibration.provenance,
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
        correction = Correction(_hexapod_in(tree["nominal"]), _hexapod_in(tree["fitted"]),
                                tuple(None if part is None else _radial_in(part) for part in tree["remainder"]))
        held = tree["held_out"]
        held_out = HeldOut(_figures_in(held["before"]), _figures_in(held["after"]), tuple(held["floor"]), tuple(held["ratio"]))
        return Calibration(correction, np.array(tree["parameter_covariance"], float), np.array(tree["strut_scatter"], float),
                           tuple(tree["fit"]["frames"]), tuple(tree["fit"]["left_out"]), held_out, tree["provenance"])
    except KeyError as error:
        raise FileError(path, f"is incomplete: {error} is missing") from None
    except (TypeError, ValueError) as error:
        raise FileError(path, f"holds a value of the wrong kind: {error}") from None


def _hexapod_out(hexapod):
    position, rotvec = np.split(vector(hexapod.home), 2)
    return {"kind": hexapod.kind, "base_joints": hexapod.base_joints.tolist(), "platform_joints": hexapod.platform_joints.tolist(),
            "strut_range": hexapod.strut_range.tolist(), "strut_zeros": hexapod.strut_zeros.tolist(),
            "home": {"position": position.tolist(), "rotvec": rotvec.tolist()}}


def _hexapod_in(tree):
    return Hexapod(tree["base_joints"], tree["platform_joints"], tree["strut_range"], pose(tree["home"]["position"], tree["home"]["rotvec"]),
                   tree["strut_zeros"])


def _radial_out(part):
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in
            ((name, getattr(part, name)) for name in Radial.__slots__)}


def _radial_in(tree):
    return Radial(**{name: np.array(value, float) if isinstance(value, list) else value for name, value in tree.items()})


def _figures_in(tree):
    return Figures(tree["n"], tuple(tree["position"]), tuple(tree["rotation"]), tuple(tree["bias"]))
