"""Digital calibration certificate as XML.

PTB's DCC 3.3.0, of a machine, with values in D-SI units.

No package carries the schema files; a test holds what is written to those that a folder named by DCC_SCHEMAS has. Who
calibrated, for whom and where is for the owner to state; what is not stated stands as "not stated".
Source: Physikalisch-Technische Bundesanstalt, DCC 3.3.0 (https://ptb.de/dcc/v3.3.0) and D-SI 2.2 (https://ptb.de/si).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from scipy.special import ndtri

from calib.certificate import certificate_sentences_and_quantity_texts
from calib.certificate.certificate_computation_verdict_and_provenance import Certificate
from calib.certification import uncertainty_budget
from calib.certification.pose_error_promise_and_conformity import CONFORMS, OPEN, Promise
from calib.certification.uncertainty_budget import COVERAGE

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


def dsi_xml_element_of_value(value: float, unit: str, uncertainty: Uncertainty) -> ET.Element:
    """D-SI XML element of a value.

    The element is si:real with its uncertainty, or si:constant of an exact value.
    """
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


VERSION = "3.3.0"
DCC = "https://ptb.de/dcc"
SCHEMA = f"{DCC} {DCC}/v{VERSION}/dcc.xsd"
INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
NOT_STATED = "not stated"
NOWHERE = "ZZ"  # ISO 3166-1 leaves it to its users


@dataclass(frozen=True, slots=True)
class Issuer:
    """Who calibrated, who is responsible for it, for whom, the country's two letters (ISO 3166-1), and who made the
    machine.
    """

    laboratory: str = NOT_STATED
    person: str = NOT_STATED
    customer: str = NOT_STATED
    country: str = NOWHERE
    manufacturer: str = NOT_STATED


def digital_certificate_xml(certificate: Certificate, issuer: Issuer) -> str:
    """Digital calibration certificate (DCC) of a certificate, as XML."""
    for prefix, name in (("dcc", DCC), ("si", SI), ("xsi", INSTANCE)):
        ET.register_namespace(prefix, name)
    root = ET.Element(
        f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": VERSION, f"{{{INSTANCE}}}schemaLocation": SCHEMA}
    )
    _administrative(_sub(root, "administrativeData"), certificate, issuer)
    _result(_sub(_sub(root, "measurementResults"), "measurementResult"), certificate)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"


def _sub(parent: ET.Element, name: str, text: str | None = None) -> ET.Element:
    found = ET.SubElement(parent, f"{{{DCC}}}{name}")
    found.text = text
    return found


def _content(parent: ET.Element, name: str, *lines: str) -> ET.Element:
    """An element with the lines as contents in English."""
    found = _sub(parent, name)
    for line in lines:
        _sub(found, "content", line).set("lang", "en")
    return found


def _contact(parent: ET.Element, name: str, who: str, country: str, located: bool = True) -> None:
    found = _sub(parent, name)
    _content(found, "name", who)
    if located:
        _sub(_sub(found, "location"), "countryCode", country)


def _administrative(part: ET.Element, c: Certificate, issuer: Issuer) -> None:
    listed = _sub(part, "dccSoftware")
    for package, release in c.provenance["versions"].items():
        software = _sub(listed, "software")
        _content(software, "name", package)
        _sub(software, "release", release)
    core = _sub(part, "coreData")
    day = c.provenance["created"][:10]
    for name, text in (
        ("countryCodeISO3166_1", issuer.country),
        ("usedLangCodeISO639_1", "en"),
        ("mandatoryLangCodeISO639_1", "en"),
        ("uniqueIdentifier", c.provenance["id"]),
        ("beginPerformanceDate", day),
        ("endPerformanceDate", day),
        ("performanceLocation", "other"),
        ("issueDate", day),
    ):
        _sub(core, name, text)
    item = _sub(_sub(part, "items"), "item")
    _content(item, "name", f"{c.machine} as calibrated")
    _contact(
        item, "manufacturer", issuer.manufacturer, issuer.country, located=False
    )  # DCC up to 3.2 does not do without
    known = _sub(_sub(item, "identifications"), "identification")
    _sub(known, "issuer", "other")
    _sub(known, "value", next(iter(next(iter(c.provenance["inputs_sha256"].values())).values())))
    _content(known, "name", "SHA-256 of the calibration")
    _contact(_sub(part, "calibrationLaboratory"), "contact", issuer.laboratory, issuer.country)
    person = _sub(_sub(part, "respPersons"), "respPerson")
    _contact(person, "person", issuer.person, issuer.country, located=False)
    _sub(person, "mainSigner", "true")
    _contact(part, "customer", issuer.customer, issuer.country)
    _statements(_sub(part, "statements"), c)


def _statements(part: ET.Element, c: Certificate) -> None:
    scale = _sub(part, "statement")
    _content(scale, "name", "scale")
    _sub(scale, "traceable", "false")
    _content(scale, "declaration", certificate_sentences_and_quantity_texts.length_scale_line(c))
    if c.conformity:
        found = _sub(part, "statement")
        _content(found, "name", " and ".join(f"conformity of {k.quantity}" for k in c.conformity))
        _sub(found, "norm", "JCGM 106:2012")
        _content(found, "declaration", *certificate_sentences_and_quantity_texts.conformity_lines(c))
        first = c.conformity[0]
        if first.verdict != OPEN:
            _sub(found, "conformity", "pass" if first.verdict == CONFORMS else "fail")
        elif first.given_scale == CONFORMS:
            _sub(found, "conformity", "conditionalPass")


def _result(part: ET.Element, c: Certificate) -> None:
    _content(part, "name", "pose error of the calibrated machine")
    _content(
        part,
        "description",
        certificate_sentences_and_quantity_texts.promise_line(c),
        certificate_sentences_and_quantity_texts.measured_volume_line(c),
        *certificate_sentences_and_quantity_texts.promise_basis_lines(c),
    )
    methods = _sub(part, "usedMethods")
    for name, norm in (
        ("distribution-free one-sided tolerance limits of held-out poses", None),
        ("pose accuracy and repeatability", "ISO 9283"),
        ("positioning of single axes", "ISO 230-2"),
    ):
        method = _sub(methods, "usedMethod")
        _content(method, "name", name)
        if norm:
            _sub(method, "norm", norm)
    _conditions(part, c)
    results = _sub(part, "results")
    p = c.promise
    exact = [
        ("share of poses", p.coverage, ONE, None),
        ("confidence", p.confidence, ONE, None),
        ("configurations", p.n, ONE, None),
    ]
    _quantities(
        results, "promise", (certificate_sentences_and_quantity_texts.promise_line(c),), [*_bounds(c, p), *exact]
    )
    for k, cell in enumerate(c.cells):
        corners: list[Row] = [
            (f"{word} {axis}", value, METRE, None)
            for word, corner in (("least", cell.low), ("greatest", cell.high))
            for axis, value in zip("xyz", corner)
        ]
        _quantities(results, f"promise in part {k + 1} of the volume", (), [*_bounds(c, cell.promise), *corners])
    r = c.repeatability
    freedom = max(r.visits - r.poses, 1)  # of each of three directions
    _quantities(
        results,
        "repeatability",
        ("RMS distance of visits from their middle, measuring included",),
        [
            (name, value, unit, None if value is None else Standard(value / (6 * freedom) ** 0.5))
            for name, value, unit in (("position", r.position, METRE), ("rotation", r.rotation, RADIAN))
        ],
    )
    for axis in c.iso230:
        _quantities(
            results,
            f"ISO 230-2 of {axis.axis}",
            (f"{axis.positions} positions, {axis.cycles} cycles", "the uncertainty is that of one reading"),
            [
                (name, value, UNITS[axis.unit], Standard(axis.u))
                for name, value in certificate_sentences_and_quantity_texts.iso230_symbol_values(axis)
            ],
        )
    totals = [
        (name, *total)
        for name, total in (
            ("pose as commanded", _total(c.budget.machine)),
            ("pose as measured", _total(c.budget.measuring)),
        )
    ]
    known = [(row.name, row.position, row.rotation, row.k) for row in c.budget.rows if row.k is not None]
    _quantities(
        results,
        "expanded uncertainty",
        ("contributions to the pose error: its length lies within the value, with the stated coverage",),
        [
            (f"{name}, {what}", None if U is None else 0.0, unit, None if U is None else Expanded(U, factor, COVERAGE))
            for name, position, rotation, k in [*known, *totals]
            for what, U, unit, factor in (("position", position, METRE, k[0]), ("rotation", rotation, RADIAN, k[1]))
        ],
    )


Row = tuple[str, float | None, str, Uncertainty]  # label, value, unit, uncertainty


def _total(total: uncertainty_budget.Expanded) -> tuple[float, float | None, tuple[float, float]]:
    return total.position, total.rotation, total.k


def _bounds(c: Certificate, p: Promise) -> list[Row]:
    """What is promised, and the quantile of the errors that it bounds, both with the interval that holds them."""
    rows: list[Row] = []
    for what, bound, unit, rms in (
        ("position", p.position, METRE, c.after.position[0]),
        ("rotation", p.rotation, RADIAN, c.after.rotation[0]),
    ):
        if bound is None:
            continue
        both = f"distribution-free; confidence {p.confidence:g} of this and all other bounds of the promise jointly"
        spread = (bound.upper - bound.lower) / (2 * ndtri(p.confidence))
        rows += [
            (f"bound of the {what} error", bound.upper, unit, Interval(0.0, bound.upper, rms, p.coverage, both)),
            (
                f"quantile of the {what} error",
                bound.estimate,
                unit,
                Interval(bound.lower, bound.upper, spread, 2 * p.confidence - 1, "distribution-free"),
            ),
        ]
    return rows


def _conditions(part: ET.Element, c: Certificate) -> None:
    k = c.conditions
    known = [
        (name, low, high, UNITS[name.rsplit("_", 1)[-1]])
        for name, low, high in k.channels
        if name.rsplit("_", 1)[-1] in UNITS
    ]
    if k.payload is not None:
        known.append(("payload", *k.payload, UNITS["kg"]))
    listed = _sub(part, "influenceConditions")
    for name, low, high, unit in [*known, ("warm-up", k.warm_up, k.warm_up, UNITS["s"])]:
        condition = _sub(listed, "influenceCondition")
        _content(condition, "name", name.replace("_", " "))
        _quantity(
            _sub(condition, "data"),
            "at the exposures",
            (low + high) / 2,
            unit,
            Interval(low, high, (high - low) / 12**0.5, 1.0, UNIFORM),
        )


def _quantities(results: ET.Element, name: str, lines: Sequence[str], rows: Sequence[Row]) -> None:
    """A result of those quantities that are known; none where none is."""
    known = [(label, value, unit, uncertainty) for label, value, unit, uncertainty in rows if value is not None]
    if not known:
        return
    result = _sub(results, "result")
    _content(result, "name", name)
    if lines:
        _content(result, "description", *lines)
    data = _sub(result, "data")
    for label, value, unit, uncertainty in known:
        _quantity(data, label, value, unit, uncertainty)


def _quantity(data: ET.Element, label: str, value: float, unit: str, uncertainty: Uncertainty) -> None:
    quantity = _sub(data, "quantity")
    _content(quantity, "name", label)
    quantity.append(dsi_xml_element_of_value(value, unit, uncertainty))
