"""A hexapod on an axis that tilts by 90 degrees, its struts springs: corrected as well as where the base stands still.

The statics, the tilt and the kinematics are those of a second writer: see tests.truth.loads.
"""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import calib
import rig
from calib.api.calibrate import CalibrateOptions
from calib.api.correct import CorrectOptions
from calib.api.corrected_command_lookup_table_over_sensor_channels import corrected_command_lookup_table
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics
from calib.files.calibration_file import save
from rig.cli.command_line import main
from rig.errors import RigError
from rig.model.base_and_link_tilt_sensors import GRAVITY, BaseTilt
from rig.recording.recording_folder import Sensors, sensors_with_gravity
from rig.recording.wanted_poses_and_roll_pitch_yaw import load_wanted_poses
from tests.truth import draw, record, rms, wanted
from tests.truth.camera_sets import Camera, Sight
from tests.truth.case import Case
from tests.truth.journey import journey
from tests.truth.laws import stood
from tests.truth.loads import Springs
from tests.truth.motion import Motion
from tests.truth.rigid import displaced, errors, rows_of
from tests.truth.written import table, write_wanted

AXIS = np.array([0.0, 1.0, 0.0])
TILT = """
[[environment.tilt]]
channel = "elevation_deg"
axis = [0.0, 2.0, 0.0]

"""


@dataclass(frozen=True)
class TiltedSprings(Springs):
    """Springs on a base that is tilted by (start, end) degrees over span s, up and down in cosines."""

    sweep: tuple[float, float, float]

    def elevation(self, t: np.ndarray) -> np.ndarray:
        """(n,) degrees."""
        start, end, span = self.sweep
        return start + (end - start) * (1 - np.cos(2 * np.pi * 3 * t / span)) / 2

    def forces(self, motion: Motion, poses: np.ndarray) -> np.ndarray:
        tilted = Rotation.from_rotvec(np.radians(self.elevation(motion.looked))[:, None] * AXIS).as_matrix()
        down = np.einsum("nji,j->ni", tilted, [0.0, 0.0, -9.80665])
        moment = np.cross(poses[:, :3, :3] @ self.centre, self.mass * down)
        wrench = np.concatenate([self.mass * down, moment], axis=1)
        return np.linalg.solve(np.swapaxes(motion.machine.rates(poses), 1, 2), -wrench[..., None])[..., 0]


def tilting(seed: int, end: float, count: int = 60) -> Case:
    """A case whose struts give by some 100 um under the platform's weight, tilted from 0 to end degrees."""
    case = draw(seed, "none", count=count)
    stiffness = case.mass * 9.81 / 6 / 1e-4
    law = TiltedSprings(
        np.ones(6), case.mass, case.centre, case.payload, stiffness, np.inf, (0.0, end, float(case.journey.t[-1]))
    )
    noise = np.random.default_rng([seed, 5]).normal(size=(len(case.journey.looked), 6)) * np.repeat(case.sigma, 3)
    case = replace(case, laws=(law,))
    return replace(case, seen=rows_of(displaced(stood(case.machine, case.journey, case.day, case.laws), noise)))


def recorded(case: Case, folder: Path, stated: bool = True) -> rig.Recording:
    """The case's recording; stated : whether rig.toml and sensors.csv say that the base tilts."""
    record(case, folder)
    if stated:
        text = (folder / "rig.toml").read_text()
        (folder / "rig.toml").write_text(text.replace("[actuator]", TILT + "[actuator]", 1))
        t = np.linspace(0.0, float(case.journey.t[-1]), 2000)
        table(folder / "sensors.csv", ("t", "elevation_deg"), np.column_stack([t, case.laws[0].elevation(t)]))
    return rig.load(folder)


def error_when_driven(
    case: Case, recording: rig.Recording, folder: Path, elevations: np.ndarray
) -> tuple[float, float]:
    """(m, rad), RMS error of fresh poses at logged elevations (k,) degrees, by a calibration of a diagnosis."""
    folder.mkdir()
    calib.diagnose(recording).write(folder)
    calibration = calib.calibrate(recording, CalibrateOptions(diagnosis=folder, quick=True)).calibration
    goals, out = np.split(wanted(case, 10 * len(elevations)), len(elevations)), []
    for elevation, goal in zip(elevations.tolist(), goals):
        log = Sensors(np.zeros(1), {"elevation_deg": np.array([elevation])}) if recording.design.tilts else None
        commands = calib.correct(calibration, RigidTransform.from_matrix(goal), CorrectOptions(sensors=log)).values
        path = journey(commands, case.owner.ranges.mean(axis=1), case.speeds, case.dwell)
        law = replace(case.laws[0], sweep=(elevation, elevation, 1.0))
        out.append(errors(stood(case.machine, path, case.day, (law,)), goal))
    return rms(np.concatenate(out))


@pytest.mark.slow
def test_struts_that_give_are_corrected_at_every_elevation(tmp_path):
    turning, still = tilting(3, 90.0), tilting(3, 0.0)
    elevations = np.linspace(5.0, 85.0, 6)
    found, _ = error_when_driven(turning, recorded(turning, tmp_path / "a"), tmp_path / "da", elevations)
    rest, _ = error_when_driven(still, recorded(still, tmp_path / "b", False), tmp_path / "db", np.zeros(6))
    unstated, _ = error_when_driven(turning, recorded(turning, tmp_path / "c", False), tmp_path / "dc", elevations)
    print(f"error {found * 1e6:.2f} um, at rest {rest * 1e6:.2f} um, tilt not stated {unstated * 1e6:.2f} um")
    assert found < 1.5 * rest and unstated > 5 * found


def exported(folder: Path, channel: str) -> int:
    """Exit status of the export of a calibration in a folder as a table over a channel, lut.csv."""
    run = ["export", str(folder / "calibration.json"), "--format", "lut", "--poses", str(folder / "wanted.csv")]
    return main([*run, "--over", f"{channel}=0:90:7.5", "--out", str(folder / "lut.csv")])


def errors_between_rows_of_a_table(case: Case, calibration: Calibration, folder: Path):
    """(m (12,), errors of position at 48.75 degrees by a table's rows of 45 and 52.5, m (12,) that it states at 45)."""
    save(folder / "calibration.json", calibration)
    goal = wanted(case, 12)
    write_wanted(goal, folder / "wanted.csv")
    assert exported(folder, "elevation_deg") == 0
    rows = np.genfromtxt(folder / "lut.csv", delimiter=",", names=True)
    commands = np.stack([rows[name] for name in case.owner.names], axis=1).reshape(13, 12, 6)
    sigma = np.sqrt(sum(rows[f"c{k}{k}"] for k in range(3))).reshape(13, 12)
    law = replace(case.laws[0], sweep=(48.75, 48.75, 1.0))
    path = journey((commands[6] + commands[7]) / 2, case.owner.ranges.mean(axis=1), case.speeds, case.dwell)
    off = np.linalg.norm(errors(stood(case.machine, path, case.day, (law,)), goal)[:, :3], axis=1)
    return off, sigma[6]


@pytest.mark.slow
def test_a_lookup_table_holds_between_its_rows_to_what_it_states(tmp_path, capsys):
    case = tilting(4, 90.0)
    recording = recorded(case, tmp_path / "a")
    (tmp_path / "d").mkdir()
    calib.diagnose(recording).write(tmp_path / "d")
    calibration = calib.calibrate(recording, CalibrateOptions(diagnosis=tmp_path / "d", quick=True)).calibration
    off, sigma = errors_between_rows_of_a_table(case, calibration, tmp_path)
    assert "156 rows (13 of elevation_deg)" in capsys.readouterr().out
    assert (off < 3 * sigma).mean() > 0.9 and off.mean() < 2 * sigma.mean()
    assert exported(tmp_path, "elevation") == 1
    assert "not learnt with a channel 'elevation'; it has elevation_deg" in capsys.readouterr().err


@pytest.mark.slow
def test_poses_that_a_lookup_table_asks_for_give_its_uncertainty(tmp_path):
    case, channels = tilting(4, 90.0), {"elevation_deg": [0.0, 45.0, 90.0]}
    write_wanted(wanted(case, 12), tmp_path / "wanted.csv")
    goals, tables = load_wanted_poses(tmp_path / "wanted.csv"), []
    for count in (60, 180):
        folder = tmp_path / f"d{count}"
        folder.mkdir()
        recording = recorded(tilting(4, 90.0, count), tmp_path / f"r{count}")
        calib.diagnose(recording).write(folder)
        calibration = calib.calibrate(recording, CalibrateOptions(diagnosis=folder, quick=True)).calibration
        tables.append(corrected_command_lookup_table(calibration, goals, channels))
    first, more = tables
    for k, kind in enumerate(("position", "rotation")):
        text = first.poses_for(kind, more.uncertainty[k])
        print(f"{first.uncertainty[k] * 1e6:.3f} from 60, {more.uncertainty[k] * 1e6:.3f} from 180: {text}")
        least, most = re.search(r"takes (?:at least )?(\d+)(?: to (\d+))? poses", text).groups()
        assert 180 / 2 < int(least) < 2 * 180 and (most is None or int(most) > 180)  # few poses overstate scatter


@dataclass(frozen=True)
class Sagging(Sight):
    """One camera's mount bends by the weight of what it carries: it turns about its own axes and moves with it."""

    camera: int
    law: TiltedSprings

    def standing(self, camera: Camera, number: int, t: np.ndarray) -> np.ndarray:
        if number != self.camera:
            return np.zeros((len(t), 6))
        tilted = Rotation.from_rotvec(np.radians(self.law.elevation(t))[:, None] * AXIS).as_matrix()
        across = np.einsum("nji,j->ni", tilted, [0.0, 0.0, -1.0]) @ camera.place[:3, :3]
        bent = 4e-4 * np.cross([0.0, 0.0, 1.0], across)  # rad, about what lies across the optical axis
        return np.concatenate([0.1 * across * 4e-4, bent], axis=1)


def seen_by_cameras(seed: int, end: float, stiffness: float | None = None) -> Case:
    """A case seen by cameras, tilted from 0 to end degrees under one of them that sags; struts of a stiffness N/m, by
    default as in `tilting`.
    """
    case = draw(seed, "none", count=30, seen=True)
    stiffness = case.mass * 9.81 / 6 / 1e-4 if stiffness is None else stiffness
    law = TiltedSprings(
        np.ones(6), case.mass, case.centre, case.payload, stiffness, np.inf, (0.0, end, float(case.journey.t[-1]))
    )
    camera_set = replace(case.camera_set, fault=Sagging(1, law))
    poses = stood(case.machine, case.journey, case.day, (law,))
    seen = camera_set.corners(case.journey.looked, lambda late: poses, case.day, np.random.default_rng(6))
    return replace(case, laws=(law,), camera_set=camera_set, seen=seen)


@pytest.mark.slow
def test_a_camera_that_sags_is_named(tmp_path):
    case = seen_by_cameras(5, 90.0, np.inf)
    report = calib.diagnose(recorded(case, tmp_path / "a")).report
    assert [(one.effect, one.place) for one in report.findings] == [
        ("camera_sag", f"camera {case.camera_set.stated[1].name}")
    ]


@pytest.mark.slow
def test_springs_under_a_camera_that_sags_are_corrected_at_every_elevation(tmp_path):
    turning, still = seen_by_cameras(5, 90.0), seen_by_cameras(5, 0.0)
    recording, elevations = recorded(turning, tmp_path / "a"), np.linspace(5.0, 85.0, 6)
    found = error_when_driven(turning, recording, tmp_path / "da", elevations)
    rest = error_when_driven(still, recorded(still, tmp_path / "b", False), tmp_path / "db", np.zeros(6))
    names = [one["effect"] for one in json.loads((tmp_path / "da" / "diagnosis.json").read_text())["findings"]]
    print(f"error {found[0] * 1e6:.2f} um and {found[1] * 1e6:.1f} urad, at rest {rest[0] * 1e6:.2f} um and ", end="")
    print(f"{rest[1] * 1e6:.1f} urad")
    assert sorted(names) == ["camera_sag", "compliance"]
    assert found[0] < 1.5 * rest[0] and found[1] < 1.5 * rest[1]
    calibration = calib.calibrate(recording, CalibrateOptions(diagnosis=tmp_path / "da", quick=True)).calibration
    off, sigma = errors_between_rows_of_a_table(turning, calibration, tmp_path)
    assert (off < 3 * sigma).mean() > 0.9 and off.mean() < 2 * sigma.mean()


def test_a_tilt_that_was_not_logged_is_refused(tmp_path):
    recorded(tilting(3, 90.0), tmp_path / "a")
    (tmp_path / "a" / "sensors.csv").write_text("t,ambient_temperature_C\n0,20\n1e4,20\n")
    with pytest.raises(RigError, match="the base tilts by elevation_deg"):
        rig.load(tmp_path / "a")


def test_gravity_keeps_its_length_between_rows_far_apart():
    tilts = (BaseTilt("elevation_deg", AXIS), BaseTilt("rotator_deg", np.array([0.0, 0.0, 1.0])))
    log = Sensors(
        np.array([0.0, 100.0]), {"elevation_deg": np.array([0.0, 90.0]), "rotator_deg": np.array([0.0, 40.0])}
    )
    turned = sensors_with_gravity(np.array([0.0, 0.0, -9.80665]), tilts, log)
    at = np.array([turned.at([12.3, 50.0], name) for name in GRAVITY])
    np.testing.assert_allclose(np.linalg.norm(at, axis=0), 9.80665, rtol=1e-4)
    with pytest.raises(RigError, match="gravity in part"):
        sensors_with_gravity(np.zeros(3), tilts, Sensors(np.zeros(1), {GRAVITY[0]: np.ones(1)}))


def test_a_tilt_counts_where_another_was_not_logged():
    tilts = (BaseTilt("elevation_deg", AXIS), BaseTilt("rotator_deg", np.array([0.0, 0.0, 1.0])))
    known = {"elevation_deg": (30.0, 20.0), "rotator_deg": (10.0, 5.0), **dict.fromkeys(GRAVITY, (1.0, 1.0))}
    physics = Physics(
        (), np.zeros((0, 0)), np.zeros((0, 0)), np.array([0, 0, -9.80665]), None, None, known, tilts=tilts
    )
    high, missing = physics.sensed(Sensors(np.zeros(1), {"elevation_deg": np.array([80.0])}), np.zeros(1))
    low, _ = physics.sensed(Sensors(np.zeros(1), {"elevation_deg": np.array([0.0])}), np.zeros(1))
    assert missing == ("rotator_deg",)
    assert high.channels[GRAVITY[2]][0] == pytest.approx(-9.80665 * np.cos(np.radians(80)))
    assert low.channels[GRAVITY[2]][0] == pytest.approx(-9.80665)
    moved = physics.displaced(high, "rotator_deg")
    assert abs(moved.channels[GRAVITY[1]][0] - high.channels[GRAVITY[1]][0]) > 0.1
