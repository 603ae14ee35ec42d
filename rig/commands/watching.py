"""Who looks on at a run, from its arguments: measuring, learning, the terminal, the page."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from calib import store
from calib.online.watch import Learner
from rig.commands.looking import Display, Looking
from rig.commands.page import Page
from rig.commands.terminal import terminal
from rig.errors import RigError
from vision.reading.live import Live

if TYPE_CHECKING:
    import numpy as np

    from rig.clock import Clock
    from rig.design import Design
    from rig.steps import Step


def looking_of(arguments: Namespace, design: Design, planned: tuple[Step, ...], start: np.ndarray, clock: Clock, stop_on: frozenset[str],
               halt: Callable[[], object]) -> Looking:
    """The Looking of a run. start : (axes,) m; halt : stops the struts from any thread.

    Raises RigError for a calibration of another kind of machine.
    """
    calibration = store.load(arguments.calibration) if arguments.calibration else None
    if calibration is not None:
        calibration.refuse_physics("watching a run")
    if calibration is not None and calibration.correction.nominal.kind != design.mechanism.kind:
        raise RigError(f"{arguments.calibration} is of a mechanism of kind {calibration.correction.nominal.kind!r}, the rig's is "
                       f"{design.mechanism.kind!r}")
    measured = not arguments.no_measure and any(target.body == "platform" for target in design.targets)
    learner = None
    if measured and design.mechanism.kind == "hexapod":
        learner = Learner(design.mechanism, calibration, tuple(arguments.tolerance) if arguments.tolerance else None)
    return Looking(design, planned, start, clock, Live(design) if measured else None, learner, stop_on, halt)


@contextmanager
def displays_of(arguments: Namespace, looking: Looking) -> Iterator[list[Display]]:
    """The displays that the arguments ask for; the page is served while the context lasts."""
    if arguments.page is None:
        yield [terminal()]
        return
    with Page(looking, arguments.page) as page:
        print(f"the run's page, for this computer alone: {page.url}", flush=True)
        yield [terminal(), page]
