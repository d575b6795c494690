"""Profile likelihoods: one parameter fixed, everything else fitted again."""
