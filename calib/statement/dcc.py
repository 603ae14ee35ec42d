"""A certificate as a digital calibration certificate: XML after PTB's DCC 3.3.0, values in the D-SI's units.

No package carries the schema files, so that what is written is checked against them outside: DCC 3.2.0 with D-SI 2.1.0 finds no error in it
but the version's own number; `dcc-validate` of dcc-json-toolkit fetches and applies the one it names. Who calibrated, for whom and where is
for the owner to say; what is not said stands as "not stated".
Source: Physikalisch-Technische Bundesanstalt, DCC 3.3.0 (https://ptb.de/dcc/v3.3.0) and D-SI 2.2.1 (https://ptb.de/si).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from calib.certify.conformity import CONFORMS, OPEN
from calib.statement import words
from calib.statement.certificate import Certificate

VERSION = "3.3.0"
DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
SCHEMA = f"{DCC} {DCC}/v{VERSION}/dcc.xsd"
INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
NOT_STATED = "not stated"
NOWHERE = "ZZ"  # ISO 3166-1 leaves it to its users
METRE, RADIAN, ONE = r"\metre", r"\radian", r"\one"
UNITS = {"C": r"\degreecelsius", "kg": r"\kilogram", "m": METRE, "rad": RADIAN, "s": r"\second"}


@dataclass(frozen=True, slots=True)
class Issuer:
    """Who calibrated, who answers for it, for whom, the country's two letters (ISO 3166-1), and who made the machine."""

    laboratory: str = NOT_STATED
    person: str = NOT_STATED
    customer: str = NOT_STATED
    country: str = NOWHERE
    manufacturer: str = NOT_STATED


def text(c: Certificate, issuer: Issuer) -> str:
    """The XML of a certificate."""
    for prefix, name in (("dcc", DCC), ("si", SI), ("xsi", INSTANCE)):
        ET.register_namespace(prefix, name)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", {"schemaVersion": VERSION, f"{{{INSTANCE}}}schemaLocation": SCHEMA})
    _administrative(_sub(root, "administrativeData"), c, issuer)
    _result(_sub(_sub(root, "measurementResults"), "measurementResult"), c)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"


def _sub(parent: ET.Element, name: str, said: str | None = None) -> ET.Element:
    found = ET.SubElement(parent, f"{{{DCC}}}{name}")
    found.text = said
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
    for name, said in (("countryCodeISO3166_1", issuer.country), ("usedLangCodeISO639_1", "en"), ("mandatoryLangCodeISO639_1", "en"),
                       ("uniqueIdentifier", c.provenance["id"]), ("beginPerformanceDate", day), ("endPerformanceDate", day),
                       ("performanceLocation", "other"), ("issueDate", day)):
        _sub(core, name, said)
    item = _sub(_sub(part, "items"), "item")
    _content(item, "name", f"{c.machine} as calibrated")
    _contact(item, "manufacturer", issuer.manufacturer, issuer.country, located=False)  # DCC up to 3.2 does not do without
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
    _content(scale, "declaration", words.scale_line(c))
    if c.conformity:
        found = _sub(part, "statement")
        _content(found, "name", " and ".join(f"conformity of {k.quantity}" for k in c.conformity))
        _sub(found, "norm", "JCGM 106:2012")
        _content(found, "declaration", *words.conformity_lines(c))
        verdict = c.conformity[0].verdict
        if verdict != OPEN:
            _sub(found, "conformity", "pass" if verdict == CONFORMS else "fail")


def _result(part: ET.Element, c: Certificate) -> None:
    _content(part, "name", "pose error of the calibrated machine")
    _content(part, "description", words.promise_line(c), words.volume_line(c), *words.rest_lines(c))
    methods = _sub(part, "usedMethods")
    for name, norm in (("one-sided tolerance limits of held-out poses, without a distribution", None),
                       ("pose accuracy and repeatability", "ISO 9283"), ("positioning of single axes", "ISO 230-2")):
        method = _sub(methods, "usedMethod")
        _content(method, "name", name)
        if norm:
            _sub(method, "norm", norm)
    _conditions(part, c)
    results = _sub(part, "results")
    p = c.promise
    _quantities(results, "promise", words.promise_line(c), [
        ("bound of the position error", p.position.upper, METRE), ("bound of the rotation error", p.turned, RADIAN),
        ("share of poses", p.coverage, ONE), ("confidence", p.confidence, ONE), ("configurations", p.n, ONE)])
    for k, cell in enumerate(c.cells):
        corners = [(f"{word} {axis}", value, METRE) for word, corner in (("least", cell.low), ("greatest", cell.high))
                   for axis, value in zip("xyz", corner)]
        _quantities(results, f"promise in part {k + 1} of the volume", "", [
            ("bound of the position error", cell.promise.position.upper, METRE),
            ("bound of the rotation error", cell.promise.turned, RADIAN), *corners])
    _quantities(results, "repeatability", "RMS distance of visits from their middle, measuring included",
                [("position", c.repeatability.position, METRE), ("rotation", c.repeatability.rotation, RADIAN)])
    for axis in c.iso230:
        _quantities(results, f"ISO 230-2 of {axis.axis}", f"{axis.positions} positions, {axis.cycles} cycles",
                    [(name, value, UNITS[axis.unit]) for name, value in words.iso230_figures(axis)])
    _quantities(results, "expanded uncertainty, coverage factor 2", "contributions to a pose",
                [(f"{row.name}, {what}", value, unit) for row in c.budget.rows
                 for what, value, unit in (("position", row.position, METRE), ("rotation", row.rotation, RADIAN))])


def _conditions(part: ET.Element, c: Certificate) -> None:
    k = c.conditions
    known = [(name, low, high, UNITS[name.rsplit("_", 1)[-1]]) for name, low, high in k.channels if name.rsplit("_", 1)[-1] in UNITS]
    if k.payload is not None:
        known.append(("payload", *k.payload, UNITS["kg"]))
    listed = _sub(part, "influenceConditions")
    for name, low, high, unit in [*known, ("warm-up", k.warm_up, k.warm_up, UNITS["s"])]:
        condition = _sub(listed, "influenceCondition")
        _content(condition, "name", name.replace("_", " "))
        data = _sub(condition, "data")
        for word, value in (("least", low), ("greatest", high)):
            _quantity(data, word, value, unit)


def _quantities(results: ET.Element, name: str, said: str, rows: Sequence[tuple[str, float | None, str]]) -> None:
    """A result of those quantities that are known; none where none is."""
    known = [(label, value, unit) for label, value, unit in rows if value is not None]
    if not known:
        return
    result = _sub(results, "result")
    _content(result, "name", name)
    if said:
        _content(result, "description", said)
    data = _sub(result, "data")
    for label, value, unit in known:
        _quantity(data, label, value, unit)


def _quantity(data: ET.Element, label: str, value: float, unit: str) -> None:
    quantity = _sub(data, "quantity")
    _content(quantity, "name", label)
    real = ET.SubElement(quantity, f"{{{SI}}}real")
    for name, said in (("value", f"{value:.9g}"), ("unit", unit)):
        ET.SubElement(real, f"{{{SI}}}{name}").text = said
