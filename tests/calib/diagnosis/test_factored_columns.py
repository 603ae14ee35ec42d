"""Columns left as a table times a small matrix answer as those written out do."""

import numpy as np
import pytest

from calib.diagnosis.engine.linear_residual_model import Block, Column, FactoredColumns, LinearModel

F, ROWS, KNOWN = 12, 30, 4


@pytest.fixture
def both():
    """(LinearModel by FactoredColumns, the same written out, generator)."""
    rng = np.random.default_rng(0)
    table, other = rng.normal(size=(F * ROWS, 5)), rng.normal(size=(F * 2 + KNOWN, 8))
    turn = rng.normal(size=(5, 8))
    whole = np.concatenate([table @ turn, other])
    half = np.linalg.inv(np.linalg.cholesky(whole.T @ whole)).T
    factored, closures = FactoredColumns(table, turn @ half), other @ half
    y = rng.normal(size=len(whole))
    Q = np.concatenate([np.asarray(factored), closures])
    y -= Q @ (Q.T @ y)
    blocks = (
        Block("corners", "px", y[: F * ROWS], np.arange(F + 1) * ROWS),
        Block("closures", "m", y[F * ROWS :], np.arange(F + 1) * 2),
    )
    models = [LinearModel(blocks, Column((part, closures)), None, 100) for part in (factored, np.asarray(factored))]
    return *models, rng


def test_models_of_both_kinds_answer_alike(both):
    factored, written, rng = both
    column = Column((rng.normal(size=(F * ROWS, 3)), rng.normal(size=(F * 2 + KNOWN, 3))))
    unseen = Column((None, column.parts[1][:, :1]))
    some = rng.random(F) < 0.5
    for grown in (
        lambda model: model,
        lambda model: model.marginalise(column),
        lambda model: model.marginalise(unseen).marginalise(column),
    ):
        one, other = grown(factored), grown(written)
        for a, b in zip(one.blocks, other.blocks):
            assert a.residual == pytest.approx(b.residual, abs=1e-12)
        for name in ("onto", "right", "gram"):
            assert getattr(one.project(column), name) == pytest.approx(getattr(other.project(column), name), abs=1e-10)
        r = other.columns.count
        reach, onto = rng.normal(size=r), rng.normal(size=(2, r))
        for a, b in zip(one.leakage_and_carried(reach, onto), other.leakage_and_carried(reach, onto)):
            assert a == pytest.approx(b, abs=1e-10)
        assert one.gram(some) == pytest.approx(other.gram(some), abs=1e-10)
        residuals = [block.residual for block in other.blocks]
        assert one.right(some, residuals) == pytest.approx(other.right(some, residuals), abs=1e-10)


def test_they_multiply_from_both_sides():
    rng = np.random.default_rng(1)
    factored = FactoredColumns(rng.normal(size=(9, 3)), rng.normal(size=(3, 4)))
    written = np.asarray(factored)
    left, right = rng.normal(size=(2, 9)), rng.normal(size=(4, 2))
    assert left @ factored == pytest.approx(left @ written) and factored @ right == pytest.approx(written @ right)
    assert factored.T @ factored == pytest.approx(written.T @ written)
    assert np.asarray(factored[2:5]) == pytest.approx(written[2:5]) and len(factored) == 9
