"""Predictions of the posterior, and checks of the model."""
