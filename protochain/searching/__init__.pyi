from .api import SearchProgress as SearchProgress
from .api import search as search
from .landscape import Landscape as Landscape
from .result import Search as Search
