"""Images to poses: corners, their places and covariance, cameras and targets adjusted together.

`measured` takes a recording (rig.load) to its `Measurement`: the platform's pose in every frame with covariance, cameras as adjusted.
"""

from typing import TYPE_CHECKING

from rig.lazily import handed_on

if TYPE_CHECKING:
    from vision.measure import Measurement as Measurement
    from vision.recorded import measured as measured

__all__ = ["measured", "Measurement"]
__getattr__ = handed_on(__name__, {"measured": "vision.recorded", "Measurement": "vision.measure"})
