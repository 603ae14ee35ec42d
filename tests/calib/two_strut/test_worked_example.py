"""The worked example: its figures are this code's, and what they show is what the source says of them."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from calib.two_strut.two_strut_patent_example_and_figures import (
    L1,
    L2,
    NOMINAL,
    REAL,
    hinge_positions_of_command_grid,
    reached_hinge_positions,
    two_strut_example_figures,
    two_strut_worked_example,
)

FIGURES = Path(__file__).parents[3] / "docs" / "two-strut"


@pytest.fixture(scope="module")
def example():
    return two_strut_worked_example()


def test_the_figures_in_the_pages_are_drawn_by_this_code():
    drawn = two_strut_example_figures()
    assert sorted(drawn) == sorted(path.stem for path in FIGURES.glob("*.svg")) and len(drawn) == 8
    page = (FIGURES.parent / "two-strut.md").read_text()
    for name, text in drawn.items():
        assert (FIGURES / f"{name}.svg").read_text() == text, name
        assert f"two-strut/{name}.svg" in page


def test_the_sample_set_is_the_four_pairs_of_two_lengths(example):
    """[0082]: (L1, L1), (L1, L2), (L2, L1), (L2, L2)."""
    assert [tuple(x) for x in example.x.round(12)] == list(product((L1, L2), repeat=2))


def test_summands_are_commands_less_the_lengths_to_where_the_hinge_was_measured(example):
    """[0085], [0130], by a ruler: from the owner's joints to the place where two circles about the real joints
    cross.
    """
    for x, place, second, summand in zip(
        example.x, example.measured.translation[:, :2], example.second, example.summand
    ):
        real = np.linalg.norm(place - REAL.base_joints, axis=1) - REAL.strut_zeros
        np.testing.assert_allclose(real, x, atol=1e-12)
        ruler = np.linalg.norm(place - NOMINAL.base_joints, axis=1)
        np.testing.assert_allclose(second, ruler, atol=1e-12)
        np.testing.assert_allclose(summand, x - ruler, atol=1e-12)


def test_the_functions_have_the_measured_values_at_the_four_samples_and_are_interpolated_between(example):
    """[0088]: four function values come from measured poses, all other points by interpolation."""
    np.testing.assert_allclose(example.correction.rho(example.x), example.summand, atol=1e-12)
    middle = example.correction.rho(np.full(2, (L1 + L2) / 2))
    np.testing.assert_allclose(middle, example.summand.mean(axis=0), atol=1e-12)


def test_one_step_takes_out_nearly_all(example):
    """[0090], [0091]: S1 + ds1 and S2 + ds2 give the wanted pose, but for what is negligible: here a thirtieth at the
    most.
    """
    wanted = hinge_positions_of_command_grid()
    before, after = (
        np.sqrt(((reached_hinge_positions(c, wanted) - wanted) ** 2).sum(axis=1).mean())
        for c in (None, example.correction)
    )
    assert before > 1e-3 and after < before / 30
