"""What the posterior predicts, and where the model must not be used."""
