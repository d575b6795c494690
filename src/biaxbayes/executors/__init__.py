"""Where many independent tasks are worked off: this process, local processes, a Dask cluster."""
