"""The statistical model: priors, noise, the compiled density and the posterior."""
