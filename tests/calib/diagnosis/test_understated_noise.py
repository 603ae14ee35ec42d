"""Arms whose poses scatter more than is stated of them, by machines of an independent truth: every command says check,
and its page why.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from rig.cli import command_line
from tests.truth import Case, draw, record, rows_of
from tests.truth.draw_machines import secret
from tests.truth.journey import journey, visits
from tests.truth.kinematics import Arm
from tests.truth.laws import stood
from tests.truth.rigid import displaced

STARS = 130


def telescope(seed: int) -> Case:
    """A mount of two axes, azimuth and elevation, that points all over the sky."""
    rng, case = np.random.default_rng([seed, 40]), draw(seed, "none", "none", "shuffled", "arm", 80)
    owner = Arm(
        np.array([[0, 0.3, 0, np.pi / 2], [0, 0, 1.0, 0]]),
        np.zeros(2, bool),
        np.zeros(2),
        np.array([[-2.5, 2.5], [0.2, 1.3]]),
        np.zeros(2),
    )
    machine, speeds = secret(owner, 3e-4, rng), np.full(2, 0.5)
    way = journey(visits("shuffled", owner.ranges, STARS, rng), owner.ranges.mean(axis=1), speeds, case.dwell)
    noise = rng.normal(size=(STARS, 6)) * np.repeat(case.sigma, 3)
    seen = rows_of(displaced(stood(machine, way, case.day, ()), noise))
    return replace(case, owner=owner, machine=machine, way=way, speeds=speeds, seen=seen)


CASES = {
    "telescope": lambda: telescope(3),
    "arm": lambda: draw(4, "none", "none", "shuffled", "arm", 100),
    "arm with play": lambda: draw(5, "backlash", "strong", "shuffled", "arm", 100),
}


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("telescope", 30),
        ("arm with play", 3),
        *(
            pytest.param(name, times, marks=pytest.mark.slow)
            for name, times in [
                ("telescope", 1),
                ("telescope", 3),
                ("arm", 1),
                ("arm", 3),
                ("arm", 30),
                ("arm with play", 30),
            ]
        ),
    ],
)
def test_scatter_beyond_the_stated_noise_is_no_all_clear(tmp_path, capsys, name, times):
    case = CASES[name]()
    rec = record(replace(case, sigma=(case.sigma[0] / times, case.sigma[1] / times)), tmp_path / "rec")
    assert command_line.main(["diagnose", str(rec), "--out", str(tmp_path / "found"), "--quiet"]) == 0
    capsys.readouterr()
    assert command_line.main(["calibrate", str(rec), "--out", str(tmp_path / "made.json"), "--json", "--quiet"]) == 0
    found, made = (
        json.loads((tmp_path / "found/diagnosis.json").read_text()),
        json.loads((tmp_path / "made.json").read_text()),
    )
    states = [found["verdict"]["state"], json.loads(capsys.readouterr().out)["verdict"]["state"]]
    pages = [(tmp_path / page).read_text(encoding="utf-8") for page in ("found/diagnosis.html", "made.html")]
    if times == 1:
        assert states == ["good", "good"] and found["unexplained"] is None
        assert not made["claim"].get("unexplained")
        return
    assert states == ["check", "check"]
    assert found["unexplained"]["place"] == "rig" and found["unexplained"]["magnitude"] > 2 * case.sigma[0] / times
    assert "no catalogued effect explains" in pages[0]
    assert made["claim"]["unexplained"] and "this calibration does not explain" in pages[1]
