"""Exposures in motion at 20 mm/s: are poses and calibration as good as at rest, and is the time offset found?

An emulated controller and `rig run --in-motion` in processes of their own, three free-running cameras whose stamps are
late by 7.3 ms, corners seen by tests.truth at each camera's and each row's own time; at rest the same poses with the
same noise of corners.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

import calib
import vision
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import ELSEWHERE
from rig.recording.recording_folder import Recording, load_recording
from tests.moving_run import (
    CAMERA,
    CONTROLLER,
    ROW_TIME,
    case_of_moving_machine,
    corners_seen,
    rig_text,
    table_of,
    write_corners,
    write_frames,
    write_standing_recording,
)
from tests.truth import rigid
from tests.truth.case import Case

SEED = 3
PLAN = "sobol:60"
SPEED = 20.0  # mm/s
LATE = 0.0073  # s by which the cameras' stamps are
DELAYS = (0.0, 0.021, 0.013)  # s by which cameras expose one after the other
RIG = [sys.executable, "-c", "from rig.cli.command_line import main; import sys; sys.exit(main())"]


@dataclass(frozen=True)
class Outcome:
    """poses : how many; minutes : of the run; measured, reached : ((m, rad) in motion, (m, rad) standing), RMS errors
    of poses measured, and of poses reached by the calibration at other places; offset, sigma, wanted : s, found,
    stated, true
    """

    poses: int
    minutes: float
    measured: tuple[tuple[float, float], ...]
    reached: tuple[tuple[float, float], ...]
    offset: float
    sigma: float
    wanted: float


def rows() -> Iterator[tuple[str, str, str]]:
    """(figure, reached, wanted)"""
    with tempfile.TemporaryDirectory() as folder:
        found = outcome(Path(folder), PLAN)
    yield "poses, minutes of the whole run", f"{found.poses}, {found.minutes:.1f}", ""
    yield compared("pose measured", found.measured)
    yield (
        "time offset found less the true one, standard deviation stated",
        f"{abs(found.offset - found.wanted) * 1e3:.3f} ms, {found.sigma * 1e3:.3f} ms",
        "<= 0.2 ms",
    )
    yield "time offset: stamps alone, with what the run adds", f"{-LATE * 1e3:.1f} ms, {found.wanted * 1e3:.2f} ms", ""
    yield compared("pose reached at 100 other places by the calibration", found.reached)


def compared(what: str, pairs: tuple[tuple[float, float], ...]) -> tuple[str, str, str]:
    """Figure of errors (m, rad) in motion and at rest."""
    (moving, turned), (standing, turning) = pairs
    return (
        f"{what}: RMS in motion, standing, ratio",
        f"{moving * 1e6:.1f} um, {standing * 1e6:.1f} um, {moving / standing:.2f}; "
        f"{turned * 1e6:.0f} urad, {turning * 1e6:.0f} urad, {turned / turning:.2f}",
        "ratio <= 1.5",
    )


def outcome(folder: Path, plan: str) -> Outcome:
    """Outcome of a run of a plan in a folder."""
    case = case_of_moving_machine(SEED)
    began = time.monotonic()
    run(case, folder, plan)
    minutes = (time.monotonic() - began) / 60
    moving, standing, truth, wanted = recordings(case, folder)
    places = case.machine.forward(goals(case, 100))
    found, measured, reached = [], [], []
    for recording in (moving, standing):
        found.append(vision.measure(recording))
        m = found[-1].measurement
        measured.append(rigid.rms(rigid.errors(m.T_base_platform.as_matrix(), truth[m.frames])))
        made = calib.calibrate(recording, calib.CalibrateOptions(quick=True)).calibration
        lengths = made.correction.inverse(RigidTransform.from_matrix(places))
        reached.append(rigid.rms(rigid.errors(case.machine.forward(lengths), places)))
    clocks = found[0].clocks[0]
    return Outcome(len(truth), minutes, tuple(measured), tuple(reached), clocks.offset, clocks.offset_sigma, wanted)


def run(case: Case, folder: Path, plan: str) -> None:
    """Run a plan in motion, at an emulated controller, into folder/REC; folder/history.csv is what the struts did."""
    names = [camera.name for camera in case.camera_set.stated]
    (folder / "late.py").write_text(
        CAMERA.format(delays=dict(zip(names, DELAYS)), late=LATE, log=str(folder / "exposed.csv"))
    )
    controller = CONTROLLER.format(port=folder / "port", speed=0.025, acceleration=0.1)
    (folder / "rig.toml").write_text(rig_text(case, True, "file:late.py") + controller)
    emulate = [*RIG, "emulate", folder / "rig.toml", "--link", folder / "port", "--history", folder / "history.csv"]
    with subprocess.Popen(emulate, stdout=subprocess.PIPE, text=True) as emulator:
        try:
            emulator.stdout.readline()
            words = ["--plan", plan, "--in-motion", f"{SPEED:g}", "--no-measure", "--exposure", "keep"]
            subprocess.run([*RIG, "run", folder / "rig.toml", *words, "--out", folder / "REC"], check=True)
        finally:
            emulator.terminate()


def table_of_frames(folder: Path) -> np.ndarray:
    """(n, cameras) s, times of frames.csv."""
    t = [float(line.split(",")[1]) for line in (folder / "REC" / "frames.csv").read_text().splitlines()[1:]]
    return np.array(t).reshape(-1, len(DELAYS))


def recordings(case: Case, folder: Path) -> tuple[Recording, Recording, np.ndarray, float]:
    """(the recording in motion, one of the same poses standing, (n, 4, 4) the true poses, s the true time offset)."""
    logged, history = table_of_frames(folder), table_of(folder / "history.csv")
    wall = float(re.search(r'"wall": ([0-9.]+)', (folder / "REC" / "journal.jsonl").read_text())[1])

    def lengths_at(t: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(wall + t, history[:, 0], column) for column in history[:, 1:].T], axis=-1)

    true = true_times(case, folder, logged, wall)
    moving, standing = folder / "moving", folder / "standing"
    for place in (moving, standing):
        place.mkdir()
        (place / "rig.toml").write_text(rig_text(case, place == moving))
    shutil.copy(folder / "REC" / "commands.csv", moving)
    write_frames(case, moving, logged)
    write_corners(case, moving, corners_seen(case, lengths_at, true, ROW_TIME, SEED))
    at = lengths_at(true[:, 0])
    write_standing_recording(case, standing, at, SEED)
    recording = load_recording(moving)
    return (
        recording,
        load_recording(standing),
        case.machine.forward(at),
        true_offset(recording, lengths_at, true, logged),
    )


def true_times(case: Case, folder: Path, logged: np.ndarray, wall: float) -> np.ndarray:
    """(n, cameras) s, when the exposures truly were, as the cameras noted."""
    noted: dict[str, list[tuple[float, float]]] = {}
    for line in (folder / "exposed.csv").read_text().splitlines():
        name, stamp, true = line.split(",")
        noted.setdefault(name, []).append((float(stamp) - wall, float(true) - wall))
    out = np.empty(logged.shape)
    for i, camera in enumerate(case.camera_set.stated):
        stamps, true = np.array(noted[camera.name]).T
        nearest = np.abs(stamps[:, None] - logged[:, i]).argmin(axis=0)
        assert np.abs(stamps[nearest] - logged[:, i]).max() < 1e-5
        out[:, i] = true[nearest]
    return out


def true_offset(recording: Recording, lengths_at, true: np.ndarray, logged: np.ndarray) -> float:
    """s by which logged times must be moved so that commands.csv is where the struts truly were, over all frames."""
    commands, t = recording.commands, logged[:, 0] + ELSEWHERE  # from the first command, so long before the run
    at, rate = commands.at(t), (commands.at(t + 0.01) - commands.at(t - 0.01)) / 0.02
    steady = np.abs(rate).max(axis=1) > 0.9e-3 * SPEED
    off = lengths_at(true[:, 0]) - at
    return float((off * rate)[steady].sum() / (rate**2)[steady].sum())


def goals(case: Case, count: int) -> np.ndarray:
    """(count, 6) m, commands about the middle of the ranges that no recording visits."""
    low, high = case.owner.ranges.T
    return (low + high) / 2 + 0.3 * (high - low) * np.random.default_rng(99).uniform(-1, 1, (count, 6))
