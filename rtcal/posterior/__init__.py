"""Posterior distributions of the coefficients, and their sensitivity to T."""

from rtcal.posterior.distributions import Posterior, posterior
from rtcal.posterior.sensitivities import sensitivity

__all__ = ["Posterior", "posterior", "sensitivity"]
