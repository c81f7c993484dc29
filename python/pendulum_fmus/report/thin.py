"""Curve thinning: every omitted sample lies near the line between two kept ones."""

import numpy as np


def thinned(x: np.ndarray, y: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the indices of the samples to keep, increasing, shape (kept,).

    Linear interpolation between them deviates by at most `tolerance`, in the unit of y. The sample
    with the largest deviation in each gap is kept first (Douglas-Peucker), so peaks are preserved.

    Parameters
    ----------
    x, y
        The curve, shape (n,) each, n >= 2; x increases, y is finite.
    tolerance
        Maximum deviation.
    """
    keep = np.array([0, len(x) - 1])
    while True:
        deviation = np.abs(y - np.interp(x, x[keep], y[keep]))
        gap = np.searchsorted(keep, np.arange(len(x)), side="right")
        worst = np.maximum.reduceat(deviation, keep)
        candidates = np.flatnonzero((deviation == worst[gap - 1]) & (deviation > tolerance))
        if not candidates.size:
            return keep
        _, first = np.unique(gap[candidates], return_index=True)
        keep = np.union1d(keep, candidates[first])
