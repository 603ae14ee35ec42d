"""Every way to extend corrections: exact at its samples, continuous everywhere, right about its gradient, and the same
from a file.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from calib.correction import correction_field_methods_fitting_combination_and_json
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    FieldSamples,
    merge_repeated_samples,
)
from calib.correction.interpolation.interpolation_on_grid_of_samples import grid_lattice_of_configurations
from rig.errors import FileError, NotConverged, RigError
from rig.formats.checked_toml_and_json_entries import Entries
from rig.planning.configuration_generators import divided_grid_configurations, sobol_configurations

STROKE = (0.4, 0.5)
GRIDS = ("linear", "simplex")


def strokes(axes):
    return np.tile(STROKE, (axes, 1))


def on_grid(axes, seed, outputs=None, parts=None):
    """Known of random values on an uneven grid, random Q an axis, that leaves out the ends of the strokes."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 4 if axes < 5 else 3, axes) if parts is None else np.full(axes, parts)
    levels = [
        0.42 + 0.06 * np.sort(np.r_[0, 1, rng.permutation(np.linspace(0.1, 0.9, 7))[: count - 1]]) for count in counts
    ]
    x = np.stack(np.meshgrid(*levels, indexing="ij"), axis=-1).reshape(-1, axes)
    x = x[rng.permutation(len(x))]
    values = 1e-4 * rng.normal(size=(len(x), axes if outputs is None else outputs))
    return FieldSamples(x, values, np.full(values.shape, 1e-14), strokes(axes)), levels


def scattered(axes, count, seed):
    """Known of a smooth function at scattered samples."""
    x = sobol_configurations(strokes(axes), count, 0.9, seed)
    return FieldSamples(x, smooth(x), np.full(x.shape, 1e-14), strokes(axes))


def smooth(x):
    u = (x - 0.45) / 0.05
    return 1e-4 * (np.sin(u) + 0.3 * u[..., [0]] * u[..., [-1]])


def affine(x, seed=0):
    rng = np.random.default_rng(seed)
    return (x - 0.45) @ rng.normal(size=(x.shape[-1], x.shape[-1])) * 1e-3 + 1e-4


@pytest.mark.slow
@given(axes=st.integers(1, 7), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_grids_pass_through_their_samples(axes, seed):
    known, _ = on_grid(axes, seed)
    for kind in GRIDS:
        field = correction_field_methods_fitting_combination_and_json.fit_field(kind, known)
        np.testing.assert_allclose(field.value(known.configurations), known.values, atol=1e-17)
        assert (field.error(known.configurations) < 2e-7).all() and field.inside(known.configurations).all()


@pytest.mark.slow
@given(axes=st.integers(1, 7), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_weights_are_a_partition_of_unity_and_their_slopes_of_nothing(axes, seed):
    known, _ = on_grid(axes, seed)
    x = np.random.default_rng(seed).uniform(0.39, 0.51, (20, axes))
    for kind in GRIDS:
        field = correction_field_methods_fitting_combination_and_json.fit_field(kind, known)
        found = field.weights(x)
        np.testing.assert_allclose(found.weight.sum(axis=1), 1, atol=1e-14)
        assert (found.weight >= -1e-15).all()
        np.testing.assert_allclose(found.slope.sum(axis=1), 0, atol=1e-10)
        np.testing.assert_allclose(
            field.value(x), np.einsum("nk,nkm->nm", found.weight, field.values[found.samples]), atol=1e-17
        )


@given(axes=st.integers(1, 7), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_simplices_and_the_grid_agree_on_linear_functions(axes, seed):
    known, _ = on_grid(axes, seed)
    known = FieldSamples(known.configurations, affine(known.configurations), known.variances, known.strokes)
    x = np.random.default_rng(seed).uniform(0.42, 0.48, (20, axes))
    for kind in GRIDS:
        field = correction_field_methods_fitting_combination_and_json.fit_field(kind, known)
        np.testing.assert_allclose(field.value(x), affine(x), atol=1e-16)
        np.testing.assert_allclose(field.gradient(x)[0], np.moveaxis(field.gradient(x), 0, -1)[..., 1], atol=1e-12)


@given(axes=st.integers(2, 7), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None, derandomize=True)
def test_grids_are_continuous_over_cells_simplices_and_the_cubes_faces(axes, seed):
    """Just on both sides of a face between cells, of a diagonal that cuts a cell, and of the cube's own faces."""
    known, levels = on_grid(axes, seed, parts=2)
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.41, 0.49, (60, axes))
    i = rng.integers(axes, size=60)
    for k in range(60):
        if k % 3 == 0:
            x[k, i[k]] = levels[i[k]][1]
        elif k % 3 == 1:
            x[k, i[k]] = levels[i[k]][rng.choice([0, -1])]
        else:  # equal places within the cells of two axes
            j = (i[k] + 1) % axes
            share = rng.random()
            x[k, i[k]], x[k, j] = (levels[a][0] + share * (levels[a][1] - levels[a][0]) for a in (i[k], j))
    step = 1e-9 * np.eye(axes)[i]
    for kind in GRIDS:
        field = correction_field_methods_fitting_combination_and_json.fit_field(kind, known)
        assert np.abs(field.value(x + step) - field.value(x - step)).max() < 2e-9 * np.abs(known.values).max() / 0.002


def test_the_grid_agrees_with_scipy():
    known, levels = on_grid(4, 5)
    x = np.random.default_rng(0).uniform(0.42, 0.48, (100, 4))
    order = np.lexsort(known.configurations.T[::-1])
    other = RegularGridInterpolator(levels, known.values[order].reshape(*[len(level) for level in levels], 4))
    np.testing.assert_allclose(
        correction_field_methods_fitting_combination_and_json.fit_field("linear", known).value(x), other(x), atol=1e-17
    )


@pytest.mark.parametrize("kind", correction_field_methods_fitting_combination_and_json.METHODS)
@pytest.mark.parametrize("axes", [2, 3])
def test_every_kind_keeps_the_interface(kind, axes, tmp_path):
    """Shapes, the gradient against differences, an error that is met, continuity far beyond the samples, and the same
    from a file.
    """
    known, _ = on_grid(axes, 1, parts=3)
    known = FieldSamples(
        known.configurations, smooth(known.configurations), np.full(known.values.shape, 1e-12), known.strokes
    )
    field = correction_field_methods_fitting_combination_and_json.fit_field(kind, known)
    rng = np.random.default_rng(2)
    x = rng.uniform(0.38, 0.52, (40, axes))
    assert field.value(x.reshape(2, 20, axes)).shape == (2, 20, axes) and field.gradient(
        x.reshape(2, 20, axes)
    ).shape == (2, 20, axes, axes)
    assert field.inside(x.reshape(2, 20, axes)).shape == (2, 20) and field.value(x[0]).shape == (axes,)
    step = 1e-7 * np.eye(axes)
    numeric = np.stack([(field.value(x + h) - field.value(x - h)) / 2e-7 for h in step], axis=-1)
    off = np.abs(field.gradient(x) - numeric).max(axis=(1, 2))
    assert np.mean(off < 1e-6 + 1e-4 * np.abs(numeric).max()) > 0.95  # a step over a kink tells nothing
    inner = rng.uniform(0.43, 0.47, (200, axes))
    error = field.value(inner) - smooth(inner)
    assert np.abs(error).max() < 6e-5 and np.sqrt((error**2).mean()) < 4 * np.sqrt((field.error(inner) ** 2).mean())
    assert (field.error(np.full(axes, 0.6)) > field.error(inner).max(axis=0)).all()
    assert field.inside(inner).all() and not field.inside(np.full(axes, 0.6))
    far = 0.45 + np.linspace(0, 0.3, 30001)[:, None] * rng.normal(size=axes)
    assert np.abs(np.diff(field.value(far), axis=0)).max() < 1e-6 and np.isfinite(field.value(far)).all()
    tree = json.loads(json.dumps(correction_field_methods_fitting_combination_and_json.field_to_dict(field)))
    reloaded = correction_field_methods_fitting_combination_and_json.field_from_entries(
        Entries(tree, (), Path("c.json"), {(): (1, 1)}), axes
    )
    np.testing.assert_allclose(reloaded.value(x), field.value(x), atol=1e-18)
    np.testing.assert_allclose(reloaded.error(x), field.error(x), atol=1e-15)


@pytest.mark.parametrize("axes, count", [(2, 40), (3, 60), (6, 60)])
def test_scattered_samples_are_met_exactly_and_linear_functions_too(axes, count):
    known = scattered(axes, count, 3)
    field = correction_field_methods_fitting_combination_and_json.fit_field("delaunay", known)
    np.testing.assert_allclose(field.value(known.configurations), known.values, atol=1e-12)
    linear = correction_field_methods_fitting_combination_and_json.fit_field(
        "delaunay", FieldSamples(known.configurations, affine(known.configurations), known.variances, known.strokes)
    )
    inner = 0.5 * known.configurations[:20] + 0.5 * known.configurations[20:40]
    np.testing.assert_allclose(linear.value(inner), affine(inner), atol=1e-12)
    assert field.inside(inner).all()


def test_samples_on_a_grid_are_triangulated_though_they_lie_on_spheres():
    known, _ = on_grid(3, 7, parts=3)
    np.testing.assert_allclose(
        correction_field_methods_fitting_combination_and_json.fit_field("delaunay", known).value(known.configurations),
        known.values,
        atol=1e-12,
    )


def test_repeats_count_once_and_samples_beside_the_grid_are_left_out():
    known, _ = on_grid(3, 4, parts=2)
    rng = np.random.default_rng(0)
    extra = rng.uniform(0.42, 0.48, (9, 3))
    twice = FieldSamples(
        np.concatenate([known.configurations, known.configurations[:5], extra]),
        np.concatenate(
            [
                known.values - np.r_[np.full(5, 1e-5), np.zeros(len(known.values) - 5)][:, None],
                known.values[:5] + 1e-5,
                np.full((9, 3), 7.0),
            ]
        ),
        np.full((len(known.values) + 14, 3), 1e-14),
        known.strokes,
    )
    assert (grid_lattice_of_configurations(twice.configurations, twice.strokes).vertex[-9:] == -1).all()
    for kind in GRIDS:
        np.testing.assert_allclose(
            correction_field_methods_fitting_combination_and_json.fit_field(kind, twice).value(known.configurations),
            known.values,
            atol=1e-16,
        )
    assert len(merge_repeated_samples(twice).values) == len(known.values) + 9


@pytest.mark.parametrize("kind", GRIDS)
@pytest.mark.parametrize("axes, parts, lost", [(2, 2, 1), (3, 1, 1), (4, 2, 9), (6, 1, 5)])
def test_vertices_that_a_grid_lost_are_estimated_as_well_as_it_states(axes, parts, lost, kind):
    rng, noise, relative = np.random.default_rng(axes), 1e-7, []
    for _ in range(8):
        grid, _ = on_grid(axes, 4, parts=parts)
        gone = rng.permutation(len(grid.values))[:lost]
        values = smooth(grid.configurations) + noise * rng.normal(size=grid.values.shape)
        known = FieldSamples(grid.configurations, values, np.full(values.shape, noise**2), grid.strokes)
        some = known.take(np.setdiff1d(np.arange(len(values)), gone))
        lattice = grid_lattice_of_configurations(some.configurations, some.strokes)
        in_order = grid.configurations[gone][np.lexsort(grid.configurations[gone].T[::-1])]
        np.testing.assert_allclose(lattice.lost, in_order, atol=1e-9)
        field = correction_field_methods_fitting_combination_and_json.fit_field(kind, some)
        np.testing.assert_allclose(field.value(some.configurations), some.values, atol=1e-15)
        off = field.value(grid.configurations[gone]) - smooth(grid.configurations[gone])
        relative.append(off / field.error(grid.configurations[gone]))
    assert 0.4 < np.sqrt(np.mean(np.square(np.concatenate(relative)))) < 1.6


@pytest.mark.parametrize(
    "shape, lost", [((3, 2, 2), 1), ((4, 2), 1), ((3, 3), 1), ((3, 2, 2, 2, 2, 2), 1), ((5, 4, 2), 4), ((2, 2, 2), 1)]
)
def test_no_level_of_a_grid_goes_with_the_vertices_that_it_lost(shape, lost):
    rng, strokes = np.random.default_rng(3), np.tile([0.0, 1.0], (len(shape), 1))
    every = np.stack(np.meshgrid(*[np.linspace(0.1, 0.9, n) for n in shape], indexing="ij"), -1).reshape(-1, len(shape))
    beside = rng.uniform(0.15, 0.85, (2, len(shape)))  # on no level
    for _ in range(12):
        gone = rng.permutation(len(every))[:lost]
        found = grid_lattice_of_configurations(np.r_[np.delete(every, gone, axis=0), beside], strokes)
        assert tuple(map(len, found.levels)) == shape and (found.vertex[-2:] == -1).all()
        np.testing.assert_allclose(found.lost, every[np.sort(gone)], atol=1e-12)


def test_samples_that_share_many_levels_and_fill_no_grid_are_refused_at_once():
    many = np.random.default_rng(2).integers(0, 40, (900, 6)) / 40
    assert grid_lattice_of_configurations(many, np.tile([0.0, 1.0], (6, 1))) is None


def test_a_grid_that_lacks_a_quarter_of_its_vertices_is_refused_by_name():
    known, _ = on_grid(3, 4, parts=2)
    with pytest.raises(RigError, match="fill no grid.*delaunay"):
        correction_field_methods_fitting_combination_and_json.fit_field(
            "simplex", known.take(np.arange(7, len(known.values)))
        )
    with pytest.raises(RigError, match="'cubic'"):
        correction_field_methods_fitting_combination_and_json.fit_field("cubic", known)


@pytest.mark.parametrize(
    "spoil, says",
    [
        (lambda tree: tree["levels"][0].reverse(), "increasing"),
        (lambda tree: tree["values"].pop(), "must have 27x|27 vertices|entries"),
        (lambda tree: tree["levels"].pop(), "3 axes"),
        (lambda tree: tree.update(kind="cubic"), "cubic"),
        (lambda tree: tree.pop("misfit"), "misfit"),
    ],
)
def test_what_is_no_field_is_refused_with_its_place(spoil, says):
    known, _ = on_grid(3, 4, parts=2)
    tree = json.loads(
        json.dumps(
            correction_field_methods_fitting_combination_and_json.field_to_dict(
                correction_field_methods_fitting_combination_and_json.fit_field("simplex", known)
            )
        )
    )
    spoil(tree)
    with pytest.raises(FileError, match=says):
        correction_field_methods_fitting_combination_and_json.field_from_entries(
            Entries(tree, ("extension",), Path("c.json"), {(): (1, 1)}), 3
        )


def test_divisions_are_even_or_not_whole_strokes_or_less(tmp_path):
    even = divided_grid_configurations(strokes(3), "2x1x3@0.5")
    assert len(even) == 3 * 2 * 4 and np.allclose(np.unique(even[:, 0].round(9)), [0.425, 0.45, 0.475])
    assert (np.abs(np.diff(even, axis=0)) > 1e-12).sum(axis=1).max() == 1
    path = tmp_path / "levels.csv"
    path.write_text("axis,level\n1,0.41\n1,0.42\n1,0.49\n2,0.4\n2,0.5\n")
    assert np.unique(divided_grid_configurations(strokes(2), str(path))[:, 0]).tolist() == [0.41, 0.42, 0.49]
    for text in ("2x2", "0", "2@1.5", "2@x", "two"):
        with pytest.raises(RigError, match="a division is"):
            divided_grid_configurations(strokes(3), text)
    for rows, says in (
        ("1,0.41\n1,0.42\n2,0.4\n", "axis 2 must have two"),
        ("1,0.41\n1,0.6\n2,0.4\n2,0.5\n", "beyond its stroke"),
        ("1,0.41\n1,0.42\n2,0.4\n2,0.5\n3,0.4\n", "no axis 3"),
    ):
        path.write_text("axis,level\n" + rows)
        with pytest.raises(FileError, match=says):
            divided_grid_configurations(strokes(2), str(path))


def test_a_compiled_fixed_point_is_the_one_that_iteration_finds(design):
    from calib.correction.machine_correction import Correction
    from tests.calib.noisy_samples import workspace

    m = design.mechanism
    levels = [np.linspace(low, high, 3) for low, high in m.strut_range]
    rng = np.random.default_rng(1)
    values = 5e-5 * rng.normal(size=(729, 6))
    field = correction_field_methods_fitting_combination_and_json.METHODS["simplex"](
        tuple(levels), values, np.zeros(values.shape), np.zeros(6)
    )
    wanted = workspace(design, 200)
    commands = Correction(m, m, (None,) * 6, extension=field).inverse(wanted)
    np.testing.assert_allclose(
        commands, Correction(m, m, (None,) * 6).inverse(wanted) + field.value(commands), atol=1e-12
    )
    with pytest.raises(NotConverged):
        wild = correction_field_methods_fitting_combination_and_json.METHODS["simplex"](
            tuple(levels), 1e4 * values, np.zeros(values.shape), np.zeros(6)
        )
        Correction(m, m, (None,) * 6, extension=wild).inverse(wanted)
