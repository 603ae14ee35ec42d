"""A certificate from simulated recordings: what it promises is so, what it refuses, and what is written keeps its
schema.
"""

import importlib.util
import io
import json
import os
import re
import shutil
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pytest

from calib.certificate.certificate_computation_verdict_and_provenance import combined_held_out_poses
from calib.certification.pose_error_promise_and_conformity import OPEN, pose_error_promise
from calib.certification.uncertainty_budget import rms_position_and_rotation_uncertainty, thermometer_covariance
from calib.correction.machine_correction import fit_geometry_and_remainder_of_correction
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.files import calibration_file
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.cli.command_line import main
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model import machine_motion_simulation as motion_simulation
from rig.model.pose import exp, pose_difference
from rig.planning import configuration_generators
from rig.planning import recording_plan as plan
from rig.recording import corner_and_pose_csv_tables, recording_folder
from rig.recording.corner_and_pose_csv_tables import Poses
from rig.recording.recording_folder import Sensors
from synthetic import random_true_machine_and_truth_file
from tests.conftest import ROOT

GAP = 40e-6
OWN = np.array([6e-6, 6e-6, 6e-6, 4e-5, 4e-5, 4e-5])  # m, rad


def rig(*arguments, ok=True):
    """What a command of `rig` says, errors and all, which ends as expected."""
    output = io.StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        try:
            status = main([str(one) for one in arguments])
        except SystemExit as end:  # a wrong call
            status = end.code
    assert (status == 0) == ok, output.getvalue()
    return output.getvalue()


def _made(folder, secret, rig_text, design, route, seed):
    """A recording folder whose poses an instrument saw, with noise of a known covariance."""
    rng = np.random.default_rng(seed)
    done = plan.build_plan(design, route, seed)
    T = motion_simulation.simulate_machine_run(secret.true, done.commands, done.t, secret.effects).T_base_platform
    folder.mkdir()
    (folder / "rig.toml").write_text(rig_text)
    frames = np.arange(len(done.t))
    corner_and_pose_csv_tables.write_table(
        folder / "frames.csv", ("frame", "t", "camera", "image"), [f"{k},{t:.4f},cam0," for k, t in zip(frames, done.t)]
    )
    corner_and_pose_csv_tables.write_table(
        folder / "commands.csv",
        ("t", *design.mechanism.axes),
        [",".join(f"{v:.9f}" for v in (t, *row)) for t, row in zip(done.commands.t, done.commands.values)],
    )
    seen = T * exp(OWN * rng.normal(size=(len(frames), 6)))
    corner_and_pose_csv_tables.write_poses(
        folder / "poses.csv", Poses(frames, seen, np.tile(np.diag(OWN**2), (len(frames), 1, 1)))
    )
    return folder


@pytest.fixture(scope="module")
def held(tmp_path_factory, design, rig_text):
    """A rig with backlash in strut 3, calibrated from one recording; another held out, with ladders and repeats; and
    what is certified of it.
    """
    folder = tmp_path_factory.mktemp("certify")
    secret = random_true_machine_and_truth_file.random_true_machine(
        design, np.random.default_rng(5), 1.0, (parse_effect(f"backlash:strut3:gap={GAP}"),)
    )
    _made(folder / "fit", secret, rig_text, design, "sobol:40,ladder:1", 1)
    _made(folder / "other", secret, rig_text, design, "sobol:62,ladder:3,repeat:12,moving:4", 2)
    rig("calibrate", folder / "fit", "--out", folder / "cal.json")
    out = rig(
        "certify", folder / "cal.json", folder / "other", "--out", folder / "made", "--tolerance", "15um", "1mrad"
    )
    return SimpleNamespace(
        folder=folder, secret=secret, out=out, tree=json.loads((folder / "made" / "certificate.json").read_text())
    )


@pytest.mark.slow
def test_the_certificate_keeps_its_published_schema(held):
    schema = json.loads((ROOT / "calib/certificate/certificate.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(held.tree, schema)
    for key, value in (("machine", "lathe"), ("promise", {}), ("more", 1)):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**held.tree, key: value}, schema)


def test_the_claim_is_compared_with_the_held_out_recording(held):
    """Backlash that the calibration's claim holds: kept, in a line and in JSON; the same claim a fifth as large is
    refuted, marked and bad.
    """
    claim, lines = held.tree["claim"], held.out.splitlines()
    (one,) = claim["recordings"]
    middle, low, high = one["position"]["claimed"]
    assert (
        claim["kept"]
        and one["recording"] == "other"
        and one["position"]["beyond_noise"] < high
        and low < middle
        and one["rotation"]["kept"]
    )
    assert any(
        line.startswith("The calibration's claim is kept by other: position error ")
        and f"{middle * 1e6:.1f} um (" in line
        for line in lines
    )
    small = json.loads((held.folder / "cal.json").read_text())
    small["claim"]["after"] = [[value / 5 for value in three] for three in small["claim"]["after"]]
    (held.folder / "small").mkdir()
    (held.folder / "small" / "cal.json").write_text(json.dumps(small))
    out = rig(
        "certify",
        held.folder / "small" / "cal.json",
        held.folder / "other",
        "--out",
        held.folder / "small" / "made.json",
        ok=False,
    )
    made = json.loads((held.folder / "small" / "made.json").read_text())
    jsonschema.validate(made, json.loads((ROOT / "calib/certificate/certificate.schema.json").read_text()))
    assert (
        "The calibration's claim is NOT kept by other" in out
        and made["claim"]["kept"] is False
        and made["verdict"]["state"] == "bad"
    )


@pytest.mark.slow
def test_a_folder_of_all_lacks_the_pdf_where_nothing_draws_it_and_says_so(held, monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "matplotlib" else find_spec(name, *rest)
    )
    rig("certify", held.folder / "cal.json", held.folder / "other", "--out", held.folder / "plain")
    assert {path.name for path in (held.folder / "plain").glob("cert*")} == {
        f"certificate.{kind}" for kind in ("json", "html", "xml")
    }


def test_the_promise_is_so(held, design):
    """Against thousands of poses of the machine as it is, come to from everywhere."""
    correction = calibration_file.load(held.folder / "cal.json").correction
    goals = configuration_generators.sobol_configurations(design.mechanism.strut_range, 2000, seed=8)[
        np.random.default_rng(1).permutation(2000)
    ]
    route = plan.plan_of_configurations(goals, goals[0], plan.planned_axis_speeds(design))
    true = motion_simulation.simulate_machine_run(
        held.secret.true, route.commands, route.t, held.secret.effects
    ).T_base_platform
    lengths = np.linalg.norm(pose_difference(correction.predict(goals), true)[:, :3], axis=1)
    promise = held.tree["promise"]
    assert promise["n"] == 62 + 1 + 3, (
        "each configuration once, the ladder's not, and neither what was exposed on the way"
    )
    assert np.quantile(lengths, 0.95) <= promise["position_m"] < 2 * np.quantile(lengths, 0.95)
    assert promise["position"]["lower"] <= np.quantile(lengths, 0.95) and held.tree["conditions"]["moving"] == 4
    assert "Not counted: 4 exposures within 0.25 s of a move;" in held.out


@pytest.mark.parametrize("offset", [-0.4, 0.4])
def test_stamps_of_another_clock_are_shifted_as_verification_shifts_them(held, design, rig_text, tmp_path, offset):
    """As much before or after the exposures, so that those at rest seem to be in motion, and some in motion at rest."""
    right = _made(tmp_path / "right", held.secret, rig_text, design, "sobol:62,ladder:3,repeat:12,moving:30", 3)
    stamped = tmp_path / "stamped"
    shutil.copytree(right, stamped)
    rows = [line.split(",") for line in (right / "frames.csv").read_text().splitlines()]
    rows[1:] = [[frame, f"{float(t) + offset:.4f}", *rest] for frame, t, *rest in rows[1:]]
    (stamped / "frames.csv").write_text("".join(",".join(row) + "\n" for row in rows))
    made = {}
    for folder in (right, stamped):
        rig("certify", held.folder / "cal.json", folder, "--out", tmp_path / f"{folder.name}.json")
        made[folder.name] = json.loads((tmp_path / f"{folder.name}.json").read_text())
    (clock_line,) = [line for line in made["stamped"]["displacement"] if "clock" in line]
    found = re.search(r"times are ([0-9.]+) ms (early|late)", clock_line)
    assert found[2] == ("early" if offset < 0 else "late") and abs(float(found[1]) - 400) < 2
    assert made["stamped"]["conditions"]["moving"] == made["right"]["conditions"]["moving"]
    promises = [made[name]["promise"] for name in ("stamped", "right")]
    assert promises[0]["n"] == promises[1]["n"]
    assert promises[0]["position_m"] == pytest.approx(promises[1]["position_m"], rel=0.02)
    assert made["stamped"]["claim"]["kept"] and made["right"]["claim"]["kept"]


def test_the_first_line_says_whose_scale_it_is(held):
    assert (
        held.out.splitlines()[1].startswith("The scale is not certified") and held.tree["scale"]["certified"] is False
    )
    out = rig(
        "certify",
        held.folder / "cal.json",
        held.folder / "other",
        "--out",
        held.folder / "scaled.json",
        "--scale-uncertainty",
        "50e-6",
        "--scale-source",
        "certificate 17",
    )
    scaled = json.loads((held.folder / "scaled.json").read_text())
    assert (
        "50 um/m, by certificate 17" in out.splitlines()[1]
        and scaled["promise"]["position_m"] > held.tree["promise"]["position_m"]
    )
    assert scaled["promise"]["position"]["scale"] == pytest.approx(1.645 * 50e-6 * 0.45 * 0.7, rel=0.5)


def test_reversal_is_the_backlash_that_is_there(held):
    axes = {axis["axis"]: axis for axis in held.tree["iso230"]}
    u = axes["strut 3"]["u"] * np.sqrt(2 / 3)
    assert axes["strut 3"]["B"] == pytest.approx(GAP, abs=4 * u) and axes["strut 3"]["cycles"] == 3
    assert all(axes[name]["B"] < 4 * u for name in axes if name != "strut 3") and len(axes) == 6 and 4 * u < 0.9 * GAP
    assert not any(axis["formal"] for axis in axes.values())


def test_symbols_of_iso_230_2_stand_with_their_arrows(held):
    axis = held.tree["iso230"][2]
    assert (
        axis["M"] <= axis["E"]
        and max(axis["E_up"], axis["E_down"]) <= axis["E"]
        and max(axis["R_up"], axis["R_down"]) <= axis["R"]
    )
    page = (held.folder / "made" / "certificate.html").read_text()
    assert all(f"{name}{arrow}<" in page for name in "EAR" for arrow in "\u2191\u2193") and ">M<" in page


def test_a_test_that_is_not_the_standards_says_so(held):
    found = held.tree["iso9283"]
    assert (
        not found["formal"] and "poses were visited 30 times or more, where the standard has 5" in found["not_met"][0]
    )
    assert "not formal: " in (held.folder / "made" / "certificate.html").read_text()


def test_physics_that_is_undone_is_part_of_what_is_certified(held):
    """A calibration that knows the backlash promises as much better as the machine then is; temperatures add through
    what they correct.
    """
    known = calibration_file.load(held.folder / "cal.json")
    other = recording_folder.load_recording(held.folder / "other")
    warm = replace(
        other,
        sensors=Sensors(
            np.arange(0.0, 4000, 30), {"ambient_temperature_C": 20 + np.random.default_rng(0).normal(0, 0.1, 134)}
        ),
    )
    samples = sample_recording(other)
    plain = pose_error_promise(
        combined_held_out_poses(known, [(other, samples)]), 0.95, 0.95, 0.0, (1e-5, 1e-4), np.random.default_rng(0)
    ).position
    design, effects = (
        held.secret.true,
        tuple(map(parse_effect, (f"backlash:strut3:gap={GAP}", "base_expansion:rig:coefficient=12e-6"))),
    )
    count = len(fit_coordinates_of_effects(effects))
    physics = Physics(
        effects,
        np.zeros((count, count)),
        np.zeros((42, count)),
        design.gravity,
        design.actuator,
        design.platform,
        {"ambient_temperature_C": (20.0, 0.1)},
    )
    wiser, fit = replace(known, physics=physics), recording_folder.load_recording(held.folder / "fit")
    refined, _ = fit_geometry_and_remainder_of_correction(
        wiser.with_physics(fit, sample_recording(fit).samples), known.correction.nominal, "none"
    )
    wiser = replace(wiser, correction=refined)
    better = pose_error_promise(
        combined_held_out_poses(wiser, [(warm, samples)]), 0.95, 0.95, 0.0, (1e-5, 1e-4), np.random.default_rng(0)
    ).position
    assert better.upper < 0.75 * plain.upper
    assert thermometer_covariance(known, [(warm, samples.samples)]) is None
    added = thermometer_covariance(wiser, [(warm, samples.samples)])
    at, both = (
        samples.samples.t,
        [Sensors(np.array([0.0, 4000]), {"ambient_temperature_C": np.full(2, degrees)}) for degrees in (20.0, 20.1)],
    )
    poses = [
        motion_simulation.simulate_machine_run(design, other.commands, at, effects, sensors).T_base_platform
        for sensors in both
    ]
    moved = np.linalg.norm(pose_difference(*poses)[:, :3], axis=1)
    assert rms_position_and_rotation_uncertainty(added)[0] == pytest.approx(np.sqrt((moved**2).mean()), rel=0.25), (
        "the log's noise is 0.1 K"
    )


def test_what_was_fitted_is_no_evidence(held, tmp_path):
    done = rig("certify", held.folder / "cal.json", held.folder / "fit", "--out", held.folder / "no.json", ok=False)
    frames = len(recording_folder.load_recording(held.folder / "fit").exposures.times()[0])
    assert f"{frames} of {frames} frames" in done and not (held.folder / "no.json").exists()
    copy = tmp_path / "copy"
    shutil.copytree(held.folder / "fit", copy)
    lines = (copy / "poses.csv").read_text().splitlines()
    (copy / "poses.csv").write_text("\n".join([lines[0], *lines[-3:]]) + "\n")
    done = rig("certify", held.folder / "cal.json", copy, "--out", tmp_path / "no.json", ok=False)
    assert f"3 of {frames} frames" in done and "took part in fitting" in done, "a few rows are enough"
    done = rig(
        "certify",
        held.folder / "cal.json",
        held.folder / "other",
        held.folder / "other",
        "--out",
        tmp_path / "no.json",
        ok=False,
    )
    assert "does not count twice" in done


def test_too_few_say_what_they_can_promise(held, tmp_path, design, rig_text):
    _made(tmp_path / "few", held.secret, rig_text, design, "sobol:30", 3)
    done = rig("certify", held.folder / "cal.json", tmp_path / "few", "--out", tmp_path / "c.json", ok=False)
    assert "30 distinct configurations" in done and "90.5% of poses" in done and "29 more" in done
    rig("certify", held.folder / "cal.json", tmp_path / "few", "--out", tmp_path / "c.json", "--coverage", "0.9")
    assert json.loads((tmp_path / "c.json").read_text())["promise"]["coverage"] == 0.9


def test_decisions_are_guarded(held):
    position, rotation = held.tree["conformity"]
    assert (position["verdict"], rotation["verdict"]) == (OPEN, OPEN), (
        "66 poses are too few for a decision with 97.5 % confidence"
    )
    assert rotation["guard"] is None and position["tolerance"] == pytest.approx(15e-6)


def test_the_page_says_it_all(held):
    page = (held.folder / "made" / "certificate.html").read_text()
    assert (
        "The scale is not certified" in page and page.count("<svg") == 2 and "ISO 230-2" in page and "ISO 9283" in page
    )
    assert "inputs_sha256" in page


DCC = "{https://ptb.de/dcc}"
CHILDREN = {  # of elements of DCC 3.3.0, in their order; those with a mark must be there
    "digitalCalibrationCertificate": "administrativeData! measurementResults!",
    "software": "name! release!",
    "statement": "name traceable norm declaration conformity",
    "coreData": "countryCodeISO3166_1! usedLangCodeISO639_1! mandatoryLangCodeISO639_1! uniqueIdentifier! "
    "beginPerformanceDate! endPerformanceDate! "
    "performanceLocation! issueDate",
    "item": "name! manufacturer! identifications!",
    "manufacturer": "name!",
    "identification": "issuer! value! name",
    "contact": "name! location!",
    "customer": "name! location!",
    "respPerson": "person! mainSigner",
    "measurementResults": "measurementResult!",
    "measurementResult": "name! description usedMethods influenceConditions results!",
    "usedMethod": "name! norm",
    "influenceCondition": "name! data!",
    "result": "name! description data!",
    "quantity": "name real constant",
    "real": "value! unit! measurementUncertaintyUnivariate!",
    "constant": "value! unit!",
    "measurementUncertaintyUnivariate": "standardMU expandedMU coverageIntervalMU",
    "standardMU": "valueStandardMU! distribution!",
    "expandedMU": "valueExpandedMU! coverageFactor! coverageProbability! distribution!",
    "coverageIntervalMU": "valueStandardMU! intervalMin! intervalMax! coverageProbability! distribution!",
}


def test_the_digital_calibration_certificate_has_the_published_structure(held):
    root = ElementTree.parse(held.folder / "made" / "certificate.xml").getroot()
    administrative = [part.tag.removeprefix(DCC) for part in root[0]]
    assert sorted(administrative) == [
        "calibrationLaboratory",
        "coreData",
        "customer",
        "dccSoftware",
        "items",
        "respPersons",
        "statements",
    ]
    seen = set()
    for element in root.iter():
        name = element.tag.split("}")[1]
        if name in CHILDREN:
            order = CHILDREN[name].replace("!", "").split()
            places = [order.index(child.tag.split("}")[1]) for child in element]
            assert places == sorted(places), name
            assert {word[:-1] for word in CHILDREN[name].split() if word[-1] == "!"} <= {
                child.tag.split("}")[1] for child in element
            }, name
            seen.add(name)
        if name in ("release", "value", "uniqueIdentifier", "norm", "content"):
            assert element.text == " ".join(element.text.split()) != ""
    assert seen == set(CHILDREN) and root.get("schemaVersion") == "3.3.0"
    real = {quantity[0][0].text: quantity[1] for quantity in root.iter(DCC + "quantity")}
    assert float(real["bound of the position error"][0].text) == pytest.approx(held.tree["promise"]["position_m"])
    assert real["bound of the position error"][1].text == r"\metre"


def test_a_bound_is_written_with_its_coverage_and_a_contribution_with_its_factor(held):
    root = ElementTree.parse(held.folder / "made" / "certificate.xml").getroot()
    real = {quantity[0][0].text: quantity[1] for quantity in root.iter(DCC + "quantity")}
    interval = {part.tag.split("}")[1]: part.text for part in real["bound of the position error"][2][0]}
    assert (
        float(interval["intervalMax"]) == pytest.approx(held.tree["promise"]["position_m"])
        and float(interval["coverageProbability"]) == 0.95
    )
    budget = {row["name"]: row for row in held.tree["budget"]["rows"]}
    expanded = {part.tag.split("}")[1]: part.text for part in real["geometry, position"][2][0]}
    assert float(expanded["valueExpandedMU"]) == pytest.approx(budget["geometry"]["position"])
    assert (
        float(expanded["coverageFactor"]) == pytest.approx(budget["geometry"]["k"][0], abs=1e-4)
        and expanded["distribution"] == "normal"
    )


@pytest.mark.skipif(
    "DCC_SCHEMAS" not in os.environ, reason="DCC_SCHEMAS names no folder with dcc.xsd and SI_Format.xsd"
)
def test_the_digital_calibration_certificate_keeps_ptbs_schema(held):
    """dcc.xsd and SI_Format.xsd as PTB publishes them (LGPL-3): https://ptb.de/dcc/v3.3.0/dcc.xsd and the D-SI's that
    it imports.
    """
    etree = pytest.importorskip("lxml.etree")
    folder = Path(os.environ["DCC_SCHEMAS"])

    class Local(etree.Resolver):
        def resolve(self, url, public_id, context):
            name = url.rsplit("/", 1)[-1]
            if (folder / name).exists():
                return self.resolve_filename(str(folder / name), context)
            space = "http://www.w3.org/2000/09/xmldsig#" if "xmldsig" in url else "http://qudt.org/vocab/"
            return self.resolve_string(
                f'''<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" targetNamespace="{space}">
                <xs:element name="Signature"/><xs:simpleType name="quantitykind"><xs:restriction \
base="xs:string"/></xs:simpleType>
                </xs:schema>''',
                context,
            )

    parser = etree.XMLParser()
    parser.resolvers.add(Local())
    published = etree.parse(str(folder / "dcc.xsd"), parser)
    version = published.getroot().get("version")
    made = etree.parse(str(held.folder / "made" / "certificate.xml"))
    made.getroot().set("schemaVersion", version)  # the folder may hold an older one, of which 3.3.0 is an extension
    schema = etree.XMLSchema(published)
    assert schema.validate(made), schema.error_log


def test_paper_has_every_page(held):
    pdf = (held.folder / "made" / "certificate.pdf").read_bytes()
    assert pdf.startswith(b"%PDF") and pdf.count(b"/Type /Page ") >= 2


@pytest.mark.parametrize(
    "words, message",
    [
        (("--tolerance", "20"), "is not a tolerance"),
        (("--tolerance", "20um", "3mm"), "one length and one angle"),
        (("--country", "de"), "two capital letters"),
        (("--scale-source", "x"), "--scale-uncertainty says"),
        (("--out", "made.txt"), "is written as"),
    ],
)
def test_what_makes_no_sense_is_refused(held, tmp_path, words, message):
    assert message in rig(
        "certify", held.folder / "cal.json", held.folder / "other", "--out", tmp_path / "c.json", *words, ok=False
    )
