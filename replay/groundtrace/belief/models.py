"""Models of masses: how what a source measures becomes masses, shape (..., 2^k).

Numbers may be floats, arrays of floats or exact fractions; arrays give one row each.

Source: Dempster-Shafer thesis, chapter II, section III.2, and chapter III, section V.2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import BeliefError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .frame import Frame

#: Weakening that Denoeux proposes for a neighbour.
DENOEUX_RELIABILITY = 0.95


def ignorance(frame: Frame, like: Any = 0.0) -> NDArray[Any]:
    """Return all mass on the whole frame, a row for each number of ``like``: (II.10)."""
    return _sorted_in(frame, {}, np.asarray(like) * 0)


def certain(frame: Frame, subset: int) -> NDArray[Any]:
    """Return all mass on one subset, shape (2^k,): thesis, equation (II.11)."""
    return simple_support(frame, subset, 1.0)


def simple_support(frame: Frame, subset: int, support: Any) -> NDArray[Any]:
    """Return ``support`` on a subset and the rest on the whole frame: (II.8)."""
    return _sorted_in(frame, {subset: support}, support)


def specialised(frame: Frame, subset: int, support: Any, against: Any) -> NDArray[Any]:
    """Return masses on a subset, its complement, and the rest on the whole frame: (II.9)."""
    parts = {subset: support, frame.complement(subset): against}
    return _sorted_in(frame, parts, np.asarray(support) + np.asarray(against))


def bayesian(frame: Frame, probabilities: NDArray[Any]) -> NDArray[Any]:
    """Return masses on single hypotheses: (II.7), whose sets are the hypotheses alone.

    Parameters
    ----------
    frame
        Of k hypotheses.
    probabilities
        Shape (..., k), in the order of the frame's hypotheses, adding up to 1.
    """
    given = _probabilities(frame, probabilities)
    masses = np.repeat(given[..., :1] * 0, frame.size, axis=-1)
    masses[..., [1 << i for i in range(given.shape[-1])]] = given
    return masses


def dubois_prade_model(frame: Frame, probabilities: NDArray[Any]) -> NDArray[Any]:
    """Return nested masses out of probabilities, shape (..., k): the i likeliest together.

    Source: thesis, equation (II.12), where the union is printed without what it unites: the i
    likeliest hypotheses.
    """
    given = _probabilities(frame, probabilities)
    count = given.shape[-1]
    order = np.argsort(-given, axis=-1, kind="stable")
    falling = np.take_along_axis(given, order, axis=-1)
    nested = np.bitwise_or.accumulate(1 << order, axis=-1)
    below = np.concatenate([falling[..., 1:], falling[..., :1] * 0], axis=-1)
    masses = np.repeat(given[..., :1] * 0, frame.size, axis=-1)
    np.put_along_axis(masses, nested, (falling - below) * np.arange(1, count + 1), axis=-1)
    return masses


def appriou_1(
    frame: Frame, hypothesis: int, likelihood: Any, reliability: Any, scale: Any = 1
) -> NDArray[Any]:
    """Return Appriou's first model of a source's likelihood of one hypothesis.

    Parameters
    ----------
    frame, hypothesis
        The frame, and the hypothesis as a subset of it.
    likelihood
        P(source | hypothesis), number or shape (...).
    reliability
        From 0 to 1: 1 in high confidence, else 0.9 is proposed.
    scale
        R, from 0 to 1 over the largest likelihood: thesis, equation (II.14).

    Notes
    -----
    Source: thesis, equation (II.13), where the mass against the hypothesis is printed with a
    factor R too much; with it the masses do not add up to 1.
    """
    scaled = _scaled(likelihood, scale)
    against = reliability / (1 + scaled)
    return specialised(frame, hypothesis, scaled * against, against)


def appriou_2(
    frame: Frame, hypothesis: int, likelihood: Any, reliability: Any, scale: Any = 1
) -> NDArray[Any]:
    """Return Appriou's second model, which only ever speaks against: thesis, equation (II.15).

    The parameters are those of :func:`appriou_1`.
    """
    against = reliability * (1 - _scaled(likelihood, scale))
    return simple_support(frame, frame.complement(hypothesis), against)


def neighbour(
    frame: Frame,
    hypothesis: int,
    distance: Any,
    typical: Any,
    reliability: float = DENOEUX_RELIABILITY,
) -> NDArray[Any]:
    """Return what a neighbour at some distance says for its hypothesis: (II.16), Denoeux.

    Parameters
    ----------
    frame, hypothesis
        The frame, and the hypothesis as a subset of it.
    distance
        To the neighbour, number or shape (...).
    typical
        Mean distance of that hypothesis's members, in the same unit.
    reliability
        What a neighbour at no distance supports.
    """
    support = reliability * np.exp(-((np.asarray(distance) / typical) ** 2))
    return simple_support(frame, hypothesis, support)


def graded(frame: Frame, hypothesis: int, certainty: Any, truth: Any) -> NDArray[Any]:
    """Return the masses of a source that can tell with ``certainty``, and then says ``truth``.

    ``m(A) = p q``, ``m(not A) = p (1 - q)``, ``m(whole) = 1 - p``: thesis, equations (III.4) and
    (III.5), p the certainty and q the probability that the hypothesis is true.
    """
    p, q = np.asarray(certainty), np.asarray(truth)
    return specialised(frame, hypothesis, p * q, p * (1 - q))


def trapezoid(x: Any, rise: float, full: float, fade: float, gone: float) -> NDArray[Any]:
    """Return the membership in a trapezoid, shape of ``x``, from 0 to 1.

    It is 0 up to ``rise``, 1 from ``full`` to ``fade`` and 0 again from ``gone`` on, linear in
    between; equal corners make an edge upright, and the upper side of an edge counts as inside.
    Thesis, chapter III, section V.2, which names the function but none of its corners.

    Raises
    ------
    BeliefError
        Where the corners are not in that order.
    """
    if not rise <= full <= fade <= gone:
        raise BeliefError(
            f"trapezoid: expected rising corners, found {rise:g}, {full:g}, {fade:g}, {gone:g}"
        )
    x = np.asarray(x)
    up = (x - rise) / (full - rise) if full > rise else (x >= full) * 1.0
    down = (gone - x) / (gone - fade) if gone > fade else (x <= fade) * 1.0
    return np.asarray(np.clip(np.minimum(up, down), 0, 1))


def _scaled(likelihood: Any, scale: Any) -> Any:
    scaled = np.asarray(np.asarray(likelihood) * scale)
    if not ((scaled >= 0) & (scaled <= 1)).all():
        raise BeliefError(
            f"scale: expected R from 0 to 1 over the largest likelihood, found R P up to "
            f"{scaled.max()}"
        )
    return scaled


def _probabilities(frame: Frame, probabilities: NDArray[Any]) -> NDArray[Any]:
    given = np.asarray(probabilities)
    if given.ndim == 0 or given.shape[-1] != len(frame.hypotheses):
        expected = len(frame.hypotheses)
        raise BeliefError(f"probabilities: expected {expected} in a row, found {given.shape}")
    return given


def _sorted_in(frame: Frame, parts: dict[int, Any], like: Any) -> NDArray[Any]:
    """Return masses with ``parts`` at their subsets and the rest on the whole frame."""
    zero = np.asarray(like) * 0
    masses = np.stack([zero] * frame.size, axis=-1)
    for subset, mass in parts.items():
        masses[..., subset] = masses[..., subset] + mass
    masses[..., -1] = masses[..., -1] + (1 - masses.sum(axis=-1))
    return masses
