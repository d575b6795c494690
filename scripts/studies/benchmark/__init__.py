"""What biaxbayes is timed against, and how the times are taken."""
