"""Where a certificate came from: hashes of what it rests on, versions, seed and arguments, and the name that follows
from them.
"""

import hashlib
import json
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from calib.certify.calibration import Calibration
from calib.files import calibration_file
from rig.recording.data_provenance import content_marks, marks_of_frames
from rig.recording.recording_folder import Recording


def certificate_provenance(
    path: Path, calibration: Calibration, recordings: Sequence[Recording], arguments: Sequence[str], seed: int
) -> dict[str, Any]:
    """dict of inputs_sha256 (of the calibration's file, of each recording's tables and of the content marks of its
    exposures), calibration, versions, seed, arguments, when it was created, and an id: of what went in and what was
    asked, not of when."""
    inputs = {path.name: {"file": hashlib.sha256(path.read_bytes()).hexdigest()}}
    for recording in recordings:
        name = recording.folder.resolve().name
        origin = calibration_file.calibration_provenance(recording, (), seed, recording.has_images)
        content = hashlib.sha256("\n".join(marks_of_frames(content_marks(recording))).encode()).hexdigest()
        inputs[name if name not in inputs else str(recording.folder)] = {
            **origin["inputs_sha256"],
            "exposures": content,
        }
    made = calibration.provenance
    what = json.dumps([inputs, list(arguments)], sort_keys=True)
    return {
        "inputs_sha256": inputs,
        "calibration": {"recording": made.get("recording"), "created": made.get("created")},
        "versions": calibration_file.package_versions(),
        "seed": seed,
        "arguments": list(arguments),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "id": hashlib.sha256(what.encode()).hexdigest()[:16],
    }
