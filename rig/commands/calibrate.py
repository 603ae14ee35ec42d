"""rig calibrate REC --out calibration.json."""

from pathlib import Path

from rig.commands.output import SEED, Progress, fresh_file, print_comparison, print_unsolved
from rig.errors import RigError


def arguments(parser):
    """Add this command's arguments to a parser."""
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument("--out", metavar="FILE", type=Path, required=True, help="calibration.json; the report is written beside it")
    parser.add_argument("--joint", action="store_true", help="solve cameras, lenses and geometry once more from all corners together")


def run(arguments):
    """Calibrate a recording and write the calibration and its report."""
    from rig import recording as recordings

    recording = recordings.load(arguments.recording)
    out = fresh_file(arguments.out, recording.folder)

    import numpy as np

    from calib.pipeline import sample_recording

    sampled = sample_recording(recording, progress=Progress())
    rng = np.random.default_rng(SEED)
    if recording.design.mechanism.kind == "arm":
        if arguments.joint:
            raise RigError("--joint solves a hexapod's cameras and struts together; an arm has none")
        _arm(recording, sampled, out, arguments.argv, rng)
    else:
        _hexapod(recording, sampled, out, arguments.argv, rng, arguments.joint)
    print_unsolved(sampled.measurement)
    print(f"written: {out}; look at {out.with_suffix('.html')}")


def _hexapod(recording, sampled, out, argv, rng, joint):
    from calib.certificate import certify
    from calib.report import calibration_page

    correction, found, held_out = certify(sampled.samples, recording.design.mechanism, rng)
    if joint:
        from calib.joint import refine

        correction, found = refine(sampled, recording.design, correction, found)
    calibration = _stored(out, recording, sampled, argv, correction, found, held_out)
    calibration_page(out.with_suffix(".html"), recording, calibration, sampled.samples, found)
    print(f"{len(sampled.samples)} poses from {sampled.source}, {found.inliers.sum()} of them agree with one geometry")
    print_comparison(held_out, "held-out poses (whole stretches in turn)")
    kept = [i + 1 for i, part in enumerate(correction.remainder) if part is not None]
    print("beyond the geometry: " + (f"struts {', '.join(map(str, kept))} corrected over the configuration space" if kept
                                     else "nothing that pays on held-out poses"))


def _arm(recording, sampled, out, argv, rng):
    from calib.arms.certify import certify
    from calib.arms.report import calibration_page

    done = certify(sampled.samples, recording.design.mechanism, recording.design.instrument, rng)
    calibration = _stored(out, recording, sampled, argv, done.correction, done.found, done.held_out)
    calibration_page(out.with_suffix(".html"), recording, calibration, sampled.samples, done)
    print(f"{len(sampled.samples)} poses from {sampled.source}, {done.found.inliers.sum()} of them agree with one geometry")
    print("\n".join(done.found.rank.report()))
    print_comparison(done.held_out, "held-out poses (a third at a time, whole stretches)")
    kept = [i + 1 for i, part in enumerate(done.correction.remainder) if part is not None]
    print("beyond the geometry: " + (f"joints {', '.join(map(str, kept))} corrected over the configuration space; the geometry alone leaves "
                                     f"{done.geometry.after.mean[0] * 1e3:.4f} mm mean on the same poses" if kept
                                     else "nothing that pays on held-out poses"))
    print(f"the same with single rows held out at random, which flatters: {done.scattered.after.mean[0] * 1e3:.4f} mm mean, "
          f"{done.scattered.after.position[0] * 1e3:.4f} RMS")


def _stored(out, recording, sampled, argv, correction, found, held_out):
    from calib import store

    frames = sampled.samples.frame
    calibration = store.Calibration(
        correction, found.covariance, found.scatter, tuple(frames[found.inliers].tolist()), tuple(frames[~found.inliers].tolist()),
        held_out, store.provenance(recording, argv, SEED, sampled.source == "images"))
    store.save(out, calibration)
    return calibration
