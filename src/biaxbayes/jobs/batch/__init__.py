"""The verb ``batch``: many specimens sampled once each, and set side by side."""
