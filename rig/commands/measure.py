"""rig measure REC --out DIR."""

from pathlib import Path

from rig.commands.output import Progress, fresh_folder, print_unsolved
from rig.errors import RigError


def arguments(parser):
    """Add this command's arguments to a parser."""
    parser.add_argument("recording", metavar="REC", type=Path)
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="gets poses.csv, corners.csv, rig.toml and report.html")
    parser.add_argument("--hold", metavar="WHAT", default="", help="hold 'poses', 'lenses' or 'poses,lenses' of the cameras as stated")
    parser.add_argument("--detect", action="store_true", help="read the images even if corners.csv is there")


def run(arguments):
    """Measure a recording and write what was measured."""
    from rig import recording as recordings
    from rig import writing
    from rig.design_file import with_cameras
    from rig.pose import vector

    hold = {part.strip() for part in arguments.hold.split(",") if part.strip()}
    if hold - {"poses", "lenses"}:
        raise RigError(f"--hold takes 'poses' and 'lenses', not {', '.join(sorted(hold - {'poses', 'lenses'}))!r}")
    recording = recordings.load(arguments.recording)
    out = fresh_folder(arguments.out, recording.folder)

    from calib.certificate import uncertainty
    from calib.report import measurement_page
    from vision.collect import image_reader
    from vision.identity import suspects
    from vision.recorded import measure_recording
    from vision.targets import marker_map

    measured, collected = measure_recording(recording, tuple(sorted({"poses", "lenses"} - hold)), arguments.detect, Progress())
    wrong = suspects(measured, marker_map(recording.design), collected, image_reader(recording))
    text = (recording.folder / "rig.toml").read_text(encoding="utf-8-sig")
    writing.write_text(out / "rig.toml", with_cameras(text, measured.design.cameras))
    writing.write_poses(out / "poses.csv", recordings.Poses(measured.frames, measured.T_base_platform, measured.covariance))
    writing.write_corners(out / "corners.csv", measured.corners())
    writing.copy_times(recording.folder, out, recording.exposures)
    measurement_page(out / "report.html", recording, measured, collected, wrong)
    position, rotation = uncertainty(measured.covariance)
    total = len(recording.exposures.times()[0])
    print(f"{len(measured.frames)} of {total} frames solved, {measured.inliers.sum()} of {len(measured.inliers)} corners used; "
          f"corners scatter by {measured.noise:.4f} px")
    print(f"standard uncertainty of a pose (RMS): {position * 1e3:.4f} mm, {rotation * 1e3:.4f} mrad")
    for stated, camera in zip(recording.design.cameras, measured.design.cameras):
        moved = vector(stated.pose.inv() * camera.pose)
        print(f"camera {camera.name}: {(moved[:3] ** 2).sum() ** 0.5 * 1e3:.3f} mm and {(moved[3:] ** 2).sum() ** 0.5 * 1e3:.3f} mrad from "
              f"where rig.toml has it, focal length {camera.matrix[0, 0] - stated.matrix[0, 0]:+.2f} px")
    if wrong:
        print(f"{len(wrong)} marker{'s are' if len(wrong) > 1 else ' is'} not what rig.toml says; what disagrees is left out of the poses:")
        for suspect in wrong:
            print(f"  {suspect}")
    print_unsolved(measured)
    print(f"written: {out}/poses.csv, corners.csv, rig.toml; look at {out}/report.html")
