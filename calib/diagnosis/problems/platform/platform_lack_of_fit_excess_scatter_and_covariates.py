"""Lack of fit of a platform, excess scatter, and ranking of covariates.

Smooth functions, excess scatter, covariates of the rest.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np
import scipy

from calib.diagnosis.engine.cross_validation_and_chance_probabilities import scan_p_value
from calib.diagnosis.engine.lack_of_fit_tests_excess_scatter_and_covariate_ranking import (
    ALPHA,
    LIKELY,
    MATERIAL,
    Covariate,
    LackOfFit,
    Share,
    Test,
    detect_excess_scatter,
    rank_covariates,
    share_explained_by_functions,
    significant_lack_of_fit,
    test_lack_of_fit,
)
from calib.diagnosis.engine.least_squares_with_nuisances_eliminated_by_frame import (
    FrameProducts,
    solve_normal_equations,
)
from calib.diagnosis.problems.covariate_functions_smoothed_temperatures_and_repeats import (
    separate_weights_for_each_direction,
    smooth_functions_of_axis_motion,
    smooth_functions_of_time_and_sensors,
)
from calib.diagnosis.problems.platform.effect_candidates_and_sensitivities import effect_context, lacks_temperature_log
from calib.diagnosis.problems.platform.linearisation_operating_point import OperatingPoint
from calib.diagnosis.problems.platform.linearised_corner_and_closure_residuals import CLOSURES, CORNERS, LinearisedModel
from calib.diagnosis.problems.platform.linearised_corners import MEDIAN, edge_shift_pixel_derivatives
from calib.diagnosis.problems.platform.platform_candidate_chi_square_scores import (
    axis_elongation_inner_products,
    constant_displacement_normal_equations,
    corner_displacement_normal_equations_by_frame,
)
from calib.diagnosis.problems.platform.smooth_function_columns_of_struts_cameras_and_markers import (
    FAST,
    SLOW,
    camera_mount_and_focal_pixel_derivatives,
    corner_rows_and_shift_pixel_derivatives,
    image_warp_pixel_derivatives,
    mount_and_focal_length_time_cosines,
    strut_deviation_basis_functions_by_covariate,
)
from rig.array_and_json_types import Floats, Integers
from rig.compute.parallel_map_and_dask_cluster import parallel_map
from rig.effects.catalogue.effect_list import ALL
from rig.effects.framework.effect_base_class import Effect
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.mechanisms.mechanism_kinds_and_kinematics import geometric_parameters

MEDIAN_SPREAD = (
    5.6  # variance of a sample's middle square over its square, times the sample's size, for normal residuals
)
FAR = 5.0  # standard deviations; a residual counts for no more where neighbours are compared
MIDDLE = 5.6 / 2  # a middle square has so many times the variance of a mean square over as many numbers
MATERIAL_OF_UNLIKE_ERRORS = 1.5  # times the noise, where corner errors are not equal and independent
STRUTS, IMAGES = "struts", "images"


def is_lack_of_fit_at_place(lack: LackOfFit, place: Place) -> bool:
    """Whether a LackOfFit is at a place.

    It may be at a part of it.
    """
    moved = Place("rig") if place.kind == "clock" else place  # a clock moves all axes
    return moved.includes(lack.place) or place.includes(lack.place)


def find_lack_of_fit_by_place(
    model: LinearisedModel, place: Place | None = None, alpha: float = ALPHA
) -> list[LackOfFit]:
    """Find lack of fit ([LackOfFit]) at each place.

    It is of the residuals, the most significant first.
    place : where alone they are asked, None for everywhere; alpha : chance of any where there is nothing
    """
    k = model.point
    requested: list[Callable[[], list[LackOfFit | None]]] = [partial(_struts, model)] if k.axes else []
    if k.seen is not None:
        requested += [partial(_camera, model, i) for i in range(len(k.design.cameras))]
        ids, counts = np.unique(k.observed.markers.id[k.observed.sightings.marker], return_counts=True)
        edges = edge_shift_pixel_derivatives(k)
        requested += [
            partial(_marker, model, edges, number, count) for number, count in zip(ids.tolist(), counts.tolist())
        ]
    found = [u for several in parallel_map(lambda question: question(), requested) for u in several]
    return significant_lack_of_fit(
        [u for u in found if u is not None and (place is None or is_lack_of_fit_at_place(u, place))], alpha
    )


def _struts(model: LinearisedModel) -> list[LackOfFit | None]:
    k = model.point
    products = axis_elongation_inner_products(model)
    each = np.einsum("fii->i", products.gamma)
    out = [
        test_lack_of_fit(
            model.linear, products, Test(place, k.axis_unit, (depends,), weights, each[weights.any(axis=(0, 2))].sum())
        )
        for depends, strutwise in strut_deviation_basis_functions_by_covariate(k)
        for place, weights in strutwise
    ]
    inverse, own = np.linalg.inv(model.closures.W), model.strut_noise()
    left = (inverse @ model.closure_residual[: len(k.t) * k.axes].reshape(len(k.t), k.axes, 1))[..., 0]
    following = np.clip(left / np.sqrt(own), -FAR, FAR)[np.argsort(k.t)]
    for i in range(k.axes):
        alike = float(following[1:, i] @ following[:-1, i])
        size = np.sqrt(max(alike, 0) / len(k.t) * own[:, i].mean())
        out.append(
            LackOfFit(
                k.places[i],
                float(size),
                k.axis_unit,
                ("order",),
                float(scipy.special.ndtr(-(alike / np.sqrt(len(k.t) - 1)))),
                max(alike, 0.0),
            )
        )
    scatter = model.closures.scatter
    for i in np.flatnonzero(scatter > 0).tolist():
        noise = own[:, i].mean() - scatter[i] ** 2
        middle = np.median(left[:, i] ** 2) / MEDIAN / noise - 1  # a few wild frames are no scatter
        ratio = middle * np.sqrt(len(k.t) / MEDIAN_SPREAD)
        if ratio > 0:
            out.append(
                LackOfFit(
                    k.places[i], float(scatter[i]), k.axis_unit, (), float(scipy.special.ndtr(-ratio)), float(ratio**2)
                )
            )
    return out


def _camera(model: LinearisedModel, i: int) -> list[LackOfFit | None]:
    k, camera = model.point, model.point.design.cameras[i]
    count = np.count_nonzero(k.observed.observations.camera == i)
    if not count:
        return []
    out: list[LackOfFit | None] = []
    at, information = Place("camera", camera.name), count / model.corner_noise() ** 2
    if i not in k.moving:
        products = corner_displacement_normal_equations_by_frame(
            model, camera_mount_and_focal_pixel_derivatives(model, at)
        )
        out += [
            test_lack_of_fit(
                model.linear,
                products,
                Test(at, "px", ("time",), mount_and_focal_length_time_cosines(k, count)[:, :, part], information),
            )
            for count in (SLOW, FAST)
            for part in _apart(k, at, count)
        ]
        out.append(_following(products, np.argsort(k.t), at, information))
    if not any(e.warps and e.site == at for e in k.effects):  # else what its image still bends by belongs to that lens
        seen = np.flatnonzero(k.observed.observations.camera == i)
        out.append(_still(model, seen, image_warp_pixel_derivatives(k, i)[seen], at, "image position", information))
    return out


def _apart(k: OperatingPoint, place: Place, count: int) -> list[slice]:
    """Which of the functions of `mount_and_focal_length_time_cosines` at a camera are tested together: a mount's
    motion and the focal length each for itself, but all together
    where an admitted effect moves the focal length, or one would by a temperature that was not logged: by what a log
    does not tell it comes and goes in time."""
    known = any(type(e).focal is not Effect.focal and e.at(place) for e in k.effects)
    if known or any(
        kind.focal is not Effect.focal and lacks_temperature_log(k, kind.follows(str(place), effect_context(k)))
        for kind in ALL
    ):
        return [slice(None)]
    return [slice(6 * count), slice(6 * count, None)]


def _marker(model: LinearisedModel, edges: Floats, number: int, count: int) -> list[LackOfFit | None]:
    """Of a marker seen so many times. edges : see `edge_shift_pixel_derivatives`

    What comes back in every frame where nothing moves is the corner finder's own error. It is not the same in a moving
    marker's views, and is taken as random between markers (DerSimonian and Laird, Controlled clinical trials 7, 1986).
    """
    hit, moved = corner_rows_and_shift_pixel_derivatives(model.point, edges, number)
    of_a_corner = count / model.corner_noise() ** 2
    found = _still(model, hit, moved, Place("marker", str(number)), "place on the marker", 4 * of_a_corner)
    if found is None or not model.point.standing:
        return [found]
    larger = 1 + model.point.standing**2 * of_a_corner
    delta = found.delta_chi2 / larger
    chance = max(found.p_value, scan_p_value(np.array([delta]), found.freedom, np.inf))
    return [replace(found, delta_chi2=delta, dispersion=(found.dispersion or 1.0) * larger, p_value=chance)]


def _still(
    model: LinearisedModel, hit: Integers, moved: Floats, place: Place, depends: str, information: float
) -> LackOfFit | None:
    """LackOfFit of displacements (h, 2, q) px of observed corners (h,) that are the same in every frame; where they are
    likely by chance, as without dispersion."""
    solved = solve_normal_equations(constant_displacement_normal_equations(model, hit, moved))
    delta, rank = float(solved.delta_chi2[0]), int(solved.rank[0])
    chance = scan_p_value(solved.delta_chi2, rank, np.inf)
    if rank and chance > LIKELY:
        return LackOfFit(
            place, float(np.sqrt(max(delta - rank, 0.0) / information)), "px", (depends,), chance, delta, rank, 1.0
        )
    pixels = np.zeros((len(model.point.observed.row), *moved.shape[1:]))
    pixels[hit] = moved
    products = corner_displacement_normal_equations_by_frame(model, pixels)
    weights = np.broadcast_to(np.eye(products.beta.shape[1]), products.gamma.shape)
    return test_lack_of_fit(model.linear, products, Test(place, "px", (depends,), weights, information))


def _following(products: FrameProducts, order: Integers, place: Place, information: float) -> LackOfFit:
    """LackOfFit of a camera that moves in any way by which exposures that follow each other look alike."""
    beta, gamma = products.beta[order], products.gamma[order]
    scale = np.sqrt(np.maximum(np.einsum("faa->a", gamma), 1e-300))
    beta, gamma = beta / scale, gamma / scale[:, None] / scale
    M = np.linalg.pinv(gamma.mean(axis=0), rcond=1e-6, hermitian=True)
    each = np.einsum("fa,ab,fb->f", beta[1:], M, beta[:-1])
    alike = float(each.sum())
    chance = np.sqrt(np.einsum("ab,fbc,cd,fda->", M, gamma[1:], M, gamma[:-1], optimize=True))
    chance = max(chance, np.sqrt((each**2).sum()))  # the second counts the errors as large as they are
    p = float(scipy.special.ndtr(-(alike / max(chance, 1e-300))))
    return LackOfFit(place, float(np.sqrt(max(alike, 0) / information)), "px", ("order",), p, max(alike, 0.0))


def excess_scatter(model: LinearisedModel, lacks_of_fit: list[LackOfFit]) -> list[LackOfFit]:
    """Excess scatter of struts and corners ([LackOfFit]).

    They are at places with no other lack of fit.
    lacks_of_fit : what functions
    explain
    """
    known = {u.place for u in lacks_of_fit}
    found = [*(_strut_scatter(model) if model.point.axes else []), _corners(model)]
    return [
        u
        for u in found
        if u is not None
        and u.place not in known
        and not any(is_lack_of_fit_at_place(u, effect.site) for effect in model.point.effects)
    ]


def closure_residuals(model: LinearisedModel) -> Floats:
    """Loop closure residuals (F, axes) m of a model as it is."""
    return closures_in_metres(model, model.closure_residual)


def closures_in_metres(model: LinearisedModel, closures: Floats) -> Floats:
    """Loop closures (F, axes) in metres, of whitened closures (F axes + .,)."""
    F, axes = model.frames, model.point.axes
    return (
        cast(Floats, np.linalg.solve(model.closures.W, closures[: F * axes].reshape(F, axes, 1))[..., 0])
        if axes
        else np.zeros((F, 0))
    )


def _strut_scatter(model: LinearisedModel) -> list[LackOfFit | None]:
    """Of each strut, by its closures."""
    k, F = model.point, model.frames
    inverse = np.linalg.inv(model.closures.W)
    residual = (inverse @ model.closure_residual[: F * k.axes].reshape(F, k.axes, 1))[..., 0]
    own = model.strut_noise() - model.closures.scatter**2
    squares, freedom = (residual**2 / own).sum(axis=0), F - len(geometric_parameters(k.platform)) / k.axes
    # what errors that are not equal and independent make of poses is known less well than what others do
    material = MATERIAL if model.corners.spread is None else MATERIAL_OF_UNLIKE_ERRORS
    if (
        k.seen is not None and k.axes > 2
    ):  # what all struts scatter alike, as far as it is no more than that, the images may do
        common = float(np.clip(squares.min() / max(freedom, 1.0), 1.0, material**2))
        own, squares = own * common, squares / common
    noise = np.sqrt(own.mean(axis=0))
    return [
        detect_excess_scatter(
            k.places[i], k.axis_unit, float(noise[i]), float(squares[i]), freedom, k.axes, material=material
        )
        for i in range(k.axes)
    ]


def _corners(model: LinearisedModel) -> LackOfFit | None:
    """Of all corners, by the middle of their residuals, where somebody states their noise."""
    seen, stated = model.point.seen, None if model.point.seen is None else model.point.seen.stated
    if seen is None or stated is None:
        return None
    freedom = (len(model.corner_residual) - model.corners.local.shape[1] * model.frames) / MIDDLE
    return detect_excess_scatter(
        Place("cameras"), "px", stated, freedom * (model.corner_noise() / stated) ** 2, freedom
    )


def ranked_covariates(before: LinearisedModel, after: LinearisedModel) -> list[Covariate]:
    """Covariates ranked by the share of residuals that they explain, without effects and with them."""
    return rank_covariates(*parallel_map(_shares, [before, after], items_per_process=1))


def _shares(model: LinearisedModel) -> dict[str, dict[str, Share]]:
    k = model.point
    out: dict[str, dict[str, Share]] = {}
    if k.axes:
        products = axis_elongation_inner_products(model)
        for name, functions in {
            **smooth_functions_of_time_and_sensors(k.t, k.sensors),
            **smooth_functions_of_axis_motion(k.motion(()).path, k.commanded, k.t),
        }.items():
            out.setdefault(name, {})[STRUTS] = share_explained_by_functions(
                model.linear, CLOSURES, [(products, separate_weights_for_each_direction(functions, k.axes))]
            )
    if k.seen is not None and len(k.moving) < len(k.design.cameras):
        seen = np.unique(k.seen.observations.camera)
        views = [
            corner_displacement_normal_equations_by_frame(
                model, camera_mount_and_focal_pixel_derivatives(model, Place("camera", k.design.cameras[i].name))
            )
            for i in seen
            if i not in k.moving
        ]
        for name, functions in smooth_functions_of_time_and_sensors(k.t, k.sensors).items():
            parts = [
                (products, separate_weights_for_each_direction(functions, products.beta.shape[1])) for products in views
            ]
            out.setdefault(name, {})[IMAGES] = share_explained_by_functions(model.linear, CORNERS, parts)
    return out
