"""What a measurement leaves open: distributions, marginals, samples, sensitivities."""
