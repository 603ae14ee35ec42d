"""A calibration's claim against a held-out recording: the error beyond measuring noise, the interval that is claimed,
whether it is kept.
"""

from dataclasses import dataclass

import numpy as np

from calib.certify.calibration import Calibration
from calib.certify.calibration_evidence import of_samples
from calib.certify.claim_verification import Part, Verification
from calib.certify.held_out_errors import pose_errors
from calib.samples.pose_samples import Samples


@dataclass(frozen=True, slots=True)
class AgainstClaim:
    """Of a recording's n poses. found : Verification; beyond : (m, rad), RMS errors beyond what measuring adds, 0 where
    that explains all, None where not judged
    claimed : ((median, low, high), ..) m and rad, the claim's 95 % intervals of them"""

    recording: str
    found: Verification
    beyond: tuple[float | None, float | None]
    claimed: tuple[tuple[float, ...], ...]

    @property
    def parts(self) -> dict[str, tuple[Part, float, tuple[float, ...]]]:
        """{"position" | "rotation": (Part, RMS beyond noise, (median, low, high) claimed)} of what was judged; m and
        rad.
        """
        rows = zip(("position", "rotation"), (self.found.position, self.found.rotation), self.beyond, self.claimed)
        return {
            name: (part, beyond, claimed)
            for name, part, beyond, claimed in rows
            if part is not None and beyond is not None
        }


def check_claim_on_recording(
    calibration: Calibration, recording: str, samples: Samples, rng: np.random.Generator
) -> AgainstClaim | None:
    """AgainstClaim of a Calibration by samples as `Calibration.told` gives them, None where no factor is claimed.
    recording : its name
    """
    found = of_samples(calibration, samples, rng)
    if found is None or calibration.claim is None or calibration.claim.after is None:
        return None
    errors, covariance = (
        pose_errors(calibration.correction.predict(samples.effective), samples),
        samples.total_covariance(),
    )

    def beyond(part: slice) -> float:
        square = (errors[:, part] ** 2).sum(axis=1) - np.trace(covariance[:, part, part], axis1=1, axis2=2)
        return float(np.sqrt(max(square.mean(), 0.0)))

    sizes = [
        None if judged is None else beyond(part)
        for judged, part in ((found.position, slice(0, 3)), (found.rotation, slice(3, 6)))
    ]
    return AgainstClaim(recording, found, (sizes[0], sizes[1]), calibration.claim.after)
