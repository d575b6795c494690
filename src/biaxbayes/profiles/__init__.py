"""Profile likelihoods: the best fit at each value of a parameter."""
