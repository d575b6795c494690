"""Whether the data determine the mounting stretch, whatever law the tissue follows."""
