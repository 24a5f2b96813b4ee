"""Weight decay and neurons by cross-validation over whole clips, or over time in the only one.

Poses of one clip are near copies of each other: a random split would flatter every model. Folds
over clips hold a sampled pose back with the clips it was mixed from; folds over moments know no
such thing.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.exchange import in_parallel
from prtnet.time_range import GUARD
from training.regression import Fit

__all__ = [
    "ALPHAS",
    "NEURONS",
    "Fold",
    "choose_alpha",
    "choose_neurons",
    "folds_over_clips",
    "folds_over_moments",
    "folds_over_time",
    "refined",
]

ALPHAS = (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 1.0)
START = 3e-3
NEURONS = (8, 16, 32, 64)
FEWEST_POSES = 4  # a fold that trains on fewer says nothing


@dataclass(frozen=True, eq=False)
class Fold:
    """Which poses a fold fits and which it validates on, (P,) each."""

    train: BoolArray
    validate: BoolArray


def folds_over_clips(sources: BoolArray, most: int = 4) -> list[Fold]:
    """Folds that leave whole clips out.

    Args:
        sources: the clips each training pose was taken or mixed from, (P, clips).
        most: clips are grouped into at most so many folds, of about equally many poses.

    Returns:
        No folds where there are fewer than two clips to tell apart.
    """
    single: BoolArray = np.asarray(sources.sum(axis=1) == 1)
    used = np.flatnonzero(sources[single].any(axis=0))
    sizes = sources[single][:, used].sum(axis=0)
    groups: list[list[int]] = [[] for _ in range(min(most, len(used)))]
    for clip in np.argsort(-sizes, kind="stable"):  # the largest first, into the smallest group
        smallest = min(groups, key=lambda g: int(sizes[g].sum()) if g else 0)
        smallest.append(int(clip))
    folds = []
    for group in groups if len(used) > 1 else []:
        tainted: BoolArray = np.any(sources[:, used[group]], axis=1)
        clean = single & tainted
        if (~tainted).sum() >= FEWEST_POSES:
            folds.append(Fold(~tainted, clean))
    return folds


def folds_over_time(
    time: FloatArray, direct: BoolArray, count: int = 4, guard: float = GUARD
) -> list[Fold]:
    """Folds that leave contiguous quarters of a single clip out.

    Args:
        time: seconds of each training pose in the clip, (P,).
        direct: whether a pose was taken from the clip as it is, (P,). Sampled poses mix moments of
            all quarters: no fold uses them.
        count: of folds, of about equally many poses.
        guard: seconds around what a fold validates on that it does not fit to either.

    Returns:
        No folds where the clip is too short for two of them.
    """
    order = np.flatnonzero(direct)[np.argsort(time[direct], kind="stable")]
    folds = []
    for block in np.array_split(order, count):
        if len(block) == 0:
            continue
        first, last = time[block[0]], time[block[-1]]
        train: BoolArray = direct & ((time < first - guard) | (time > last + guard))
        if train.sum() >= FEWEST_POSES:
            validate = np.zeros(len(time), dtype=bool)
            validate[block] = True
            folds.append(Fold(train, validate))
    return folds if len(folds) > 1 else []


def folds_over_moments(
    clip: IntArray, time: FloatArray, sampled: int | None, count: int = 4, guard: float = GUARD
) -> list[Fold]:
    """Folds that leave one contiguous part of every clip out, and as many sampled poses.

    What is left out is as like the rest as a clip is like other clips of its kind: kinder than
    leaving whole clips out, which asks a model for moves it was never shown.

    Args:
        clip: of each training pose, (P,).
        time: seconds of each in its clip, (P,).
        sampled: the clip of poses that were sampled and have no time, if any.
        count: of folds.
        guard: seconds around what is left out that are not fitted to either; less in short clips.

    Returns:
        No folds where there are too few poses for two.
    """
    train = np.ones((count, len(clip)), dtype=bool)
    validate = np.zeros((count, len(clip)), dtype=bool)
    for own in np.unique(clip):
        rows = np.flatnonzero(clip == own)
        rows = rows[np.argsort(time[rows], kind="stable")]
        if own == sampled or np.ptp(time[rows]) == 0:  # moments that cannot be told apart
            for fold in range(count):
                validate[fold, rows[fold::count]] = True
                train[fold, rows[fold::count]] = False
            continue
        near = min(guard, float(np.ptp(time[rows])) / (2 * count))
        for fold, block in enumerate(np.array_split(rows, count)):
            if len(block) > 0:
                validate[fold, block] = True
                inside = (time >= time[block[0]] - near) & (time <= time[block[-1]] + near)
                train[fold, (clip == own) & inside] = False
    folds = [
        Fold(*pair)
        for pair in zip(train, validate, strict=True)
        if pair[0].sum() >= FEWEST_POSES and pair[1].any()
    ]
    return folds if len(folds) > 1 else []


def choose_alpha(
    fit: Callable[[Tensor, Tensor, float], Fit],
    inputs: Tensor,
    targets: Tensor,
    folds: Sequence[Fold],
    alphas: Sequence[float] = ALPHAS,
    start: float = START,
    on_candidate: Callable[[float, float], None] | None = None,
) -> tuple[float, dict[float, float]]:
    """The α to fit all poses with, and the relative error of the latents of all tried.

    Descends from ``start`` to the nearest local minimum: the error has one valley in log α, and
    a fit of every candidate would cost more than the final fit.

    Args:
        fit: (inputs (C, P, K), targets (C, P, L), α) to a fit.
        inputs: of all training poses, (C, P, K).
        targets: their latents, (C, P, L).
        folds: from :func:`folds_over_clips` or :func:`folds_over_time`.
        alphas: candidates, ascending, ``start`` among them.
        start: tried first.
        on_candidate: called with each α and its error.
    """
    trial = Trials(inputs, targets, folds, on_candidate)
    errors: dict[float, float] = {}

    def error(position: int) -> float:
        alpha = alphas[position]
        if alpha not in errors:
            errors[alpha] = trial(fit, alpha)
        return errors[alpha]

    best = descend(error, len(alphas), alphas.index(start))
    return refined(alphas, errors, alphas[best], folds), errors


def choose_neurons(
    fit: Callable[[Tensor, Tensor, int, float], Fit],
    inputs: Tensor,
    targets: Tensor,
    folds: Sequence[Fold],
    alphas: Sequence[float] = ALPHAS,
    sizes: Sequence[int] = NEURONS,
    start: tuple[int, float] = (16, START),
    on_candidate: Callable[[float, float], None] | None = None,
) -> tuple[int, float, dict[tuple[int, float], float]]:
    """Number of neurons and α to fit all poses with, and the errors of all pairs tried.

    Descends in α, then in the number of neurons, in turn until neither helps; every pair is tried
    once at most. "Arbitrary BRDFs" section 5.3 chooses both likewise.

    Args:
        fit: (inputs (C, P, K), targets (C, P, L), neurons, α) to a fit.
        inputs: of all training poses, (C, P, K).
        targets: their latents, (C, P, L).
        folds: from :func:`folds_over_clips`.
        alphas: candidates, ascending.
        sizes: candidates, ascending.
        start: neurons and α tried first, of the candidates.
        on_candidate: called with each α and its error.
    """
    trial = Trials(inputs, targets, folds, on_candidate)
    errors: dict[tuple[int, float], float] = {}

    def error(row: int, column: int) -> float:
        pair = sizes[row], alphas[column]
        if pair not in errors:

            def sized(x: Tensor, t: Tensor, alpha: float) -> Fit:
                return fit(x, t, pair[0], alpha)

            errors[pair] = trial(sized, pair[1])
        return errors[pair]

    row, column = sizes.index(start[0]), alphas.index(start[1])
    while True:
        column = descend(functools.partial(error, row), len(alphas), column)

        def down(position: int, column: int = column) -> float:
            return error(position, column)

        best = descend(down, len(sizes), row)
        if best == row:
            own = {alpha: e for (size, alpha), e in errors.items() if size == sizes[row]}
            return sizes[row], refined(alphas, own, alphas[column], folds), errors
        row = best


def refined(
    alphas: Sequence[float], errors: Mapping[float, float], best: float, folds: Sequence[Fold]
) -> float:
    """The α for all poses, from the best that was tried on parts of them.

    The bottom of the parabola, in log α, through the best and its neighbours; times the share of
    poses that a fold fits. α weighs against a mean over poses: what it does to a fit with more of
    them, α · share does.

    Args:
        alphas: candidates, ascending.
        errors: of those tried.
        best: of them.
        folds: that they were tried on.
    """
    if len(alphas) == 1:  # there was nothing to choose
        return best
    share = float(np.mean([fold.train.mean() for fold in folds]))
    at = list(alphas).index(best)
    near = [alphas[k] for k in (at - 1, at, at + 1) if 0 <= k < len(alphas)]
    if len(near) < 3 or any(alpha not in errors for alpha in near):
        return best * share
    x = np.log(near)
    curve, slope, _ = np.polyfit(x - x[1], [errors[alpha] for alpha in near], 2)
    if not curve > 0:
        return best * share
    bottom = x[1] + np.clip(-slope / (2.0 * curve), (x[0] - x[1]) / 2.0, (x[2] - x[1]) / 2.0)
    return float(np.exp(bottom)) * share


def descend(error: Callable[[int], float], count: int, best: int) -> int:
    """The position of a local minimum among ``count``, downhill from ``best``."""
    for direction in (1, -1):
        while 0 <= best + direction < count and error(best + direction) < error(best):
            best += direction
    return best


class Trials:
    """Relative validation errors of the latents, over all folds."""

    def __init__(
        self,
        inputs: Tensor,
        targets: Tensor,
        folds: Sequence[Fold],
        on_candidate: Callable[[float, float], None] | None,
    ) -> None:
        self.inputs, self.targets, self.folds = inputs, targets, folds
        self.signal = sum(float(targets[:, fold.validate].square().sum()) for fold in folds)
        self.on_candidate = on_candidate

    def __call__(self, fit: Callable[[Tensor, Tensor, float], Fit], alpha: float) -> float:
        def loss(fold: Fold) -> float:
            return validation_loss(fit, self.inputs, self.targets, fold, alpha)

        lost = sum(in_parallel(loss, self.folds))
        error = float((lost / max(self.signal, 1e-30)) ** 0.5)
        if self.on_candidate is not None:
            self.on_candidate(alpha, error)
        return error


def validation_loss(
    fit: Callable[[Tensor, Tensor, float], Fit],
    inputs: Tensor,
    targets: Tensor,
    fold: Fold,
    alpha: float,
) -> float:
    """Squared error of the fold's validation latents after a fit to its training poses."""
    train = torch.from_numpy(np.flatnonzero(fold.train)).to(inputs.device)
    validate = torch.from_numpy(np.flatnonzero(fold.validate)).to(inputs.device)
    fitted = fit(inputs[:, train], targets[:, train], alpha)
    residual = fitted(inputs[:, validate]) - targets[:, validate]
    return float(residual.square().sum())
