"""Many structures, on one machine or, by Dask, on a cluster."""

from protochain.batches.api import Batch, BatchProgress, batch
from protochain.batches.cluster import Processes
from protochain.batches.jobs import BatchSettings, Job, find_jobs
from protochain.batches.relaxing import relax_files

__all__ = ["Batch", "BatchProgress", "BatchSettings", "Job", "Processes", "batch", "find_jobs", "relax_files"]
