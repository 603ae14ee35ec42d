"""rig calibrate REC --out calibration.json."""

from pathlib import Path

from rig.commands.output import SEED, Progress, add_force, add_recording, file_or_stdout, print_comparison, print_unsolved, read_recording
from rig.errors import RigError


def arguments(parser):
    """Add this command's arguments to a parser."""
    add_recording(parser)
    parser.add_argument("--out", metavar="FILE", type=file_or_stdout, required=True, help="calibration.json; the report is written beside it")
    parser.add_argument("--joint", action="store_true", help="solve cameras, lenses and geometry once more from all corners together")
    add_force(parser)


def run(arguments):
    """Calibrate a recording and write the calibration and its report."""

    recording = read_recording(arguments)
    out = arguments.outputs.file(arguments.out)
    page = arguments.outputs.beside(out, ".html")

    import numpy as np

    from calib.pipeline import sample_recording

    sampled = sample_recording(recording, progress=Progress())
    rng = np.random.default_rng(SEED)
    if recording.design.mechanism.kind == "arm":
        if arguments.joint:
            raise RigError("--joint solves a hexapod's cameras and struts together; an arm has none")
        _arm(recording, sampled, (out, page), arguments.argv, rng)
    else:
        _hexapod(recording, sampled, (out, page), arguments.argv, rng, arguments.joint)
    print_unsolved(sampled.measurement)
    print(f"written: {arguments.out}" + (f"; look at {arguments.out.with_suffix('.html')}" if page else ""))


def _hexapod(recording, sampled, out, argv, rng, joint):
    from calib.certificate import certify
    from calib.report import calibration_page

    correction, found, held_out = certify(sampled.samples, recording.design.mechanism, rng)
    if joint:
        from calib.joint import refine

        correction, found = refine(sampled, recording.design, correction, found)
    calibration = _stored(out[0], recording, sampled, argv, correction, found, held_out)
    if out[1]:
        calibration_page(out[1], recording, calibration, sampled.samples, found)
    print(f"{len(sampled.samples)} poses from {sampled.source}, {found.inliers.sum()} of them agree with one geometry")
    print_comparison(held_out, "held-out poses (whole stretches in turn)")
    kept = [i + 1 for i, part in enumerate(correction.remainder) if part is not None]
    print("beyond the geometry: " + (f"struts {', '.join(map(str, kept))} corrected over the configuration space" if kept
                                     else "nothing that pays on held-out poses"))


def _arm(recording, sampled, out, argv, rng):
    from calib.arms.certify import certify
    from calib.arms.report import calibration_page

    done = certify(sampled.samples, recording.design.mechanism, recording.design.instrument, rng)
    calibration = _stored(out[0], recording, sampled, argv, done.correction, done.found, done.held_out)
    if out[1]:
        calibration_page(out[1], recording, calibration, sampled.samples, done)
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
