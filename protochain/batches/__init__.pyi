from .batch_structures import Batch as Batch
from .batch_structures import BatchProgress as BatchProgress
from .batch_structures import batch as batch
from .batch_structures import relax_files as relax_files
from .cluster import Processes as Processes
from .jobs import BatchSettings as BatchSettings
from .jobs import Job as Job
from .jobs import find_jobs as find_jobs
