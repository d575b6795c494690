"""A hierarchical posterior over specimens, from their finished runs."""
