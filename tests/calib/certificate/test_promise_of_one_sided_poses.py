"""The sentence of a certificate's promise names the axes that came to its poses from one side."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from calib.certificate.certificate_content_dataclasses import Conditions
from calib.certificate.certificate_sentences_and_quantity_texts import promise_line
from calib.samples.position_confounds_and_poses_on_one_clock import approach_text

AXES = tuple(f"strut {i + 1}" for i in range(6))


@pytest.mark.parametrize(
    ("both", "condition"),
    [
        ([], " approached from one side by every axis as recorded, "),
        ([5], " approached from one side on struts 1-5 as recorded, "),
        ([0, 1, 2, 3, 4, 5], ""),
    ],
)
def test_a_promise_is_for_poses_approached_as_recorded(both: list[int], condition: str) -> None:
    rng = np.random.default_rng(0)
    values, direction = rng.uniform(-0.02, 0.02, (60, 6)), np.ones((60, 6))
    direction[::2, both] = -1.0
    approach = approach_text(values, direction, AXES)
    conditions = Conditions((), 60, 60, 0, 0.25, (), None, approach, 0.0, 0.0, "", "")
    promise = SimpleNamespace(position=SimpleNamespace(upper=20e-6), rotation=None, confidence=0.95, coverage=0.95)
    line = promise_line(cast(Any, SimpleNamespace(promise=promise, conditions=conditions)))
    assert line.startswith("With 95 % confidence, 95 % of poses in this volume")
    assert (condition in line) if condition else ("approached" not in line), line
