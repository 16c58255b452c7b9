"""How sure the numbers of a fit are, whatever the colour of what it leaves."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sgms_mhe.recordings.evidence import block_moments
from sgms_mhe.recordings.recording import Recording

Array = NDArray[np.float64]

UNKNOWN: Final = 1e-15  # of the largest eigenvalue of the information
ALONE: Final = 0.9
"""Share of the information on a number that one block may hold: with all of it there is none to move to without it."""
COHERENT_ROWS: Final = 16
"""Stretch that a model's own error keeps its sign over, for intervals [rows]: a reversal."""
UNSEEN_ERROR: Final = 0.15
"""RMS that a model may get wrong beyond what is seen, for intervals [noise floor]: a floor that is right to 1 % hides
as much."""


def robust_covariance(recording: Recording, X: Array, residual: Array, H: Array, inverse: Array, wrong: float) -> Array:
    """Covariance of fitted numbers (p, p).

    Noise, by what each block moves the numbers by (`between_blocks`), robust to colour within a block and to numbers
    that few blocks tell of, but no less than if the residual were white. And what the model gets wrong, which does not
    average out as noise does: taken as coherent over COHERENT_ROWS.

    Args:
        recording: rows of the fit.
        X: derivatives of the model (m, p).
        residual: measured minus model (m) [N].
        H: information of the used rows and of priors (p, p).
        inverse: of H, where that has one.
        wrong: RMS of what the model gets wrong [N].
    """
    noise = between_blocks(recording, X, residual, H)
    # Blocks that happen to balance must not promise more than white noise would allow.
    white = inverse * float(np.mean(residual[recording.used] ** 2))
    noise = np.where(np.eye(len(noise), dtype=np.bool_), np.maximum(noise, white), noise)
    return np.asarray(noise + inverse * COHERENT_ROWS * wrong**2)


def between_blocks(recording: Recording, X: Array, residual: Array, H: Array) -> Array:
    """Covariance from what the numbers move by when one block is left out (jackknife), of X (m, p): (p, p).

    A sandwich over blocks takes their residuals as they are; but in a block that alone tells of a number the fit has
    already made them small. H (p, p): information of all.
    """
    information, scores, _ = block_moments(recording, X, residual)
    values, vectors = np.linalg.eigh(H)
    known = values > UNKNOWN * values.max()
    root = vectors[:, known] / np.sqrt(values[known])
    moves = []
    for own, score in zip(information, scores, strict=True):
        share, direction = np.linalg.eigh(root.T @ own @ root)
        moves.append(root @ direction @ (direction.T @ root.T @ score / (1.0 - np.minimum(share, ALONE))))
    moved = np.stack(moves)
    return np.asarray(moved.T @ moved * (len(moved) - 1) / len(moved))
