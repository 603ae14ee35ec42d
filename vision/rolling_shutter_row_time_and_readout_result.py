"""Row time of a rolling shutter as stated, and the result (Readout) of estimating its readout time elsewhere."""

from dataclasses import dataclass

from rig.array_and_json_types import Json
from rig.model.design import Camera


def rolling_shutter_row_time(camera: Camera) -> float:
    """s, from one row of a camera's images to the next as far as it is known; 0 where all rows are exposed at once."""
    return (camera.row_time or 0.0) if camera.shutter == "rolling" else 0.0


@dataclass(frozen=True, slots=True)
class Readout:
    """Readout time of a camera, found from exposures in motion.

    camera : its name; time, sigma : s from the exposure of its first image row to that of its last, negative where the
    last is first, and standard uncertainty; certain : whether it is beyond doubt that there is one; stated : its
    shutter in rig.toml: "rolling", or "global", which a certain readout time contradicts
    """

    camera: str
    time: float
    sigma: float
    certain: bool
    stated: str

    def tree(self) -> Json:
        """As JSON has it."""
        return {
            "camera": self.camera,
            "readout_s": self.time,
            "readout_sigma_s": self.sigma,
            "certain": self.certain,
            "stated_shutter": self.stated,
        }

    def __str__(self) -> str:
        size = f"{self.time * 1e3:.3f} ms, +- {2e3 * self.sigma:.3f} ms (k = 2)"
        if not self.certain:
            return f"camera {self.camera!r} shows no readout time beyond doubt: {size}; none is taken into account"
        if self.stated == "global":
            return (
                f"camera {self.camera!r} is stated to have a global shutter, but reads its rows in {size}; where it "
                'does, state shutter = "rolling"'
            )
        return f"camera {self.camera!r} reads its rows in {size}; this is taken into account"
