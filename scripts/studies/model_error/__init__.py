"""Truths that GOH cannot represent, and the error models that are to survive them."""
