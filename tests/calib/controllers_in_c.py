"""Calibrations of many kinds, and controllers compiled from their C files, for tests against `rig correct`."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from calib.certification.calibration_dataclass_and_claim_sentences import Calibration
from calib.correction.correction_field_methods_fitting_combination_and_json import (
    correction_with_pose_space_map,
    fit_field,
    home_pose,
)
from calib.correction.hexapod_correction_c_source_and_shared_c_file_parts import correction_c_source
from calib.correction.interpolation.gaussian_process_interpolation import fit_gaussian_process
from calib.correction.interpolation.interpolation_field_interface_samples_and_combinations import (
    FieldSamples,
    RestrictedMap,
    SpacePart,
    SummedPasses,
)
from calib.correction.machine_correction import Correction
from calib.models.arm.arm_calibration_page_and_c_source import arm_correction_c_source
from calib.models.arm.arm_correction import ArmCorrection
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.model.mechanisms import hexapod
from rig.model.pose import pose, pose_to_vector
from rig.planning import configuration_generators
from rig.recording.recording_folder import Sensors
from synthetic import random_true_machine_and_truth_file
from tests.calib.correction.test_physics import physics_of

COMPILER = shutil.which("cc")
needs_compiler = pytest.mark.skipif(
    COMPILER is None, reason="no C compiler cc here, and nothing else proves the C file"
)
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-Wmissing-prototypes", "-Wshadow")
LONGEST = 20e-6  # s of the slowest pose, by the fastest of several calls, where no sum over samples is taken
OK, BAD_POSE, OUT_OF_STROKE, NOT_CONVERGED, SENSOR_MISSING, NO_STATE = range(6)
WARM = {f"strut{i + 1}_temperature_C": 20.0 + 1.5 * i for i in range(6)} | {"ambient_temperature_C": 24.0}
LOOP = r"""
#define _POSIX_C_SOURCE 199309L
#include "correction.c"
#include <time.h>

int poses(const double *pose, const double *channels, struct rig_state *state, double *lengths, int *status, int n);
double slowest(const double *pose, const double *channels, struct rig_state *state, int n, double limit, double *mean);

int poses(const double *pose, const double *channels, struct rig_state *state, double *lengths, int *status, int n)
{
    int worst = 0;
    for (int i = 0; i < n; i++) {
        status[i] = rig_correct(pose + RIG_AXES * i, channels, state, lengths + RIG_AXES * i);
        worst = status[i] > worst ? status[i] : worst;
    }
    return worst;
}

/* s, of the slowest pose and in the mean; of five calls each the fastest counts, as the machine runs other programs,
   and of up to a thousand where none of five took less than `limit` s. */
double slowest(const double *pose, const double *channels, struct rig_state *state, int n, double limit, double *mean)
{
    double most = 0.0, total = 0.0, lengths[RIG_AXES];
    for (int i = 0; i < n; i++) {
        const struct rig_state before = *state;
        double least = HUGE_VAL;
        for (int k = 0; k < 5 || (k < 1000 && least >= limit); k++) {
            struct timespec begin, end;
            *state = before;
            clock_gettime(CLOCK_MONOTONIC, &begin);
            rig_correct(pose + RIG_AXES * i, channels, state, lengths);
            clock_gettime(CLOCK_MONOTONIC, &end);
            least = fmin(least, (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec));
        }
        most = fmax(most, least);
        total += least;
    }
    *mean = total / n;
    return most;
}
"""


def c_text(calibration):
    """Text of the C file of a calibration."""
    arm = isinstance(calibration.correction, ArmCorrection)
    source = arm_correction_c_source if arm else correction_c_source
    return source(calibration.correction, calibration.physics, "rig 1.2.3").text


def compiled_library(folder, name, *sources, include=()):
    """The library NAME.so of C sources in a folder, loaded. include : further options"""
    done = subprocess.run(
        [COMPILER, *FLAGS, *include, "-shared", "-fPIC", *sources, "-o", f"{name}.so", "-lm"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / f"{name}.so"))


class Controller:
    """The C file of a calibration, compiled. channels : names in their order; state : as C holds it, or None"""

    def __init__(self, calibration, folder, start=None, stateless=False):
        self.text = c_text(calibration)
        (folder / "correction.c").write_text(self.text)
        alone = subprocess.run(
            [COMPILER, *FLAGS, "-c", "correction.c", "-o", "correction.o"], cwd=folder, capture_output=True, text=True
        )
        assert alone.returncode == 0, alone.stderr
        (folder / "loop.c").write_text(LOOP)
        self.library = compiled_library(folder, "loop", "loop.c")
        self.library.slowest.restype = ctypes.c_double
        self.channels = re.findall(r"channels\[\d+\] (\w+)", self.text)
        self.state = None if stateless else np.full(2 * len(calibration.correction.nominal.axes), np.nan)
        if not stateless:
            assert self.start(start) == OK

    def start(self, lengths=None):
        """Status of standing at lengths (axes,) m or rad, or home."""
        given = None if lengths is None else np.ascontiguousarray(lengths)
        return self.library.rig_start(pointer(self.state), pointer(given))

    def took(self, T, limit=np.inf):
        """(slowest, mean) s a pose (n,), or joint values (n, axes). limit : s, above which more calls are timed"""
        values, mean = np.array([WARM[name] for name in self.channels] or [0.0]), np.zeros(1)
        vectors = np.ascontiguousarray(T if isinstance(T, np.ndarray) else pose_to_vector(T))
        states = map(pointer, (vectors, values, self.state))
        most = self.library.slowest(*states, len(vectors), ctypes.c_double(limit), pointer(mean))
        return most, mean.item()

    def __call__(self, T, sensors=None):
        """(commands (n, axes) m or rad, status (n,)) of poses (n,), or of an arm's joint values (n, axes).

        sensors : {channel: value}, None to pass none
        """
        wanted = np.ascontiguousarray(T if isinstance(T, np.ndarray) else pose_to_vector(T).reshape(-1, 6))
        values = None if sensors is None else np.array([sensors[name] for name in self.channels] or [0.0])
        lengths, status = np.full(wanted.shape, np.nan), np.zeros(len(wanted), np.int32)
        self.library.poses(*map(pointer, (wanted, values, self.state, lengths, status)), len(wanted))
        return lengths, status


def pointer(array):
    return None if array is None else ctypes.c_void_p(array.ctypes.data)


def summand(design, x):
    """(n, 6) m: a smooth summand of some 40 um, with more along each strut's own command."""
    low, high = design.mechanism.strut_range.T
    u = (2 * x - low - high) / (high - low)
    return 2e-5 * np.sin(2 * u + u[:, ::-1]) + 1e-5 * u[:, [1, 2, 3, 4, 5, 0]] ** 2


def field_samples(design, kind):
    """FieldSamples of that summand over the inner 80 % of the strokes, on a grid where a kind takes one."""
    strokes = design.mechanism.strut_range + 0.1 * np.ptp(design.mechanism.strut_range, axis=1)[:, None] * [1, -1]
    if kind in ("simplex", "linear"):
        x = np.stack(np.meshgrid(*np.linspace(strokes[:, 0], strokes[:, 1], 3, axis=1), indexing="ij"), -1)
        x = x.reshape(-1, 6)
    else:
        x = configuration_generators.sobol_configurations(strokes, 120, 1.0, 5)
    return FieldSamples(x, summand(design, x), np.full(x.shape, 1e-14), strokes)


def fitted(design, seed=4):
    """A Correction whose geometry is another than the nominal one."""
    true = random_true_machine_and_truth_file.random_true_machine(design, np.random.default_rng(seed)).true.mechanism
    return Correction(design.mechanism, true, (None,) * 6)


def calibration_of(correction, physics=None):
    return Calibration(correction, 1e-14 * np.eye(42), np.zeros(6), (), (), None, {}, None, physics)


def restricted(design):
    """Two passes, the second over a part of one strut's stroke."""
    low, high = design.mechanism.strut_range[2]
    bounds = np.full((2, 6), np.inf) * [[-1], [1]]
    bounds[:, 2] = low + 0.3 * (high - low), low + 0.6 * (high - low)
    first = fit_field("linear", field_samples(design, "linear"))
    second = fit_field("axes", field_samples(design, "axes"))
    return SummedPasses((first, RestrictedMap(second, SpacePart(*bounds))))


def pose_map(design, kind, amplitude=3e-5):
    """A field in pose space, of some 30 um and 30 urad."""
    home = home_pose(design.mechanism)
    size = np.array([0.05] * 3 + [0.15] * 3)
    u = configuration_generators.sobol_configurations(np.tile([-1.0, 1.0], (6, 1)), 150, 1.0, 8)
    x = u * size + np.r_[home.translation, np.zeros(3)]
    values = amplitude * np.sin(2 * u + u[:, ::-1])
    return fit_field(kind, FieldSamples(x, values, np.full(x.shape, 1e-14), np.stack([x.min(0), x.max(0)], 1)))


def remainder(design):
    """A Correction whose struts 2 and 5 have a Gaussian process each."""
    known, start = field_samples(design, "radial"), fitted(design)
    parts = [
        fit_gaussian_process(known.configurations, known.values[:, i], known.variances[:, i], i, known.strokes)
        if i in (1, 4)
        else None
        for i in range(6)
    ]
    return replace(start, remainder=tuple(parts))


def effects(design, *texts):
    return physics_of(design, *[parse_effect(text) for text in texts])


BACKLASH = ("backlash:strut1:gap=8e-5", "backlash:strut4:gap=3e-5")
THERMAL = ("thermal_expansion:rig:coefficient=1.2e-5", "base_expansion:rig:coefficient=2e-5")
CALIBRATIONS = {
    "plain": lambda design: calibration_of(fitted(design)),
    "simplices": lambda design: calibration_of(
        replace(fitted(design), extension=fit_field("simplex", field_samples(design, "simplex")))
    ),
    "backlash": lambda design: calibration_of(fitted(design), effects(design, *BACKLASH)),
    "thermal": lambda design: calibration_of(fitted(design), effects(design, *THERMAL)),
    "all": lambda design: calibration_of(remainder(design), effects(design, *BACKLASH, *THERMAL)),
    "linear and part": lambda design: calibration_of(replace(fitted(design), extension=restricted(design))),
    **{
        kind: lambda design, kind=kind: calibration_of(
            replace(fitted(design), extension=fit_field(kind, field_samples(design, kind)))
        )
        for kind in ("axes", "radial", "polynomial")
    },
    "pose maps": lambda design: calibration_of(
        correction_with_pose_space_map(
            correction_with_pose_space_map(remainder(design), pose_map(design, "polynomial")),
            pose_map(design, "radial"),
        )
    ),
}


def wanted(design, count, seed=11, fill=0.9):
    """Poses (count,) all over the workspace, as numbers of a file have them: vectors there and back."""
    lengths = configuration_generators.sobol_configurations(design.mechanism.strut_range, count, fill, seed)
    found = pose_to_vector(hexapod.forward(lengths, design.mechanism))
    return pose(found[:, :3], found[:, 3:])


def sensors_of(calibration):
    return None if calibration.physics is None else Sensors(np.zeros(1), {k: np.array([v]) for k, v in WARM.items()})
