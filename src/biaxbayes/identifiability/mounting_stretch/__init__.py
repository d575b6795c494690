"""Whether the data tell the mounting stretch, and what can be stated of it under any law."""
