"""Rigs and recordings that several tests use, and what is skipped where the system lacks something.

The packages are imported within the fixtures: where one cannot be imported, the tests that need it are skipped, and
no others.
"""

import gc
import os
from dataclasses import replace
from pathlib import Path

os.environ.setdefault(
    "OPENBLAS_NUM_THREADS", "1"
)  # as rig.cli.command_line.run_script has it; read when NumPy is loaded

if "PYTEST_XDIST_WORKER" in os.environ:  # processes of tests share the cores already; --workers still starts others
    os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pytest

from tests.missing_system_modules import missing_part

ROOT = Path(__file__).parents[1]
BENCH = ROOT / "tests" / "data" / "bench"
SHARED = ROOT.parent / "shared"
LONGEST = ("test_types_are_clean",)  # a process of tests begins with these, so that none is left over at the end

gc.disable()  # until all tests are collected: modules stay, and each search for garbage would walk through them all


def pytest_collection_modifyitems(items):
    """The longest tests come first; all others stay in their order."""
    items.sort(key=lambda item: item.name not in LONGEST)


def pytest_collection_finish():
    """Search for garbage from here on, though not among what importing the tests made, and more rarely."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    """A module of tests is skipped where importing it needs what the system lacks."""
    report = yield
    reason = missing_part(str(report.longrepr)) if report.failed else None
    if reason:
        report.outcome, report.longrepr = "skipped", (str(collector.path), 1, f"Skipped: {reason}")
    return report


def _skip_for_system(error):
    """Skip a test that ended with an error for what the system lacks; raise any other error again."""
    reason = missing_part(str(error))
    if reason:
        pytest.skip(reason)
    raise error


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    """A test is skipped where a fixture needs what the system lacks."""
    try:
        return (yield)
    except Exception as error:
        _skip_for_system(error)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """A test is skipped where it needs what the system lacks."""
    try:
        return (yield)
    except Exception as error:
        _skip_for_system(error)


@pytest.fixture
def shared():
    """The folder with the recordings that outside checks use; the test is skipped where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("needs the shared recordings beside the project")
    return SHARED


@pytest.fixture(scope="session")
def opengl():
    """Skips a test that draws pictures where there is no OpenGL; `rig simulate --images` says there what to install."""
    from rig.errors import MissingLibrary
    from synthetic import ideal_image_renderer

    try:
        ideal_image_renderer.import_pyrender_without_viewer()
    except MissingLibrary as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def rig_text():
    from rig.planning.layout import hexapod_layout_and_camera_placement

    return hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=3, width=1280, height=1024, cubes=4)


@pytest.fixture(scope="session")
def design(rig_text, tmp_path_factory):
    from rig.formats.rig_toml import design_from_rig_toml

    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(rig_text)
    return design_from_rig_toml.load_design(path)


@pytest.fixture(scope="session")
def driven_design(design):
    """A design with a controller that counts from home and can home; speeds such that a move of 2 mm takes a quarter of
    a second.
    """
    from rig.driving.emulators.emulator_opening_and_serving_over_terminal_or_tcp import home_lengths
    from rig.model.design import Controller

    controller = Controller(
        "grblhal",
        "none",
        115200,
        "",
        (),
        homing=True,
        zero=home_lengths(design.mechanism),
        home=home_lengths(design.mechanism),
        max_speed=np.full(6, 0.01),
        max_acceleration=np.full(6, 0.1),
        tolerance=1e-5,
        max_step=None,
        margin=0.1,
        timeout=2.0,
        home_timeout=120.0,
        watchdog=1.0,
        kinematics="joint",
        password="EMC",
        enable_password="EMCTOO",
    )
    return replace(design, controller=controller)


def make_recording(folder, design, rig_text, seed, count=24, noise=0.04, size=1.0, effects=()):
    """A simulated recording at corner level in a folder, its World and its true poses."""
    from rig.planning import configuration_generators
    from rig.planning import recording_plan as plan
    from synthetic import random_true_machine_and_truth_file, recording_simulation

    rng = np.random.default_rng(seed)
    secret = random_true_machine_and_truth_file.random_true_machine(design, rng, size, effects)
    strokes = design.mechanism.strut_range
    route = plan.plan_of_configurations(
        configuration_generators.sobol_configurations(strokes, count, seed=seed),
        strokes.mean(axis=1),
        plan.planned_axis_speeds(design),
    )
    done = recording_simulation.simulate_world(secret, route, rng)
    recording_simulation.write_recording(done, folder, rig_text, rng, noise)
    return secret, done.run.T_base_platform


@pytest.fixture
def recording_folder(tmp_path, design, rig_text):
    """A sound recording of six frames that a test may spoil."""
    folder = tmp_path / "rec"
    make_recording(folder, design, rig_text, 3, count=6)
    return folder


@pytest.fixture(scope="session")
def limbed(tmp_path_factory):
    """(Design, Recording, its Simulation) of a rig with measuring limbs that went along and about every axis; the
    folder holds a second recording of the same machine, "again", another day."""
    from rig.formats.rig_toml import design_from_rig_toml
    from rig.planning import recording_plan as plan
    from rig.planning.layout import hexapod_layout_and_camera_placement
    from rig.recording import recording_folder
    from synthetic import random_true_machine_and_truth_file, recording_simulation

    folder = tmp_path_factory.mktemp("limbs")
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, legs=(6, 6))
    (folder / "rig.toml").write_text(text)
    design = design_from_rig_toml.load_design(folder / "rig.toml")
    rng = np.random.default_rng(2)
    machine = random_true_machine_and_truth_file.random_true_machine(design, rng)
    done = recording_simulation.simulate_world(machine, plan.build_plan(design, "axes:5,sobol:50"), rng)
    recording_simulation.write_recording(done, folder / "rec", text, rng, noise=0.04)
    recording_simulation.write_recording(
        recording_simulation.simulate_world(machine, plan.build_plan(design, "sobol:40", seed=1), rng),
        folder / "again",
        text,
        rng,
        noise=0.04,
    )
    return design, recording_folder.load_recording(folder / "rec"), done


@pytest.fixture(scope="module")
def browser():
    """Headless Chromium of playwright; skips where either is missing."""
    from docs.make import pictures

    pytest.importorskip("playwright.sync_api", reason="needs the extra `browser`")
    if pictures.chromium() is None:
        pytest.skip("needs Chromium: apt-get install chromium")
    with pictures.browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def axe():
    """The code of axe-core; skips where it is missing."""
    from importlib import resources

    pytest.importorskip("axe_core_python", reason="needs the extra `browser`")
    return resources.files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
