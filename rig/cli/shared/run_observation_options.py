"""Who looks on at a run, from its arguments: measuring, learning, the terminal, the page."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from calib.files import calibration_file
from calib.online.live_limb_poses import LimbLive
from calib.online.run_learning import Learner
from rig.cli.shared import limb_poses
from rig.cli.shared.run_observation import Display, Looking, Stopping
from rig.cli.shared.run_page import Page
from rig.cli.shared.run_terminal import terminal_display
from rig.errors import RigError
from vision.hand_mounted_cameras import has_hand_cameras
from vision.reading.live_measurement import Live

if TYPE_CHECKING:
    import numpy as np

    from rig.driving.clock import Clock
    from rig.driving.run_steps import Step
    from rig.model.design import Design

SHARED = 42  # draws that all poses by limbs have in common: their geometry


def run_observation(
    arguments: Namespace, design: Design, planned: tuple[Step, ...], start: np.ndarray, clock: Clock, stopping: Stopping
) -> Looking:
    """The Looking of a run, by limbs where the arguments name accepted ones. start : (axes,) m.

    Raises RigError for a calibration of another kind of machine, and for limbs that do not stand for vision.
    """
    every = limb_poses.check_interval(arguments)
    accepted = limb_poses.accepted_limbs_for_run(arguments, design) if arguments.limbs is not None else None
    calibration = calibration_file.load(arguments.calibration) if arguments.calibration else None
    if calibration is not None:
        calibration.refuse_physics("watching a run")
    if calibration is not None and calibration.correction.nominal.kind != design.mechanism.kind:
        raise RigError(
            f"{arguments.calibration} is of a mechanism of kind {calibration.correction.nominal.kind!r}, the rig's is "
            f"{design.mechanism.kind!r}"
        )
    measured = not arguments.no_measure and (
        has_hand_cameras(design) or any(target.body == "platform" for target in design.targets)
    )
    learner = None
    if measured and design.mechanism.kind == "hexapod":
        learner = Learner(
            design.mechanism,
            calibration,
            tuple(arguments.tolerance) if arguments.tolerance else None,
            0 if accepted is None else SHARED,
        )
    looking = Looking(design, planned, start, clock, Live(design) if measured else None, learner, stopping)
    if accepted is not None:
        looking.source = LimbLive(accepted, every)
        looking.withdraw = partial(_withdraw, arguments)
    return looking


def _withdraw(arguments: Namespace, source: LimbLive, frame: int, reason: str) -> None:
    limb_poses.write_withdrawal(arguments.limbs, source.accepted, str(arguments.out), frame, reason)


@contextmanager
def run_displays(arguments: Namespace, looking: Looking) -> Iterator[list[Display]]:
    """The displays that the arguments ask for; the page is served while the context lasts."""
    if arguments.page is None:
        yield [terminal_display()]
        return
    with Page(looking, arguments.page) as page:
        print(f"the run's page, for this computer alone: {page.url}", flush=True)
        yield [terminal_display(), page]
