from .figures import draw_lines as draw_lines
from .provenance import commit as commit
from .provenance import processor as processor
