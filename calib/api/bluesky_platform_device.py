"""Platform as a device of Bluesky (ophyd-async).

Plans of Bluesky move it to corrected poses.

The move is that of `rig go`: corrected lengths, checked, and read back from where the struts stand. ophyd-async is
imported where a device is made.
"""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from scipy.spatial.transform import RigidTransform

from calib.api.correction_server_and_move_to_pose import PoseMove, plan_pose_move, require_same_rig
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from rig.array_and_json_types import Floats, Json
from rig.driving.axis_driver import Driver
from rig.errors import MissingLibrary, MotionError, Stopped
from rig.model.pose import pose, pose_to_vector
from rig.recording.corner_and_pose_csv_tables import POSE_COLUMNS, POSE_UNITS


class PosePlatform:
    """What a platform's device does, without the base class of ophyd-async; see bluesky_platform for the arguments.

    Its values are poses T_base_platform, (6,) x y z in m and the rotation vector in rad.
    """

    name: str

    def __init__(
        self,
        driver: Driver,
        calibration: Calibration,
        share: float = 1.0,
        measure: Callable[[], RigidTransform] | None = None,
    ) -> None:
        self._driver, self._calibration, self._share, self._measure = driver, calibration, share, measure
        self._last: PoseMove | None = None  # the last move that was begun
        self._ends_well = False  # whether a stop that was requested is no failure

    async def move(self, value: Sequence[float] | Floats) -> None:
        """Move to a pose, until the read-back says that the struts are there.

        Raises ValueError for what is no pose, Unreachable before anything moves, and what Driver.move raises
        """
        numbers = np.asarray(value, float)
        if numbers.shape != (6,) or not np.isfinite(numbers).all():
            raise ValueError(f"{self.name}: a pose is x, y, z (m) and rx, ry, rz (rad), not {value!r}")
        self._ends_well = False
        try:
            await asyncio.to_thread(self._carry_out, pose(numbers[:3], numbers[3:]))
        except Stopped:
            if not self._ends_well:
                raise

    async def stop(self, success: bool = True) -> None:
        """Stop every strut. success : whether the move that it ends counts as done, as Bluesky asks"""
        self._ends_well = success
        await asyncio.to_thread(self._driver.stop)

    async def read(self) -> dict[str, Json]:
        """Poses and the time, as Bluesky reads them: commanded, read back now and, where one measures, measured."""
        poses = await asyncio.to_thread(self._poses)
        now = self._driver.clock.now()
        return {
            self._key(kind, column): {"value": float(number), "timestamp": now}
            for kind, T in poses.items()
            for column, number in zip(POSE_COLUMNS, pose_to_vector(T))
        }

    async def describe(self) -> dict[str, Json]:
        """What `read` returns: a number for each coordinate, with its unit."""
        kinds = ("commanded", "reached", *(() if self._measure is None else ("measured",)))
        return {
            self._key(kind, column): {
                "source": f"rig://{self._driver.controller.protocol}/{kind}/{column}",
                "dtype": "number",
                "dtype_numpy": "<f8",
                "shape": [],
                "units": unit,
            }
            for kind in kinds
            for column, unit in zip(POSE_COLUMNS, POSE_UNITS)
        }

    async def locate(self) -> Json:
        """The pose commanded last and the one read back, each as `set` takes it."""
        poses = await asyncio.to_thread(self._poses, False)
        return {
            name: pose_to_vector(poses[kind]).tolist()
            for name, kind in (("setpoint", "commanded"), ("readback", "reached"))
        }

    @property
    def hints(self) -> Json:
        """Which of its values Bluesky shows."""
        return {"fields": [self._key("reached", column) for column in POSE_COLUMNS]}

    def _key(self, kind: str, column: str) -> str:
        return f"{self.name}-{kind}-{column}"

    def _carry_out(self, wanted: RigidTransform) -> None:
        planned, before = plan_pose_move(self._driver.design, self._calibration, wanted), self._last
        start = self._driver.lengths()
        self._last = planned
        try:
            self._last = planned.carry_out(self._driver, self._share)
        except BaseException:
            with suppress(MotionError):  # where it cannot be read, it may have moved
                if np.abs(self._driver.lengths() - start).max() <= self._driver.controller.tolerance:
                    self._last = before  # refused: the platform stands where it was commanded before
            raise

    def _poses(self, measured: bool = True) -> dict[str, RigidTransform]:
        """T_base_platform () of each kind. Before the first move the pose read back counts as the one commanded."""
        lengths = self._driver.lengths()
        last = self._last
        reached = self._calibration.correction.predict(lengths) if last is None else last.pose_at(lengths)
        found = {"commanded": reached if last is None else last.wanted, "reached": reached}
        return found if self._measure is None or not measured else found | {"measured": self._measure()}


def bluesky_platform(
    driver: Driver,
    calibration: Calibration,
    name: str = "platform",
    share: float = 1.0,
    measure: Callable[[], RigidTransform] | None = None,
) -> PosePlatform:
    """The platform as a Bluesky (ophyd-async) device.

    It does what a PosePlatform does, and `set` is its move as a status.
    driver : open, of a rig whose position is known; calibration : of the same rig; share : of the greatest speeds
    measure : T_base_platform () of the platform at rest, called whenever the device is read; None where nobody measures
    Raises MissingLibrary without ophyd-async, RigError for a calibration of another rig
    """
    require_same_rig(driver.design, calibration, "the driver's rig.toml", f"the calibration for {name!r}")
    try:
        from ophyd_async.core import AsyncStatus, Device
    except ImportError:
        raise MissingLibrary("a device of Bluesky needs ophyd-async: pip install 'rig[bluesky]'") from None

    class PlatformDevice(PosePlatform, Device):  # type: ignore[misc]
        """See PosePlatform."""

        set = AsyncStatus.wrap(PosePlatform.move)

        def __init__(self) -> None:
            Device.__init__(self, name)
            PosePlatform.__init__(self, driver, calibration, share, measure)

    return PlatformDevice()
