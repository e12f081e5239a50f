# Copyright 2026 The dotsim_ros authors
# SPDX-License-Identifier: Apache-2.0

"""How much a trajectory would say of which explanation is right, before it is recorded.

An explanation knows its parameters up to a normal distribution, and a trajectory shows them
linearly, with noise of unit variance: what each explanation expects of it is normal, too. The
information is between the explanation and what is recorded. A mixture's has no closed form; a lower
bound by the distances of its parts has (Kolchinsky and Tracey 2017, equation 10).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dotsim_ros.io.arrays import FloatArray


@dataclass(frozen=True)
class Beliefs:
    """H explanations in the same p parameters, those that one does not have being 0 in it.

    Attributes:
        weight: (H,) probabilities.
        mean: (H, p) of the parameters.
        covariance: (H, p, p) of the parameters.
    """

    weight: FloatArray
    mean: FloatArray
    covariance: FloatArray


def weights_of(log_evidence: FloatArray, least: float) -> FloatArray:
    """Return the probabilities (H,) of explanations that are equally probable before any data, from
    the logarithms of the data's probabilities; none is below about `least`."""
    weight = np.exp(log_evidence - np.max(log_evidence))
    weight = np.maximum(weight / weight.sum(), least)
    return np.asarray(weight / weight.sum())


def reduced(design: FloatArray) -> FloatArray:
    """Return a design (m, p), m <= p, that says as much as one (n, p): an orthogonal turn of the
    observables leaves their noise as it is."""
    return np.asarray(np.linalg.qr(design, mode="r")) if len(design) > design.shape[1] else design


def distances(beliefs: Beliefs, design: FloatArray) -> FloatArray:
    """Return (H, H) Bhattacharyya distances, in nats, between what explanations expect.

    A decision between two that are equally probable errs with a probability of at most
    exp(-distance) / 2.

    Args:
        beliefs: the explanations.
        design: (n, p) what a unit of each parameter does to each observable, whose noise has unit
            variance; rows of several trajectories below each other.
    """
    design = reduced(design)
    mean = beliefs.mean @ design.T
    covariance = np.eye(len(design)) + design @ beliefs.covariance @ design.T
    log_det = np.linalg.slogdet(covariance)[1]
    count = len(mean)
    result = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            middle = 0.5 * (covariance[i] + covariance[j])
            apart = mean[i] - mean[j]
            between = 0.125 * apart @ np.linalg.solve(middle, apart)
            widths = 0.5 * np.linalg.slogdet(middle)[1] - 0.25 * (log_det[i] + log_det[j])
            # Rounding alone makes the same widths differ.
            result[i, j] = result[j, i] = max(between + widths, 0.0)
    return result


def information(weight: FloatArray, distance: FloatArray) -> float:
    """Return the least mutual information, in nats, between explanation and observables: 0 where
    all expect the same, the entropy of the weights where no two do.

    Args:
        weight: (H,) probabilities.
        distance: (H, H) of `distances`.
    """
    return float(-weight @ np.log(np.exp(-distance) @ weight))
