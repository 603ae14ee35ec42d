"""Image settings of blind cases drawn at random: resolution, lens, sensor, printing errors of the markers."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.framework.effect import Effect
from rig.effects.framework.marker_table import Markers, replace_marker_columns
from rig.model.design import Design, Sensor
from rig.model.pose import exp
from synthetic.image_simulation import Images, is_renderable
from vision.predict import marker_map


@dataclass(frozen=True, slots=True)
class Printing(Effect):
    """offsets (2 m) : m, each marker's shift in its plane, x right and y up, in the map's order
    scales (m) : its printed side over the stated, less 1"""

    place: str
    offsets: tuple[float, ...]
    scales: tuple[float, ...]
    name: ClassVar = "printing"
    stage: ClassVar = "targets"
    places: ClassVar = ("markers",)

    def attach(self, markers: Markers) -> Markers:
        tangent = np.zeros((len(markers.id), 6))
        tangent[:, :2] = np.reshape(self.offsets, (-1, 2))
        return replace_marker_columns(
            markers,
            T_body_marker=markers.T_body_marker * exp(tangent),
            side=markers.side * (1 + np.asarray(self.scales)),
        )


def draw_printing_errors(
    design: Design, rng: np.random.Generator, shift_sigma: float, relative_side_sigma: float
) -> Printing:
    """Printing errors of a design's markers drawn at random: shifts (sigma m), and sides (sigma as a share)."""
    count = len(marker_map(design).id)
    scales = relative_side_sigma * (rng.normal() + rng.normal(size=count))
    return Printing("markers", tuple((shift_sigma * rng.normal(size=2 * count)).tolist()), tuple(scales.tolist()))


IMAGE_KINDS = (
    "nothing",
    "one",
    "two",
)  # of what is hidden: a disturbance of corners has no picture, an effect out of the catalogue seldom one
IMAGE_FRAMES = 40  # of a recording by default
RESOLUTIONS = ((640, 512), (960, 768), (1280, 1024))  # px
LENSES = (
    "[-0.1, 0.08, 0.0, 0.0, 0.0]",
    "[-0.25, 0.1, 0.0004, -0.0003, 0.0]",
)  # OpenCV k1 k2 p1 p2 k3; the first is the layout's
BLUR, DEFOCUS, VIGNETTING, READ_NOISE = (0.4, 0.9), (0.0, 0.8), (0.0, 0.3), (0.5, 2.0)  # px, px, share, grey levels
PLACE, SIDE = (
    (1e-6, 5e-6),
    (2e-5, 1.2e-4),
)  # m of a marker's place, share of its side: standard deviations of how they are printed
CONTRAST = 180.0  # grey levels between black and white, about
SHARE = 25  # a marker's side is about so much of an image's width


@dataclass(frozen=True, slots=True)
class ImageSettings:
    """width, height : px; lens : as rig.toml has it; sensor : Sensor"""

    width: int
    height: int
    lens: str
    sensor: Sensor

    def seen_through(self, text: str) -> str:
        """Text of a rig.toml with this lens in place of the layout's."""
        return text.replace(f"distortion = {LENSES[0]}", f"distortion = {self.lens}")

    @property
    def images(self) -> Images:
        """How they are drawn: in one process, since cases run side by side."""
        return Images(self.sensor, processes=1)

    @property
    def noise(self) -> float:
        """px, what a corner is good for: the Cramer-Rao bound of two edges through blur and noise, and a quarter for
        the grey levels' rounding.
        """
        s, blur = self.sensor, float(np.hypot(self.sensor.blur, self.sensor.defocus / 2))
        grey = np.hypot(s.read_noise, 1 / np.sqrt(12))
        return float(1.25 * 2 * grey / CONTRAST * np.sqrt(2 * np.sqrt(np.pi) * blur / (self.width / SHARE)))


def draw_image_settings(rng: np.random.Generator) -> ImageSettings:
    """Image settings (ImageSettings) drawn at random."""
    width, height = RESOLUTIONS[rng.integers(len(RESOLUTIONS))]
    sensor = Sensor(
        blur=float(rng.uniform(*BLUR)),
        defocus=float(rng.uniform(*DEFOCUS)),
        vignetting=float(rng.uniform(*VIGNETTING)),
        read_noise=float(rng.uniform(*READ_NOISE)),
    )
    return ImageSettings(width, height, LENSES[rng.integers(len(LENSES))], sensor)


def draw_typical_printing_errors(design: Design, rng: np.random.Generator) -> Printing:
    """Printing errors of a design's markers drawn at random, as large as printers make them."""
    place, side = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (PLACE, SIDE))
    return draw_printing_errors(design, rng, place, side)


def renderable_effects(catalogue: list[type[Effect]]) -> list[type[Effect]]:
    """Effects of a catalogue that can be rendered in images."""
    return [kind for kind in catalogue if is_renderable(kind)]
