"""rig calibrate REC --out calibration.json."""

from pathlib import Path

from rig.commands.output import SEED, Progress, fresh_file, print_comparison, print_unsolved


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

    from calib import store
    from calib.certificate import certify
    from calib.pipeline import sample_recording
    from calib.report import calibration_page

    sampled = sample_recording(recording, progress=Progress())
    correction, found, held_out = certify(sampled.samples, recording.design.mechanism, np.random.default_rng(SEED))
    if arguments.joint:
        from calib.joint import refine

        correction, found = refine(sampled, recording.design, correction, found)
    frames = sampled.samples.frame
    calibration = store.Calibration(
        correction, found.covariance, found.scatter, tuple(frames[found.inliers].tolist()), tuple(frames[~found.inliers].tolist()),
        held_out, store.provenance(recording, arguments.argv, SEED, sampled.source == "images"))
    store.save(out, calibration)
    page = out.with_suffix(".html")
    calibration_page(page, recording, calibration, sampled.samples, found)
    print(f"{len(frames)} poses from {sampled.source}, {found.inliers.sum()} of them agree with one geometry")
    print_comparison(held_out, "held-out poses (whole stretches in turn)")
    kept = [i + 1 for i, part in enumerate(correction.remainder) if part is not None]
    print("beyond the geometry: " + (f"struts {', '.join(map(str, kept))} corrected over the configuration space" if kept
                                     else "nothing that pays on held-out poses"))
    print_unsolved(sampled.measurement)
    print(f"written: {out}; look at {page}")
