"""Edits of a rig.toml's text: cameras and target markers replaced, everything else unchanged."""

from collections.abc import Iterable

import numpy as np

from rig.model.design import Camera, Marker
from rig.model.pose import pose_to_vector


def replace_cameras(text: str, cameras: Iterable[Camera]) -> str:
    """The rig.toml text with the matrix, distortion and pose of each camera replaced.

    text : a valid rig.toml; cameras : Camera objects, matched by name. Raises KeyError for one that is not in the text.
    """
    import tomlkit

    document = tomlkit.parse(text)
    tables = {table["name"]: table for table in document["camera"]}
    for camera in cameras:
        table = tables[camera.name]
        table["matrix"] = np.round(camera.matrix, 6).tolist()
        table["distortion"] = np.round(camera.distortion, 9).tolist()
        position, rotvec = np.split(np.round(pose_to_vector(camera.pose), 10), 2)
        entry = tomlkit.inline_table()
        entry.update({"position": position.tolist(), "rotvec": rotvec.tolist()})
        table["pose"] = entry
    return tomlkit.dumps(document)


def camera_toml(camera: Camera, has_pose: bool = False) -> str:
    """TOML text of a [[camera]] table, with its pose or a blank to fill in.
    has_pose : whether its pose is known; else it is a place to fill in
    """
    place = np.round(pose_to_vector(camera.pose), 10) if has_pose else np.zeros(6)
    remark = "" if has_pose else "   # camera in base: put in where it stands"
    matrix, distortion = np.round(camera.matrix, 6).tolist(), np.round(camera.distortion, 9).tolist()
    return (
        f'[[camera]]\nname = "{camera.name}"\nwidth = {camera.width}\nheight = {camera.height}\nmatrix = {matrix}\n'
        f"distortion = {distortion}\n"
        f"pose = {{ position = {place[:3].tolist()}, rotvec = {place[3:].tolist()} }}{remark}\n"
        'shutter = "global"\n'
    )


def replace_target_markers(text: str, markers: dict[str, tuple[Marker, ...]]) -> str:
    """The rig.toml text with the markers of each target replaced; cubes become lists of markers.

    text : a valid rig.toml; markers : {target name: (Marker, ...)}
    """
    import tomlkit

    document = tomlkit.parse(text)
    for table in (table for table in document["target"] if table["name"] in markers):
        for key in ("edge", "marker", "faces", "pose"):
            table.pop(key, None)
        rows = tomlkit.aot()
        for marker in markers[table["name"]]:
            position, rotvec = np.split(np.round(pose_to_vector(marker.pose), 10), 2)
            row, entry = tomlkit.table(), tomlkit.inline_table()
            entry.update({"position": position.tolist(), "rotvec": rotvec.tolist()})
            row.update(
                {
                    "id": int(marker.id),
                    "side": float(marker.side),
                    "margin": float(np.round(marker.margin, 9)),
                    "pose": entry,
                }
            )
            rows.append(row)
        table["marker"] = rows
    return tomlkit.dumps(document)
