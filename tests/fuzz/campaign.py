"""python -m tests.fuzz.campaign INPUTS OUT: so many inputs in all to the readers, coverage-guided, each reader in a
process of its own.

Inputs that a reader fails on are kept in OUT/<reader>/, what it did in OUT/failures.txt; exits with 1 where there are
any.
"""

import importlib
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import FunctionType, ModuleType

WATCHED = (
    "rig.formats.csv_and_parquet_tables_and_time_origin",
    "rig.formats.checked_toml_and_json_entries",
    "rig.formats.json_toml_and_yaml_loading",
    "rig.formats.local_and_remote_input_files",
    "rig.recording.exposures_and_image_files",
    "rig.recording.corner_and_pose_csv_tables",
    "rig.recording.recording_folder",
    "rig.formats.rig_toml.design_from_rig_toml",
    "rig.formats.numbers_and_units",
    "rig.formats.output_files.atomic_file_writing_and_process_locks",
    "rig.driving.cameras.opencv_uvc_gstreamer_and_network_cameras",
    "rig.model.design",
    "rig.report.pages.run_page_server",
    "calib.files.mechanism_and_physics_entries",
    "rig.effects.texts.effect_text_parsing_and_user_effect_file_loading",
    "calib.files.calibration_file",
    "calib.online.information_filter_state_steps_and_json_file",
    "synthetic.blind_diagnosis_score",
    "synthetic.random_true_machine_and_truth_file",
    "rig.model.calibration_board_layout_and_description_parsing",
    "tomllib._parser",
)
SHARES = {
    "rig.toml": 0.25,
    "image": 4.0,
    "effect": 3.0,
    "place": 3.0,
    "board": 3.0,
    "trials": 3.0,
    "effect as JSON": 2.0,
    "plan": 0.02,
    "calibration.json": 0.1,
    "state.json": 0.1,
    "frames.csv": 0.5,
    "sensors.csv": 0.5,
    "commands.csv": 0.5,
    "whole calibration.json": 0.1,
    "number": 3.0,
    "text shown": 3.0,
    "port": 3.0,
    "pipeline": 3.0,
}  # of the inputs, 1 by default


def one(name: str, inputs: int, out: Path, seed: int) -> None:
    """Feed one reader; libFuzzer ends the process."""
    import atheris
    import numpy as np

    from tests.fuzz.readers import readers
    from tests.fuzz.trial import LONGEST, TOKENS, confined, failure, mutated

    for module in WATCHED:
        _watch(importlib.import_module(module), atheris.instrument_func)
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    reader = next(r for r in readers(folder) if r.name == name)
    corpus = folder / "corpus"
    corpus.mkdir()
    for number, data in enumerate((*reader.seeds, *(t for t in TOKENS))):
        (corpus / str(number)).write_bytes(data)
    case_folder = out / name.replace(" ", "_")
    seen = set()

    def feed(data):
        problem = failure(reader, data, folder / "input")
        if problem and problem not in seen:
            seen.add(problem)
            case_folder.mkdir(parents=True, exist_ok=True)
            (case_folder / sha256(data).hexdigest()[:16]).write_bytes(data)
            with open(out / "failures.txt", "a", encoding="utf-8") as file:
                file.write(f"{name}: {problem}\n")

    def mutator(data, most, number):
        rng = np.random.default_rng(number)
        if rng.random() < 0.3:
            return atheris.Mutate(data, most)
        return mutated(data, reader.seeds, rng)[:most]

    limits = confined()  # held until the process ends: a limit that nobody holds is lifted
    limits.__enter__()
    atheris.Setup(
        [
            sys.argv[0],
            f"-runs={inputs}",
            f"-max_len={LONGEST}",
            f"-seed={seed}",
            "-rss_limit_mb=0",
            "-timeout=60",
            "-verbosity=0",
            "-print_final_stats=1",
            str(corpus),
        ],
        feed,
        custom_mutator=mutator,
    )
    atheris.Fuzz()


def _watch(module: ModuleType, instrument: Callable) -> None:
    """Count the branches of a module's own functions and methods; what is compiled is left alone."""
    for found in list(vars(module).values()):
        for function in (found, *vars(found).values()) if isinstance(found, type) else (found,):
            if isinstance(function, FunctionType) and function.__module__ == module.__name__:
                instrument(function)


def main(inputs: int, out: Path) -> int:
    """All readers one after the other; the exit status."""
    from tests.fuzz.readers import readers

    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        names = [reader.name for reader in readers(Path(folder))]
    whole = sum(SHARES.get(name, 1.0) for name in names)
    status, fed = 0, 0
    for number, name in enumerate(names):
        count = int(inputs * SHARES.get(name, 1.0) / whole) + 1
        done = subprocess.run(
            [sys.executable, "-m", "tests.fuzz.campaign", name, str(count), str(out), str(number + 1)],
            capture_output=True,
            text=True,
        )
        count = int(next(iter(re.findall(r"number_of_executed_units: +(\d+)", done.stderr)), 0))
        fed += count
        print(f"{name}: {count} inputs, exit status {done.returncode}", flush=True)
        if done.returncode:
            status = 1
            print(done.stderr[-2000:], flush=True)
    failures = (out / "failures.txt").read_text() if (out / "failures.txt").exists() else ""
    print(f"{fed} inputs in all, {len(failures.splitlines())} kinds of failure\n{failures}", flush=True)
    return 1 if status or failures else 0


if __name__ == "__main__":
    if len(sys.argv) == 3:
        sys.exit(main(int(sys.argv[1]), Path(sys.argv[2])))
    one(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]))
