"""A case's recording as a folder: rig.toml as the owner believes the machine to be, and the tables of what was
commanded and seen.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tests.truth.camera_sets import FACES, HIGH, WIDE, CameraSet
from tests.truth.case import Case
from tests.truth.draw_faults import LEAD
from tests.truth.kinematics import Arm, Chain, Hinge, Machine, SixStruts
from tests.truth.motion import EVERY
from tests.truth.rigid import rows_of

UPPER = [f"c{i}{j}" for i in range(6) for j in range(i, 6)]


def record(case: Case, folder: str | Path) -> Path:
    """Write a case's recording into a new folder, and return it. Raises FileExistsError where there is one."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    (folder / "rig.toml").write_text(rig_toml(case))
    table(folder / "commands.csv", ("t", *case.owner.names), np.column_stack([case.journey.t, case.journey.values]))
    frames = np.arange(len(case.journey.looked))
    names = [""] if case.camera_set is None else [camera.name for camera in case.camera_set.stated]
    (folder / "frames.csv").write_text(
        "frame,t,camera,image\n"
        + "".join(f"{k},{t:.9f},{name},\n" for k, t in zip(frames, case.journey.looked) for name in names)
    )
    (_write_poses if case.camera_set is None else _write_corners)(case, folder)
    if case.logged:
        write_sensors(case, folder / "sensors.csv", float(case.journey.t[-1]))
    return folder


def _write_poses(case: Case, folder: Path) -> None:
    square = np.diag(np.repeat(np.square(case.sigma), 3))[np.triu_indices(6)]
    rows = ["frame,x,y,z,rx,ry,rz," + ",".join(UPPER)]
    rows += [",".join([str(k), *(f"{x:.12g}" for x in (*pose, *square))]) for k, pose in enumerate(case.seen)]
    (folder / "poses.csv").write_text("\n".join(rows) + "\n")


def _write_corners(case: Case, folder: Path) -> None:
    assert case.camera_set is not None
    rows = ["frame,camera,marker,corner,u,v,sigma"]
    for frame, camera, marker, corner, u, v in case.seen[np.lexsort(case.seen[:, 3::-1].T)]:
        rows.append(
            f"{frame:.0f},{case.camera_set.stated[int(camera)].name},{marker:.0f},{corner:.0f},"
            f"{u:.6f},{v:.6f},{case.camera_set.sigma:.6g}"
        )
    (folder / "corners.csv").write_text("\n".join(rows) + "\n")


def write_sensors(case: Case, path: Path, last: float) -> None:
    """Write what the sensors logged from 0 to last s: the channels that the case keeps. A change of payload is a step
    within 1 ms.
    """
    t = np.arange(0.0, last + EVERY, EVERY)
    if case.logged == "payload":
        changes = case.day.loads[1:, 0]
        t = np.union1d(t, np.concatenate([changes - 1e-3, changes]))
        table(path, ("t", "payload_mass_kg"), np.column_stack([t, case.day.load_at(t)]))
        return
    names = [
        "ambient_temperature_C",
        *(f"strut{i + 1}_temperature_C" for i in range(case.owner.width) if case.kind in ("hexapod", "planar2")),
    ]
    columns = [case.day.room_at(t), *(case.day.axes_at(t).T if len(names) > 1 else [])]
    table(path, ("t", *names), np.column_stack([t, *columns]))


def write_wanted(poses: np.ndarray, path: Path, t: np.ndarray | None = None) -> None:
    """Write poses (n, 4, 4) as a table of wanted poses, with times (n,) s where they are given."""
    rows = np.column_stack([np.arange(len(poses)), *([] if t is None else [t]), rows_of(poses)])
    table(path, ("frame", *([] if t is None else ["t"]), "x", "y", "z", "rx", "ry", "rz"), rows)


def table(path: Path, names: Iterable[str], rows: np.ndarray) -> None:
    """Write rows (n, columns) below names as CSV, 12 digits; a column named frame as whole numbers."""
    names = list(names)
    text = [",".join(names)]
    text += [",".join(str(int(x)) if name == "frame" else f"{x:.12g}" for name, x in zip(names, row)) for row in rows]
    path.write_text("\n".join(text) + "\n")


def rig_toml(case: Case) -> str:
    """Text of the owner's rig.toml."""
    parts = [
        'schema = "rig/1"',
        f'name = "truth {case.seed}"',
        "",
        "[environment]",
        "gravity = [0.0, 0.0, -9.80665]",
        "",
        *_mechanism(case.owner),
        "",
        "[actuator]",
        f"screw_lead = {LEAD}",
        'joints = "cardan-cardan"',
        f"max_speed = {float(case.speeds[0])!r}",
        "",
    ]
    if case.kind == "hexapod":
        parts += [
            "[platform]",
            f"mass = {case.mass!r}",
            f"centre_of_mass = {_list(case.centre)}",
            f"payload_centre_of_mass = {_list(case.payload)}",
            "",
        ]
    if case.camera_set is None:
        parts += [
            "[instrument]",
            'base = "rig"',
            'tool = "rig"',
            f"position_sigma = {case.sigma[0]!r}",
            f"rotation_sigma = {case.sigma[1]!r}",
            "",
        ]
    else:
        parts += _cameras(case.camera_set)
    return "\n".join(parts)


def _cameras(camera_set: CameraSet) -> list[str]:
    lines = []
    for camera in camera_set.stated:
        matrix = [
            [camera.focal, 0.0, float(camera.middle[0])],
            [0.0, camera.focal, float(camera.middle[1])],
            [0.0, 0.0, 1.0],
        ]
        lines += [
            "[[camera]]",
            f'name = "{camera.name}"',
            f"width = {WIDE}",
            f"height = {HIGH}",
            f"matrix = {matrix}",
            f"distortion = {_list(camera.lens)}",
            f"pose = {_pose(camera.place)}",
            "",
        ]
    for cube in camera_set.cubes:
        faces = ", ".join(f'"{face}" = {cube.first + k}' for k, face in enumerate(FACES))
        lines += [
            "[[target]]",
            f'name = "{cube.name}"',
            f'body = "{"platform" if cube.moves else "base"}"',
            f"edge = {cube.edge!r}",
            f"marker = {cube.side!r}",
            'dictionary = "DICT_5X5_100"',
            f"faces = {{ {faces} }}",
            f"pose = {_pose(cube.place)}",
            "",
        ]
    return lines


def _pose(place: np.ndarray) -> str:
    row = rows_of(place[None])[0]
    return f"{{ position = {_list(row[:3])}, rotvec = {_list(row[3:])} }}"


def _list(values: np.ndarray) -> str:
    return str(np.asarray(values, float).tolist())


def _mechanism(machine: Machine, head: str = "[mechanism]") -> list[str]:
    if isinstance(machine, SixStruts):
        return [
            head,
            'kind = "hexapod"',
            f"base_joints = {_list(machine.base)}",
            f"platform_joints = {_list(machine.plate)}",
            f"strut_range = {_list(machine.ranges)}",
            f"home = {{ position = [0.0, 0.0, {machine.height!r}], rotvec = [0.0, 0.0, 0.0] }}",
        ]
    if isinstance(machine, Hinge):
        return [
            head,
            'kind = "planar2"',
            f"base_joints = {_list(machine.base)}",
            f"strut_range = {_list(machine.ranges)}",
        ]
    if isinstance(machine, Arm):
        rows = ", ".join(
            "[" + ", ".join((['"prismatic"'] if slide else []) + [repr(float(x)) for x in row]) + "]"
            for slide, row in zip(machine.slides, machine.rows)
        )
        return [head, 'kind = "arm"', f"joints = [{rows}]", f"limits = {_list(machine.ranges)}"]
    if isinstance(machine, Chain):
        lines = [head, 'kind = "chain"', ""]
        for stage in machine.stages:
            lines += [*_mechanism(stage, "[[mechanism.stage]]"), ""]
        return lines
    raise TypeError(f"no way to write a {type(machine).__name__}")
