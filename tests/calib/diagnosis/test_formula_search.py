"""A formula for what has no name: found by its covariates, worth its numbers, held out, written as a file that the
diagnosis then asks for.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis.engine.formula_search_for_unexplained_residuals import Library, Quantity, Search
from calib.diagnosis.engine.forward_and_backward_term_selection import select_terms
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import FrameProducts, Reduced
from calib.diagnosis.problems.arm.arm_lack_of_fit_covariates_and_joint_formulas import (
    find_lack_of_fit_by_joint as arm_left,
)
from calib.diagnosis.problems.arm.arm_lack_of_fit_covariates_and_joint_formulas import (
    suggest_joint_formulas as arm_suggestions,
)
from calib.diagnosis.problems.arm.arm_problem import ArmProblem
from calib.diagnosis.problems.arm.joint_effect_candidates_and_effects_seen_by_instruments import (
    joint_candidates_and_untested_effects,
)
from calib.diagnosis.problems.arm.robust_fit_of_effect_terms_to_arm_poses import fit_terms_to_poses
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    platform_candidates_and_untested_effects,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.platform_problem import PlatformProblem
from calib.diagnosis.problems.platform.strut_formula_suggestions import suggest_strut_formulas
from calib.diagnosis.report.diagnosis_json_entries import FitEntry, suggested_formula_entries
from calib.diagnosis.report.diagnosis_page import _suggestions
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import (
    Report,
    recommended_actions,
    write_diagnosis_json,
)
from rig.cli.command_line import main
from rig.effects.framework.unmodelled_curve_and_formula_quantities import quantities_of_motion
from rig.effects.texts.effect_file_from_formula import Term, Written
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import load_effect_file
from rig.errors import FileError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.arm_hands_effect_places_and_tolerances import Place
from tests.calib import unlisted_laws
from tests.calib.diagnosis.test_arm_diagnosis import recorded as arm_recorded
from tests.calib.recordings_with_effects import recorded
from tests.calib.rigs_with_unmodelled_physics import measured_by
from tests.rig.effects.test_effects_of_all_machines import context_of, setting_of

FRAMES, NOISE = 240, 5e-6


def looked(rng):
    """Quantities of so many frames: a travel with sinusoids, a pose, a temperature, a time, a sign."""
    travel, pose, t = (
        rng.uniform(-0.05, 0.05, FRAMES),
        rng.normal(size=FRAMES) * 0.03,
        np.sort(rng.uniform(0, 1200, FRAMES)),
    )
    room, sign = 2 + np.sin(t / 500), rng.choice([-1.0, 1.0], FRAMES)
    made = (
        ("travel", travel, 3, 8.0),
        ("pose", pose, 3, 0.0),
        ("room", room, 2, 0.0),
        ("time", t, 3, 12.0),
        ("sign", sign, 1, 0.0),
    )
    return tuple(Quantity(name, values[:, None], powers, turns) for name, values, powers, turns in made)


def sought(quantities, moved, rng):
    """The Formula of what frames are moved by (m), beside nuisances that take a constant and the pose."""
    nuisances = np.linalg.qr(np.stack([np.ones(FRAMES), quantities[1].values[:, 0]], axis=1))[0]
    y = (moved + NOISE * rng.normal(size=FRAMES)) / NOISE
    y -= nuisances @ (nuisances.T @ y)
    products = FrameProducts(y[:, None] / NOISE, np.full((FRAMES, 1, 1), NOISE**-2), nuisances[:, None] / NOISE)
    return Search(Library(quantities), Reduced.of(products, np.arange(FRAMES))).best()


@pytest.mark.parametrize(
    "law, atoms",
    [
        (lambda q: 2e-5 * np.sin(190 * q["travel"] + 0.7), [((), "travel")]),
        (
            lambda q: 0.2 * q["pose"] ** 3 + 3e-4 * q["pose"] * q["room"],
            [(("pose", 3), None), (("pose", 1), ("room", 1), None)],
        ),
        (lambda q: 3e-4 * q["sign"] * q["pose"], [(("pose", 1), ("sign", 1), None)]),
        (lambda q: 2e-5 * (0.4 + q["time"] / 1200) * np.sin(q["time"] / 40), [((), "time"), (("time", 1), "time")]),
        (lambda q: 0 * q["time"], None),
    ],
    ids=["sine", "two terms", "a sign", "swelling", "nothing"],
)
def test_atoms_are_found_beside_nuisances(law, atoms):
    rng = np.random.default_rng(5)
    quantities = looked(rng)
    found = sought(quantities, law({q.name: q.values[:, 0] for q in quantities}), rng)
    if atoms is None:
        assert found is None
        return
    got = {
        (*((quantities[i].name, power) for i, power in a.powers), a.wave and quantities[a.wave.quantity].name)
        for a in found.atoms
    }
    assert got == {a if a[0] != () else a[1:] for a in atoms}
    if got == {("travel",)}:
        assert found.atoms[0].wave.frequency == pytest.approx(190, rel=0.01)
        assert np.hypot(*found.coefficients) == pytest.approx(2e-5, rel=0.05)
        assert np.arctan2(found.coefficients[1], found.coefficients[0]) == pytest.approx(0.7, abs=0.1)


WRITTEN = Written(
    "strut",
    (
        Term((("own speed", 1), ("ambient_temperature_C", 1)), None, None, (1e-5,), 0.1),
        Term((("own direction", 1),), ("travel of strut 2", 90.0), None, (3e-6, -2e-6), 1.0, 1.4),
        Term((("own load", 1),), None, None, (1e-8,), 100.0),
    ),
)
SAG = Written("strut", (Term((("x", 3),), None, "z", (0.2,), 1e-3), Term((("time", 1),), None, "rx", (1e-6,), 1e3)))


def test_a_file_does_what_its_formula_says(design):
    motion = context_of(setting_of(design, "hexapod")).moved()
    q = {one.name: one.values(motion) for one in quantities_of_motion(motion, True)}
    effect = WRITTEN.kind("mine")("strut 3", **WRITTEN.values)
    wave = 3e-6 * np.sin(90 * q["travel of strut 2"]) - 2e-6 * np.cos(90 * q["travel of strut 2"])
    expected = 1e-5 * q["own speed"] * q["ambient_temperature_C"] + q["own direction"] * wave + 1e-8 * q["own load"]
    np.testing.assert_allclose(effect.deviation(motion), expected * (np.arange(6) == 2), atol=1e-18)
    assert effect.needs(replace(motion, sensors=None)) and not effect.needs(motion)
    sway = SAG.kind("sag")("rig", **SAG.values).sway(motion)
    down = np.einsum("nij,nj->ni", motion.poses().rotation.as_matrix(), sway[:, :3])
    np.testing.assert_allclose(down, 0.2 * q["x"] ** 3 * [0, 0, 1], atol=1e-15)


def test_every_quantity_is_what_its_python_gives(design):
    for kind in ("hexapod", "arm"):
        motion = context_of(setting_of(design, kind)).moved()
        for one in quantities_of_motion(motion, True):
            form = Written(motion.kind.AXIS, (Term(((one.name, 1),), None, None, (1.0,), 1.0),))
            made = form.kind("mine")(motion.places[1], **form.values).deviation(motion)
            np.testing.assert_array_equal(
                made[:, 1], np.broadcast_to(one.values(motion), made.shape)[:, 1], err_msg=one.name
            )


def test_a_channel_of_any_name_stays_a_name():
    name = 'x"""; __import__("os").abort() #{axis}'
    form = Written("strut", (Term(((name, 1),), None, None, (1.0,), 1.0),))
    effect = form.kind("mine")("strut 1", c1=1.0)
    assert repr(name) in form.source("mine") and effect.experiment_at("strut 1") and effect.action_at("strut 1")


@pytest.mark.parametrize(
    "spoil, message",
    [
        (lambda model: model.update(word="leg"), "word"),
        (lambda model: model.update(terms=[]), "terms"),
        (lambda model: model["terms"][0].update(powers=[["x", 9]]), "powers"),
        (lambda model: model["terms"][0].update(powers="x"), "powers"),
        (lambda model: model["terms"][0].update(wave=["x", -1.0]), "wave|values"),
        (lambda model: model["terms"][0].update(greatest=0), "greatest"),
        (lambda model: model["terms"][0].update(along="w"), "along"),
        (lambda model: model["terms"][1].pop("along"), "terms"),
        (lambda model: model["terms"][0].update(values=[1, 2]), "values"),
    ],
)
def test_a_spoilt_suggestion_is_refused(tmp_path, spoil, message):
    model = json.loads(
        json.dumps(
            {
                "word": "strut",
                "alike": False,
                "terms": [
                    {"powers": t.powers, "along": t.along, "values": t.values, "greatest": t.greatest, "turns": t.turns}
                    for t in SAG.terms
                ],
            }
        )
    )
    (tmp_path / "diagnosis.json").write_text(json.dumps({"schema": "diagnosis/1", "model": model}))
    assert (
        Written.read(
            json_toml_and_yaml_loading.load_json(tmp_path / "diagnosis.json", "diagnosis", "diagnosis/1").table("model")
        )
        == SAG
    )
    spoil(model)
    (tmp_path / "diagnosis.json").write_text(json.dumps({"schema": "diagnosis/1", "model": model}))
    with pytest.raises(FileError, match=f"diagnosis.json.*({message})"):
        Written.read(
            json_toml_and_yaml_loading.load_json(tmp_path / "diagnosis.json", "diagnosis", "diagnosis/1").table("model")
        )


def test_commands_write_what_is_to_be_edited(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words, message in (
        (["--new", "backlash"], "collides with the catalogue's backlash"),
        (["--new", "My own"], "small letters"),
        (["--new", "mine", "--from", "nothing"], "nothing/diagnosis.json: no such file"),
        (["--out", "mine.py"], "--new"),
        (["--new", "mine", "backlash"], "omit NAME"),
        (["--new", "mine", "--place", "rig"], "--from"),
    ):
        assert main(["effects", *words]) == 1 and message in capsys.readouterr().err
    assert main(["effects", "--new", "mine"]) == 0 and load_effect_file(tmp_path / "mine.py").kinds[0].name == "mine"
    capsys.readouterr()
    assert main(["effects", "mine", "--effects", "mine.py"]) == 0 and "travel of strut 2" in capsys.readouterr().out
    (tmp_path / "mine.py").write_text("# edited\n")
    assert main(["effects", "--new", "mine"]) == 1 and "was changed since" in capsys.readouterr().err


@pytest.fixture(scope="module")
def measured(tmp_path_factory, rig_text):
    """(text, Design) of a rig whose poses an instrument measures, which is quick."""
    text, path = measured_by(rig_text), tmp_path_factory.mktemp("measured") / "rig.toml"
    path.write_text(text)
    return text, design_from_rig_toml.load_design(path)


def sought_in(recording):
    """(PlatformProblem, its Fit, what is left) of a recording with nothing admitted."""
    problem = PlatformProblem(operating_point_source_and_measurement(recording)[0], [])
    fit = problem.start()
    return problem, fit, problem.lack_of_fit(problem.residual(fit))


@pytest.mark.parametrize("number", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_law_is_suggested_by_its_covariates(tmp_path, measured, number, monkeypatch):
    text, design = measured
    monkeypatch.setattr(unlisted_laws, "PLAN", "moving:10,sobol:40,ladder:3,sobol:30")
    recording, effect, covariates = unlisted_laws.recorded(tmp_path / "rec", design, text, number, 3)
    problem, fit, left = sought_in(recording)
    (found,) = suggest_strut_formulas(problem, fit, left)
    assert {q.name for q in found.written.quantities} == covariates and found.place == effect.place
    assert found.after < 1.2 * found.noise < found.before and all(set(part) == covariates for part in found.parts)
    if number == 1:
        value, low, high = found.intervals["c1"]
        assert low < -effect.size < high and high - low < 0.2 * abs(value)
    (entry,) = suggested_formula_entries([found])
    assert entry.parameters[next(iter(found.intervals))].unit == ("m" if number == 0 else "m/m^3")
    report = Report("rec", 0.0, {}, (), None, {}, FitEntry(1e-5, 1e-5, 1e-5, "m"), (), suggestions=(entry,))
    page = "".join(_suggestions(report))
    assert (
        f"{found.after / found.noise:.2f} times the noise" in page
        and "a suggestion, not an identification" in page
        and recommended_actions(report) != recommended_actions(replace(report, suggestions=()))
    )
    write_diagnosis_json(tmp_path, report)
    assert main(["effects", "--new", "mine", "--from", str(tmp_path), "--out", str(tmp_path / "mine.py")]) == 0
    (kind,) = load_effect_file(tmp_path / "mine.py").kinds
    requested_problem = PlatformProblem(
        problem.point,
        platform_candidates_and_untested_effects(
            problem.point, RequestedEffects((f"mine {effect.place}",), (), (kind,))
        )[0],
    )
    selection = select_terms(requested_problem)
    assert [(f.score.candidate.name, f.score.candidate.place) for f in selection.findings] == [("mine", effect.place)]
    assert requested_problem.lack_of_fit(requested_problem.residual(selection.fit)) == []


def test_nothing_is_suggested_where_nothing_is_left(tmp_path, measured):
    text, design = measured
    problem, fit, left = sought_in(unlisted_laws.recorded(tmp_path / "rec", design, text, 3, 1, seen=1e-9)[0])
    assert left == [] and suggest_strut_formulas(problem, fit, left) == []


@pytest.mark.slow
def test_a_joint_that_follows_another_is_suggested_once(tmp_path):
    (arms, _), _ = arm_recorded(lambda q: 3e-4 * np.sin(1.3 * q[:, [3]] + 0.5) * (np.arange(6) == 1))
    now = fit_terms_to_poses(arms)
    left = arm_left(now)
    assert {Place("joint", "2"), Place("joint", "3")} <= {u.place for u in left}  # they turn about axes that are alike
    (found,) = arm_suggestions(now, left)
    assert found.place == "joint 2" and [q.name for q in found.written.quantities] == ["travel of joint 4"]
    assert found.after < 1.2 * found.noise < 0.5 * found.before
    assert np.hypot(found.effect.sine1, found.effect.cosine1) == pytest.approx(3e-4, rel=0.05)
    low, high = found.intervals["frequency"][1:]
    assert low < 1.3 < high < 1.05 * low
    (tmp_path / "mine.py").write_text(found.written.source("mine"))
    (kind,) = load_effect_file(tmp_path / "mine.py").kinds
    candidates, _ = joint_candidates_and_untested_effects(arms, RequestedEffects(("mine",), (), (kind,)))
    assert [(t.candidate.name, t.candidate.place) for t in select_terms(ArmProblem(arms, candidates)).fit.terms] == [
        ("mine", "joint 2")
    ]


@pytest.mark.slow
def test_what_was_suggested_is_found_calibrated_and_undone(tmp_path, measured, monkeypatch, capsys):
    monkeypatch.setattr(unlisted_laws, "PLAN", "moving:10,sobol:40,ladder:3,sobol:30")
    text, design = measured
    recording, effect, _ = unlisted_laws.recorded(tmp_path / "rec", design, text, 0, 3)
    monkeypatch.chdir(tmp_path)
    assert (
        main(["diagnose", "rec", "--out", "first", "--only", "backlash"]) == 0
        and "a formula for it at" in capsys.readouterr().out
    )
    tree = json.loads((tmp_path / "first" / "diagnosis.json").read_text())
    assert [s["place"] for s in tree["suggestions"]] == [effect.place] and "a suggestion, not an identification" in (
        tmp_path / "first" / "diagnosis.html"
    ).read_text()
    assert main(["effects", "--new", "swing", "--from", "first"]) == 0
    ask = ["--only", "swing", "--effects", "swing.py"]
    assert (
        main(["diagnose", "rec", "--out", "second", *ask]) == 0
        and f"swing at {effect.place}" in capsys.readouterr().out
    )
    tree = json.loads((tmp_path / "second" / "diagnosis.json").read_text())
    assert tree["own_effects"][0]["effects"] == ["swing"] and tree["suggestions"] == [] and tree["unexplained"] is None
    assert (
        main(["diagnose", "rec", "--out", "third", "--from", "second"]) == 1
        and "name its file with --effects" in capsys.readouterr().err
    )
    assert main(["simulate", "--from", "second", "--out", "drawn", "--effects", "swing.py"]) == 0
    assert (
        main(["calibrate", "rec", "--diagnosis", "second", "--effects", "swing.py", "--out", "calibration.json"]) == 0
    )
    home = design.mechanism.home.translation
    (tmp_path / "poses.csv").write_text(
        "frame,x,y,z,rx,ry,rz\n"
        + "".join(f"{i},{home[0] + x},{home[1]},{home[2]},0,0,0\n" for i, x in enumerate((-0.02, 0.0, 0.02)))
    )
    correct = ["correct", "calibration.json", "--poses", "poses.csv", "--out", "commands.csv"]
    capsys.readouterr()
    assert main(correct) == 1 and "there is no effect 'swing'" in capsys.readouterr().err
    assert main([*correct, "--effects", "swing.py"]) == 0
    assert main([*correct[:-1], "plain.csv", "--uncorrected", "--effects", "swing.py"]) == 0
    done, plain = (
        np.genfromtxt(name, delimiter=",", skip_header=1)[:, int(effect.place[-1])]
        for name in ("commands.csv", "plain.csv")
    )
    assert 5e-6 < np.ptp(done - plain) < 1e-3
    (tmp_path / "swing.py").write_text((tmp_path / "swing.py").read_text() + "# edited\n")
    assert main([*correct, "--effects", "swing.py", "--force"]) == 1 and "has changed since" in capsys.readouterr().err


MOUNTED = '''"""A mount that swings."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Parameter


@dataclass(frozen=True, slots=True)
class Swing(Effect):
    """The camera turns about its own z by size * sin(frequency * t)."""

    place: str
    size: float = 0.0
    frequency: float = 0.05
    name: ClassVar = "swing"
    stage: ClassVar = "view"
    places: ClassVar = ("camera",)
    parameters: ClassVar = (Parameter("size", "rad", (-0.1, 0.1), (1e-5, 1e-3), signed=True),
                            Parameter("frequency", "rad/s", (1e-3, 1), (0.03, 0.08), role="log"))
    experiment: ClassVar = "look at cubes that stand still"
    action: ClassVar = "Tighten it."

    def mount(self, camera, t, channel):
        turn = np.zeros((len(t), 6))
        turn[:, 5] = self.size * np.sin(self.frequency * t) * self.at(f"camera {camera.name}")
        return turn
'''


@pytest.mark.slow
def test_a_camera_may_have_an_effect_of_ones_own(tmp_path, design):
    (tmp_path / "swing.py").write_text(MOUNTED)
    (kind,) = load_effect_file(tmp_path / "swing.py").kinds
    place = f"camera {design.cameras[1].name}"
    recording = recorded(tmp_path / "rec", design, (kind(place, 2e-4, 0.047),), route="sobol:60")
    point = operating_point_source_and_measurement(recording)[0]
    selection = select_terms(
        PlatformProblem(
            point, platform_candidates_and_untested_effects(point, RequestedEffects(("swing",), (), (kind,)))[0]
        )
    )
    (found,) = selection.findings
    effect = selection.fit.refined.point.effects[found.number]
    assert (
        effect.place == place
        and effect.size == pytest.approx(2e-4, rel=0.1)
        and effect.frequency == pytest.approx(0.047, rel=0.02)
    )
