"""Many jobs: a manifest, records of what is finished, and workers on the local cores or on a Dask cluster."""
