"""Contents of a certificate as dataclasses.

Figures, with the conditions and the volume in which its poses were measured.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.certification.calibration_evidence_verdict_and_claim_check import AgainstClaim
from calib.certification.held_out_pose_error_statistics import Figures
from calib.certification.held_out_pose_errors_and_distinct_configurations import REST, HeldPoses, Repeatability
from calib.certification.iso230_and_iso9283_tests import AxisTest, Iso9283
from calib.certification.pose_error_promise_and_conformity import Cell, Conformity, Promise
from calib.certification.uncertainty_budget import Budget
from calib.samples.position_confounds_and_poses_on_one_clock import ONE_SIDE, Confounds, approach_text
from rig.array_and_json_types import Floats, Json
from rig.model import mechanisms
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Commanded
from rig.recording.recording_folder import LIMB, PAYLOAD, Recording
from rig.report.verdict_refutations_and_result_display import Evidence


@dataclass(frozen=True, slots=True)
class Volume:
    """Where the poses that count lie. low, high : (3,) m of the platform's position; turned : rad, the greatest
    rotation away from their middle one
    axes : names; commands : (axes, 2), least and greatest of each; units : of each, "m" or "rad"."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    turned: float | None
    axes: tuple[str, ...]
    commands: tuple[tuple[float, float], ...]
    units: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Conditions:
    """recordings : ((name, source of its poses), ..); poses : at rest; configurations : of these, each of which counts
    once
    moving : exposures excluded because the machine moved; rest : s nothing moved before each
    channels : ((name, least, greatest), ..) logged at the exposures; payload : (least, greatest) kg, None where not
        logged
    approach : in words; warm_up : s from the first command to the first exposure, the least over the recordings;
        duration : s of them all
    instrument : what measured, in words; frame : what holds the base frame and its scale, in words."""

    recordings: tuple[tuple[str, str], ...]
    poses: int
    configurations: int
    moving: int
    rest: float
    channels: tuple[tuple[str, float, float], ...]
    payload: tuple[float, float] | None
    approach: str
    warm_up: float
    duration: float
    instrument: str
    frame: str

    @property
    def one_sided(self) -> str:
        """The approach in words where every axis or some came to nearly all poses from one side; "" where none did."""
        return self.approach if self.approach.startswith(ONE_SIDE) else ""


def ranges_of_measured_positions_rotations_and_axes(poses: HeldPoses, mechanism: Commanded) -> Volume:
    """Ranges of positions, rotations and axes over which HeldPoses were measured (Volume).

    Of the poses that count.
    """
    T = poses.T_base_platform[poses.first]
    places, commands = T.translation, poses.commanded[poses.first]
    turned = float((T.rotation.mean().inv() * T.rotation).magnitude().max()) if poses.rotations else None
    return Volume(
        tuple(places.min(axis=0).tolist()),
        tuple(places.max(axis=0).tolist()),
        turned,
        mechanism.axes,
        tuple((float(low), float(high)) for low, high in zip(commands.min(axis=0), commands.max(axis=0))),
        mechanisms.axis_units(mechanism),
    )


def measuring_conditions(poses: HeldPoses, recordings: Sequence[Recording], sources: Sequence[str]) -> Conditions:
    """Measuring conditions of HeldPoses.

    sources : where each recording's poses came from, in words
    """
    logged: dict[str, list[Floats]] = {}
    for k, recording in enumerate(recordings):
        for name in recording.sensors.channels if recording.sensors is not None else ():
            if not LIMB.fullmatch(name) and recording.sensors is not None:
                logged.setdefault(name, []).append(recording.sensors.at(poses.t[poses.recording == k], name))
    channels = tuple(
        (name, float(np.concatenate(v).min()), float(np.concatenate(v).max())) for name, v in logged.items()
    )
    payload = next(((low, high) for name, low, high in channels if name == PAYLOAD), None)
    first = [float(poses.t[poses.recording == k].min(initial=np.inf)) for k in range(len(recordings))]
    spans = [float(np.ptp(recording.exposures.times()[1])) for recording in recordings]
    design = recordings[0].design
    if design.instrument is not None:
        seen, frame = (
            f"an outside instrument, position to {design.instrument.position_sigma * 1e6:.3g} um",
            "the instrument's own",
        )
    else:
        seen = f"{len(design.cameras)} cameras" if design.cameras else "poses.csv"
        based = any(target.body == "base" for target in design.targets)
        frame = (
            "the base targets' stated places"
            if based
            else "the cameras' stated places"
            if design.cameras
            else "poses.csv"
        )
    return Conditions(
        tuple((recording.name, source) for recording, source in zip(recordings, sources)),
        len(poses),
        len(poses.first),
        poses.moving,
        REST,
        tuple(c for c in channels if c[0] != PAYLOAD),
        payload,
        approach_text(
            poses.commanded[poses.first], poses.before[poses.first], mechanisms.axis_place_texts(design.mechanism)
        ),
        min(first),
        sum(spans),
        seen,
        frame,
    )


@dataclass(frozen=True, slots=True)
class CertifyOptions:
    """coverage, confidence : of the promise; tolerances : {"position": m, "rotation": rad} to judge against, either or
    none
    scale : relative standard uncertainty of the targets' scale, None where nobody certified it; scale_source : who did,
        in words
    rated_load : kg that the machine is made for, None where not stated."""

    coverage: float = 0.95
    confidence: float = 0.95
    tolerances: tuple[tuple[str, float], ...] = ()
    scale: float | None = None
    scale_source: str | None = None
    rated_load: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """What is certified. machine : its kind; calibrated_from : recording, in words; options : CertifyOptions; promise,
    cells : whole volume and boxes of it
    errors : (n, 6) m and rad of the poses that count, for drawing; before, after : Figures by the nominal model and
        calibrated, of those
    provenance : {what: value} of inputs' hashes, versions, seed and arguments; confounds : of the held-out recordings
    known : Evidence of the calibration, what these recordings say of its claim included; claims : AgainstClaim of each
    recording, none where no factor is claimed; displacement : what is stated of base and tool, which poses are without
    """

    machine: str
    options: CertifyOptions
    promise: Promise
    cells: tuple[Cell, ...]
    volume: Volume
    repeatability: Repeatability
    iso9283: Iso9283
    iso230: tuple[AxisTest, ...]
    conformity: tuple[Conformity, ...]
    budget: Budget
    conditions: Conditions
    errors: Floats
    before: Figures
    after: Figures
    provenance: Json
    confounds: Confounds | None = None
    known: Evidence | None = None
    claims: tuple[AgainstClaim, ...] = ()
    displacement: tuple[str, ...] = ()
