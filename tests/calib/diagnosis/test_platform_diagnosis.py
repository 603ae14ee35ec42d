"""What physics was left out: hidden in simulated recordings, and found with its place and size; nothing where there is
nothing.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.platform_certification import certify_platform
from calib.diagnosis.engine.cross_validation_and_chance_probabilities import scan_p_value
from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.problems.platform import (
    joint_refinement_of_cameras_geometry_poses_and_effects,
    marker_swap_detection_and_effect_cross_validation,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    Sensitivities,
    effect_coordinates_and_directions,
    platform_candidates_and_untested_effects,
)
from calib.diagnosis.problems.platform.joint_refinement_of_cameras_geometry_poses_and_effects import (
    refine_operating_point,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, linearise
from calib.diagnosis.problems.platform.platform_lack_of_fit_excess_scatter_and_covariates import (
    find_lack_of_fit_by_place,
)
from calib.diagnosis.report.diagnosis_report_verdict_and_json_folder import diagnosis_report
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.effects.catalogue.effect_list import ALL
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.planning import recording_plan as plan
from rig.planning.layout.hexapod_layout_and_camera_placement import hexapod_layout_rig_toml
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation, unlisted_effects_and_corner_noise
from tests.calib.diagnose_recording import diagnosis_of, page_text
from tests.calib.recordings_with_effects import recorded
from tests.numerical_derivatives import jacobian
from tests.vision import tumbling_block
from vision.marker_corner_prediction import marker_map

LINEARISATIONS = 275  # of a whole diagnosis in which one effect is hidden, each a Jacobian of all corners


@pytest.fixture(scope="module")
def quiet(tmp_path_factory, design):
    rec = recorded(tmp_path_factory.mktemp("quiet"), design, ())
    return operating_point_source_and_measurement(rec)[0]


def test_without_anything_left_out_both_planes_hold_noise_alone(quiet):
    model = linearise(quiet)
    corners, closures = model.corner_residual, model.closure_residual
    degrees = len(corners) - 6 * model.frames
    assert (corners**2).sum() == pytest.approx(degrees, rel=0.03)
    assert (closures**2).sum() == pytest.approx(6 * model.frames - 42, rel=0.15)
    assert model.corners.sigma == pytest.approx(1, abs=0.03) and not model.closures.scatter.any()
    basis = model.linear.columns.parts
    assert np.abs(basis[1].T @ closures + basis[0].T @ corners).max() < 1e-6  # nuisances are taken out


def test_nothing_unknown_where_nothing_is(quiet):
    assert find_lack_of_fit_by_place(linearise(quiet)) == []


def test_sensitivities_are_what_effects_do(quiet):
    found, _ = platform_candidates_and_untested_effects(
        quiet, RequestedEffects(("compliance rig", "thermal_expansion rig", "creep strut 2", "time_offset"))
    )
    sensitivities, motion = Sensitivities(quiet), quiet.motion(())
    for candidate in found[:4]:
        node = candidate.grid[len(candidate.grid) // 2]
        column = sensitivities.deviation(candidate, node, motion)[..., 0]
        small = 1e-3 * candidate.spec.linear[0].step
        moved = quiet.effective((candidate.effect(node, [small]),)) - quiet.effective(())
        np.testing.assert_allclose(moved / small, column, rtol=1e-3, atol=1e-3 * np.abs(column).max())


def test_davies_bound_honours_the_search():
    rng = np.random.default_rng(0)
    t = np.linspace(0, 1, 200)
    shapes = np.stack([(t > m).astype(float) - (t > m).mean() for m in np.linspace(0.05, 0.95, 91)])
    shapes /= np.linalg.norm(shapes, axis=1, keepdims=True)
    p = np.array([scan_p_value((shapes @ rng.normal(size=200)) ** 2, 1, 5000) for _ in range(2000)])
    for level in (0.2, 0.05, 0.01):  # a bound: never too bold, and not idle either
        assert level / 6 < (p < level).mean() < level + 3 * np.sqrt(level / 2000)


@pytest.mark.parametrize(
    ("text", "name", "parameter", "value"),
    [
        ("backlash:strut5:gap=6e-5", "backlash strut 5", "gap", 6e-5),
        pytest.param(
            "missed_steps:strut2:jump=8e-5,time=300", "missed_steps strut 2", "jump", 8e-5, marks=pytest.mark.slow
        ),
        pytest.param("edge_bias:cameras:bias=0.2", "edge_bias cameras", "bias", 0.2, marks=pytest.mark.slow),
    ],
)
def test_what_is_hidden_is_found(tmp_path, design, text, name, parameter, value):
    rec = recorded(tmp_path, design, [text])
    kind, place = name.split(" ", 1)
    alike = {"backlash": ["hysteresis"], "missed_steps": ["warm_up"], "edge_bias": ["print_scale"]}[kind]
    found = diagnosis_of(rec, only=[kind, *alike])
    tree = json.loads(json.dumps(diagnosis_report(found).tree()))
    assert [(f["effect"], f["place"]) for f in tree["findings"]] == [(kind, place)]
    fitted = tree["findings"][0]["parameters"][parameter]
    sigma = (fitted["ci95"][1] - fitted["ci95"][0]) / 3.92
    assert abs(fitted["value"] - value) < 4 * sigma and sigma < 0.1 * value
    fit = tree["fit"]
    assert fit["heldout_after"] < 1.1 * fit["noise_floor"]
    assert {plane: f["unit"] for plane, f in tree["fits"].items()} == {
        "corners": "px",
        "closures": "m",
    } and fit in tree["fits"].values()
    if kind != "edge_bias":  # which the corner finder's own bias would take up, at a price that only the prior shows
        assert fit["heldout_before"] > 1.2 * fit["heldout_after"]


@pytest.mark.slow
def test_a_tilted_window_is_found_in_few_linearisations(tmp_path, design, monkeypatch):
    """It moves corners by hundreds of standard deviations, far from what is linear in its numbers, and every variant of
    a distorted lens takes up most of it."""
    normal, count = np.array([-0.66446, -0.24184, 0.70711]), []

    def counted(*args, **options):
        count.append(1)
        return linearise(*args, **options)

    monkeypatch.setattr(joint_refinement_of_cameras_geometry_poses_and_effects, "linearise", counted)
    text = f"refraction:cam1:thickness=0.025,normal={'/'.join(map(str, normal))}"
    found = diagnosis_of(recorded(tmp_path, design, [text]), only=["refraction", "lens_distortion", "camera_bump"])
    report = json.loads(json.dumps(diagnosis_report(found).tree()))
    assert [(f["effect"], f["place"]) for f in report["findings"]] == [("refraction", "camera cam1")]
    numbers = report["findings"][0]["parameters"]
    low, high = numbers["thickness"]["ci95"]
    assert abs(numbers["thickness"]["value"] - 0.025) < high - low < 0.01
    assert np.abs(numbers["normal"]["value"] - normal).max() < 0.05
    assert len(count) < LINEARISATIONS


@pytest.mark.slow
def test_faces_exchanged_are_named(tmp_path, design):
    rec = recorded(tmp_path, design, ["marker_swap:8:other=6,turn=1"])
    point, _, _ = operating_point_source_and_measurement(rec)
    found = marker_swap_detection_and_effect_cross_validation.find_marker_swaps(point, [k for k in ALL if k.discrete])
    assert len(found) == 1 and {found[0].place, f"marker {int(found[0].other)}"} == {"marker 8", "marker 6"}
    left = marker_swap_detection_and_effect_cross_validation.operating_point_with_marker_swaps_corrected(point, found)
    assert np.abs(left.seen.observations.uv - left.pixels()).max() < 3


def test_what_no_catalogue_lists_is_called_unknown(tmp_path, design):
    rec = recorded(tmp_path, design, [])
    point = operating_point_source_and_measurement(rec)[0]
    lengths = point.commands.values.copy()
    lengths[:, 3] -= 3e-5 * np.cos(
        8 * (lengths[:, 0] - lengths[:, 0].mean()) / np.ptp(lengths[:, 0])
    )  # one strut minds another's place
    odd = replace(point, commands=replace(point.commands, values=lengths))
    refined = refine_operating_point(odd, Sensitivities(odd))
    left = find_lack_of_fit_by_place(refined.model)
    assert left and left[0].place == Place("strut", "4") and left[0].depends_on == ("strut 1's position",)


@pytest.mark.parametrize(("marker", "off"), [(None, 0.0), (8, 0.15)])
def test_errors_of_a_corner_finder_that_recur_are_no_misplaced_marker(tmp_path, design, marker, off):
    """off : px, by which one marker's corners are drawn apart, besides what the finder does to each in each camera."""
    rec = recorded(tmp_path, design, [], route="sobol:80", noise=0.02)
    corners, rng = rec.corners, np.random.default_rng(3)
    seen = np.array(list(zip(map(ord, (c[-1] for c in corners.camera)), corners.marker, corners.corner)))
    _, which = np.unique(seen, axis=0, return_inverse=True)
    uv = corners.uv + 0.012 * rng.standard_normal((which.max() + 1, 2))[which]
    if marker is not None:
        own = corners.marker == marker
        uv[own] += off * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])[corners.corner[own]]
    point = operating_point_source_and_measurement(replace(rec, corners=replace(corners, uv=uv)))[0]
    left = find_lack_of_fit_by_place(refine_operating_point(point, Sensitivities(point)).model)
    markers = [str(u.place) for u in left if u.place.kind == "marker"]
    assert markers[:1] == ([] if marker is None else [f"marker {marker}"])


def test_tangents_of_what_is_seen_are_derivatives(quiet):
    effect = parse_effect("camera_drift:cam1:motion=1e-4/2e-4/0/0/1e-4/0,time_constant=500")
    point = quiet.with_effects((effect,))
    model = linearise(point)
    coordinates, column = effect_coordinates_and_directions(model, Sensitivities(point))
    at = [c.name for c in coordinates].index("time_constant")

    def whitened(x):
        moved = (coordinates[at].written(effect, x[0]),)
        return model.fold((point.pixels(moved) - point.pixels())[..., None]).parts[CORNERS][:, 0]

    expected = jacobian(whitened, np.array([coordinates[at].read(effect)]), 1e-4)[..., 0]
    np.testing.assert_allclose(column.parts[CORNERS][:, at], expected, atol=1e-4 * np.abs(expected).max())


def test_tangents_of_struts_are_derivatives_of_what_all_effects_do_together(quiet):
    """Each direction is computed by one effect alone; held against differences of all effects' commands."""
    effects = tuple(
        parse_effect(text)
        for text in (
            "transmission_error:strut2:profile=1e-5/-2e-5/3e-5/0/1e-5",
            "compliance:rig:stiffness=8e6",
            "backlash:strut3:gap=4e-5",
            "servo_lag:rig:time_constant=0.03",
            "scale_error:strut5:scale=1e-4,curvature=0.2",
        )
    )
    point = quiet.with_effects(effects)
    model = linearise(point)
    coordinates, column = effect_coordinates_and_directions(model, Sensitivities(point))
    assert [c.name for c in coordinates] == [
        *["profile"] * 5, "stiffness", "gap", "time_constant", "scale", "curvature",
    ]  # fmt: skip
    for at, c in enumerate(coordinates):

        def lengthened(x, c=c):
            moved = c.written(effects[c.effect], x[0])
            return point.effective((*effects[: c.effect], moved, *effects[c.effect + 1 :])).ravel()

        value = np.array([c.read(effects[c.effect])])
        expected = jacobian(lengthened, value, c.step).reshape(model.frames, -1, 1)
        np.testing.assert_allclose(
            column.parts[CLOSURES][:, at],
            model.lengthened(expected).parts[CLOSURES][:, 0],
            atol=1e-5 * np.abs(column.parts[CLOSURES][:, at]).max(),
        )


@pytest.mark.slow
def test_geometry_known_from_elsewhere_shows_what_would_hide_in_it(tmp_path, design):
    rng = np.random.default_rng(7)
    for name, load in (("before", ()), ("after", ("compliance:rig:stiffness=8e6",))):
        secret = random_true_machine_and_truth_file.random_true_machine(
            design, np.random.default_rng(7), 1.0, tuple(parse_effect(text) for text in load)
        )
        recording_simulation.write_recording(
            recording_simulation.simulate_world(secret, plan.build_plan(design, "sobol:90", len(load)), rng),
            tmp_path / name,
            hexapod_layout_rig_toml(0.3),
            rng,
            0.04,
        )
    before, after = (recording_folder.load_recording(tmp_path / name) for name in ("before", "after"))
    sampled = sample_recording(before)
    done = certify_platform(sampled.samples, before.design.mechanism, rng)
    known = Calibration(done.correction, done.found.covariance, done.found.scatter, (), (), done.held_out, {})
    assert not diagnosis_of(after, only=["compliance"]).selection.findings  # a constant load hides in the joints
    tree = diagnosis_report(diagnosis_of(after, only=["compliance"], calibration=known)).tree()
    assert [(f["effect"], f["place"]) for f in tree["findings"]] == [("compliance", "rig")]
    assert tree["findings"][0]["parameters"]["stiffness"]["value"] == pytest.approx(8e6, rel=0.2)


@pytest.mark.slow
def test_a_strong_profile_is_one_finding_however_fine(tmp_path, design):
    rec = recorded(tmp_path, design, ["transmission_error:strut1:profile=-1e-5/-4e-5/2e-5/6e-5/3e-5/-6e-5"])
    found = diagnosis_of(rec, only=["transmission_error", "cyclic_error", "scale_error"])
    assert [(e.name, e.place) for e in found.effects] == [("transmission_error", "strut 1")] and not found.left


@pytest.mark.slow
def test_a_marker_of_another_size_gets_no_name(tmp_path, design):
    rng = np.random.default_rng(4)
    scales = np.where(marker_map(design).id == 7, 4e-3, 0.0)
    secret = random_true_machine_and_truth_file.random_true_machine(
        design, rng, 1.0, (unlisted_effects_and_corner_noise.UnevenPrint("markers", tuple(scales)),)
    )
    recording_simulation.write_recording(
        recording_simulation.simulate_world(secret, plan.build_plan(design, "sobol:60", 3), rng),
        tmp_path,
        hexapod_layout_rig_toml(0.3),
        rng,
        0.04,
    )
    found = diagnosis_of(
        recording_folder.load_recording(tmp_path),
        only=["face_misplacement", "print_scale", "edge_bias", "cube_misplacement"],
    )
    assert not found.effects and found.left[0].place == Place("marker", "7")


@pytest.mark.slow
def test_a_body_moved_by_hand_says_which_faces_sit_elsewhere(tmp_path):
    observations, stated, true, t = tumbling_block.scene(1)
    o, names = observations, [camera.name for camera in stated.cameras]
    ids = marker_map(stated).id
    corners = recording_folder.Corners(
        o.frames[o.frame], [names[i] for i in o.camera], [int(ids[m]) for m in o.marker], o.corner, o.uv, None
    )
    exposures = recording_folder.Exposures(np.arange(len(t)), t, names * len(t), [""] * len(t))
    rec = recording_folder.Recording(tmp_path, stated, None, exposures, None, corners, None)
    found = diagnosis_of(rec)
    tree = json.loads(json.dumps(diagnosis_report(found).tree()))
    moved = [f for f in tree["findings"] if f["effect"] == "face_misplacement"]
    assert (
        len(moved) >= len(np.unique(o.marker)) - 1
        and len(tree["findings"]) == len(moved)
        and tree["unexplained"] is None
    )
    assert all(
        low < value < high
        for f in moved
        for p in f["parameters"].values()
        for value, low, high in zip(p["value"], *p["ci95"])
    )
    assert tree["fit"]["heldout_after"] < 1.1 * tree["fit"]["noise_floor"]
    page_text(tmp_path / "page.html", rec, found)
    assert (tmp_path / "page.html").read_text().count("face misplacement at marker") >= len(moved)
