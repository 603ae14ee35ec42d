"""Readings that an operator enters during a run.

At the places of a run without cameras.
A place is named in the units of rig.toml, and so is a reading; it is stored in m and rad.
"""

from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Floats
from rig.driving.axis_display_units_and_controller_counts import axes_word
from rig.errors import NotConverged, RigError
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG
from rig.formats.numbers_and_units import LengthAndAngleUnits, parse_number
from rig.model import mechanisms
from rig.model.design import Instrument
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded
from rig.model.pose import pose_to_vector
from rig.recording.corner_and_pose_csv_tables import POSE_UNITS

FORMS = {3: "x y z", 6: "x y z rx ry rz"}


@dataclass(frozen=True, slots=True, eq=False)
class ReadingForm:
    """How places are named and readings entered. mechanism : that is driven; units : of rig.toml; sizes : how many
    figures a reading may have, none where the instrument measures no poses
    """

    mechanism: Commanded
    units: LengthAndAngleUnits
    sizes: tuple[int, ...]

    def question(self, frame: int, lengths: Floats, sizes: tuple[int, ...]) -> str:
        """What an operator is asked at lengths (axes,) m. sizes : of readings that may be entered here"""
        forms = " or ".join(FORMS[size] for size in sizes)
        reading = f", after {forms} ({self.units}) if it is to be recorded" if forms else ""
        return f"frame {frame} stands at {self._place(lengths)}; press Enter once it is measured{reading}"

    def reading(self, text: str, sizes: tuple[int, ...]) -> tuple[float, ...]:
        """A reading (m, rad) parsed from what an operator entered, () for none. sizes : as above

        Raises RigError for what is no reading.
        """
        words = text.replace(",", " ").split()
        if not words:
            return ()
        try:
            values = np.array([parse_number(word) for word in words])
        except ValueError as error:
            raise RigError(f"no reading: {error}") from None
        if len(words) not in sizes:
            wanted = " or ".join(f"{size} figures ({FORMS[size]})" for size in sizes) or "nothing: enter no figures"
            raise RigError(f"no reading: {len(words)} figures; expected {wanted}")
        found = self.units.si(values, POSE_UNITS[: len(words)])
        if np.abs(found[:3]).max() > LARGEST_RIG:
            raise RigError(
                f"no reading: a position of {words[int(np.abs(found[:3]).argmax())]} {self.units.length} is implausible"
            )
        return tuple(found.tolist())

    def _place(self, lengths: Floats) -> str:
        """Lengths (axes,) m as text, with the pose of the nominal model where there is one."""
        texts = [self._text(value, unit) for value, unit in zip(lengths, mechanisms.axis_units(self.mechanism))]
        struts = f"{axes_word(self.mechanism)} {' '.join(texts)} {self._units_of_axes()}"
        if self.mechanism.plates is None:
            return struts
        try:
            v = pose_to_vector(mechanisms.kinematics_of(self.mechanism).forward(lengths, self.mechanism))
        except NotConverged:
            return struts
        pose = f"{self._text(v[:3], 'm')} {self.units.length}, {self._text(v[3:], 'rad')} {self.units.angle}"
        return f"{pose} by the nominal model ({struts})"

    def _units_of_axes(self) -> str:
        """Names of the axes' units, once each."""
        return ", ".join(dict.fromkeys(self.units.name(unit) for unit in mechanisms.axis_units(self.mechanism)))

    def _text(self, values: Floats | float, unit: str) -> str:
        shown = np.round(np.atleast_1d(values) * self.units.per_si(unit), 9) + 0.0
        return " ".join(f"{value:.7g}" for value in shown)


def permitted_figure_counts_of_reading(instrument: Instrument | None) -> tuple[int, ...]:
    """Permitted counts of figures of a reading of an instrument.

    3 of a position, 6 of a pose, none of anything else.
    """
    if instrument is None:
        return 3, 6
    if instrument.kind != "pose":
        return ()
    return (3,) if instrument.rotation_sigma is None else (6,)
