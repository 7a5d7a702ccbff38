"""The plain twin of consistency/cascade.py's tails: MC (7) and (8), term by term with the gamma function."""

import math


def binomial_term(i, r, alpha):
    """MC (8)."""
    logarithm = i * math.log(alpha) + (r - i) * math.log(1.0 - alpha)
    logarithm += math.lgamma(r + 1) - math.lgamma(i + 1) - math.lgamma(r - i + 1)
    return math.exp(logarithm)


def binomial_tail(at_least, r, alpha):
    return sum(binomial_term(i, r, alpha) for i in range(at_least, r + 1))


def most_failures(r, alpha, level):
    """MC (7): the smallest number of failed tests that no more than ``level`` of consistent scans exceed."""
    return next(most for most in range(r + 1) if binomial_tail(most + 1, r, alpha) <= level)
