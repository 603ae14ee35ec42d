"""A recording folder <-> arrays: what the rig did and what was seen of it, all outside data checked here."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig import design_file, table
from rig.design import Design
from rig.errors import FileError, RigError
from rig.images import check_image
from rig.pose import TRIANGLE, covariance_from_triangle, pose

POSE_COLUMNS = ("x", "y", "z", "rx", "ry", "rz")
COVARIANCE_COLUMNS = tuple(f"c{i}{j}" for i, j in zip(*TRIANGLE))
CORNER_COLUMNS = ("frame", "camera", "marker", "corner", "u", "v")
CORNER_COVARIANCE = ("cuu", "cuv", "cvv")
LAST_DWELL = 0.25  # share of frames that may follow the last command, in its dwell, before the file counts as cut off
SIMULTANEOUS = 1e-3  # s; exposures of one frame that differ by more were not exposed together


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """t : (n,) s, increasing; values : (n, axes) m or rad; between two rows every axis moves linearly, after the last it dwells."""

    t: np.ndarray
    values: np.ndarray

    def at(self, t):
        """(..., axes) what was commanded at times t (s). Raises RigError for a time before the first command."""
        t = np.asarray(t, float)
        if (t < self.t[0]).any():
            raise RigError(f"t = {t.min():g} s is before the first command (t = {self.t[0]:g} s)")
        return np.stack([np.interp(t, self.t, column) for column in self.values.T], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """One row per exposure. frame : (n,) int; t : (n,) s; camera, image : n names ("" where there is none)."""

    frame: np.ndarray
    t: np.ndarray
    camera: list[str]
    image: list[str]

    def times(self):
        """(frames, t) : the distinct frames in order and their times (s)."""
        frames, first = np.unique(self.frame, return_index=True)
        return frames, self.t[first]


@dataclass(frozen=True, slots=True, eq=False)
class Sensors:
    """t : (n,) s; channels : {name: (n,) values in the unit its name says}, linear between rows."""

    t: np.ndarray
    channels: dict[str, np.ndarray]

    def at(self, t, *names):
        """(n,) values at times t (n,) s of the first of these channels that there is. Raises RigError where there is none."""
        for name in names:
            if name in self.channels:
                return np.interp(t, self.t, self.channels[name])
        raise RigError(f"the model needs a sensor channel {' or '.join(map(repr, names))}, which the recording does not have")


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Marker corners in images. frame, marker, corner : (n,) int; camera : n names; uv : (n, 2) px;
    covariance : (n, 2, 2) px^2, or None where the recording states none."""

    frame: np.ndarray
    camera: list[str]
    marker: np.ndarray
    corner: np.ndarray
    uv: np.ndarray
    covariance: np.ndarray | None


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Platform in base. frame : (n,) int; T_base_platform : RigidTransform (n,); covariance : (n, 6, 6) m, rad, on the
    right, order x y z rx ry rz, or None."""

    frame: np.ndarray
    T_base_platform: RigidTransform
    covariance: np.ndarray | None


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A whole recording; parts that the folder lacks are None."""

    folder: Path
    design: Design
    commands: Commands | None
    exposures: Exposures
    sensors: Sensors | None
    corners: Corners | None
    poses: Poses | None

    @property
    def has_images(self):
        """Whether any exposure names an image."""
        return any(self.exposures.image)

    def commanded(self):
        """(frames, t, values (n, axes)): what was commanded at each frame. Raises RigError without commands.csv."""
        if self.commands is None:
            raise RigError(f"{self.folder}: there is no commands.csv, so nothing was commanded")
        frames, t = self.exposures.times()
        return frames, t, self.commands.at(t)


def load(folder):
    """Recording of a folder. Raises FileError naming file, line and column of the first thing that cannot be used."""
    folder = Path(folder)
    if not folder.is_dir():
        raise FileError(folder, "is a file, not a recording folder" if folder.exists() else "no such folder")
    if not any(folder.iterdir()):
        raise FileError(folder, "is an empty folder; a recording has at least rig.toml and frames.csv")
    design = design_file.load(folder / "rig.toml")
    exposures = _exposures(folder, design)
    commands = _commands(folder / "commands.csv", design, exposures)
    corners = _corners(folder / "corners.csv", design, exposures)
    known = set(exposures.frame.tolist())
    alone = design.instrument is not None and design.instrument.rotation_sigma is None
    poses = load_poses(folder / "poses.csv", known, alone) if (folder / "poses.csv").exists() else None
    return Recording(folder, design, commands, exposures, _sensors(folder / "sensors.csv"), corners, poses)


def _commands(path, design, exposures):
    if not path.exists():
        return None
    if not design.mechanism.axes:
        raise FileError(path, 'stands beside a mechanism of kind "free", which cannot be commanded')
    rows = table.read(path, ("t", *design.mechanism.axes))
    t = _increasing(rows)
    for column in rows.columns:
        if column not in ("t", *design.mechanism.axes) and column[:1] == design.mechanism.axes[0][0] and column[1:].isdigit():
            raise FileError(path, f"column {column!r}: rig.toml has only {len(design.mechanism.axes)} axes", 1, rows.columns.index(column) + 1)
    frames, times = exposures.times()
    if times[0] < t[0]:
        rows.fail(f"frame {frames[0]} was exposed at t = {times[0]:g} s, before the first command (t = {t[0]:g} s)", 0, "t", t[0])
    after = np.flatnonzero(times > t[-1])
    if len(after) > 1 and len(after) > LAST_DWELL * len(times):
        rows.fail(f"{len(after)} of {len(times)} frames, from frame {frames[after[0]]} at t = {times[after[0]]:g} s on, were exposed after "
                  f"the last command (t = {t[-1]:g} s): is the file cut off?", len(rows) - 1, "t", t[-1])
    return Commands(t, rows.matrix(design.mechanism.axes))


def _increasing(rows):
    t = rows.numbers("t")
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        i = back[0] + 1
        rows.fail(f"time must increase: t = {t[i]:g} s follows {t[i - 1]:g} s", i, "t", t[i])
    return t


def _exposures(folder, design):
    path = folder / "frames.csv"
    rows = table.read(path, ("frame", "t", "camera", "image"))
    frame, t, camera, image = rows.whole("frame"), rows.numbers("t"), rows.text("camera"), rows.text("image")
    cameras = {c.name: c for c in design.cameras}
    seen, start = {}, {}
    last = (-1, -np.inf)
    for i in range(len(rows)):
        if camera[i] and camera[i] not in cameras:
            rows.fail(f"unknown camera {camera[i]!r}; rig.toml has {', '.join(map(repr, cameras)) or 'none'}", i, "camera", camera[i])
        if image[i] and not camera[i]:
            rows.fail(f"image {image[i]!r} without a camera", i, "camera")
        if (frame[i], camera[i]) in seen:
            rows.fail(f"frame {frame[i]} of camera {camera[i]!r} is listed twice, first in line {seen[frame[i], camera[i]]}", i, "frame")
        seen[frame[i], camera[i]] = rows.lines[i]
        if frame[i] in start:
            if abs(t[i] - start[frame[i]]) > SIMULTANEOUS:
                rows.fail(f"frame {frame[i]} at t = {t[i]:g} s, but its first exposure was at {start[frame[i]]:g} s: "
                          "exposures of one frame are simultaneous", i, "t", t[i])
            continue
        if frame[i] < last[0]:
            rows.fail(f"frame {frame[i]} follows frame {last[0]}: frames must come in order", i, "frame", frame[i])
        if t[i] < last[1]:
            rows.fail(f"time runs backwards: t = {t[i]:g} s follows {last[1]:g} s", i, "t", t[i])
        start[frame[i]], last = t[i], (frame[i], t[i])
    for i, name in enumerate(image):
        if name:
            problem = check_image(folder / name, cameras[camera[i]])
            if problem:
                raise FileError(folder / name, f"{problem} ({path.name}, line {rows.lines[i]})")
    return Exposures(frame, t, camera, image)


def _sensors(path):
    if not path.exists():
        return None
    rows = table.read(path, ("t",))
    return Sensors(_increasing(rows), {name: rows.numbers(name) for name in rows.columns if name != "t"})


def _corners(path, design, exposures):
    if not path.exists():
        return None
    rows = table.read(path, CORNER_COLUMNS, ("sigma", *CORNER_COVARIANCE))
    frame, marker, corner, camera = rows.whole("frame"), rows.whole("marker"), rows.whole("corner"), rows.text("camera")
    uv = rows.matrix(("u", "v"))
    cameras = {c.name for c in design.cameras}
    markers = {number for target in design.targets for number in target.ids}
    exposed = set(zip(exposures.frame.tolist(), exposures.camera))
    seen = {}
    for i, key in enumerate(zip(frame.tolist(), camera, marker.tolist(), corner.tolist())):
        if key[1] not in cameras:
            rows.fail(f"unknown camera {key[1]!r}; rig.toml has {', '.join(sorted(cameras)) or 'none'}", i, "camera", key[1])
        if key[2] not in markers:
            rows.fail(f"unknown marker {key[2]}: no target of rig.toml has it", i, "marker", key[2])
        if key[3] > 3:
            rows.fail(f"a marker has corners 0..3, not {key[3]}", i, "corner", key[3])
        if key[:2] not in exposed:
            rows.fail(f"frame {key[0]} of camera {key[1]!r} is not in frames.csv", i, "frame", key[0])
        if key in seen:
            rows.fail(f"corner {key[3]} of marker {key[2]} is listed twice in frame {key[0]}, camera {key[1]!r}, first in line "
                      f"{rows.lines[seen[key]]}", i, "marker", key[2])
        seen[key] = i
    return Corners(frame, camera, marker, corner, uv, _corner_covariance(rows))


def _corner_covariance(rows):
    if all(name in rows.columns for name in CORNER_COVARIANCE):
        cuu, cuv, cvv = rows.matrix(CORNER_COVARIANCE).T
        bad = np.flatnonzero((cuu <= 0) | (cuu * cvv <= cuv**2))
        if len(bad):
            rows.fail("cuu, cuv, cvv are no covariance: not positive definite", bad[0], "cuu")
        return np.stack([np.stack([cuu, cuv], -1), np.stack([cuv, cvv], -1)], -2)
    if "sigma" not in rows.columns:
        return None
    sigma = rows.numbers("sigma")
    bad = np.flatnonzero(sigma <= 0)
    if len(bad):
        rows.fail(f"sigma must be positive px, not {sigma[bad[0]]:g}", bad[0], "sigma", sigma[bad[0]])
    return sigma[:, None, None] ** 2 * np.eye(2)


def load_poses(path, known_frames=None, positions_alone=False):
    """Poses of a poses.csv: measured ones, or wanted ones for `rig correct`.

    known_frames : set of frame numbers that there are, or None; positions_alone : rotations and covariances, if there are any,
    mean nothing: the poses are unrotated. Raises FileError with line and column.
    """
    rows = table.read(path, ("frame", *POSE_COLUMNS[: 3 if positions_alone else 6]), COVARIANCE_COLUMNS)
    frame = rows.whole("frame")
    seen = {}
    for i, number in enumerate(frame.tolist()):
        if known_frames is not None and number not in known_frames:
            rows.fail(f"frame {number} is not in frames.csv", i, "frame", number)
        if number in seen:
            rows.fail(f"frame {number} is listed twice, first in line {rows.lines[seen[number]]}", i, "frame", number)
        seen[number] = i
    values = np.zeros((len(rows), 6))
    values[:, : 3 if positions_alone else 6] = rows.matrix(POSE_COLUMNS[: 3 if positions_alone else 6])
    far = np.argwhere(np.abs(values[:, :3]) > design_file.LARGEST_RIG)
    if len(far):
        i, j = far[0]
        rows.fail(f"{POSE_COLUMNS[j]} = {values[i, j]:g} m is implausible: poses are in metres (millimetres?)", i, POSE_COLUMNS[j], values[i, j])
    return Poses(frame, pose(values[:, :3], values[:, 3:]), None if positions_alone else _pose_covariance(rows))


def _pose_covariance(rows):
    given = [name for name in COVARIANCE_COLUMNS if name in rows.columns]
    if not given:
        return None
    if len(given) < len(COVARIANCE_COLUMNS):
        missing = next(name for name in COVARIANCE_COLUMNS if name not in given)
        raise FileError(rows.path, f"column {missing!r} is missing: a covariance has all of {','.join(COVARIANCE_COLUMNS)}", 1)
    covariance = covariance_from_triangle(rows.matrix(COVARIANCE_COLUMNS))
    scale = np.sqrt(np.abs(np.einsum("nii->ni", covariance)))
    whitened = covariance / np.maximum(scale[:, :, None] * scale[:, None, :], 1e-300)
    bad = np.flatnonzero(np.linalg.eigvalsh(whitened)[:, 0] <= 0)
    if len(bad):
        rows.fail("c00 .. c55 are no covariance: not positive definite", bad[0], "c00")
    return covariance
