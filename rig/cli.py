"""The command line: the only file that sees every package, each imported inside the command that needs it."""

import argparse
import json
import os
import sys
from pathlib import Path

from rig.errors import RigError

SEED = 0  # of the bootstrap; results are the same from run to run


def main(argv=None):
    """Run one command; returns the exit status: 0 done, 1 refused with a reason, 2 wrong usage, 130 interrupted."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if not hasattr(arguments, "run"):
        parser.print_help()
        return 2
    arguments.argv = sys.argv[1:] if argv is None else list(argv)
    try:
        return arguments.run(arguments) or 0
    except RigError as error:
        print(f"rig {arguments.command}: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except KeyboardInterrupt:
        print(f"rig {arguments.command}: interrupted", file=sys.stderr)
        return 130


def _parser():
    parser = argparse.ArgumentParser(prog="rig", description="Vision-measured calibration of robots that move a platform on struts.",
                                     epilog="A recording is a folder with rig.toml, frames.csv, commands.csv and images or corners.csv; "
                                            "SI units and radians throughout.")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")

    def command(name, run, text):
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        return sub

    sub = command("measure", _measure, "Images or corners of a recording -> platform poses with covariance, cameras adjusted.")
    sub.add_argument("recording", metavar="REC", type=Path)
    sub.add_argument("--out", metavar="DIR", type=Path, required=True, help="gets poses.csv, corners.csv, rig.toml and report.html")
    sub.add_argument("--hold", metavar="WHAT", default="", help="hold 'poses', 'lenses' or 'poses,lenses' of the cameras as stated")
    sub.add_argument("--detect", action="store_true", help="read the images even if corners.csv is there")

    sub = command("calibrate", _calibrate, "A recording -> calibration.json: geometry and corrections, with held-out figures.")
    sub.add_argument("recording", metavar="REC", type=Path)
    sub.add_argument("--out", metavar="FILE", type=Path, required=True, help="calibration.json; the report is written beside it")

    sub = command("correct", _correct, "Wanted poses -> the strut lengths to command for them.")
    sub.add_argument("calibration", metavar="CALIBRATION", type=Path)
    sub.add_argument("--poses", metavar="FILE", type=Path, required=True, help="frame,x,y,z,rx,ry,rz of the wanted poses")
    sub.add_argument("--out", metavar="FILE", type=Path, required=True, help="frame,l1..l6 to command")
    sub.add_argument("--skip-unreachable", action="store_true", help="leave out, and list, poses beyond the strut range")

    sub = command("verify", _verify, "A calibration held against a recording it was not made from: error before and after.")
    sub.add_argument("calibration", metavar="CALIBRATION", type=Path)
    sub.add_argument("recording", metavar="REC", type=Path)
    sub.add_argument("--json", action="store_true", help="print JSON instead of a table (m, rad)")
    return parser


class _Progress:
    """Bars on a terminal, nothing in a pipe: called with (label, done, of)."""

    def __init__(self):
        self.bar, self.label = None, None

    def __call__(self, label, done, of):
        from tqdm import tqdm

        if label != self.label:
            self.close()
            self.bar, self.label = tqdm(total=of, desc=label, disable=None, leave=False, file=sys.stderr), label
        self.bar.update(done - self.bar.n)
        if done >= of:
            self.close()

    def close(self):
        """Take the bar away."""
        if self.bar is not None:
            self.bar.close()
        self.bar, self.label = None, None


def _measure(arguments):
    from rig import recording as recordings
    from rig.design_file import with_cameras
    from rig.pose import vector

    hold = {part.strip() for part in arguments.hold.split(",") if part.strip()}
    if hold - {"poses", "lenses"}:
        raise RigError(f"--hold takes 'poses' and 'lenses', not {', '.join(sorted(hold - {'poses', 'lenses'}))!r}")
    recording = recordings.load(arguments.recording)
    out = _fresh_folder(arguments.out, recording.folder)

    from calib.report import measurement_page
    from vision.recorded import measure_recording

    measured, collected = measure_recording(recording, tuple(sorted({"poses", "lenses"} - hold)), arguments.detect, _Progress())
    text = (recording.folder / "rig.toml").read_text(encoding="utf-8-sig")
    _write(out / "rig.toml", with_cameras(text, measured.design.cameras))
    recordings.write_poses(out / "poses.csv", recordings.Poses(measured.frames, measured.T_base_platform, measured.covariance))
    recordings.write_corners(out / "corners.csv", _corners(measured))
    recordings.copy_times(recording.folder, out, recording.exposures)
    measurement_page(out / "report.html", recording, measured, collected)
    position, rotation = _uncertainty(measured.covariance)
    total = len(recording.exposures.times()[0])
    print(f"{len(measured.frames)} of {total} frames solved, {measured.inliers.sum()} of {len(measured.inliers)} corners used; "
          f"corners scatter by {measured.noise:.4f} px")
    print(f"standard uncertainty of a pose (RMS): {position * 1e3:.4f} mm, {rotation * 1e3:.4f} mrad")
    for stated, camera in zip(recording.design.cameras, measured.design.cameras):
        moved = vector(stated.pose.inv() * camera.pose)
        print(f"camera {camera.name}: {(moved[:3] ** 2).sum() ** 0.5 * 1e3:.3f} mm and {(moved[3:] ** 2).sum() ** 0.5 * 1e3:.3f} mrad from "
              f"where rig.toml has it, focal length {camera.matrix[0, 0] - stated.matrix[0, 0]:+.2f} px")
    _print_unsolved(measured)
    print(f"written: {out}/poses.csv, corners.csv, rig.toml; look at {out}/report.html")


def _corners(measured):
    from rig.recording import Corners

    o = measured.observations
    ids = [number for target in measured.design.targets for number in target.ids]
    names = [camera.name for camera in measured.design.cameras]
    return Corners(o.frames[o.frame], [names[i] for i in o.camera], [ids[i] for i in o.marker], o.corner, o.uv, o.covariance)


def _calibrate(arguments):
    from rig import recording as recordings

    recording = recordings.load(arguments.recording)
    out = _fresh_file(arguments.out, recording.folder)

    import numpy as np

    from calib import store
    from calib.certificate import certify
    from calib.pipeline import sample_recording
    from calib.report import calibration_page

    sampled = sample_recording(recording, progress=_Progress())
    correction, found, held_out = certify(sampled.samples, recording.design.mechanism, np.random.default_rng(SEED))
    frames = sampled.samples.frame
    calibration = store.Calibration(
        correction, found.covariance, found.scatter, tuple(frames[found.inliers].tolist()), tuple(frames[~found.inliers].tolist()),
        held_out, store.provenance(recording, arguments.argv, SEED, sampled.source == "images"))
    store.save(out, calibration)
    page = out.with_suffix(".html")
    calibration_page(page, recording, calibration, sampled.samples, found)
    print(f"{len(frames)} poses from {sampled.source}, {found.inliers.sum()} of them agree with one geometry")
    _print_comparison(held_out, "held-out poses (whole stretches in turn)")
    kept = [i + 1 for i, part in enumerate(correction.remainder) if part is not None]
    print("beyond the geometry: " + (f"struts {', '.join(map(str, kept))} corrected over the configuration space" if kept
                                     else "nothing that pays on held-out poses"))
    if sampled.measurement is not None:
        _print_unsolved(sampled.measurement)
    print(f"written: {out}; look at {page}")


def _correct(arguments):
    import numpy as np

    from calib import store
    from calib.correction import reachable
    from rig import recording as recordings
    from rig.errors import Unreachable

    calibration = store.load(arguments.calibration)
    wanted = recordings.load_poses(arguments.poses)
    out = _fresh_file(arguments.out, None)
    commands = calibration.correction.inverse(wanted.T_base_platform)
    keep = np.ones(len(commands), bool)
    try:
        reachable(commands, calibration.correction.nominal, [f"frame {frame}" for frame in wanted.frame])
    except Unreachable as error:
        if not arguments.skip_unreachable:
            raise
        keep[error.index] = False
        print(f"rig correct: {error}\nleft out, as asked", file=sys.stderr)
    rows = [",".join([str(frame), *(f"{length:.10f}" for length in lengths)])
            for frame, lengths in zip(wanted.frame[keep], commands[keep])]
    _write(out, "\n".join([",".join(("frame", *calibration.correction.nominal.axes)), *rows]) + "\n")
    print(f"{keep.sum()} of {len(keep)} poses written to {out}")


def _verify(arguments):
    from calib import store

    calibration = store.load(arguments.calibration)
    from rig import recording as recordings

    recording = recordings.load(arguments.recording)

    import numpy as np

    from calib.certificate import compare, errors_of
    from calib.pipeline import sample_recording

    sampled = sample_recording(recording, progress=_Progress())
    samples = sampled.samples
    held = compare(*errors_of(calibration.correction, samples), samples.total_covariance(), np.random.default_rng(SEED))
    used = store.provenance(recording, [], SEED, sampled.source == "images")["inputs_sha256"]
    same = used == calibration.provenance["inputs_sha256"]
    if arguments.json:
        print(json.dumps(_verification(held, same, sampled), indent=1))
        return
    if same:
        print("warning: the calibration was made from this very recording, so these figures are not held out", file=sys.stderr)
    _print_comparison(held, f"{samples.frame.size} poses from {sampled.source}")
    if sampled.measurement is not None:
        _print_unsolved(sampled.measurement)


def _verification(held, same, sampled):
    def side(figures):
        names = ("rms", "p95", "max")
        return {"position": dict(zip(names, figures.position)), "rotation": dict(zip(names, figures.rotation)), "bias": figures.bias}

    unsolved = sampled.measurement.unsolved if sampled.measurement is not None else {}
    return {"schema": "verification/1", "unit": {"position": "m", "rotation": "rad"}, "held_out": not same, "n": held.after.n,
            "before": side(held.before), "after": side(held.after),
            "measurement_uncertainty": {"position": held.floor[0], "rotation": held.floor[1]},
            "ratio": {"position": held.ratio[0], "ci95": held.ratio[1:]},
            "unsolved": [{"frame": frame, "reason": reason} for frame, reason in sorted(unsolved.items())]}


def _print_comparison(held, title):
    print(f"{title}, N = {held.after.n}:")
    print(f"{'':14}{'position, mm':>30}{'rotation, mrad':>33}")
    print(f"{'':14}" + "".join(f"{name:>10}" for name in ("RMS", "95 %", "max")) + "   " + "".join(f"{name:>10}" for name in ("RMS", "95 %", "max")))
    for name, figures in (("owner's model", held.before), ("corrected", held.after)):
        print(f"{name:14}" + "".join(f"{v * 1e3:10.4f}" for v in figures.position) + "   " + "".join(f"{v * 1e3:10.4f}" for v in figures.rotation))
    print(f"{held.ratio[0]:.1f} times better (95 % interval {held.ratio[1]:.1f} to {held.ratio[2]:.1f}); the measured poses themselves are "
          f"uncertain by {held.floor[0] * 1e3:.4f} mm and {held.floor[1] * 1e3:.4f} mrad")


def _print_unsolved(measured):
    if measured.unsolved:
        print(f"{len(measured.unsolved)} frames without a pose:")
        for frame, reason in sorted(measured.unsolved.items())[:20]:
            print(f"  frame {frame}: {reason}")
        if len(measured.unsolved) > 20:
            print(f"  and {len(measured.unsolved) - 20} more")


def _uncertainty(covariance):
    import numpy as np

    traces = [np.trace(covariance[:, part, part], axis1=1, axis2=2).mean() for part in (slice(0, 3), slice(3, 6))]
    return np.sqrt(traces)


def _fresh_folder(path, source):
    if path.exists() and not path.is_dir():
        raise RigError(f"{path} is a file; --out names a folder")
    if path.resolve() == source.resolve():
        raise RigError(f"--out is the recording itself; it stays as it was, name another folder than {path}")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(f"{path} cannot be made: {error.strerror}") from None
    return path


def _fresh_file(path, source):
    if path.is_dir():
        raise RigError(f"{path} is a folder; --out names a file")
    if not path.parent.is_dir():
        raise RigError(f"{path.parent} is no folder; make it first")
    if source is not None and path.parent.resolve() == source.resolve() and path.suffix in (".csv", ".toml"):
        raise RigError(f"--out {path} is a file of the recording, which stays as it was; name another")
    return path


def _write(path, text):
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
