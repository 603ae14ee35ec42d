"""Quiet recordings, at pose level of the independent truth: how many of them a diagnosis finds something in.

python -m tests.bench false_findings [--recordings N] [--seed S] [--only SPOILS] [--corners | --images]

Nothing is hidden in them. Every fourth is of an arm, two struts or a chain; every fifth has 5 % of wild rows, every
seventh a noise that its rig.toml states half as large, every eleventh 25 configurations alone. With `--corners` they
are set-ups of `accusations`, seen by cameras that stand elsewhere than stated and, in every second one, through lenses
that nobody stated; five of six have corners that are spoilt as no effect spoils them: by air, outliers, uneven or
heavy-tailed noise, shaken frames. With `--images` the images of such set-ups are drawn by a sensor of their own and
measured, which takes half a minute each.
"""

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Protocol

import numpy as np
from scipy.stats import beta

from calib.api.diagnose import diagnose
from calib.diagnosis.recording_diagnosis import Diagnosis
from rig.errors import RigError
from rig.model.design import Sensor
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import Corners
from synthetic.image_simulation import Images
from synthetic.unlisted_effects_and_corner_noise import DISTURBANCES
from tests.bench.accusations import drawn_recording
from tests.truth import PLANS, draw, record
from tests.truth.wild import spoilt

RECORDINGS = 20
KINDS = {"hexapod": 100, "arm": 100, "planar2": 80, "chain": 80}  # configurations that are visited
OTHERS = ("arm", "planar2", "chain")
FRAMES = 100  # of a recording of corners
PICTURES = 40  # frames of a recording of images


@dataclass(frozen=True, slots=True)
class Quiet:
    """One recording. number, of the campaign; seed; kind, plan; spoils : what is unusual about it"""

    number: int
    seed: int

    @property
    def kind(self) -> str:
        """Kind of the machine."""
        return OTHERS[self.number // 4 % len(OTHERS)] if self.number % 4 == 3 else "hexapod"

    @property
    def spoils(self) -> str:
        """What is unusual about the recording."""
        return (
            "wild rows"
            if self.number % 5 == 4
            else "noise stated by half"
            if self.number % 7 == 6
            else "25 configurations"
            if self.number % 11 == 10
            else "plain"
        )

    def findings(self) -> list[str]:
        """Names and places of what the diagnosis finds or leaves unknown. Raises RigError where it refuses."""
        plan = PLANS[self.number % len(PLANS)]
        count = 14 if plan == "ladders" else 25 if self.spoils == "25 configurations" else KINDS[self.kind]
        case = draw(self.seed + self.number, "none", "none", plan, self.kind, count=count)
        if self.spoils == "wild rows":
            case = spoilt(case, self.seed + self.number)[0]
        if self.spoils == "noise stated by half":
            case = replace(case, sigma=(case.sigma[0] / 2, case.sigma[1] / 2))
        with tempfile.TemporaryDirectory() as folder:
            found = diagnose(recording_folder.load_recording(record(case, Path(folder) / "rec"))).found
        return _named(found)


@dataclass(frozen=True, slots=True)
class QuietCorners:
    """One recording of corners. number, of the campaign; seed"""

    number: int
    seed: int
    kind: ClassVar = "hexapod"

    @property
    def disturb(self) -> Callable[..., Corners] | None:
        """What spoils the corners, None for nothing."""
        return (None, *DISTURBANCES)[self.number % (len(DISTURBANCES) + 1)]

    @property
    def spoils(self) -> str:
        """What is unusual about the corners."""
        name = "plain" if self.disturb is None else self.disturb.__name__.removeprefix("_add_")
        return f"corners, {name.replace('_', ' ')}"

    def findings(self) -> list[str]:
        """As those of Quiet."""
        with tempfile.TemporaryDirectory() as folder:
            _, read, noise = drawn_recording(self.seed + self.number, Path(folder), FRAMES)
            if self.disturb is not None:
                rng = np.random.default_rng([self.seed, self.number])
                read = replace(read, corners=self.disturb(read.corners, read.design, noise, rng))
            return _named(diagnose(read).found)


@dataclass(frozen=True, slots=True)
class QuietImages:
    """One recording of images. number, of the campaign; seed"""

    number: int
    seed: int
    kind: ClassVar = "hexapod"

    @property
    def images(self) -> Images:
        """What draws it: every third sensor is out of focus, every fourth background cluttered, light falls off."""
        rng = np.random.default_rng([self.seed, self.number])
        sensor = Sensor(
            blur=rng.uniform(0.3, 0.9),
            defocus=rng.uniform(0.8, 2.0) if self.number % 3 == 2 else 0.0,
            vignetting=rng.uniform(0.0, 0.5),
            gain=rng.uniform(120.0, 230.0),
            read_noise=rng.uniform(0.5, 3.0),
            electrons=rng.uniform(20.0, 200.0),
        )
        return Images(sensor, "cluttered" if self.number % 4 == 3 else "plain", processes=1)

    @property
    def spoils(self) -> str:
        """What is unusual about the images."""
        images = self.images
        return f"images, {images.background}{', out of focus' if images.sensor.defocus else ''}"

    def findings(self) -> list[str]:
        """As those of Quiet."""
        with tempfile.TemporaryDirectory() as folder:
            _, read, _ = drawn_recording(self.seed + self.number, Path(folder), PICTURES, self.images)
            return _named(diagnose(read).found)


def _named(found: Diagnosis) -> list[str]:
    """Names and places of what a diagnosis finds or leaves unknown."""
    return [f"{effect.name} at {effect.place}" for effect in found.effects] + [
        f"unknown at {left.place} by {left.depends_on}" for left in found.left
    ]


class QuietRecording(Protocol):
    """One recording of a campaign, in which nothing is hidden."""

    @property
    def kind(self) -> str:
        """Kind of the machine."""

    @property
    def spoils(self) -> str:
        """What is unusual about the recording."""

    def findings(self) -> list[str]:
        """Names and places of what the diagnosis finds or leaves unknown. Raises RigError where it refuses."""


WANTED: dict[Callable[[int, int], QuietRecording], str] = {
    Quiet: "<= 3 of 1000",
    QuietCorners: "<= 1 of 200",
    QuietImages: "0 of 100",
}


def campaign(
    count: int,
    seed: int,
    report: bool = False,
    only: str | None = None,
    draw_recording: Callable[[int, int], QuietRecording] = Quiet,
) -> tuple[Counter[str], Counter[str], Counter[str]]:
    """(recordings, false ones, refused ones), each by what is unusual.

    report : whether each false one is printed; only : what is unusual about those that are diagnosed, None for all;
    draw_recording : (number of the campaign, seed) -> recording
    """
    done, false, refused = Counter[str](), Counter[str](), Counter[str]()
    for number in range(count):
        one = draw_recording(number, seed)
        if only not in (None, one.spoils):
            continue
        what = one.spoils if one.kind == "hexapod" else f"{one.kind}, {one.spoils}"
        try:
            found = one.findings()
        except RigError as error:
            refused[what] += 1
            if report:
                print(f"{number} {what}: refused: {str(error)[:150]}", flush=True)
            continue
        done[what] += 1
        false[what] += bool(found)
        if found and report:
            print(f"{number} {what}: {'; '.join(found[:4])}", flush=True)
    return done, false, refused


def rows(
    count: int = RECORDINGS,
    seed: int = 31000,
    report: bool = False,
    only: str | None = None,
    draw_recording: Callable[[int, int], QuietRecording] = Quiet,
) -> Iterator[tuple[str, str, str]]:
    """Yield (figure, reached, wanted)."""
    start = time.process_time()
    done, false, refused = campaign(count, seed, report, only, draw_recording)
    for what in sorted(done):
        yield f"quiet recordings, {what}: with a finding", f"{false[what]} of {done[what]}", ""
    n, k = done.total(), false.total()
    high = float(beta.ppf(0.95, k + 1, n - k)) if k < n else 1.0
    yield ("all: with a finding (95 % upper bound of the share)", f"{k} of {n} (< {high:.2%})", WANTED[draw_recording])
    yield "refused, with the reason", f"{refused.total()} of {n + refused.total()}", ""
    spent = (time.process_time() - start) / max(n + refused.total(), 1)
    yield "one recording, of one processor", f"{spent:.2f} s", ""


def main(words: list[str]) -> None:
    """Run a campaign of the size that the words of a command line state, and print each false finding."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench false_findings")
    parser.add_argument("--recordings", type=int, default=RECORDINGS)
    parser.add_argument("--seed", type=int, default=31000)
    parser.add_argument("--only", help="diagnose only those of this kind, for example 'noise stated by half'")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--corners", action="store_true", help="recordings of corners, cameras to be adjusted")
    what.add_argument("--images", action="store_true", help="recordings of images, to be drawn and measured")
    arguments = parser.parse_args(words)
    draw_recording = QuietImages if arguments.images else QuietCorners if arguments.corners else Quiet
    found = rows(arguments.recordings, arguments.seed, True, arguments.only, draw_recording)
    for figure, reached, wanted in found:
        print(f"{figure:78} {reached:>34}   {wanted}", flush=True)
