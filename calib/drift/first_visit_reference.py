"""Reference that visits are compared with: cameras as the first visit found them, and movable places."""

from dataclasses import dataclass
from hashlib import sha256

import numpy as np

from rig.errors import RigError
from rig.model.design import Camera, Design
from rig.recording.recording_folder import Recording
from vision.recording_adjustment import Measurement
from vision.targets import marker_map


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """cameras : (Camera, ...) as the first visit found them; places : what may move, "camera NAME", "target NAME" of
    base and platform, or "instrument"; base : names of the targets on the base; targets : a mark of where rig.toml
    states all markers."""

    cameras: tuple[Camera, ...]
    places: tuple[str, ...]
    base: tuple[str, ...]
    targets: str

    @classmethod
    def of(cls, design: Design, measured: Measurement | None) -> "Reference":
        """The Reference of a first visit. measured : its Measurement, None where an instrument measured. Raises
        RigError for a camera that moves.
        """
        if measured is None:
            return cls((), ("instrument",), (), "")
        cameras = measured.design.cameras
        moving = [camera.name for camera in cameras if camera.mount == "moving"]
        if moving:
            raise RigError(f"camera {moving[0]} has a moving mount; watching takes cameras that stand still")
        places = (
            *(f"camera {camera.name}" for camera in cameras),
            *(f"target {target.name}" for target in design.targets),
        )
        return cls(
            cameras, places, tuple(target.name for target in design.targets if target.body == "base"), _mark(design)
        )

    def camera(self, name: str) -> Camera:
        """The camera of a name."""
        return next(camera for camera in self.cameras if camera.name == name)

    def refuse(self, recording: Recording, by_cameras: bool) -> None:
        """Raise RigError for a visit with other cameras or targets, or measured by something else than the first
        one.
        """
        design = recording.design
        if by_cameras != bool(self.cameras):
            raise RigError(
                f"{recording.folder} was measured by {'cameras' if by_cameras else 'an instrument'}, the first visit "
                f"{'was not' if by_cameras else 'by cameras'}; begin a new history"
            )
        mine = [camera.name for camera in self.cameras]
        theirs = [camera.name for camera in design.cameras] if self.cameras else []
        if mine != theirs:
            raise RigError(
                f"{recording.folder} has the cameras {', '.join(theirs) or 'of none'}, the first visit "
                f"{', '.join(mine)}; "
                "begin a new history"
            )
        other = [
            a.name
            for a, b in zip(self.cameras, design.cameras)
            if len(a.distortion) != len(b.distortion) or a.mount != b.mount
        ]
        if other:
            raise RigError(
                f"{recording.folder}: camera {other[0]} has another kind of lens or mount than at the first "
                "visit; begin a new history"
            )
        if self.cameras and _mark(design) != self.targets:
            raise RigError(
                f"{recording.folder}: its rig.toml states other targets, or other places of them, than the "
                "first visit's; begin a new "
                "history"
            )


def _mark(design: Design) -> str:
    markers = marker_map(design)
    return sha256(np.r_[markers.id, np.round(markers.corners, 7).ravel()].tobytes()).hexdigest()[:16]
