"""Values as D-SI XML elements: each with its unit and uncertainty, or as an exact constant.

Source: Physikalisch-Technische Bundesanstalt, D-SI 2.2 (https://ptb.de/si), realQuantityType and constantQuantityType.
"""

from dataclasses import dataclass
from xml.etree import ElementTree as ET

SI = "https://ptb.de/si"
METRE, RADIAN, ONE = r"\metre", r"\radian", r"\one"
UNITS = {"C": r"\degreecelsius", "kg": r"\kilogram", "m": METRE, "rad": RADIAN, "s": r"\second"}
NORMAL, UNIFORM = "normal", "uniform"


@dataclass(frozen=True, slots=True)
class Standard:
    """A standard uncertainty, in the value's unit."""

    uncertainty: float
    distribution: str = NORMAL


@dataclass(frozen=True, slots=True)
class Expanded:
    """uncertainty : in the value's unit; k : coverage factor; coverage : probability."""

    uncertainty: float
    k: float
    coverage: float
    distribution: str = NORMAL


@dataclass(frozen=True, slots=True)
class Interval:
    """low, high : between which the quantity lies with probability `coverage`; standard : its standard uncertainty; in
    the value's unit
    """

    low: float
    high: float
    standard: float
    coverage: float
    distribution: str


Uncertainty = Standard | Expanded | Interval | None  # None : of a number that is exact


def si_element(value: float, unit: str, uncertainty: Uncertainty) -> ET.Element:
    """D-SI XML element of a value: si:real with its uncertainty, si:constant of an exact one."""
    root = ET.Element(_name("constant" if uncertainty is None else "real"))
    _add(root, "value", f"{value:.9g}")
    _add(root, "unit", unit)
    if uncertainty is None:
        return root
    within = ET.SubElement(root, _name("measurementUncertaintyUnivariate"))
    if isinstance(uncertainty, Standard):
        rows = {"valueStandardMU": _scientific(uncertainty.uncertainty)}
        kind = "standardMU"
    elif isinstance(uncertainty, Expanded):
        rows = {
            "valueExpandedMU": _scientific(uncertainty.uncertainty),
            "coverageFactor": f"{uncertainty.k:.4f}",
            "coverageProbability": f"{uncertainty.coverage:.6f}",
        }
        kind = "expandedMU"
    else:
        rows = {
            "valueStandardMU": _scientific(uncertainty.standard),
            "intervalMin": _scientific(uncertainty.low),
            "intervalMax": _scientific(uncertainty.high),
            "coverageProbability": f"{uncertainty.coverage:.6f}",
        }
        kind = "coverageIntervalMU"
    parent = ET.SubElement(within, _name(kind))
    for name, text in (*rows.items(), ("distribution", uncertainty.distribution)):
        _add(parent, name, text)
    return root


def _add(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, _name(name)).text = text


def _name(name: str) -> str:
    return f"{{{SI}}}{name}"


def _scientific(value: float) -> str:
    return f"{value:.9g}"
