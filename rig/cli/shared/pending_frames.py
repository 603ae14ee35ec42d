"""rig online: the frames of a recording that a learner has not learnt from yet."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.errors import RigError

if TYPE_CHECKING:
    from calib.samples.pose_samples import Samples
    from rig.recording.data_provenance import Marks
    from rig.recording.recording_folder import Recording


def unlearnt_frame_numbers(recording: Recording, of: Marks, learnt: set[str]) -> list[int]:
    """Numbers of the frames whose data have not been learnt; how many have been is said. of : Marks of the recording;
    learnt : marks

    Raises RigError where none is left: what is learnt twice counts twice
    """
    from rig.recording.data_provenance import frames_with_known_data

    frames, again = recording.exposures.times()[0], frames_with_known_data(of, learnt)
    if len(again) == len(of) > 0:
        raise RigError(
            f"all {len(of)} frames of {recording.folder} in which anything is seen have been learnt already; "
            "once more they would count "
            "twice"
        )
    if again:
        print(f"{len(again)} of {len(frames)} frames have been learnt already and are left out")
    return [frame for frame in frames.tolist() if frame not in set(again)]


def unlearnt_samples(samples: Samples, fresh: list[int], recording: Recording) -> Samples:
    """The Samples of frames that have not been learnt. Raises RigError where none of these has a pose."""
    import numpy as np

    chosen = np.isin(samples.frame, fresh)
    if not chosen.any():
        raise RigError(f"none of the {len(fresh)} frames of {recording.folder} that have not been learnt has a pose")
    return samples.take(chosen)
