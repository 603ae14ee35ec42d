"""Every reader of outside data, with inputs that it takes: what the fuzzers begin from."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.certification.held_out_pose_error_statistics import Figures, HeldOut
from calib.correction.machine_correction import Correction
from calib.files import calibration_file
from calib.online.hexapod_information_filter import Online
from rig.effects.catalogue.effect_list import ALL
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import (
    effect_with_existing_place,
    parse_effect,
    require_known_effect,
)
from rig.errors import RigError
from rig.formats import csv_and_parquet_tables_and_time_origin, importers
from rig.formats.importers import exposures_from_image_names as frames
from rig.formats.importers.foreign_file_import_recipe import ForeignTable
from rig.formats.machine_geometry_and_effects_json_file import effect_from_dict
from rig.formats.rig_toml import design_from_rig_toml
from rig.model import calibration_board_layout_and_description_parsing
from rig.model.pose import TRIANGLE
from rig.planning import recording_plan as plan
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.recording import recording_folder
from rig.recording.corner_and_pose_csv_tables import COVARIANCE_COLUMNS, load_corners, load_poses
from rig.recording.exposures_and_image_files import image_file_problem, load_exposures_and_unreadable_images
from synthetic import blind_diagnosis_score, random_true_machine_and_truth_file, recording_simulation
from synthetic.blind_campaign import Campaign, parse_case_numbers
from tests.fuzz.laws import laws


@dataclass(frozen=True, slots=True)
class Reader:
    """name; seeds : inputs that it takes; read : what reads a file, and raises RigError or returns."""

    name: str
    seeds: tuple[bytes, ...]
    read: Callable[[Path], object]


def readers(folder: Path) -> list[Reader]:
    """All of them. folder : where what they read beside their input is kept"""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=2, width=640, height=480, cubes=2)
    (folder / "rig.toml").write_text(text)
    design = design_from_rig_toml.load_design(folder / "rig.toml")
    rng = np.random.default_rng(1)
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(
            design, rng, 1.0, (parse_effect("backlash:strut2:gap=4e-5"),)
        ),
        plan.build_plan(design, "sobol:3"),
        rng,
    )
    recording_simulation.write_recording(done, folder, text, rng, 0.04)
    for name, keep in (("corners.csv", 9), ("sensors.csv", 99), ("commands.csv", 99)):
        (folder / name).write_text("\n".join((folder / name).read_text().splitlines()[:keep]) + "\n")
    held = recording_folder.load_recording(folder)
    known = [*_files(folder, design, held), *_json(folder, design, done), *_texts(design), *_foreign(folder, design)]
    return known + [Reader(*law) for law in laws((folder / "calibration.json").read_bytes())]


def _files(folder, design, held):
    def seed(name):
        return ((folder / name).read_bytes(),)

    def frames(path):
        rows = csv_and_parquet_tables_and_time_origin.read_csv_table(path, ("frame", "t", "camera", "image"))
        return load_exposures_and_unreadable_images(folder, design, rows, rows.first_time_origin())

    def commands(path):
        rows = recording_folder._command_rows(path, design)
        return recording_folder._commands(rows, design, held.exposures, rows.first_time_origin())

    poses = ",".join(["frame", "x", "y", "z", "rx", "ry", "rz", *COVARIANCE_COLUMNS])
    row = ",".join(map(str, ["0", 0.1, 0.2, 0.3, 0.1, 0.0, 0.2, *np.eye(6)[TRIANGLE] * 1e-8]))
    pictures = tuple(
        cv2.imencode(kind, np.zeros((8, 8), np.uint8))[1].tobytes()
        for kind in (".png", ".jpg", ".tiff", ".bmp", ".pgm")
    )
    arm = (
        b'schema = "rig/1"\n[mechanism]\nkind = "arm"\njoints = [[0.1, 0.2, 0.0, 1.5], [0, 0, 0.3, '
        b"0]]\nlimits = [[-3, 3], [-3, 3]]\n"
        b'[instrument]\nbase = "free"\ntool = "rig"\nposition_sigma = 1e-5\n'
    )
    return [
        Reader("rig.toml", (*seed("rig.toml"), arm), design_from_rig_toml.load_design),
        Reader("frames.csv", seed("frames.csv"), frames),
        Reader("commands.csv", seed("commands.csv"), commands),
        Reader(
            "sensors.csv",
            seed("sensors.csv"),
            lambda path: recording_folder._sensors(path, held.origin, held.exposures),
        ),
        Reader("corners.csv", seed("corners.csv"), lambda path: load_corners(path, design, held.exposures)),
        Reader("poses.csv", (f"{poses}\n{row}\n".encode(),), load_poses),
        Reader("image", pictures, image_file_problem),
    ]


def _json(folder, design, done):
    m = design.mechanism
    figures = Figures(9, (1e-3,) * 3, (1e-3,) * 3, (0.0,) * 6, (1e-3, 1e-3))
    calibration_file.save(
        folder / "calibration.json",
        Calibration(
            Correction(m, m, (None,) * 6),
            np.eye(42) * 1e-8,
            np.zeros(6),
            (0, 1),
            (2,),
            HeldOut(figures, figures, (1e-5, 1e-5), (2.0, 1.0, 3.0), 9),
            {"seed": 0},
        ),
    )
    Online(m).save(folder / "state.json")
    random_true_machine_and_truth_file.write_truth(
        folder / "truth.json", done.world, done.run.T_base_platform, kind="one", disturbance=None, strengths=[9.0]
    )
    finding = {
        "effect": "backlash",
        "place": "strut 2",
        "parameters": {"gap": {"value": 4e-5, "unit": "m", "ci95": [3e-5, 5e-5]}},
        "cannot_be_told_from": [{"effect": "creep", "place": "rig"}],
    }
    diagnosis = {"findings": [finding], "unexplained": None, "fit": {"heldout_after": 1.0, "noise_floor": 0.9}}
    (folder / "diagnoses").mkdir()

    def seed(name):
        return ((folder / name).read_bytes(),)

    def judged(case):
        return blind_diagnosis_score.campaign_rates_with_intervals([case]), blind_diagnosis_score.campaign_medians(
            [case]
        )

    def record(path):
        (folder / "diagnoses" / "0001.json").write_bytes(path.read_bytes())
        return Campaign(folder, lambda text: None).record(1)

    return [
        Reader("calibration.json", seed("calibration.json"), calibration_file.load),
        Reader("state.json", seed("state.json"), Online.load),
        Reader(
            "truth.json",
            seed("truth.json"),
            lambda path: random_true_machine_and_truth_file.load_world_from_truth_file(path, design),
        ),
        Reader(
            "sealed truth", seed("truth.json"), lambda path: judged(blind_diagnosis_score.score_case(1, path, None))
        ),
        Reader(
            "diagnosis.json",
            (json.dumps(diagnosis).encode(),),
            lambda path: judged(blind_diagnosis_score.score_case(1, folder / "truth.json", path)),
        ),
        Reader("record", (b'{"seconds": 1.5, "failed": null}\n', b'{"seconds": 1.5, "failed": "no"}\n'), record),
        Reader(
            "effect as JSON",
            tuple(
                json.dumps({"effect": e.name, "place": "rig", "parameters": {p.name: 0 for p in e.parameters}}).encode()
                for e in ALL
            ),
            lambda path: effect_with_existing_place(effect_from_dict(_loaded(path)), design),
        ),
    ]


def _loaded(path):
    try:
        return json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise RigError("not JSON: the JSON reader's own business") from error


def _texts(design):
    def of(read):
        return lambda path: read(path.read_bytes().decode("utf-8", "surrogateescape"))

    effects = tuple(
        f"{e.name}:{place}:{','.join(f'{p.name}=' + '/'.join(['1e-4'] * (p.size or 3)) for p in e.parameters)}".encode()
        for e, place in zip(ALL, ("strut1", "cam0", "8", "rig", "P1", "clock", "cameras") * 9)
    )
    plans = (
        b"standard",
        b"sobol:9,grid:2,simplices:1,axes:2,ladder:1",
        b"payload:2,moving:3,zigzag:3,warmup:3,repeat:4",
        b"commands:x.csv",
    )
    return [
        Reader("effect", effects, of(lambda text: effect_with_existing_place(parse_effect(text), design))),
        Reader("plan", plans, of(lambda text: plan.build_plan(design, text))),
        Reader(
            "place",
            (b"backlash strut 2", b"camera_bump camera cam0", b"marker_swap", b"cube_misplacement target P1"),
            of(lambda text: require_known_effect(text, design)),
        ),
        Reader(
            "board",
            (
                b"charuco:8x6:0.03:0.022:DICT_5X5_100",
                b"aruco:8x6:0.03:0.01:DICT_5X5_100",
                b"aprilgrid:6x6:0.03:0.01:DICT_APRILTAG_36h11",
            ),
            of(calibration_board_layout_and_description_parsing.parse_board),
        ),
        Reader("trials", (b"3,7-9", b"1"), of(lambda text: parse_case_numbers(text, 100))),
    ]


def _foreign(folder, design):
    """What `rig import` reads: tables in any dialect, recipes, names of images."""
    q = [repr(1e3 * float(v)) for v in design.mechanism.strut_range.mean(axis=1)]
    rows = "\n".join(
        ";".join([f"{1763800000000 + 900 * k}", *(f"{float(v) + 5 * (k % 3):.4f}".replace(".", ",") for v in q)])
        for k in range(6)
    )
    german = f"# log\nZeit [ms];{';'.join(f'L{i} [mm]' for i in range(1, 7))}\n{rows}\n".encode()
    lines = (" ".join([f"{k}.5", *(f"{(float(v) + 5 * (k % 3)) / 1e3:.6f}" for v in q)]) for k in range(6))
    plain = "\n".join(["# t l1 l2 l3 l4 l5 l6", *lines]).encode()
    turns = (
        b"timestamp,x [mm],y [mm],z "
        b"[mm],qw,qx,qy,qz\n2026-01-31T12:00:00.5Z,1,2,450,1,0,0,0\n2026-01-31T12:00:01.5Z,2,1,455,0,1,0,0\n"
    )
    angles = b"t [s]\tx\ty\tz\troll [deg]\tpitch [deg]\tyaw [deg]\n0\t10\t20\t450\t1\t2\t3\n1\t20\t10\t440\t3\t1\t0\n"
    log = b"t [s];Ambient temp [K]\n0,5;293,15\n1,5;293,25\n"
    recipe = (
        b'schema = "import/1"\nrig = "rig.toml"\n[images]\nfolders = ["in"]\ntolerance = '
        b'0.01\n[images.cameras]\nleft = "cam0"\n'
        b'[commands]\nfile = "c.csv"\nunit = "mm"\nshift = 1.5\n[commands.columns]\nl1 = "Bein 1"\n'
    )
    Images = importers.foreign_file_import_recipe.Images

    def names(path):
        lines = path.read_bytes().decode("utf-8", "replace").splitlines()[:50]
        cameras = ["cam0", "cam1"]
        files = [Path("in") / line.replace("\0", "0").lstrip("/")[:255] for line in lines if line.strip("/. ")]
        found = frames.image_files_of_folder(files, Path("in"), {name: name for name in cameras}, None, cameras)
        return frames.group_images_into_exposures(found, Images((Path("in"),)), lambda t: True) if found else None

    return [
        Reader(
            "foreign commands",
            (german, plain),
            lambda path: importers.foreign_command_table.read_commands(ForeignTable(path), design),
        ),
        Reader(
            "foreign poses",
            (turns, angles),
            lambda path: importers.foreign_pose_table.read_poses(
                ForeignTable(path, rotation_unit="deg", rotation="zyx")
                if b"roll" in path.read_bytes()
                else ForeignTable(path),
                design,
                lambda *_: None,
                lambda t: True,
            ),
        ),
        Reader(
            "foreign sensors",
            (log,),
            lambda path: importers.foreign_sensor_table.read_sensors(
                ForeignTable(path), lambda t: True, design.mechanism
            ),
        ),
        Reader("recipe", (recipe,), importers.load_recipe),
        Reader(
            "names of images",
            (b"cam0_1763800000123.png\ncam1_1763800000125.png\ncam0_1763800001123.png", b"cam0/1.png\ncam1/1.png"),
            names,
        ),
    ]
