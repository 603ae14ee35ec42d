"""Cameras out of tables of outside data: lens, place, what carries them."""

from rig.formats.checked_entries import REQUIRED, Entries
from rig.model.design import DISTORTION_TERMS, SOURCES, Camera, Free, Target
from rig.model.mechanism_kinds import Mechanism

LARGEST_IMAGE = 100_000  # px along a side


def cameras(tables: list[Entries]) -> tuple[Camera, ...]:
    """The Cameras of [[camera]] tables. Raises FileError with line and column for anything that is no camera."""
    found: list[Camera] = []
    for table in tables:
        table.refuse_misspelt(
            ("name", "width", "height", "matrix", "distortion", "pose", "shutter", "row_time", "mount", "source")
        )
        name = table.identifier("name")
        if name in [camera.name for camera in found]:
            table.fail(f"camera {name!r} is listed twice", "name", value=name)
        matrix = table.array("matrix", (3, 3))
        for (i, j), want in {(0, 1): 0, (1, 0): 0, (2, 0): 0, (2, 1): 0, (2, 2): 1}.items():
            if matrix[i, j] != want:
                table.fail(
                    f"{table.name('matrix')} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; "
                    f"row {i + 1}, column {j + 1} is {matrix[i, j]:g}",
                    "matrix",
                    i,
                    j,
                    value=matrix[i, j],
                )
        for i in (0, 1):
            if matrix[i, i] <= 0:
                table.fail(
                    f"{table.name('matrix')}: the focal length must be positive px, not {matrix[i, i]:g}",
                    "matrix",
                    i,
                    i,
                )
        distortion = table.array("distortion", (None,))
        if len(distortion) not in DISTORTION_TERMS:
            table.fail(
                f"{table.name('distortion')} must have {', '.join(map(str, DISTORTION_TERMS))} terms (OpenCV order), "
                f"got {len(distortion)}",
                "distortion",
            )
        shutter = table.text("shutter", ("global", "rolling"), default="global")
        row_time = table.number(
            "row_time", default=REQUIRED if shutter == "rolling" else 0.0, least=0, most=1, unit="s"
        )
        width, height = (table.whole(key, 1, most=LARGEST_IMAGE) for key in ("width", "height"))
        found.append(
            Camera(
                name,
                width,
                height,
                matrix,
                distortion,
                table.pose("pose"),
                shutter,
                row_time,
                table.text("mount", ("fixed", "moving", "hand"), default="fixed"),
                _source(table),
            )
        )
    return tuple(found)


def check_in_hand(
    root: Entries, cameras: tuple[Camera, ...], targets: tuple[Target, ...], mechanism: Mechanism
) -> None:
    """Raise FileError for cameras in the hand beside what they cannot be measured with."""
    held = [camera.mount == "hand" for camera in cameras]
    for table, camera, mine in zip(root.tables("camera"), cameras, held):
        if any(held) and not mine:
            table.fail(
                f"camera {camera.name!r} is {camera.mount} and others are in the hand: a rig has all of its "
                "cameras there, or none",
                "name",
            )
        if mine and camera.shutter != "global":
            table.fail(
                f"camera {camera.name!r} is in the hand, where rows of a rolling shutter cannot be told from "
                "the hand's own way",
                "shutter",
            )
        if mine and isinstance(mechanism, Free):
            table.fail(
                f'camera {camera.name!r}: a mechanism of kind "free" has no hand; a camera that is moved '
                'about is "moving"',
                "mount",
            )
    for table, target in zip(root.tables("target"), targets):
        if any(held) and target.body != "base":
            table.fail(
                f"target {target.name!r} is on the {target.body}, and the platform carries the cameras: they "
                "see the base's targets alone",
                "body",
            )


def check_of_stages(root: Entries, cameras: tuple[Camera, ...], targets: tuple[Target, ...]) -> None:
    """Raise FileError for targets on a stage of a chain beside a camera that moves: where it stood is told frame by
    frame, of one body.
    """
    moving = [camera.name for camera in cameras if camera.mount == "moving"]
    for table, target in zip(root.tables("target"), targets):
        if moving and target.stage:
            table.fail(
                f"target {target.name!r} is on {target.body}, which cameras that stand still measure, and "
                f"camera {moving[0]!r} moves",
                "body",
            )


def _source(table: Entries) -> str | None:
    """What a camera is opened by, "KIND:PLACE", or None."""
    source = table.text("source", default=None)
    if source is not None and (source.partition(":")[0] not in SOURCES or not source.partition(":")[2]):
        table.fail(
            f'{table.name("source")} must be written as "KIND:PLACE" with a kind out of '
            f"{', '.join(SOURCES)}, not {source!r}",
            "source",
            value=source,
        )
    return source
