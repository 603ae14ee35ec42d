"""A project in a folder in which the commands write every page that there is, on a rig with a backlash at strut 3 that
nobody was told of.
"""

import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path

import cv2
import numpy as np

from rig.cli.command_line import main
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import Effect

LOST = next(kind for kind in ALL if kind.forgets is not Effect.forgets)  # how an axis came to its place matters
SCALED = next(kind for kind in ALL if kind.form == "slope")  # it grows with the travel
LATE = next(kind for kind in ALL if kind.retimes() and "rig" in kind.places)  # the axes follow their commands late
HIDDEN = f"{LOST.name}:strut3:{LOST.parameters[0].name}=2e-4"
BOARD = "charuco:7x5:0.03:0.022:DICT_5X5_100"
SHOTS, PIXELS, STARTED = (
    12,
    90,
    60,
)  # photographs of the board, px of its squares as drawn, s that an emulator may take to answer
RIG = (sys.executable, "-c", "import sys; from rig.cli.command_line import main; sys.exit(main(sys.argv[1:]))")


def rig(*words: object, may_end: tuple[int, ...] = (0,)) -> None:
    """Run a command. may_end : with which statuses. Raises RuntimeError for any other"""
    status = main([str(word) for word in words])
    if status not in may_end:
        raise RuntimeError(f"rig {' '.join(map(str, words))} ended with {status}")


def quick(at: Path) -> dict[str, Path]:
    """{kind: page} of those that take a minute together, in a new folder."""
    rig("new", at, "--defaults", "--radius", "300mm", "--cameras", "2", "--size", "640x512")
    with chdir(at):
        rig(
            "simulate",
            "rig.toml",
            "--plan",
            "sobol:30,ladder:1",
            "--seed",
            "7",
            "--effect",
            HIDDEN,
            "--out",
            "rec",
            "--truth",
            "secret.json",
        )
        rig("simulate", "rig.toml", "--machine", "secret.json", "--plan", "sobol:60", "--seed", "9", "--out", "rec2")
        rig(
            "simulate",
            "rig.toml",
            "--machine",
            "secret.json",
            "--plan",
            "sobol:5",
            "--seed",
            "3",
            "--images",
            "--blur",
            "0.5",
            "--out",
            "pictures",
        )
        rig("measure", "pictures", "--out", "measured")
        rig("calibrate", "rec", "--out", "calibration.json")
        rig("diagnose", "rec", "--only", LOST.name, "--only", SCALED.name, "--out", "found")
        rig("verify", "calibration.json", "rec2", "--page", "verified.html")
        rig(
            "certify",
            "calibration.json",
            "rec2",
            "--coverage",
            "0.8",
            "--tolerance",
            "500um",
            "--out",
            "certificate.html",
        )
        rig("workspace", "calibration.json", "--out", "map")
        rig("online", "rec", "--page", "online.html")
        rig("plan", "rig.toml", "--for", "parameters", "--count", "9", "--out", "plan.csv", "--page", "plan.html")
        rig("view", "rec", "--page", "view.html", "--effect", HIDDEN)
        rig("watch", "calibration.json", "rec2", "--page", "watch.html", may_end=(0, 3))
        photographed(Path("photos"))
        rig("lens", *sorted(Path("photos").iterdir()), "--board", BOARD, "--out", "lens")
    pages = {
        "measure": "measured/report.html",
        "calibrate": "calibration.html",
        "diagnose": "found/diagnosis.html",
        "verify": "verified.html",
        "certify": "certificate.html",
        "workspace": "map/workspace.html",
        "lens": "lens/lens.html",
    }
    return {kind: at / page for kind, page in pages.items()} | {
        kind: at / f"{kind}.html" for kind in ("online", "plan", "view", "watch", "index")
    }


def slow(at: Path) -> dict[str, Path]:
    """{kind: page} of those that take minutes: measuring limbs, a blind campaign, an investigation. at : where `quick`
    was
    """
    with chdir(at):
        rig("design", "--radius", "0.3", "--cameras", "2", "--limbs", "6", "--out", "limbs.toml")
        rig("simulate", "limbs.toml", "--plan", "sobol:60", "--seed", "3", "--out", "limbed", "--truth", "limbed.json")
        rig("insitu", "limbed", "--tolerance", "3e-4", "1e-3", "--out", "limbs.json", "--page", "insitu.html")
        rig("blind", "--season", "4", "--frames", "120", "--hide", "nothing,one", "--seed", "2", "--out", "campaign")
        rig(
            "simulate",
            "rig.toml",
            "--plan",
            "sobol:4",
            "--effect",
            f"{LATE.name}:rig:{LATE.parameters[0].name}=0.012",
            "--seed",
            "1",
            "--out",
            "lagging",
            "--truth",
            "lag.json",
        )
        rig("investigate", "rig.toml", "--machine", "lag.json", "--plan", "moving:30,sobol:40", "--out", "asked")
    return {
        "insitu": at / "insitu.html",
        "blind": at / "campaign/score.html",
        "investigate": at / "asked/notebook.html",
    }


def photographed(folder: Path) -> None:
    """Photographs of a printed board, drawn through a pinhole from places around it."""
    across, down = map(int, re.findall(r"\d+", BOARD)[:2])
    side, marker = map(float, re.findall(r"0\.\d+", BOARD))
    board = cv2.aruco.CharucoBoard(
        (across, down), side, marker, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    )
    drawn = board.generateImage((across * PIXELS, down * PIXELS), marginSize=0)
    K = np.array([[800.0, 0, 640], [0, 800, 480], [0, 0, 1]])
    corners = np.array([[0, 0], [across, 0], [across, down], [0, down]], np.float32)
    rng = np.random.default_rng(1)
    folder.mkdir()
    for k in range(SHOTS):
        R = cv2.Rodrigues(rng.uniform(-0.45, 0.45, 3))[0]
        middle = np.array([rng.uniform(-0.06, 0.06), rng.uniform(-0.04, 0.04), rng.uniform(0.2, 0.32)])
        seen = (np.c_[(corners - [across / 2, down / 2]) * side, np.zeros(4)] @ R.T + middle) @ K.T
        H = cv2.getPerspectiveTransform(corners * PIXELS, (seen[:, :2] / seen[:, 2:]).astype(np.float32))
        image = cv2.warpPerspective(drawn, H, (1280, 960), flags=cv2.INTER_AREA, borderValue=200.0)
        image = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, 1.5, image.shape)
        cv2.imwrite(str(folder / f"{k:02d}.png"), np.clip(image, 0, 255).astype(np.uint8))


@contextmanager
def running(at: Path) -> Iterator[str]:
    """The address of the page of a run that goes on through an emulated controller and drawn cameras. at : where
    `quick` was
    """
    port, log = at / "port", at / "emulator.log"
    text = (at / "rig.toml").read_text(
        encoding="utf-8"
    ) + f'\n[controller]\nprotocol = "grblhal"\nport = "{port}"\nmax_acceleration = 1.0\n'
    text = re.sub(r"^max_speed = .*$", "max_speed = 0.2", text, flags=re.MULTILINE)
    (at / "driven.toml").write_text(text, encoding="utf-8")
    emulate = [
        *RIG,
        "emulate",
        str(at / "driven.toml"),
        "--truth",
        str(at / "secret.json"),
        "--link",
        str(port),
        "--cameras",
        "0",
    ]
    with subprocess.Popen(emulate, stdout=log.open("w"), stderr=subprocess.STDOUT) as emulator:
        try:
            cameras = _figure_in_log(log, r"^cameras (\S+)")
            (at / "driven.toml").write_text(
                re.sub(r"^shutter = .*$", rf'\g<0>\nsource = "emulator:{cameras}"', text, flags=re.MULTILINE),
                encoding="utf-8",
            )
            run = [
                *RIG,
                "run",
                str(at / "driven.toml"),
                "--plan",
                "sobol:60",
                "--settle",
                "time:0.05",
                "--page",
                "--out",
                str(at / "running"),
            ]
            with subprocess.Popen(run, stdout=(at / "run.log").open("w"), stderr=subprocess.STDOUT) as runner:
                try:
                    yield _figure_in_log(at / "run.log", r"(http://\S+)")
                finally:
                    runner.terminate()
        finally:
            emulator.terminate()


def _figure_in_log(log: Path, pattern: str) -> str:
    """What a process says in its log. Raises RuntimeError where it does not in time"""
    until = time.monotonic() + STARTED
    while time.monotonic() < until:
        found = re.search(pattern, log.read_text(encoding="utf-8"), re.MULTILINE)
        if found:
            return found[1]
        time.sleep(0.1)
    raise RuntimeError(f"{log} says no {pattern}: {log.read_text(encoding='utf-8')[-500:]}")
