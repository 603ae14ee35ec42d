"""Blind cases: what is blinded is what is scored, the truth stays closed to the diagnosis, and a campaign goes on where
it stopped.
"""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from rig.cli import command_line
from rig.cli import simulate_blind as command
from rig.cli.shared import blind_case_process
from rig.effects.catalogue.effect_list import ALL, BY_NAME
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import FileError
from rig.model import arm_hands_effect_places_and_tolerances
from rig.model import machine_motion_simulation as motion_simulation
from rig.planning import recording_plan as plan
from rig.recording import recording_folder
from synthetic import (
    blind_diagnosis_score,
    random_blind_platform_cases_with_truth,
    random_true_machine_and_truth_file,
    recording_simulation,
    unlisted_effects_and_corner_noise,
)


def test_a_schedule_deals_every_kind_and_every_effect_alike():
    dealt = [
        random_blind_platform_cases_with_truth.random_case_kind_and_effect_numbers(3, i)[:2] for i in range(1, 24 * 23)
    ]
    kinds = [kind for kind, _ in dealt]
    assert {
        kind: round(kinds.count(kind) / len(kinds) * 23) for kind in random_blind_platform_cases_with_truth.KINDS
    } == random_blind_platform_cases_with_truth.TIMES
    assert {
        kind: {len(numbers) for k, numbers in dealt if k == kind}
        for kind in random_blind_platform_cases_with_truth.KINDS
    } == {"nothing": {0}, "one": {1}, "two": {2}, "foreign": {0}, "noise": {0}}
    count = np.bincount([n for _, numbers in dealt for n in numbers], minlength=len(ALL))
    assert np.ptp(count) <= 2  # the deck is cut at both ends
    assert (
        random_blind_platform_cases_with_truth.random_case_kind_and_effect_numbers(3, 7)[:2] == dealt[6]
        and random_blind_platform_cases_with_truth.random_case_kind_and_effect_numbers(4, 7)[2].random()
        != random_blind_platform_cases_with_truth.random_case_kind_and_effect_numbers(3, 7)[2].random()
    )


@pytest.mark.parametrize("kind", [kind for kind in ALL if not kind.of_links], ids=lambda kind: kind.name)
def test_every_effect_is_drawn_within_its_bounds(kind, design):
    rng = np.random.default_rng(1)
    route = plan.build_plan(design, "sobol:4", 1)
    for _ in range(6):
        effect = effect_with_valid_place_and_parameters(
            random_blind_platform_cases_with_truth._effect(kind, design, route, rng)
        )
        assert effect.name == kind.name and any(np.any(v) for v in effect.values().values())
    if kind.name == "lens_distortion":
        assert (
            0.02
            < np.std(
                np.subtract(
                    *[
                        random_blind_platform_cases_with_truth.lens.project(
                            np.array([[0.3, 0.2, 1.0]]), c.matrix, c.distortion
                        )
                        for c in (effect.camera(design.cameras[0]), design.cameras[0])
                    ]
                )
            )
            < 40
            or effect.warp
        )


@pytest.mark.parametrize("kind", unlisted_effects_and_corner_noise.OUT_OF_CATALOGUE, ids=lambda kind: kind.name)
def test_every_effect_out_of_the_catalogue_changes_what_is_seen_and_is_in_no_catalogue(kind, design, monkeypatch):
    monkeypatch.setattr(unlisted_effects_and_corner_noise, "OUT_OF_CATALOGUE", (kind,))
    rng = np.random.default_rng(2)
    route = plan.build_plan(design, "moving:8,sobol:8", 1)
    foreign = unlisted_effects_and_corner_noise.random_unlisted_effect(design, route.t[-1], rng)
    assert foreign.name == kind.name and kind.name not in BY_NAME
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, (foreign,))
    bent = recording_simulation.simulate_world(secret, route, np.random.default_rng(5))
    plain = recording_simulation.simulate_world(replace(secret, effects=()), route, np.random.default_rng(5))
    found, uv = recording_simulation.visible_marker_sightings_and_corners(bent)
    moved = uv - recording_simulation.predict_sightings(
        found,
        recording_simulation.State(secret.true.cameras, plain.run.T_base_platform, {}),
        recording_simulation.marker_map(design),
    )
    assert 1e-4 < np.sqrt(np.mean(moved**2)) < 20


@pytest.mark.parametrize(
    "disturb", unlisted_effects_and_corner_noise.DISTURBANCES, ids=lambda disturb: disturb.__name__
)
def test_every_disturbance_adds_noise_and_no_shift(disturb, design):
    rng = np.random.default_rng(3)
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng), plan.build_plan(design, "sobol:30"), rng
    )
    clean = recording_simulation.noisy_corners(done, 0.0, rng)
    off = disturb(clean, design, 0.05, rng).uv - clean.uv
    assert 0.02 < np.sqrt(np.mean(off**2)) < 3 and np.abs(np.median(off, axis=0)).max() < 0.02


@pytest.mark.parametrize(
    "withheld, gone",
    [("temperature", "strut1_temperature_C"), ("payload", None), ("reversals", None), ("motion", None)],
)
def test_what_is_withheld_is_away(withheld, gone):
    for index in (1, 2):
        case = random_blind_platform_cases_with_truth.draw_case(6, index, 60, (withheld,), ("nothing",))
        assert gone not in case.simulation.log.channels and "payload_mass_kg" in case.simulation.log.channels
        assert (withheld not in ("payload",)) or not case.simulation.log.channels["payload_mass_kg"].any()
        if withheld in ("motion", "reversals"):
            assert "moving" not in case.plan
        if withheld == "reversals":
            path = motion_simulation.motion_of_commands(
                case.simulation.world.stated, case.simulation.plan.commands, case.simulation.plan.t
            ).path
            step = np.diff(path.lengths, axis=0)
            for at in path.at:
                last = [step[:at][step[:at, i] != 0, i][-1] for i in range(6)]
                assert (np.array(last) > 0).all()


def test_the_truth_is_closed_to_a_diagnosis(tmp_path):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "0001.json").write_text("secret")
    (tmp_path / "link").symlink_to(tmp_path / "truth")
    for path in ("truth/0001.json", "link/0001.json", "truth"):
        look = (
            f"import os, pathlib; p = pathlib.Path({str(tmp_path / path)!r}); print(os.listdir(p) if p.is_dir() "
            "else p.read_text())"
        )
        code = (
            "from rig.cli.shared.blind_case_process import forbid_this_process_to_read_folder as forbid; "
            f"forbid({str(tmp_path / 'truth')!r}); {look}"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert "is withheld" in done.stderr and "secret" not in done.stdout and "0001" not in done.stdout


def perfect(out, index):
    """A diagnosis that has looked: every effect hidden, with an interval about each number."""
    tree = json.loads((command.Path(out) / "truth" / f"{index:04d}.json").read_text())
    findings = []
    for e in tree["effects"]:
        known = e["effect"] in BY_NAME
        parameters = {
            n: {"value": v, "unit": "", "ci95": [(np.array(v) - 1).tolist(), (np.array(v) + 1).tolist()]}
            for n, v in e["parameters"].items()
        }
        findings.append(
            {
                "effect": e["effect"] if known else "unknown",
                "place": e["place"],
                "parameters": parameters if known else {},
                "cannot_be_told_from": [],
            }
        )
    folder = command.Path(out) / "diagnoses" / f"{index:04d}"
    folder.mkdir(exist_ok=True)
    (folder / "diagnosis.json").write_text(
        json.dumps({"findings": findings, "unexplained": None, "fit": {"heldout_after": 1.0, "noise_floor": 1.0}})
    )
    folder.with_suffix(".json").write_text(json.dumps({"seconds": 1.0, "failed": None}))
    return index, 1.0, None


@pytest.mark.slow
def test_a_campaign_is_blinded_scored_and_goes_on(tmp_path, monkeypatch, capfd):
    seen = []
    monkeypatch.setattr(command, "_diagnosed", lambda out, index: seen.append(index) or perfect(out, index))
    call = [
        "blind",
        "--season",
        "4",
        "--frames",
        "40",
        "--seed",
        "11",
        "--hide",
        "one,nothing",
        "--out",
        str(tmp_path / "s"),
        "--jobs",
        "1",
    ]
    assert command_line.main([*call, "--cases", "1-2"]) == 0 and seen == [1, 2]
    monkeypatch.setattr(command, "_drawn", blind_case_process.draw_blind_case)  # a process has been seen to do it
    blinded = (tmp_path / "s" / "hashes" / "0001.sha256").read_text()
    assert command_line.main([*call, "--cases", "1,3"]) == 0 and seen == [1, 2, 3]
    assert (tmp_path / "s" / "hashes" / "0001.sha256").read_text() == blinded
    assert (
        subprocess.run(
            ["sha256sum", "-c", "0001.sha256"], cwd=tmp_path / "s" / "hashes", capture_output=True
        ).returncode
        == 0
    )
    tree = json.loads((tmp_path / "s" / "score.json").read_text())
    assert [t["case"] for t in tree["cases"]] == [1, 2, 3]
    assert all(h["outcome"] == "named and placed" for t in tree["cases"] for h in t["hidden"])
    assert recording_folder.load_recording(tmp_path / "s" / "recordings" / "0003").corners is not None
    capfd.readouterr()
    (tmp_path / "s" / "hashes" / "0001.sha256").write_text("")
    (tmp_path / "s" / "diagnoses" / "0002.json").write_text('{"seconds": 1')
    assert command_line.main([*call, "--cases", "1-3"]) == 0 and seen == [
        1,
        2,
        3,
        1,
        2,
    ]  # a disk that was full, a cut power line
    error_text = capfd.readouterr().err
    assert (
        "case 1" in error_text
        and "is regenerated" in error_text
        and "case 2" in error_text
        and "is diagnosed anew" in error_text
    )
    assert (tmp_path / "s" / "hashes" / "0001.sha256").read_text() == blinded
    page = (tmp_path / "s" / "score.html").read_text()
    assert "://" not in page and "Confusion matrix" in page and 'content="rig blind"' in page
    capfd.readouterr()
    assert (
        command_line.main([*call[:6], "12", *call[7:]]) == 1
        and "contains another campaign, with seed 11 (not 12)" in capfd.readouterr().err
    )
    truth = tmp_path / "s" / "truth" / "0002.json"
    truth.write_text(truth.read_text().replace('"effects"', '"effects "', 1))
    assert command_line.main([*call, "--cases", "2"]) == 1 and "differs from that hashed" in capfd.readouterr().err


@pytest.mark.parametrize(
    "more, message",
    [
        (["--hide", "nothign"], "there is no 'nothign'"),
        (["--cases", "9"], "the campaign has cases 1 to 2"),
        (["--cases", "a"], "not 'a'"),
        (["--frames", "3"], "at least 40"),
        (["--jobs", "0"], "1 to 1024"),
        (["--effects", "play"], "there is no 'play'"),
        (["--withhold", "eyes"], "there is no 'eyes'"),
    ],
)
def test_a_wrong_campaign_is_refused_before_anything_is_written(more, message, tmp_path, capfd):
    assert command_line.main(["blind", "--season", "2", "--out", str(tmp_path / "s"), *more]) == 1
    assert message in capfd.readouterr().err and not (tmp_path / "s").exists()


def case(hidden=(), found=(), kind="one", unexplained=False):
    h = [blind_diagnosis_score.Hidden(name, place, {}, 30.0) for name, place in hidden]
    f = [blind_diagnosis_score.Found(name, place, {}, list(alternatives)) for name, place, *alternatives in found]
    return blind_diagnosis_score.Case(1, kind, None, h, f, unexplained, 1.0, 1.0)


def test_answers_are_judged():
    lag, clock = ("servo_lag", "rig"), ("time_offset", "clock")
    right = case([lag], [lag])
    allowed = case([lag], [(*clock, lag)])
    misplaced = case([("backlash", "strut 1")], [("backlash", "strut 2")])
    wrong = case([lag], [("creep", "rig")])
    missed = case([lag])
    f = {
        g.name: (g.hits, g.trials)
        for g in blind_diagnosis_score.campaign_rates_with_intervals(
            [
                right,
                allowed,
                misplaced,
                wrong,
                missed,
                case(kind="nothing"),
                case(kind="nothing", found=[("creep", "rig")]),
            ]
        )
    }
    assert (
        f["one effect: detected"] == (4, 5)
        and f["one effect: named first"] == (2, 5)
        and f["one effect: truth in the set"] == (3, 5)
    )
    assert (
        f["one effect: at its place"] == (1, 5)
        and f["nothing hidden: no finding"] == (1, 2)
        and f["no wrong name in any case"] == (5, 7)
    )
    assert blind_diagnosis_score.strong_effect_confusion_table([right, allowed, wrong, missed])["servo_lag"] == {
        "servo_lag": 1,
        "time_offset": 1,
        "creep": 1,
        "nothing": 1,
    }
    both = case([lag, ("backlash", "strut 1")], [("backlash", "strut 1"), lag], "two")
    half = case([lag, ("backlash", "strut 1")], [("backlash", "strut 1"), ("creep", "rig")], "two")
    f = {g.name: (g.hits, g.trials) for g in blind_diagnosis_score.campaign_rates_with_intervals([both, half])}
    assert f["two effects: both named"] == (1, 2) and f["two effects: no wrong name"] == (1, 2)
    assert half.seen_as(half.hidden[0]) == "creep"
    foreign = [
        case([("cable_pull", "rig")], found, "foreign", unexplained)
        for found, unexplained in (
            ([("unknown", "strut 1")], True),
            ([("warm_up", "rig"), ("unknown", "strut 1")], True),
            ([], False),
        )
    ]
    f = {g.name: (g.hits, g.trials) for g in blind_diagnosis_score.campaign_rates_with_intervals(foreign)}
    assert f["outside the catalogue: called unknown"] == (1, 3) and f["outside the catalogue: no name given"] == (2, 3)


def test_intervals_are_held_to_the_truth():
    hidden = blind_diagnosis_score.Hidden(
        "cyclic_error", "strut 1", {"amplitude": 1.0, "phase": 3.1, "order": 1.5}, 30.0
    )
    found = blind_diagnosis_score.Found(
        "cyclic_error",
        "strut 1",
        {"amplitude": (1.1, [0.9, 1.3]), "phase": (-3.1, [-3.3, -2.9]), "order": (1.4, [1.3, 1.45])},
        [],
    )
    assert blind_diagnosis_score.do_parameter_intervals_cover_truth(hidden, found) == [True, True, False]
    assert (
        blind_diagnosis_score.do_parameter_intervals_cover_truth(hidden, replace(found, place="strut 2")) == []
        and blind_diagnosis_score.do_parameter_intervals_cover_truth(hidden, None) == []
    )


def test_exact_intervals():
    low, high = blind_diagnosis_score.clopper_pearson_interval(2, 150)
    assert (low, high) == pytest.approx((0.001621, 0.047329), abs=2e-5)  # 2 of 150, from tables
    assert (
        blind_diagnosis_score.clopper_pearson_interval(0, 10) == (0.0, pytest.approx(1 - 0.025 ** (1 / 10)))
        and blind_diagnosis_score.clopper_pearson_interval(10, 10)[1] == 1.0
    )


def test_what_is_no_campaign_is_said(tmp_path):
    (tmp_path / "t.json").write_text('{"effects": [')
    with pytest.raises(FileError, match="cut off"):
        blind_diagnosis_score.score_case(1, tmp_path / "t.json", None)
    (tmp_path / "t.json").write_text('{"effects": []}')
    with pytest.raises(FileError, match="strengths is missing"):
        blind_diagnosis_score.score_case(1, tmp_path / "t.json", None)


def test_strength_is_the_signal_after_calibration_has_had_its_share(design, rig_text, tmp_path):
    from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import platform_effect_signal_to_noise

    effects = (parse_effect("backlash:strut2:gap=5e-5"), parse_effect("scale_error:strut3:scale=1e-12"))
    rng = np.random.default_rng(8)
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng, 1.0, effects),
        plan.build_plan(design, "sobol:30,ladder:1", 1),
        rng,
    )
    found = []
    for noise in (0.04, 0.08):
        recording_simulation.write_recording(done, tmp_path / "rec", rig_text, rng, noise)
        found.append(
            platform_effect_signal_to_noise(
                recording_folder.load_recording(tmp_path / "rec"), done.world.true, noise, effects, done.sensors
            )
        )
    assert (
        8 < found[0][0] < 60 and found[0][1] < 1e-3
    )  # 50 um over 8 um of noise in one strut of 54 frames, part of it swallowed
    assert found[1][0] == pytest.approx(found[0][0] / 2, rel=0.05)
    window, exchanged = parse_effect("refraction:cam1:thickness=0.01"), parse_effect("marker_swap:8:turn=1")
    alone, with_others = (
        platform_effect_signal_to_noise(
            recording_folder.load_recording(tmp_path / "rec"), done.world.true, 0.04, (window, *more), done.sensors
        )
        for more in ((), (exchanged,))
    )
    assert (
        with_others[0] == pytest.approx(alone[0]) and with_others[1] > 1e3
    )  # corners taken for others are put right first, and make no other effect stronger


@pytest.mark.slow
def test_a_campaign_end_to_end(tmp_path, capsys):
    assert (
        command_line.main(
            [
                "blind",
                "--season",
                "3",
                "--frames",
                "80",
                "--hide",
                "one",
                "--effects",
                "backlash,missed_steps",
                "--out",
                str(tmp_path / "s"),
                "--json",
            ]
        )
        == 0
    )
    output = json.loads(capsys.readouterr().out)
    assert output["schema"] == "campaign/1" and output["verdict"]["state"] == "check"
    tree = json.loads((tmp_path / "s" / "score.json").read_text())
    strong = [h["outcome"] for t in tree["cases"] for h in t["hidden"] if h["strength"] > 15]
    assert len(tree["cases"]) == 3 and all(outcome == "named and placed" for outcome in strong)


def test_a_case_in_images_draws_optics_and_prints_its_markers_within_tolerance():
    cases = [
        random_blind_platform_cases_with_truth.draw_case(8, index, 40, (), ("one",), (), True) for index in range(1, 7)
    ]
    assert {(t.image_settings.width, t.image_settings.height) for t in cases} == set(
        random_blind_platform_cases_with_truth.RESOLUTIONS
    )
    assert {t.image_settings.lens for t in cases} == set(random_blind_platform_cases_with_truth.LENSES) and all(
        t.image_settings.lens in t.text for t in cases
    )
    for t in cases:
        (hidden,), (*_, printed) = t.hidden, t.simulation.world.effects
        assert (
            random_blind_platform_cases_with_truth.is_renderable(type(hidden)) and hidden in t.simulation.world.effects
        )
        assert (
            printed.name == "printing"
            and np.std(printed.offsets) < arm_hands_effect_places_and_tolerances.PLACES.sigma * 1.3
            and np.any(printed.offsets)
        )
        assert np.abs(printed.scales).max() < 6 * arm_hands_effect_places_and_tolerances.SIDES.sigma
        assert 0.0005 < t.noise < 0.05 and len(random_blind_platform_cases_with_truth.simulated_corners(t).frame) > 40


def test_a_campaign_in_images_says_what_pictures_do_not_show(tmp_path, capsys):
    base = ["blind", "--season", "1", "--out", str(tmp_path / "s"), "--images"]
    assert (
        command_line.main([*base, "--effects", "edge_bias"]) != 0
        and "images do not show edge_bias" in capsys.readouterr().err
    )
    assert (
        command_line.main([*base, "--hide", "noise"]) != 0
        and "--hide takes some of nothing, one, two" in capsys.readouterr().err
    )


def test_an_effect_within_tolerances_is_rightly_a_remark():
    remark = blind_diagnosis_score.Found("print_scale", "markers", {"scale": (3e-4, [2e-4, 4e-4])}, [])
    hidden = blind_diagnosis_score.Hidden("print_scale", "markers", {"scale": 3e-4}, 20.0)
    case = blind_diagnosis_score.Case(1, "one", None, [hidden], [], False, 1.0, 1.0, remarks=(remark,))
    assert case.match(hidden) is remark and case.named_or_remarked == [remark] and not case.named and not case.wrong()
    elsewhere = blind_diagnosis_score.Hidden("backlash", "strut 1", {"gap": 3e-5}, 20.0)
    assert (
        blind_diagnosis_score.Case(1, "one", None, [elsewhere], [], False, 1.0, 1.0, remarks=(remark,)).match(elsewhere)
        is None
    )
    figures = {f.name: f.hits for f in blind_diagnosis_score.campaign_rates_with_intervals([case])}
    assert (
        figures["one effect: detected"]
        == figures["one effect: named first"]
        == figures["one effect: at its place"]
        == 1
    )
