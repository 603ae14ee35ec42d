"""Alarms of a run: a camera that was moved, a marker that is covered, a frame without a pose."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from rig.model.design import Design
from vision.reading.live_measurement_and_corner_refit import Sight

SHIFT = (
    8.0  # standard deviations of a corner by which the base's markers, all together, are off once a camera has moved
)
LEAST = 0.1  # px, and at least so much: what the pixel grid does to a marker comes and goes with its place
FEWEST = 2  # base markers that must show it
CHANCE = (
    1e-4  # of a marker's being missed so often in a row by what has been seen of it, below which something covers it
)
TOGETHER = 1e-6  # the same of all markers of a camera that are missed in one frame


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something that an operator should know at once. kind : "camera", "covered", "unseen", "jump", "drift" or "limbs";
    text : in words.
    """

    kind: str
    text: str


class Watch:
    """Looks at the frames of one run, one after the other; what it has said it says again only once it had gone."""

    def __init__(self, design: Design) -> None:
        self._names = [camera.name for camera in design.cameras]
        self._moving = {camera.name for camera in design.cameras if camera.mount == "moving"}
        self._seen: dict[tuple[str, int], int] = defaultdict(int)
        self._missed: dict[tuple[str, int], int] = defaultdict(int)
        self._row: dict[tuple[str, int], int] = defaultdict(int)  # missed one after the other, up to now
        self._reported: set[tuple[str, str]] = set()

    def look(self, sight: Sight, noise: float | None) -> list[Alarm]:
        """Alarms that a sight gives cause for. noise : px of a corner, None while the cameras have not been
        adjusted.
        """
        found = {}
        if (
            sight.T_base_platform is None and noise is not None
        ):  # before, cameras stand where they are stated, which may solve nothing
            found["unseen", "frame"] = f"frame {sight.frame} has no pose: {sight.reason}"
        if noise is not None:
            found |= self._moved(sight, noise)
        found |= self._covered(sight)
        fresh = [
            Alarm(kind, text)
            for (kind, what), text in found.items()
            if (kind, what) not in self._reported or kind == "unseen"
        ]
        self._reported = set(found) | {
            key for key in self._reported if key[0] == "camera"
        }  # a camera does not come back by itself
        return fresh

    def _moved(self, sight: Sight, noise: float) -> dict[tuple[str, str], str]:
        o, found = sight.observations, {}
        limit = max(SHIFT * noise, LEAST)
        for i, name in enumerate(self._names):
            rows = np.flatnonzero((o.camera == i) & ~o.on_platform)
            if name in self._moving or len(np.unique(o.marker[rows])) < FEWEST or np.isnan(sight.residuals[rows]).any():
                continue
            size = float(np.median(np.linalg.norm(sight.residuals[rows], axis=1)))
            if size > limit:
                found["camera", name] = (
                    f"frame {sight.frame}: camera {name!r} has moved, or its lens has: the base's markers "
                    f"are off by {size:.2f} px "
                    f"({limit:.2f} px is allowed)"
                )
        return found

    def _covered(self, sight: Sight) -> dict[tuple[str, str], str]:
        """Markers missed, or no whole image of themselves, where they have always been seen."""
        found = {}
        for name, detection in sight.detections.items():
            read, missing, together = set(detection.marker.tolist()), [], 1.0
            for number in sight.expected.get(name, ()):
                key = (name, number)
                often = (self._missed[key] + 1) / (
                    self._missed[key] + self._seen[key] + 2
                )  # Laplace's rule of succession
                if number in read:
                    self._seen[key] += 1
                    self._row[key] = 0
                    continue
                self._row[key] += 1
                chance = often ** self._row[key]
                if chance < CHANCE:
                    found["covered", f"{name} {number}"] = (
                        f"frame {sight.frame}: marker {number} in camera {name!r} has not been seen in "
                        f"{self._row[key]} frames, but always before: is it covered?"
                    )
                else:  # what explains a marker's absence is not counted as its habit
                    missing.append(number)
                    together *= often
                    self._missed[key] += 1
            if together < TOGETHER:
                text = ", ".join(map(str, missing))
                found["covered", name] = (
                    f"frame {sight.frame}: markers {text} are not seen in camera {name!r}, all at once: is "
                    "something in front?"
                )
        return found
