"""rig insitu REC --tolerance M RAD [--state FILE]."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.commands.output import Progress, add_recording, print_unsolved, read_recording
from rig.errors import RigError
from rig.kinds import hexapod_of

if TYPE_CHECKING:
    import numpy as np

    from calib.samples import Samples
    from rig.recording import Recording


def arguments(parser: ArgumentParser) -> None:
    """Add this command's arguments to a parser."""
    add_recording(parser, "with columns m1..m6 (m) in sensors.csv and [insitu] in rig.toml")
    parser.add_argument("--tolerance", nargs=2, type=float, default=(5e-5, 2e-4), metavar=("M", "RAD"),
                        help="that each axis must agree with vision within (default 5e-5 m and 2e-4 rad)")
    parser.add_argument("--state", metavar="FILE", type=Path, help="once passed: learn the struts from the limbs' poses, and save that here")
    parser.add_argument("--check", type=int, default=20, metavar="N", help="with --state: vision checks every Nth pose (default 20)")


def run(arguments: Namespace) -> int:
    """Hold the measuring limbs against vision, say whether they pass, and learn from them where they do."""
    if min(*arguments.tolerance, arguments.check) <= 0:
        raise RigError("--tolerance and --check take positive numbers")
    recording = read_recording(arguments)
    state = arguments.outputs.file(arguments.state, own=True) if arguments.state else None

    from calib.certify import insitu
    from calib.pipeline import sample_recording

    nominal = insitu.stated(recording.design)
    frames, lengths = insitu.readings(recording)
    sampled = sample_recording(recording, progress=Progress())
    samples, sigma = insitu.read(sampled.samples, frames, lengths), insitu.length_sigma(recording.design)
    T, expected = insitu.held_out(samples, nominal, sigma)
    found = insitu.agreement(samples.T_base_platform, T, expected, arguments.tolerance)
    _print(found, sampled.source)
    print_unsolved(sampled.measurement)
    passed = bool(found.passed.all())
    print("the measuring limbs pass: their poses may stand for vision's" if passed else "the measuring limbs do not pass")
    if state is not None and passed:
        limbs, _ = insitu.calibrated(samples, nominal, sigma)
        return _learn(arguments, recording, limbs, frames, lengths, samples, state)
    return 0 if passed else 1


def _print(found: Any, source: str) -> None:
    from calib.certify.insitu import AXES, MOVES

    print(f"measuring limbs less vision ({source}), {found.n} poses, each by limbs fitted to other stretches; um and urad:")
    print(f"{'':4}{'bias':>9}{'scatter':>9}{'expected':>9}{'limits of agreement':>24}{'surely within':>15}{'tolerance':>11}{'moved over':>14}")
    for i, axis in enumerate(AXES):
        low, high = found.limits[:, i] * 1e6
        moved = f"{found.moved[i] * 1e3:.1f} {'mm' if i < 3 else 'mrad'}"
        said = "passes" if found.passed[i] else ("fails" if found.surely[i] > found.tolerance[i]
                                                 else f"not shown: it must move over {MOVES:g} tolerances")
        print(f"{axis:4}{found.bias[i] * 1e6:9.2f}{found.scatter[i] * 1e6:9.2f}{found.expected[i] * 1e6:9.2f}"
              f"{f'{low:.2f} .. {high:.2f}':>24}{found.surely[i] * 1e6:15.2f}{found.tolerance[i] * 1e6:11.1f}{moved:>14}  {said}")


def _learn(arguments: Namespace, recording: Recording, limbs: Any, frames: np.ndarray, lengths: np.ndarray, samples: Samples, state: Path) -> int:
    """Learn the struts from the limbs' poses, vision checking every so often; the exit status."""
    import numpy as np

    from calib.certify import insitu
    from calib.identify.geometry import parameters
    from calib.online.filter import Online
    from rig.commands.online import not_learnt, said
    from rig.provenance import flat, marks

    known, _, values = recording.commanded()
    commands = values[np.searchsorted(known, frames)]
    T = limbs.pose(lengths)
    own, common = limbs.uncertainty(T)
    of = marks(recording)
    if arguments.state.exists():
        learner = Online.load(arguments.state)
        fresh = not_learnt(recording, of, learner.data)
        new = np.isin(frames, fresh)
        frames, commands, T, own, common = frames[new], commands[new], T[new], own[new], common[new]
        learner.data |= set(flat(of, fresh))
        learner.new_session(common.shape[2])
        print(f"going on after {learner.number} poses")
    else:
        learner = Online(hexapod_of(recording.design.mechanism), shared=common.shape[2])
        learner.data = set(flat(of))
    first, checked = learner.number, 0
    at = {frame: i for i, frame in enumerate(samples.frame.tolist())}
    vision = samples.total_covariance()
    for k, frame in enumerate(frames.tolist()):
        if k % arguments.check == 0 and frame in at:
            i, checked = at[frame], checked + 1
            if not insitu.still_agrees(samples.T_base_platform[i], vision[i], T[k], own[k], common[k]):
                learner.save(state)
                print(f"frame {frame}: vision no longer agrees with the measuring limbs, nothing is learnt from here on; written: {arguments.state}")
                return 1
        update = learner.update(commands[k], T[k], own[k], common[k])
        for change in update.changes:
            print(f"frame {frame}: {said(change, frames[max(change.onset - first, 0)])}")
        for number in update.dropped:
            print(f"frame {frames[number - first]}: its pose agrees with no other and is left out")
    learner.save(state)
    moved = learner.p - parameters(learner.nominal)
    print(f"{len(frames)} poses from the limbs learnt, vision agreed at all of {checked} checks; joints and zeros moved by "
          f"{np.sqrt(np.mean(moved**2)) * 1e3:.4f} mm RMS, known to {np.sqrt(np.mean(np.diag(learner.covariance))) * 1e3:.4f} mm RMS")
    print(f"written: {arguments.state}")
    return 0
