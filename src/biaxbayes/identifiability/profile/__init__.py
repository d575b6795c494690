"""Profile likelihoods: one parameter held, everything else fitted again."""
