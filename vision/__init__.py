"""Images to poses: corners, their places and covariance, cameras and targets adjusted together.

`measured` takes a recording (rig.load_recording) to its `Measurement`: the platform's pose in every frame with
covariance, cameras as adjusted.
"""

from typing import TYPE_CHECKING

from rig.compute.lazy_package_exports import lazy_getattr

if TYPE_CHECKING:
    from vision.recording_adjustment import Measurement as Measurement
    from vision.recording_measurement import measured as measured

__all__ = ["measured", "Measurement"]
__getattr__ = lazy_getattr(
    __name__, {"measured": "vision.recording_measurement", "Measurement": "vision.recording_adjustment"}
)
