# Copyright 2026 The trajeval_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the figures show, and what the terms mean."""

from __future__ import annotations

CAPTIONS = {
    "map": (
        "Point at a path to see that moment everywhere; drag along it, or over any chart, to show a"
        " stretch alone; a double click shows all. Each estimate is moved into the ground truth's"
        " world by the alignment that ATE is under, or lies where it was, raw. With the keyboard:"
        " arrows move the moment, + and − zoom, Escape shows all; A, D, W and S turn the space."
    ),
    "time": (
        "An error inside the green band cannot be told from the ground truth's own uncertainty;"
        " above it, it is the estimate's. In a gap of the ground truth (shaded) the band opens up,"
        " and the same error says less. Triangles: moments of note, listed at the top."
    ),
    "growth": (
        "Relative errors from a pose to the one so far on: the box holds the middle half, the line"
        " in it is the median, nine in ten lie within the whiskers. Neither alignment nor where the"
        " run began matters. Errors that grow with the length are drift, with its square root a"
        " random walk; as large over any length, they are jitter or wander."
    ),
    "whiteness": (
        "Once the error model has explained the errors, what is left should not remember the pose"
        " before. Bars beyond the green band: it does, and the ± are too small."
    ),
    "clock": (
        "What each part of the run, taken alone, says is to be added to the estimate's stamps. A"
        " slope is a clock that runs at another rate, a step one that was set."
    ),
    "rates": (
        "Messages as they came; shaded: no ground truth. Green triangles: samples refuted the"
        " process that models the ground truth, and another one was learned."
    ),
    "likelihoods": (
        "The log-likelihoods fall where the estimate is bad; the relative and the absolute one lie"
        " on one another as long as first order holds. What was gained within some seconds is what"
        " they added to the run's totals, given all before: the tables take the last ones alone."
    ),
}
"""By the section that they stand in."""

HOW_TO_READ = (
    (
        "Relative likelihood",
        "How the motion between neighbouring estimates differs from the true one, weighed by how"
        " well the true one is known. It needs no alignment.",
    ),
    (
        "Absolute likelihood",
        "How the aligned estimate differs from the ground truth at each instant, integrated over"
        " all alignments. To first order, under the gauge se3, it carries the same information as"
        " the relative one; the two figures then agree.",
    ),
    (
        "Log-likelihood",
        "In nats, of the errors under the ground truth's own uncertainty: higher is better. With"
        " millimetre ground truth and centimetre errors, -10,000 nats a pose are right. Totals of"
        " runs of different length do not compare, nor do those under different gauges; the"
        " figures of the sliding window do compare.",
    ),
    (
        "χ² and log-determinant",
        "The log-likelihood is minus half of χ² + log-determinant + degrees of freedom times"
        " log 2π. A gap in the ground truth makes χ² small and the log-determinant large: look at"
        " both before you call an estimate good.",
    ),
    (
        "χ² per degree of freedom",
        "1: the estimate is as good as the ground truth. Its square root says how many standard"
        " deviations of the ground truth the error is worth.",
    ),
    (
        "p-value",
        "How often an estimate as good as the ground truth would have a χ² as far out as this, on"
        " either side. Near 0: the error is the estimate's own, or the uncertainty is wrong.",
    ),
    (
        "Noise-equivalent error",
        "The white noise which, added to the ground truth's uncertainty, explains the errors best:"
        " an accuracy from which the ground truth's share is taken out.",
    ),
    (
        "ATE and RE, conventional",
        "Root mean square error after alignment of positions (Umeyama), and of the motion over a"
        " fixed step, as other tools print them. They take the ground truth for exact.",
    ),
)
"""Terms, and what to make of them."""
