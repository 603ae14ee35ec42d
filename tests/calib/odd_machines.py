"""Machines with one law that no catalogue has, of the independent truth: calibrated, commanded and driven."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calib.api.correct import CorrectionResult, CorrectOptions, correct
from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from rig.model.mechanisms import axis_place_texts
from rig.recording.recording_folder import Recording, load_recording, load_sensors
from rig.recording.wanted_poses_and_roll_pitch_yaw import load_wanted_poses
from tests.truth import Case, draw, drive_in_time, errors, oddities, record, rms, wanted, write_sensors, write_wanted
from tests.truth import case as cases
from tests.truth.laws import Law

NOISE = (2e-6, 2e-5)  # m, rad of the instrument
EVERY = 62.0  # s between wanted poses, about as in the recording


def odd_laws(case: Case, axes: np.ndarray) -> dict[str, Law]:
    """Laws by name, each some 10 to 100 um large (an arm's joints: 0.1 to 1 mrad), at axes (axes,)."""
    warm = case.day.axes_at(case.journey.looked)[:, int(axes.argmax())]
    middle, half, span = float(warm.mean()), float(np.ptp(warm)) / 2, float(case.journey.t[-1])
    um, cm = (1e-6, 0.01) if case.kind == "hexapod" else (6e-6, 0.3)
    return {
        "friction heat": oddities.FrictionHeat(axes, 200 * um, span / 15, 2 * cm, 50 * cm, 1.0),
        "friction heat that saturates": oddities.FrictionHeat(axes, 200 * um, span / 6, 100 * cm, 40 * cm, 0.7),
        "gap that widens along the screw": oddities.SlopingGap(axes, 20 * um, 200 * um),
        "one-sided loop, short": oddities.OneSidedLoop(axes, 60 * um, cm, 0.4),
        "one-sided loop, long": oddities.OneSidedLoop(axes, 60 * um, 3 * cm, 1.0),
        "heat with a knee": oddities.HeatCurve(axes, 80 * um, middle, half, "knee"),
        "heat that turns": oddities.HeatCurve(axes, 80 * um, middle, half, "turn"),
        "heat that snaps": oddities.HeatCurve(axes, 50 * um, middle, half, "snap"),
        "dent in the screw": oddities.Dent(axes, 80 * um, 0.05, 0.1),
        "bent frame": oddities.Bent(axes, 80 * um, 3 * cm),
        "swing after switching on": oddities.Course(axes, 100 * um, span, "swing"),
        "soak after switching on": oddities.Course(axes, 100 * um, span, "root"),
    }


@dataclass(frozen=True)
class OddMachine:
    """A case with one odd law, recorded in a folder."""

    case: Case
    folder: Path
    recording: Recording

    @staticmethod
    def of(law: str, seed: int, folder: Path, count: int = 120, kind: str = "hexapod") -> "OddMachine":
        """The machine of a seed with a law at one axis, which the seed chooses; its thermometers are logged."""
        case = draw(seed, "thermal_expansion", "strong", "shuffled", kind, count=count)
        axes = np.eye(case.owner.width)[seed % case.owner.width]
        case = replace(case, laws=(odd_laws(case, axes)[law],), sigma=NOISE)
        case = replace(case, seen=cases._seen(case, np.random.default_rng(seed)))
        return OddMachine(case, folder, load_recording(record(case, folder / "recording")))

    @property
    def place(self) -> str:
        """Where the law is."""
        return axis_place_texts(self.recording.design.mechanism)[int(self.case.laws[0].axes.argmax())]

    def driven(self, calibration: Calibration) -> tuple[float, CorrectionResult]:
        """(RMS position error in m at fresh poses, the correction) where the machine goes by a calibration's commands,
        on a day like that of the recording."""
        count = int(self.case.journey.t[-1] / EVERY) - 2
        poses, t = wanted(self.case, count), 1 + EVERY * np.arange(1, count + 1)
        write_sensors(self.case, self.folder / "sensors.csv", t[-1] + 100)
        write_wanted(poses, self.folder / "wanted.csv", t)
        wanted_poses = load_wanted_poses(self.folder / "wanted.csv")
        log = load_sensors(self.folder / "sensors.csv", wanted_poses.origin)
        found = correct(calibration, wanted_poses, CorrectOptions(log, skip_unreachable=True))
        found.write(self.folder / "commands.csv")
        rows = np.genfromtxt(self.folder / "commands.csv", delimiter=",", skip_header=1)
        held = rows[np.isfinite(rows[:, 0]), 0].astype(int)
        stood = drive_in_time(self.case, rows[:, 1], rows[:, 2:], t[held])
        return rms(errors(stood, poses[held]))[0], found


def without_remainder(calibration: Calibration) -> Calibration:
    """A calibration by its geometry alone."""
    correction = calibration.correction
    return replace(calibration, correction=replace(correction, remainder=tuple(None for _ in correction.remainder)))
