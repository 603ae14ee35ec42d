"""A sinusoid that a scan wants larger than any is begins at the largest that is allowed."""

import numpy as np
import pytest

from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import platform_candidate
from rig.effects.catalogue.cyclic_error import CyclicError
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.catalogue.vibration import Vibration
from rig.effects.framework.effect_base_class import QUADRATURE, Candidate, Linear
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters


@pytest.mark.parametrize("kind", [Vibration, CyclicError])
def test_coefficients_stay_within_the_amplitudes_bound(kind):
    assert kind is BY_NAME[kind.name]
    rng = np.random.default_rng(5)
    if kind is Vibration:
        columns = [Linear(name, j, 1e-6) for name in ("mode", QUADRATURE) for j in range(6)]
        candidate, node = platform_candidate(Candidate(kind, "rig", [{}], columns, extra=1, tied=5)), {"frequency": 3.0}
    else:
        columns = [Linear("amplitude", None, 1e-6), Linear(QUADRATURE, None, 1e-6)]
        candidate, node = platform_candidate(Candidate(kind, "strut 2", [{"order": 1.0}], columns)), {"order": 1.0}
    high = next(p for p in kind.parameters if p.name == "amplitude").bounds[1]
    for _ in range(50):
        wanted = rng.normal(size=len(columns)) * 10 ** rng.uniform(-6, 1)
        found, free = (candidate.effect(node, c) for c in (candidate.allowed(wanted), wanted))
        assert effect_with_valid_place_and_parameters(found).amplitude == pytest.approx(min(free.amplitude, high))
        assert found.phase == pytest.approx(free.phase, abs=1e-6)
