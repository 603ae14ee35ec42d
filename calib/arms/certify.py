"""What an arm's calibration promises: fitted on all samples, its figures from whole stretches that were held out in turn."""

from dataclasses import dataclass, replace

import numpy as np

from calib.arms import model, profile
from calib.arms.correction import ArmCorrection
from calib.arms.identify import Identified, identify
from calib.arms.observations import of_samples
from calib.arms.place import placed
from calib.certificate import GAIN, HeldOut, compare, correlation, errors_of
from calib.samples import blocks

STRETCHES = 30  # in time; every third is held out at once, so a third of the samples, and each sample once
PARTS = 3
ROUNDS = 2  # of fitting the geometry and the profiles in turn


@dataclass(frozen=True, slots=True, eq=False)
class Certified:
    """correction : ArmCorrection of all samples; found : Identified, its geometry
    held_out : HeldOut on whole stretches; scattered : the same on single rows drawn at random, which flatter, since
    neighbours in time share their errors; geometry : on whole stretches, by the geometry alone"""

    correction: ArmCorrection
    found: Identified
    held_out: HeldOut
    scattered: HeldOut
    geometry: HeldOut


def certify(samples, nominal, instrument, rng):
    """Certified : geometry and joint profiles of an arm, the profiles only where they pay on held-out stretches.

    samples : Samples; nominal : Arm as its owner believes it; instrument : Instrument or None (poses in the rig's own frames)
    rng : numpy Generator, for the random rows and the bootstrap. Raises NotEnoughData, RigError as `calibrate`
    """
    stretches = blocks(len(samples), min(STRETCHES, len(samples))) % PARTS
    start = start_of(of_samples(samples), nominal, instrument)  # a basin, not a fit: the folds' own fits forget it
    plain, full = [_held_out(samples, nominal, instrument, (stretches, start), profiles) for profiles in (False, True)]
    scale = _spread(plain[1])
    gain = [np.nansum((e / scale) ** 2, axis=1) for e in (plain[1], full[1])]
    gain = gain[0] - gain[1]
    pays = bool(gain.mean() > GAIN * gain.std() / np.sqrt(len(gain) / correlation(gain)))
    rows = rng.permutation(np.arange(len(samples)) % PARTS)
    scattered = _held_out(samples, nominal, instrument, (rows, start), pays)
    correction, found = calibrate(samples, nominal, instrument, pays, start)
    covariance = samples.total_covariance()
    held = [compare(*errors, covariance, rng) for errors in (full if pays else plain, scattered, plain)]
    return Certified(correction, found, *held)


def calibrate(samples, nominal, instrument, profiles, start=None):
    """(ArmCorrection, Identified) of samples; profiles : whether joint profiles are fitted on top of the geometry.

    start : Arm, as `start_of` has it where None. Raises what `identify` raises
    """
    observations = of_samples(samples)
    start = start_of(observations, nominal, instrument) if start is None else start
    owners = owners_model(observations, nominal, instrument, start)
    found = identify(observations, start)
    parts = (None,) * len(nominal.joints)
    for _ in range(ROUNDS if profiles else 0):
        left = observations.residuals(found.arm) - np.einsum("mkj,j->mk", observations.common, found.shared)
        parts = profile.fit(observations, replace(found, residuals=left))
        if not any(parts):
            break
        effective = observations.q - ArmCorrection(owners, owners, parts, observations.q).rho(observations.q)
        found = identify(replace(observations, q=effective), found.arm)
    return ArmCorrection(owners, found.arm, parts, observations.q), found


def start_of(observations, nominal, instrument):
    """The Arm from which a fit starts: nominal, with the instrument's free places as the observations have them, and zeros moved along."""
    if instrument is None:
        return nominal
    return placed(observations, nominal, instrument.base == "free", instrument.tool == "free")


def owners_model(observations, nominal, instrument, start):
    """The nominal Arm, standing and holding its target where the instrument's free places put it; nothing else is fitted.

    start : Arm of `start_of`"""
    if instrument is None or "free" not in (instrument.base, instrument.tool):
        return nominal
    free = np.zeros(12 + 5 * len(nominal.joints), bool)
    free[:6], free[-6:] = instrument.base == "free", instrument.tool == "free"
    return identify(observations, replace(nominal, base=start.base, tool=start.tool), free, np.inf).arm


def model_covariance(calibration, commands):
    """(m, 6, 6) covariance of the corrected arm's pose at commands (m, joints) rad: the parameters' and what the model leaves."""
    J = model.parameter_jacobian(commands, calibration.correction.fitted)
    known = np.arange(6) < len(calibration.scatter)  # of rotations that were never measured, nothing is known beyond the parameters
    return J @ calibration.covariance @ np.swapaxes(J, 1, 2) + np.diag(np.resize(calibration.scatter, 6) ** 2 * known)


def _held_out(samples, nominal, instrument, plan, profiles):
    part, start = plan
    before, after = np.empty((len(samples), 6)), np.empty((len(samples), 6))
    for k in np.unique(part):
        correction, _ = calibrate(samples.take(part != k), nominal, instrument, profiles, start)
        before[part == k], after[part == k] = errors_of(correction, samples.take(part == k))
    return before, after


def _spread(errors):
    """(6,) a robust scale of positions and of rotations, for comparing two fits."""
    return np.repeat([np.median(np.abs(errors[:, part])) for part in (slice(0, 3), slice(3, 6))], 3) + 1e-15
