from .api import relax as relax
from .presets import PRESETS as PRESETS
from .presets import PROTOCOLS as PROTOCOLS
from .presets import Preset as Preset
from .result import Relaxation as Relaxation
from .rounds import Round as Round
from .settings import RelaxSettings as RelaxSettings
