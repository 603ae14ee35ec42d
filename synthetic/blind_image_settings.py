"""What a blind case from images draws besides: resolution, lens, optics, sensor, and how the markers are printed."""

from dataclasses import dataclass

import numpy as np

from rig.effects.framework.effect import Effect
from rig.model.design import Design, Sensor
from synthetic.image_simulation import Images, is_drawable
from synthetic.printing_errors import Printing, draw_printing_errors

KINDS = (
    "nothing",
    "one",
    "two",
)  # of what is hidden: a disturbance of corners has no picture, an effect out of the catalogue seldom one
FRAMES = 40  # of a recording by default
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
    """Random ImageSettings."""
    width, height = RESOLUTIONS[rng.integers(len(RESOLUTIONS))]
    sensor = Sensor(
        blur=float(rng.uniform(*BLUR)),
        defocus=float(rng.uniform(*DEFOCUS)),
        vignetting=float(rng.uniform(*VIGNETTING)),
        read_noise=float(rng.uniform(*READ_NOISE)),
    )
    return ImageSettings(width, height, LENSES[rng.integers(len(LENSES))], sensor)


def draw_printing(design: Design, rng: np.random.Generator) -> Printing:
    """How the markers of a design are printed, within what printers do."""
    place, side = (float(np.exp(rng.uniform(*np.log(ends)))) for ends in (PLACE, SIDE))
    return draw_printing_errors(design, rng, place, side)


def drawable_effects(catalogue: list[type[Effect]]) -> list[type[Effect]]:
    """Of a catalogue, the effects that a picture can show."""
    return [kind for kind in catalogue if is_drawable(kind)]
