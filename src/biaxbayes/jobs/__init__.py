"""The main jobs, each in a folder: a specimen sampled, a study, a calibration."""
