"""Mounting stretch of the tissue, whatever law it follows."""
