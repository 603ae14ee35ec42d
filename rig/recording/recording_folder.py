"""Recording with its commands and sensors as dataclasses of arrays, loaded from its folder with checks."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rig.array_and_json_types import Floats, Integers
from rig.errors import FileError, RigError
from rig.formats import csv_and_parquet_tables_and_time_origin, local_and_remote_input_files
from rig.formats.checked_toml_and_json_entries import rig_part_name_problem
from rig.formats.csv_and_parquet_tables_and_time_origin import Table, TimeOrigin
from rig.formats.local_and_remote_input_files import read_bytes
from rig.formats.numbers_and_units import count_text
from rig.formats.output_files import require_folder_of_uninterrupted_command, write_bytes, write_text
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import COUPLED, hand_names
from rig.model.base_and_link_tilt_sensors import (
    GRAVITY,
    BaseTilt,
    base_gravity_channels_under_tilts,
    has_gravity_sensor_channels,
    log_times_refined_for_tilt_steps,
)
from rig.model.design import Design
from rig.model.mechanism_geometry_classes import Arm
from rig.model.mechanisms.mechanism_kinds_and_kinematics import has_links, target_bodies
from rig.recording.corner_and_pose_csv_tables import Corners, Poses, load_corners, load_instrument_poses
from rig.recording.exposures_and_image_files import (
    ONE_FRAME,
    SIMULTANEOUS,
    Exposures,
    UnreadableImage,
    load_exposures_and_unreadable_images,
)
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

LIMB = re.compile(r"m[1-9]\d*")  # a channel of a measuring limb, m, read only where there are rows about an exposure
PAYLOAD = "payload_mass_kg"  # channel of sensors.csv, column of a plan in time: what the platform carries
LAST_DWELL = 0.25  # share of frames that may follow the last command, in its dwell, before the file counts as cut off


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """t : (n,) s, increasing; values : (n, axes) m or rad; between two rows every axis moves linearly, after the last
    it dwells
    starts : (k,) s, rows at which another recording of the same machine begins (see rig.recording.combined_recordings):
        nothing before them is
    remembered."""

    t: Floats
    values: Floats
    starts: Floats = field(default_factory=lambda: np.zeros(0))

    def at(self, t: ArrayLike) -> Floats:
        """(..., axes) what was commanded at times t (s). Raises RigError for a time before the first command."""
        t = np.asarray(t, float)
        if (t < self.t[0]).any():
            raise RigError(f"t = {t.min():g} s is before the first command (t = {self.t[0]:g} s)")
        return np.stack([np.interp(t, self.t, column) for column in self.values.T], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Sensors:
    """t : (n,) s; channels : {name: (n,) values in the unit its name says}, linear between rows; reading a recording
    sees to it that the log covers the exposures to within the distance of its rows, over which the nearest row stands
    starts : (k,) s, rows at which another recording's log begins"""

    t: Floats
    channels: dict[str, Floats]
    starts: Floats = field(default_factory=lambda: np.zeros(0))

    def at(self, t: Floats | Sequence[float], *names: str) -> Floats:
        """(n,) values at times t (n,) s of the first of these channels that there is. Raises RigError where there is
        none.
        """
        for name in names:
            if name in self.channels:
                return np.interp(t, self.t, self.channels[name])
        raise RigError(
            f"the model needs a sensor channel {' or '.join(map(repr, names))}, which the recording does not have"
        )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recording(OneLineRepr):
    """A whole recording; parts that the folder lacks are None. All times are s from the recording's start: its first
    command, or where nothing was commanded its first exposure; origin : of the owner's clock, to write them
    skipped : images that cannot be used and were excluded, as requested
    parts : (RecordingPart, ..) where it is several recordings of one rig together (see
        rig.recording.combined_recordings)
    stages : {number (from 1): Poses} of a chain's stages below the last, where the folder has them"""

    folder: Path
    design: Design
    commands: Commands | None
    exposures: Exposures
    sensors: Sensors | None
    corners: Corners | None
    poses: Poses | None
    origin: TimeOrigin = TimeOrigin()
    skipped: tuple[UnreadableImage, ...] = ()
    parts: tuple["RecordingPart", ...] = ()
    stages: dict[int, Poses] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its folder's name; of several, theirs."""
        return " + ".join(part.recording.name for part in self.parts) or self.folder.resolve().name

    @property
    def apart(self) -> tuple["RecordingPart", ...]:
        """The recordings that it consists of: itself, where it is one."""
        return self.parts or (RecordingPart(self, 0, 0.0),)

    def __str__(self) -> str:
        frames, t = self.exposures.times()
        return f"{self.name}: {count_text(len(frames), 'frame')} over {np.ptp(t):.4g} s"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        parts = [
            name
            for name, part in (
                ("commands", self.commands),
                ("sensors", self.sensors),
                ("corners", self.corners),
                ("poses", self.poses),
            )
            if part is not None
        ] + (["images"] if self.has_images else [])
        cameras = ", ".join(f"{c.name} ({c.width} x {c.height})" for c in self.design.cameras) or "none"
        return result_html(
            str(self),
            [
                f"a {self.design.mechanism.kind}; cameras: {cameras}; {len(self.design.targets)} targets",
                f"it has {', '.join(parts) or 'nothing'}",
            ],
        )

    @property
    def has_images(self) -> bool:
        """Whether any exposure names an image."""
        return any(self.exposures.image)

    def commanded(self) -> tuple[Integers, Floats, Floats]:
        """(frames, t, values (n, axes)): what was commanded at each frame. Raises RigError without commands.csv."""
        if self.commands is None:
            raise RigError(f"{self.folder}: there is no commands.csv, so nothing was commanded")
        frames, t = self.exposures.times()
        return frames, t, self.commands.at(t)


@dataclass(frozen=True, slots=True, eq=False)
class RecordingPart:
    """One of several recordings together. recording : as it stands; frames : added to its frames' numbers; t : s, added
    to its times.
    """

    recording: Recording
    frames: int
    t: float


def load_recording(folder: str | Path, skip_unreadable: bool = False) -> Recording:
    """Load the Recording of a folder.

    Local or behind a URL.
    skip_unreadable : whether images that cannot be used are left out, into `skipped`.

    Raises FileError naming file, line and column of the first thing that cannot be used; of images, all that cannot be

    >>> import rig
    >>> recording = rig.load("tests/data/bench/check")
    >>> recording.design.mechanism.kind, recording.commands.values.shape
    ('hexapod', (14, 6))
    """
    folder = Path(folder)
    local_and_remote_input_files.clear_listing_cache()
    if not local_and_remote_input_files.is_folder(folder):
        raise FileError(
            folder,
            "is a file, not a recording folder" if local_and_remote_input_files.exists(folder) else "no such folder",
        )
    require_folder_of_uninterrupted_command(folder)
    if local_and_remote_input_files.is_empty(folder):
        raise FileError(folder, "is an empty folder; a recording has at least rig.toml and frames.csv")
    design = design_from_rig_toml.load_design(folder / "rig.toml")
    commanded = _command_rows(folder / "commands.csv", design)
    exposed = csv_and_parquet_tables_and_time_origin.read_csv_table(
        folder / "frames.csv", ("frame", "t", "camera", "image")
    )
    origin = (exposed if commanded is None else commanded).first_time_origin()
    apart = SIMULTANEOUS if commanded is None else ONE_FRAME
    exposures, skipped = load_exposures_and_unreadable_images(folder, design, exposed, origin, skip_unreadable, apart)
    commands = None if commanded is None else _commands(commanded, design, exposures, origin)
    corners = load_corners(folder / "corners.csv", design, exposures)
    known = set(exposures.frame.tolist())
    poses = (
        load_instrument_poses(folder / "poses.csv", known, design.instrument, hands=hand_names(design.mechanism))
        if local_and_remote_input_files.exists(folder / "poses.csv")
        else None
    )
    sensors = _sensors(folder / "sensors.csv", origin, exposures)
    if sensors is not None or design.tilts:
        sensors = sensors_with_gravity(design.gravity, design.tilts, sensors or Sensors(np.zeros(1), {}))
    return Recording(
        folder,
        design,
        commands,
        exposures,
        sensors,
        corners,
        poses,
        origin,
        tuple(skipped),
        stages=_stages(folder, design, known),
    )


def _stages(folder: Path, design: Design, known: set[int]) -> dict[int, Poses]:
    """{number: Poses} of a folder's poses_stage1.csv .. Raises FileError for one of a stage that rig.toml does not have
    below the last.
    """
    bodies = target_bodies(design.mechanism)
    out = {}
    for name in local_and_remote_input_files.list_folder(folder):
        if not name.startswith("poses_stage") or not name.endswith(".csv"):
            continue
        body = name.removesuffix(".csv").replace("poses_stage", "stage ")
        if body not in bodies:
            raise FileError(
                folder / name, f"rig.toml has no {body!r} below a last platform; there are {', '.join(bodies)}"
            )
        out[int(body.removeprefix("stage "))] = load_instrument_poses(folder / name, known, design.instrument)
    return out


def load_sensors(path: str | Path, origin: TimeOrigin) -> Sensors:
    """Load Sensors from a sensors.csv.

    Times are relative to a TimeOrigin. Raises FileError with line and column.
    """
    return _sensor_rows(csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("t",)), origin)


def sensors_with_gravity(gravity: Floats, tilts: tuple[BaseTilt, ...], sensors: Sensors) -> Sensors:
    """Sensors with channels of gravity.

    In the base frame, where the base tilts. gravity : (3,) m/s^2 at zero tilt
    Gravity that was logged itself, by an accelerometer on the base, is left as it is. Rows are added where a tilt
    changes much, as gravity is interpolated between them.
    Raises RigError where a tilt was not logged, or gravity in part
    """
    if set(GRAVITY) & set(sensors.channels) and not has_gravity_sensor_channels(sensors.channels):
        raise RigError(f"sensors.csv has gravity in part: {', '.join(GRAVITY)} belong together")
    if not tilts or has_gravity_sensor_channels(sensors.channels):
        return sensors
    missing = [tilt.channel for tilt in tilts if tilt.channel not in sensors.channels]
    if missing:
        raise RigError(
            f"rig.toml states that the base tilts by {', '.join(missing)} ([[environment.tilt]]), which sensors.csv "
            "does not have: log it, or gravity in the base frame as " + ", ".join(GRAVITY)
        )
    t = log_times_refined_for_tilt_steps(sensors.t, tilts, sensors.channels)
    channels: dict[str, Floats] = {
        name: np.asarray(np.interp(t, sensors.t, values)) for name, values in sensors.channels.items()
    }
    return replace(
        sensors,
        t=t,
        channels={**channels, **base_gravity_channels_under_tilts(gravity, tilts, lambda name: channels[name])},
    )


def _command_rows(path: Path, design: Design) -> Table | None:
    if not local_and_remote_input_files.exists(path):
        return None
    if not design.mechanism.axes:
        raise FileError(path, 'accompanies a mechanism of kind "free", which cannot be commanded')
    return csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("t", *design.mechanism.axes))


def _commands(rows: Table, design: Design, exposures: Exposures, origin: TimeOrigin) -> Commands:
    path, t = rows.path, rows.increasing_times(origin)
    for column in rows.columns:
        if (
            column not in ("t", *design.mechanism.axes)
            and column[:1] == design.mechanism.axes[0][0]
            and column[1:].isdigit()
        ):
            raise FileError(
                path,
                f"column {column!r}: rig.toml has only {len(design.mechanism.axes)} axes",
                1,
                rows.columns.index(column) + 1,
            )
    frames, times = exposures.times()
    if times[0] < t[0]:
        rows.fail(
            f"frame {frames[0]} was exposed at t = {origin.text(times[0])} s, before the first command (t = "
            f"{origin.text(t[0])} s)",
            0,
            "t",
        )
    after = np.flatnonzero(times > t[-1])
    if len(after) > 1 and len(after) > LAST_DWELL * len(times):
        rows.fail(
            f"{len(after)} of {len(times)} frames, from frame {frames[after[0]]} at t = "
            f"{origin.text(times[after[0]])} s on, were exposed "
            f"after the last command (t = {origin.text(t[-1])} s): is the file cut off?",
            len(rows) - 1,
            "t",
        )
    values = rows.matrix(design.mechanism.axes)
    if has_links(design.mechanism):
        require_follower_joint_values_match_leaders(rows, values, design.mechanism)
    return Commands(t, values)


def require_follower_joint_values_match_leaders(rows: Table, values: Floats, arm: Arm) -> None:
    """Raise FileError unless follower joint values match their leaders.

    It names a row of commanded values (n, axes) in which a joint is not where its leader has it.
    """
    off = np.abs(arm.with_followers(values) - values)
    for i, j in np.argwhere(off > COUPLED)[:1].tolist():
        one = next(one for one in arm.couplings if one.joint == j)
        rows.fail(
            f"joint {j + 1} follows joint {one.leader + 1}, and is {off[i, j]:.3g} {mechanisms.axis_units(arm)[j]} off "
            f"{one.multiplier:.6g} times it {one.offset:+.6g}: [[mechanism.coupling]] in rig.toml states that",
            i,
            arm.axes[j],
        )


def _sensors(path: Path, origin: TimeOrigin, exposures: Exposures) -> Sensors | None:
    if not local_and_remote_input_files.exists(path):
        return None
    rows = csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("t",))
    sensors = _sensor_rows(rows, origin)
    if not all(LIMB.fullmatch(name) for name in sensors.channels):
        _covers(rows, sensors.t, exposures, origin)
    return sensors


def _sensor_rows(rows: Table, origin: TimeOrigin) -> Sensors:
    t, channels = rows.increasing_times(origin), tuple(name for name in rows.columns if name != "t")
    for name in channels:
        if rig_part_name_problem(name):
            raise FileError(rows.path, f"column {rig_part_name_problem(name)}", 1, rows.columns.index(name) + 1, name)
    return Sensors(t, {name: rows.numbers(name) for name in channels})


def _covers(rows: Table, t: Floats, exposures: Exposures, origin: TimeOrigin) -> None:
    """Raise FileError where exposures lie farther outside a log, at t (n,) s, than its rows are apart: nobody knows
    what was then.
    One row alone states what never changed."""
    if len(t) == 1:
        return
    times, apart = exposures.times()[1], np.diff(t).max()
    for outside, row, word in ((times < t[0] - apart, 0, "begins"), (times > t[-1] + apart, len(rows) - 1, "ends")):
        if outside.any():
            far = times[outside][-1 if row else 0]
            rows.fail(
                f"the log {word} at t = {origin.text(t[row])} s, but {outside.sum()} of {len(times)} frames "
                "were exposed "
                f"{'after it, up to' if row else 'before it, from'} {origin.text(far)} "
                f"s{'' if row else ' on'}: values are not extended "
                "beyond a log; is it cut off, or of another clock?",
                row,
                "t",
            )


def copy_frames_commands_and_sensors(source: Path, target: Path, exposures: Exposures, origin: TimeOrigin) -> None:
    """Copy frames, commands and sensors of a recording from one folder to another.

    frames.csv (without image names), commands.csv and sensors.csv.
    origin : TimeOrigin that the folder's times are told by
    """
    lines = ["frame,t,camera,image"]
    lines += [
        f"{frame},{origin.text(t)},{camera},"
        for frame, t, camera in zip(exposures.frame, exposures.t, exposures.camera)
    ]
    write_text(Path(target) / "frames.csv", "\n".join(lines) + "\n")
    for name in ("commands.csv", "sensors.csv"):
        if local_and_remote_input_files.exists(Path(source) / name):
            write_bytes(Path(target) / name, read_bytes(Path(source) / name))
