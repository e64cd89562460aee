from .landscape import Landscape as Landscape
from .result import Search as Search
from .search_chain import SearchProgress as SearchProgress
from .search_chain import search as search
