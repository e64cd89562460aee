from .api import Batch as Batch
from .api import BatchProgress as BatchProgress
from .api import batch as batch
from .api import relax_files as relax_files
from .cluster import Processes as Processes
from .jobs import BatchSettings as BatchSettings
from .jobs import Job as Job
from .jobs import find_jobs as find_jobs
