"""A function of many things on several processes: the same results in the same order, errors and progress as on one."""

import os

import numpy as np
import pytest

from calib.diagnosis.problems.evidence_interface_and_requested_effects import RequestedEffects
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import (
    Sensitivities,
    platform_candidates_and_untested_effects,
)
from calib.diagnosis.problems.platform.linearisation_operating_point import operating_point_source_and_measurement
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import linearise
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import score_candidates
from rig.compute import parallel_map_and_dask_cluster
from rig.compute.worker_processes import MOST, split_into_decreasing_parts
from tests.calib.recordings_with_effects import recorded


@pytest.fixture(params=[1, 3])
def processes(request, monkeypatch):
    monkeypatch.setattr(parallel_map_and_dask_cluster, "worker_count", lambda: request.param)
    return request.param


def test_results_come_in_order_and_progress_reaches_the_end(processes):
    things, seen = [object() for _ in range(40)], []
    out = parallel_map_and_dask_cluster.parallel_map(
        lambda thing: (things.index(thing), os.getpid()), things, lambda done, of: seen.append((done, of))
    )
    done = [of_all for of_all, of in seen if of == 40]
    assert [i for i, _ in out] == list(range(40)) and done[-1] == 40 and len(done) == len(seen)
    assert (np.diff([0, *done]) >= 1).all() and max(np.diff([0, *done])) <= (1 if processes == 1 else MOST)
    assert (len({pid for _, pid in out} - {os.getpid()}) > 0) == (processes > 1)


@pytest.mark.parametrize("count", [1, 2, 7])
def test_parts_hold_all_in_order_and_are_single_at_the_end(count):
    for many in (0, 1, 5, 999):
        shares = split_into_decreasing_parts(range(many), count)
        assert [thing for share in shares for thing in share] == list(range(many))
        sizes = [len(share) for share in shares]
        assert (
            all(1 <= size <= MOST for size in sizes)
            and sizes == sorted(sizes, reverse=True)
            and (many == 0 or sizes[-1] == 1)
        )


def test_what_a_process_raises_is_raised_here(processes):
    def fail(i):
        if i == 17:
            raise ValueError("thing 17")
        return i

    with pytest.raises(ValueError, match="thing 17"):
        parallel_map_and_dask_cluster.parallel_map(fail, range(40))
    assert parallel_map_and_dask_cluster.parallel_map(abs, [-1, 2]) == [1, 2]  # and the next call is not disturbed


@pytest.mark.slow
def test_a_search_finds_the_same_on_one_process_and_on_several(tmp_path, design, monkeypatch):
    point = operating_point_source_and_measurement(recorded(tmp_path, design, ["backlash:strut5:gap=6e-5"]))[0]
    requested = RequestedEffects(("backlash", "camera_drift", "vibration", "face_misplacement"))
    model, (candidates, _) = linearise(point), platform_candidates_and_untested_effects(point, requested)
    both = []
    for count in (1, 3):
        monkeypatch.setattr(parallel_map_and_dask_cluster, "worker_count", lambda count=count: count)
        sensitivities = Sensitivities(point)
        both.append((score_candidates(model, candidates, sensitivities), sensitivities.pixels))
    (one, pixels), (several, other_pixels) = both
    assert [s.candidate for s in one] == [s.candidate for s in several] and pixels.keys() == other_pixels.keys()
    for a, b in zip(one, several):
        assert a.node == b.node and a.delta_chi2 == pytest.approx(b.delta_chi2, rel=1e-6)
        np.testing.assert_allclose(a.coefficients, b.coefficients, rtol=1e-5, atol=1e-12)
