"""Means over seeds with intervals, comparisons in words, and statistics over panels (Agarwal et al., 2021).

They are the same as in `statistics.rs` and `over_panels.rs` in `deploy/report/src`.
"""

import numpy as np
from scipy.stats import sem, t, trim_mean

# Fewest seeds that have an interval, and the quantile of the upper end of a 95 % interval.
FEWEST = 3
UPPER = 0.975
# Number of bootstrap samples.
SAMPLES = 2000
# Share of the scores that an interquartile mean leaves out at each end.
TRIMMED = 0.25

# A number and the ends of its 95 % interval.
Bounded = tuple[float, float, float]


def interval(shares: list[float] | np.ndarray) -> np.ndarray | None:
    """Returns the ends of the 95 % interval of a mean (Student's t); None for too few seeds."""
    if len(shares) < FEWEST:
        return None
    mean, half = np.mean(shares, axis=0), half_width(shares)
    return np.clip([mean - half, mean + half], 0, 1)


def half_width(numbers: list[float] | np.ndarray) -> np.ndarray:
    """Returns half of the width of the 95 % interval of a mean (Student's t)."""
    return t.ppf(UPPER, len(numbers) - 1) * sem(numbers)


def gain(own: list[float], others: list[float]) -> Bounded:
    """Returns how much the mean of seeds exceeds that of others, with Welch's 95 % interval."""
    groups = own, others
    errors = [sem(shares) ** 2 for shares in groups]
    freedoms = [error**2 / (len(shares) - 1) for error, shares in zip(errors, groups, strict=True)]
    # If the seeds of both groups all agree, there is no deviation and no degrees of freedom.
    half = t.ppf(UPPER, sum(errors) ** 2 / sum(freedoms)) * sum(errors) ** 0.5 if any(errors) else 0.0
    difference = float(np.mean(own) - np.mean(others))
    return difference, difference - half, difference + half


def paired_gain(own: list[float], others: list[float]) -> Bounded:
    """Returns how much seeds exceed the same seeds of others: the mean of pairs with Student's interval."""
    differences = np.subtract(own, others)
    mean, half = float(np.mean(differences)), float(half_width(differences))
    return mean, mean - half, mean + half


def standing(own: list[float], others: list[float]) -> str:
    """Returns how seeds compare with others, in words; empty for too few seeds."""
    if min(len(own), len(others)) < FEWEST:
        return ""
    difference, low, high = gain(own, others)
    if low <= 0 <= high:
        # Seeds that fail widen the interval, however clear the order is.
        if min(own) > max(others):
            return "every seed above"
        return "every seed below" if max(own) < min(others) else "not told apart"
    return "ahead" if difference > 0 else "behind"


def interquartile_mean(panels: list[list[float]]) -> Bounded:
    """Returns the mean of the middle half of all success rates, with its stratified bootstrap interval."""
    samples = trim_mean(np.concatenate(resampled(panels), axis=1), TRIMMED, axis=1)
    return with_interval(trim_mean(np.concatenate(panels), TRIMMED), samples)


def improvement(panels: list[list[float]], others: list[list[float]]) -> Bounded:
    """Returns the probability that a seed beats one of another method, mean over panels, with interval."""

    def better(own: list[np.ndarray], other: list[np.ndarray]) -> np.ndarray:
        pairs = [left[:, :, None] - right[:, None, :] for left, right in zip(own, other, strict=True)]
        return np.mean([np.heaviside(pair, 0.5).mean(axis=(1, 2)) for pair in pairs], axis=0)

    whole = better(*([np.array([panel]) for panel in group] for group in (panels, others)))
    return with_interval(whole[0], better(resampled(panels), resampled(others, 1)))


def resampled(panels: list[list[float]], stream: int = 0) -> list[np.ndarray]:
    """Draws with replacement as many seeds as each panel has, a row for each bootstrap sample."""
    random = np.random.default_rng(stream)
    return [np.array(panel)[random.integers(len(panel), size=(SAMPLES, len(panel)))] for panel in panels]


def with_interval(estimate: float, samples: np.ndarray) -> Bounded:
    """Returns an estimate with the interval of its bootstrap samples."""
    return (float(estimate), *map(float, np.quantile(samples, [1 - UPPER, UPPER])))
