"""Frames held out: nuisances fitted on the others and on what was known beforehand, as plain least squares on those
rows has it.
"""

import numpy as np
import pytest

from calib.diagnosis.engine.cross_validation_and_chance_probabilities import RIDGE, held_out_residuals
from calib.diagnosis.engine.linear_residual_model import Block, Column, LinearModel

FRAMES, NUISANCES = 12, 5
FOLDS = {"stretches": np.repeat([0, 1, 2], 4), "scattered": np.tile([0, 1, 2], 4)}


@pytest.fixture
def model():
    """Two blocks, of 3 rows a frame and of 0 to 4, each with 2 rows known beforehand."""
    rng = np.random.default_rng(1)
    counts = [np.full(FRAMES, 3), rng.integers(0, 5, FRAMES)]
    Q = np.linalg.qr(rng.normal(size=(sum(c.sum() + 2 for c in counts), NUISANCES)))[0]
    first = int(counts[0].sum()) + 2
    blocks = tuple(
        Block(name, "px", rng.normal(size=int(c.sum()) + 2), np.r_[0, np.cumsum(c)]) for name, c in zip("ab", counts)
    )
    return LinearModel(blocks, Column((Q[:first], Q[first:])), None, len(Q) - NUISANCES)


def expected(model, fold, hold):
    """(residuals of all rows of frames, by nuisances fitted to the frames of other folds alone) for each block."""
    train = [np.r_[np.repeat(fold != hold, np.diff(block.edges)), True, True] for block in model.blocks]
    Q = np.concatenate([part[rows] for part, rows in zip(model.columns.whole, train)])
    y = np.concatenate([block.residual[rows] for block, rows in zip(model.blocks, train)])
    size = np.linalg.solve(Q.T @ Q + RIDGE * np.eye(NUISANCES), Q.T @ y)
    return [(block.residual - part @ size)[block.frames_rows] for block, part in zip(model.blocks, model.columns.whole)]


@pytest.mark.parametrize("fold", FOLDS.values(), ids=FOLDS)
def test_a_fold_is_held_against_a_fit_of_the_others(model, fold):
    residuals = tuple(block.residual for block in model.blocks)
    whole = held_out_residuals(model, residuals, fold)
    for hold in range(3):
        alone = held_out_residuals(model, residuals, fold, hold)
        for n, (block, wanted) in enumerate(zip(model.blocks, expected(model, fold, hold))):
            own = np.repeat(fold == hold, np.diff(block.edges))
            assert whole.frames[n][own] == pytest.approx(wanted[own], abs=1e-12)
            assert alone.frames[n][own] == pytest.approx(wanted[own], abs=1e-12)
            assert (alone.frames[n][~own] == block.residual[block.frames_rows][~own]).all()
    fitted = sum(part.T @ y for part, y in zip(model.columns.whole, residuals))
    for known, part, y in zip(whole.beforehand, model.columns.whole, residuals):
        assert known == pytest.approx(y[-2:] - part[-2:] @ fitted, abs=1e-12)


def test_a_basis_that_is_not_written_out_is_refused(model):
    half = LinearModel(model.blocks, model.columns, np.eye(NUISANCES), model.size)
    with pytest.raises(ValueError, match="explicit"):
        held_out_residuals(half, tuple(block.residual for block in half.blocks), FOLDS["stretches"])
