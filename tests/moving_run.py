"""Recordings in motion of a secret machine: what its cameras see, each at its own time, of struts on a known way."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from rig.driving.emulators.emulated_axis_motion_and_controller_faults import MovingAxes
from tests.truth.camera_sets import CameraSet
from tests.truth.case import Case, draw
from tests.truth.sights import Rolling
from tests.truth.written import rig_toml

ROW_TIME = 1.5e-5  # s
CONTROLLER = """
[controller]
protocol = "grblhal"
port = "{port}"
max_speed = {speed}
max_acceleration = {acceleration}
"""
CAMERA = '''"""A camera that waits, exposes, and stamps images by a late clock; it notes when it truly exposed."""

import time

import numpy as np

from rig.driving.base import UserCamera

DELAYS = {delays}
LATE = {late}


class Late(UserCamera):
    def grab(self):
        time.sleep(DELAYS[self.camera.name])
        t = time.time()
        with open({log!r}, "a", encoding="utf-8") as file:
            file.write(f"{{self.camera.name}},{{t + LATE:.6f}},{{t:.6f}}\\n")
        return np.full((self.camera.height, self.camera.width), 90, np.uint8), t + LATE, 1e-4
'''


def case_of_moving_machine(seed: int) -> Case:
    """A machine with six struts that is seen by three cameras, its owner's figures millimetres off."""
    return draw(seed, "none", "none", kind="hexapod", seen=True)


def rig_text(case: Case, rolling: bool, source: str = "") -> str:
    """rig.toml of a case. rolling : whether its cameras are stated to expose row by row"""
    stated = f'shutter = "rolling"\nrow_time = {ROW_TIME}' if rolling else 'shutter = "global"'
    stated += f'\nsource = "{source}"' if source else ""
    return rig_toml(case).replace("[[camera]]", f"[[camera]]\n{stated}")


def corners_seen(
    case: Case, lengths_at: Callable[[np.ndarray], np.ndarray], t: np.ndarray, row_time: float, seed: int
) -> np.ndarray:
    """(k, 6) rows frame, camera, marker, corner, u, v. lengths_at : (n,) s -> (n, 6) m, commands that struts are truly
    at; t : (n, cameras) s, true middles of the exposures; row_time : s from one row to the next
    """
    rng, rows = np.random.default_rng(seed), []
    for i, camera in enumerate(case.camera_set.cameras):
        camera_set = CameraSet((camera,), (camera,), case.camera_set.cubes, case.camera_set.sigma, Rolling(row_time))

        def bodies_at(late: np.ndarray, own: np.ndarray = t[:, i]) -> np.ndarray:
            return case.machine.forward(lengths_at(own + late))

        seen = camera_set.corners(t[:, i], bodies_at, case.day, rng)
        seen[:, 1] = i
        rows.append(seen)
    return np.concatenate(rows)


def write_corners(case: Case, folder: Path, rows: np.ndarray) -> None:
    """Write corners.csv of rows as `corners_seen` gives them."""
    text = ["frame,camera,marker,corner,u,v,sigma"]
    for frame, camera, marker, corner, u, v in rows[np.lexsort(rows[:, 3::-1].T)]:
        name = case.camera_set.stated[int(camera)].name
        text.append(f"{frame:.0f},{name},{marker:.0f},{corner:.0f},{u:.6f},{v:.6f},{case.camera_set.sigma:.6g}")
    (folder / "corners.csv").write_text("\n".join(text) + "\n")


def write_frames(case: Case, folder: Path, t: np.ndarray) -> None:
    """Write frames.csv of logged times t (n, cameras) s."""
    names = [camera.name for camera in case.camera_set.stated]
    rows = [f"{k},{at:.6f},{name},\n" for k, row in enumerate(t) for at, name in zip(row, names)]
    (folder / "frames.csv").write_text("frame,t,camera,image\n" + "".join(rows))


def table_of(path: Path) -> np.ndarray:
    """(n, columns) numbers of a CSV file."""
    with open(path, encoding="utf-8") as file:
        return np.array([[float(cell) for cell in row] for row in list(csv.reader(file))[1:]])


def write_standing_recording(case: Case, folder: Path, at: np.ndarray, seed: int) -> None:
    """A recording of the machine at rest at lengths at (n, 6) m, but for rig.toml. seed : of the noise of corners"""
    steps = [(100.0 * k + part, row) for k, row in enumerate(at) for part in (0.0, 90.0)]
    write_commands(folder, np.array([t for t, _ in steps]), np.array([row for _, row in steps]))
    t = np.repeat(100.0 * np.arange(len(at))[:, None] + 50, len(case.camera_set.cameras), axis=1)
    write_frames(case, folder, t)
    write_corners(case, folder, corners_seen(case, lambda t: at, t, 0.0, seed))


def write_commands(folder: Path, t: np.ndarray, lengths: np.ndarray) -> None:
    """Write commands.csv of lengths (n, 6) m at t (n,) s."""
    lines = [f"{at:.6f}," + ",".join(f"{value:.9f}" for value in row) for at, row in zip(t, lengths)]
    (folder / "commands.csv").write_text("t,l1,l2,l3,l4,l5,l6\n" + "\n".join(lines) + "\n")


def write_moving_recording(
    folder: Path,
    offset: float,
    delays: np.ndarray,
    speed: float,
    seed: int = 1,
    moves: int = 14,
    row_time: float = ROW_TIME,
) -> tuple[Case, np.ndarray]:
    """A recording of a machine that never rests, its cameras rolling: its Case, and (n, 6) m its true lengths.

    offset : s by which stamps are early; delays : (cameras,) s by which cameras expose one after the other; speed : m/s
    seed : of moves and noise; row_time : s; rig.toml states ROW_TIME
    """
    case, rng = case_of_moving_machine(3), np.random.default_rng(seed)
    low, high = case.owner.ranges.T
    middle = (low + high) / 2
    axes = MovingAxes(0.0, middle, np.full(6, speed), np.full(6, 0.1))
    end = 1.0
    for goal in middle + 0.35 * (high - low) * rng.uniform(-1, 1, (moves, 6)):
        end = axes.go(end, goal)
    true = np.arange(1.0, end, 0.6)[:, None] + delays
    (folder / "rig.toml").write_text(rig_text(case, True))
    write_commands(folder, *axes.knots())
    write_frames(case, folder, true - offset)
    write_corners(case, folder, corners_seen(case, axes.lengths_at, true, row_time, 6 + seed))
    return case, axes.lengths_at(true[:, 0])
