"""Posterior distributions of the coefficients, and their sensitivity to T."""

from rtcal.calibration.posterior.distributions import Posterior, distribution, sensitivity

__all__ = ["Posterior", "distribution", "sensitivity"]
__dir__ = __all__.copy
