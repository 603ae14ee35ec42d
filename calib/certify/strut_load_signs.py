"""Which way struts are loaded at a configuration: joints with a clearance lie on one side where a strut pushes, on the
other where it pulls.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.samples.pose_samples import Samples
from rig.model import mechanisms
from rig.model.mechanism_kinds import Struts
from rig.planning.plan import FILL, low_discrepancy
from rig.recording.recording_folder import PAYLOAD

PLACES = 64  # of the workspace, at which signs are looked at
NOTHING = 1e-9  # of the greatest load, below which a strut is not loaded

Use = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def strut_load_signs(samples: Samples, nominal: Struts) -> list[tuple[np.ndarray, Use] | None]:
    """Per strut ((n,) sign of its load at the samples, positive where it pushes, and a `Component.use` of it), None
    where no sign changes over the workspace or nothing is known of weights. By the owner's geometry; payloads are those
    of the recording, each as likely as it was there."""
    if samples.conditions is None or samples.conditions.weight is None:
        return [None] * len(nominal.axes)
    weight, nothing = samples.conditions.weight, np.zeros(len(samples))
    carried = samples.conditions.channels.get(PAYLOAD, nothing)
    each, count = np.unique(np.round(carried, 3), return_counts=True)
    middle, half = nominal.strut_range.mean(axis=1), np.ptp(nominal.strut_range, axis=1) / 2

    def seen(T: RigidTransform, commands: np.ndarray, payload: np.ndarray) -> np.ndarray:
        loads = mechanisms.kinematics_of(nominal).loads(T, commands, nominal, weight.wrench(T, payload))
        return np.asarray(np.sign(loads) * (np.abs(loads) > NOTHING * np.abs(loads).max(initial=0.0)))

    @cache
    def there(
        places: bytes,
    ) -> np.ndarray:  # (m, axes), mean over the payloads; the same places are looked at for every strut
        commands = middle + half * np.frombuffer(places).reshape(-1, len(middle))
        T = mechanisms.kinematics_of(nominal).forward(commands, nominal)
        return np.asarray(
            np.average([seen(T, commands, np.full(len(commands), kg)) for kg in each], axis=0, weights=count)
        )

    def use(i: int) -> Use:
        def mean_and_variance(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mean = there(np.ascontiguousarray(places, float).tobytes())[:, i]
            return mean, np.maximum(1 - mean**2, 0.0)

        return mean_and_variance

    recorded = seen(samples.T_base_platform, samples.effective, carried)
    anywhere = there(((low_discrepancy(nominal.strut_range, PLACES, FILL) - middle) / half).tobytes())
    both = np.concatenate([recorded, anywhere])
    turning = recorded.any(axis=0) & (both.min(axis=0) < 1) & (both.max(axis=0) > -1)
    return [(recorded[:, i], use(i)) if turns else None for i, turns in enumerate(turning)]
