"""A rig.toml's text with cameras and markers written into it: what was measured replaces what stood there, all else
stays as it was.
"""

from collections.abc import Iterable

import numpy as np

from rig.model.design import Camera, Marker
from rig.model.pose import pose_to_vector


def with_cameras(text: str, cameras: Iterable[Camera]) -> str:
    """The rig.toml text with each camera's matrix, distortion and pose replaced; all else, comments too, as it was.

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


def camera_block(camera: Camera, placed: bool = False) -> str:
    """Text of a [[camera]] table as rig.toml takes it. placed : whether its pose is known; else it is a place to fill
    in
    """
    place = np.round(pose_to_vector(camera.pose), 10) if placed else np.zeros(6)
    remark = "" if placed else "   # camera in base: put in where it stands"
    matrix, distortion = np.round(camera.matrix, 6).tolist(), np.round(camera.distortion, 9).tolist()
    return (
        f'[[camera]]\nname = "{camera.name}"\nwidth = {camera.width}\nheight = {camera.height}\nmatrix = {matrix}\n'
        f"distortion = {distortion}\n"
        f"pose = {{ position = {place[:3].tolist()}, rotvec = {place[3:].tolist()} }}{remark}\n"
        'shutter = "global"\n'
    )


def with_places(text: str, places: dict[str, tuple[Marker, ...]]) -> str:
    """The rig.toml text with every target's markers listed at their places; a cube becomes a target of listed markers.

    text : a valid rig.toml; places : {target name: (Marker, ...)}
    """
    import tomlkit

    document = tomlkit.parse(text)
    for table in (table for table in document["target"] if table["name"] in places):
        for key in ("edge", "marker", "faces", "pose"):
            table.pop(key, None)
        rows = tomlkit.aot()
        for marker in places[table["name"]]:
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
