"""Correction values as data: read back as a controller reads them, they correct as `rig correct` does."""

from dataclasses import replace

import numpy as np
import pytest

from calib.correction import correction_field_methods_fitting_combination_and_json
from calib.correction.correction_field_methods_fitting_combination_and_json import measured_correction_summands
from calib.correction.correction_tables import (
    axis_correction_tables,
    correction_summand_column_names,
    correction_summand_csv_rows,
    grid_commands_and_corrections,
    strut_correction_summands,
)
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import FieldSamples
from calib.correction.machine_correction import Correction
from rig.formats.exporters import json_csv_linuxcnc_and_camera_file_exports
from rig.model.mechanisms import hexapod
from rig.planning.configuration_generators import sobol_configurations
from tests.calib.noisy_samples import real, sampled


@pytest.fixture(scope="module")
def additive(design):
    """A Correction whose struts each have an error of their own position, on top of a fitted geometry."""
    m = design.mechanism
    x = sobol_configurations(m.strut_range, 300, 1.0, 3)
    values = 5e-5 * np.sin((x - m.strut_range.mean(axis=1)) / 0.02)
    field = correction_field_methods_fitting_combination_and_json.fit_field(
        "axes", FieldSamples(x, values, np.full(values.shape, 1e-14), m.strut_range)
    )
    return Correction(m, replace(m, strut_zeros=m.strut_zeros + 3e-4), (None,) * 6, extension=field)


def by_linuxcnc(text, position):
    """Motor positions that LinuxCNC makes of joint positions going up: its table's nominal less actual, by straight
    lines, added.
    """
    nominal, up, down = np.array([[float(cell) for cell in line.split()] for line in text.splitlines()]).T
    assert (up == down).all() and len(nominal) <= 256
    return position + np.interp(position, nominal, nominal - up)


@pytest.mark.parametrize("units", ["mm", "m"])
def test_joint_tables_read_back_as_linuxcnc_reads_them_correct_as_we_do(additive, design, units):
    found = axis_correction_tables(additive, 256)
    assert (found.left < 2e-7).all()
    wanted = sobol_configurations(design.mechanism.strut_range, 60, 0.7, 5)
    T = hexapod.forward(wanted, additive.fitted)
    commands, scale, zeros = (
        additive.inverse(T),
        json_csv_linuxcnc_and_camera_file_exports.SCALE[units],
        additive.fitted.strut_zeros,
    )
    for i in range(6):
        text = json_csv_linuxcnc_and_camera_file_exports.linuxcnc_compensation_file(
            found.levels[i] + zeros[i], found.trims[i], units
        )
        corrected = by_linuxcnc(text, (wanted[:, i] + zeros[i]) * scale) / scale - zeros[i]
        np.testing.assert_allclose(corrected, commands[:, i], atol=3e-7)
        assert np.abs(wanted[:, i] - commands[:, i]).max() > 1e-5


def test_a_table_for_each_joint_says_what_it_cannot_hold(design):
    m = design.mechanism
    x = sobol_configurations(m.strut_range, 300, 1.0, 3)
    values = np.zeros(x.shape)
    values[:, 1] = 1e-3 * (x[:, 0] - m.strut_range[0].mean())
    field = correction_field_methods_fitting_combination_and_json.fit_field(
        "polynomial", FieldSamples(x, values, np.full(x.shape, 1e-14), m.strut_range)
    )
    found = axis_correction_tables(Correction(m, m, (None,) * 6, extension=field), 9)
    assert found.left[1] > 1e-5 and np.delete(found.left, 1).max() < 1e-9


def test_a_grid_read_back_gives_the_commands(additive, design):
    m = design.mechanism
    text = json_csv_linuxcnc_and_camera_file_exports.correction_grid_csv(
        *grid_commands_and_corrections(additive, 2), m.axes, "m"
    )
    lines = text.splitlines()
    comments, header = (
        [line for line in lines if line.startswith("#")],
        next(line for line in lines if not line.startswith("#")),
    )
    assert "command = x + k" in comments[0] and "unit of both m" in comments[0]
    assert header.split(",") == [*(f"x_{a}" for a in m.axes), *(f"k_{a}" for a in m.axes)]
    rows = np.array([[float(cell) for cell in line.split(",")] for line in lines[len(comments) + 1 :]])
    assert len(rows) == 3**6 and rows[1, 5] != rows[0, 5]
    T = hexapod.forward(rows[:, :6], m)
    np.testing.assert_allclose(rows[:, :6] + rows[:, 6:], additive.inverse(T), atol=2e-12)


def test_ksf_rows_are_commanded_less_what_was_measured_with_its_covariance(design):
    samples, true = sampled(design, 1, 200, own=np.array([5e-6] * 3 + [5e-5] * 3))
    columns = correction_summand_column_names(6)
    rows = np.array(
        [
            [float(cell) for cell in line.split(",")]
            for line in correction_summand_csv_rows(samples, strut_correction_summands(samples, design.mechanism))
        ]
    )
    assert rows.shape == (200, len(columns)) and len(columns) == 1 + 18 + 21
    x, y, k = rows[:, 1:7], rows[:, 7:13], rows[:, 13:19]
    np.testing.assert_allclose(k, x - y, atol=2e-12)
    np.testing.assert_allclose(k, measured_correction_summands(samples, design.mechanism).values, atol=1e-12)
    exact = x - hexapod.inverse(real(samples.commanded, true), design.mechanism)
    C = np.zeros((200, 6, 6))
    C[:, *np.triu_indices(6)] = rows[:, 19:]
    C = C + np.swapaxes(np.triu(C, 1), 1, 2)
    square = np.einsum("ni,nij,nj->n", k - exact, np.linalg.inv(C), k - exact)
    assert 5 < square.mean() < 7  # six numbers each
