"""What a certificate holds, as figures."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.certificate.measuring_conditions import Conditions, Volume
from calib.certify.held_out_errors import Figures
from calib.certify.iso230_axis_errors import AxisTest
from calib.certify.iso9283 import Iso9283
from calib.certify.pose_error_promise import Cell, Promise
from calib.certify.recording_claim_check import AgainstClaim
from calib.certify.repeatability import Repeatability
from calib.certify.tolerance_conformity import Conformity
from calib.certify.uncertainty_budget import Budget
from calib.samples.confounded_conditions import Confounds
from rig.report.verdict import Evidence


@dataclass(frozen=True, slots=True)
class Asked:
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
    """What is certified. machine : its kind; calibrated_from : recording, in words; asked : Asked; promise,
    cells : whole volume and boxes of it
    errors : (n, 6) m and rad of the poses that count, for drawing; before, after : Figures by the owner's model and
        calibrated, of those
    provenance : {what: value} of inputs' hashes, versions, seed and arguments; confounds : of the held-out recordings
    known : Evidence of the calibration, what these recordings say of its claim included; claims : AgainstClaim of each
    recording, none where no factor is claimed."""

    machine: str
    asked: Asked
    promise: Promise
    cells: tuple[Cell, ...]
    volume: Volume
    repeatability: Repeatability
    iso9283: Iso9283
    iso230: tuple[AxisTest, ...]
    conformity: tuple[Conformity, ...]
    budget: Budget
    conditions: Conditions
    errors: np.ndarray
    before: Figures
    after: Figures
    provenance: dict[str, Any]
    confounds: Confounds | None = None
    known: Evidence | None = None
    claims: tuple[AgainstClaim, ...] = ()
