"""One frame of all cameras at once; a grab that failed is tried again, a camera that stays silent is named."""

from concurrent.futures import ThreadPoolExecutor

from rig.driving.cameras.camera_interface import CameraError, Frame, Source
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
