"""Lens calibration from photographs of a board.

Every lens model's result, and photographs left out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Floats, Pixels
from rig.errors import FileError, NotEnoughData, RigError
from rig.model.calibration_board_layout_and_description_parsing import Board
from rig.model.design import Camera
from rig.recording.exposures_and_image_files import MOST_OF_A_PHOTOGRAPH, read_grey_or_colour_image
from vision.corner_observations_and_merging import Observations
from vision.lenses.calibration_board_corner_detection_in_photograph import BoardView, find_board_corners
from vision.lenses.lens_calibration_from_board_views import (
    LEAST_CORNERS,
    MODELS,
    Fit,
    HeldOut,
    calibrate_lens,
    choose_simplest_adequate_lens_model,
    cross_validate_lens,
    observations_from_board_views,
    projection_pixels_and_uncertainty,
)

FIRST = 5  # distortion terms of the lens that straightens edges for the second look


@dataclass(frozen=True, slots=True)
class Model:
    """How one lens model did: rms px per axis where it was fitted, held : HeldOut; or the reason why it could not be
    fitted.
    """

    rms: float | None
    held: HeldOut | None
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """fit : Fit of the model taken; models : {terms: Model}; used : paths of the photographs that count
    left_out : (path, reason); observations : Observations of all corners, frames counted as `used`
    uv, sigma : the uncertainty of projection over the frame, px; middle, worst : of it, px."""

    fit: Fit
    models: dict[int, Model]
    used: tuple[Path, ...]
    left_out: tuple[tuple[Path, str], ...]
    observations: Observations
    board: Board
    uv: Floats
    sigma: Floats

    @property
    def middle(self) -> float:
        """px, standard uncertainty of projection in the middle of the frame."""
        rows, columns = self.sigma.shape
        return float(self.sigma[rows // 2, columns // 2])

    @property
    def worst(self) -> float:
        """px, the largest standard uncertainty of projection."""
        return float(np.nanmax(self.sigma))


def calibrate_photographs(
    paths: Sequence[Path], board: Board, name: str = "cam0", progress: Callable[[str, int, int], None] | None = None
) -> Calibrated:
    """Calibrate a lens from photographs (paths) of a board.
    progress : called with (label, done, of), or None

    A photograph that does not show the board is named and left out. Raises FileError for one that is no image or of
    another size than the first, NotEnoughData where too few show the board.
    """
    images: list[Pixels] = []
    for path in paths:
        image = read_grey_or_colour_image(path, MOST_OF_A_PHOTOGRAPH)
        if images and image.shape[:2] != images[0].shape[:2]:
            raise FileError(
                path,
                f"is {image.shape[1]} x {image.shape[0]} px, the first photograph {images[0].shape[1]} x "
                f"{images[0].shape[0]} px: all images of a camera have the same size",
            )
        images.append(image)
    height, width = images[0].shape[:2]
    K = np.array([[1.2 * width, 0, (width - 1) / 2], [0, 1.2 * width, (height - 1) / 2], [0, 0, 1]])
    camera = Camera(name, width, height, K, np.zeros(FIRST), RigidTransform.identity())
    for repeated in (False, True):
        views = []
        for k, image in enumerate(images):
            views.append(find_board_corners(image, board, camera))
            if progress:
                progress("finding corners" + " again" * repeated, k + 1, len(images))
        left_out = tuple((path, _reason(view)) for path, view in zip(paths, views) if len(view.corner) < LEAST_CORNERS)
        try:
            observations = observations_from_board_views(views, board)
        except NotEnoughData as error:
            named = "".join(f"\n  {path}: {reason}" for path, reason in left_out)
            raise NotEnoughData(f"{error}{named}") from None
        if not repeated:
            camera = calibrate_lens(observations, width, height, FIRST, name).camera
    models, fits = _models(observations, width, height, name, progress)
    held = [model.held for model in models.values() if model.held]
    fit = fits[choose_simplest_adequate_lens_model(held).terms]
    uv, sigma = projection_pixels_and_uncertainty(fit)
    return Calibrated(
        fit, models, tuple(paths[f] for f in observations.frames), left_out, observations, board, uv, sigma
    )


def _models(
    observations: Observations, width: int, height: int, name: str, progress: Callable[[str, int, int], None] | None
) -> tuple[dict[int, Model], dict[int, Fit]]:
    """({terms: Model}, {terms: Fit}); all models are held to the corners that the richest that can be fitted keeps."""
    fits, models, reasons = {}, {}, {}
    for terms in MODELS:
        try:
            fits[terms] = calibrate_lens(observations, width, height, terms, name)
        except RigError as error:
            reasons[terms] = str(error)
    if not fits:
        raise NotEnoughData("no lens model can be fitted: " + "; ".join(reasons.values()))
    inliers = min((fit for fit in fits.values()), key=lambda fit: fit.rms).inliers
    for k, terms in enumerate(MODELS):
        if terms in fits:
            try:
                fits[terms] = calibrate_lens(observations, width, height, terms, name, inliers)
                models[terms] = Model(fits[terms].rms, cross_validate_lens(observations, width, height, terms, inliers))
            except RigError as error:
                reasons[terms] = str(error)
        if terms in reasons:
            models[terms] = Model(None, None, reasons[terms])
        if progress:
            progress("cross-validating photographs", k + 1, len(MODELS))
    if not any(model.held for model in models.values()):
        raise NotEnoughData("no lens model can be held out: " + "; ".join(reasons.values()))
    return models, fits


def _reason(view: BoardView) -> str:
    if not len(view.corner) and not view.left_out:
        return "the board is not found in it"
    why = f"; {view.left_out[0][1]}" if view.left_out else ""
    return f"only {len(view.corner)} corners of the board are found, {LEAST_CORNERS} are needed{why}"
