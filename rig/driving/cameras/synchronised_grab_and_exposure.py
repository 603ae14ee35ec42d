"""Synchronised grab of one frame from all cameras, with retries; exposure setting without clipped markers."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from rig.arrays import Pixels
from rig.driving.cameras.camera_interface_and_clock import CameraError, Frame, Source
from rig.driving.clock import Clock

TRIES = 3
PAUSE = 0.1  # s before trying again, doubled each time


class Shutter:
    """All cameras of a rig. retried : (camera, what it said) of grabs that were tried again."""

    def __init__(self, sources: tuple[Source, ...], clock: Clock, tries: int = TRIES) -> None:
        if not sources:
            raise CameraError("there is no camera to take a frame with")
        self.sources = tuple(sources)
        self.retried: list[tuple[str, str]] = []
        self._clock, self._tries = clock, tries
        self._pool = ThreadPoolExecutor(len(sources))

    def grab(self) -> dict[str, Frame]:
        """{camera: Frame}, exposed together as nearly as their triggers allow. Raises CameraError for all that gave
        none.
        """
        futures = [self._pool.submit(self._one, source) for source in self.sources]
        errors = [error for error in (future.exception() for future in futures) if error is not None]
        for error in errors:
            if not isinstance(error, CameraError):
                raise error
        if errors:
            raise CameraError("; ".join(map(str, errors)))
        return {source.name: future.result() for source, future in zip(self.sources, futures)}

    def _one(self, source: Source) -> Frame:
        for k in range(self._tries):
            try:
                return source.grab()
            except CameraError as error:
                if k + 1 == self._tries:
                    raise
                self.retried.append((source.name, str(error)))
                self._clock.sleep(PAUSE * 2**k)
        raise AssertionError("unreachable: the last try returns or raises")

    def close(self) -> None:
        """Let go of all cameras."""
        self._pool.shutdown()
        for source in self.sources:
            source.close()


WHITE = 200.0  # of 255, where the markers' white is brought to
WHITE_SLACK = 0.1  # share of that which is off without harm
CLIPPED = 250.0  # of 255; brighter than this may be anything
CLIPS = 0.005  # share of the markers' pixels that may be brighter
STEPS = 8  # of setting and looking
RANGE = (1e-5, 1.0)  # s


def set_exposure_for_markers(
    source: Source, white_level: Callable[[Pixels], tuple[float, float]], start_exposure: float
) -> tuple[float, float]:
    """Set a camera's exposure such that markers do not clip; returns (exposure in s, white level of 255).

    white_level : (image) -> (level of the markers' white, of 255; share of their pixels that clip); start_exposure : s
    Raises CameraError where no exposure does it.
    """
    exposure = source.set_exposure(start_exposure)
    low, high = RANGE
    for _ in range(STEPS):
        level, clips = white_level(source.grab().image)
        bright = clips > CLIPS or level >= CLIPPED
        if not bright and abs(level - WHITE) <= WHITE_SLACK * WHITE:
            return exposure, level
        if bright:
            high = exposure
        elif level < WHITE:
            low = exposure
        wanted = exposure / 2 if bright else exposure * WHITE / max(level, 1.0)
        if not low < wanted < high:
            wanted = (low * high) ** 0.5
        before, exposure = exposure, source.set_exposure(wanted)
        if exposure == before:
            break
    if not bright and level > WHITE / 4:
        return exposure, level  # as good as this camera's steps allow
    raise CameraError(
        f"camera {source.name!r}: no exposure found at which markers are bright and do not clip; at "
        f"{exposure * 1e3:.3g} ms white is "
        f"at {level:.0f} of 255 and {clips:.1%} clip: change the light or the aperture"
    )
