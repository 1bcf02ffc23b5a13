"""Posterior distributions of the coefficients, and their sensitivity to T."""

from rtcal.posterior.distributions import Posterior, distribution
from rtcal.posterior.sensitivities import sensitivity

__all__ = ["Posterior", "distribution", "sensitivity"]
__dir__ = __all__.copy
