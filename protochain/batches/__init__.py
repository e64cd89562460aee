"""Many structures, on one machine or on a cluster, by Dask."""

from protochain.batches.api import Batch, batch
from protochain.batches.jobs import Job, Settings, find_jobs

__all__ = ["Batch", "Job", "Settings", "batch", "find_jobs"]
