from .presets import PRESETS as PRESETS
from .presets import PROTOCOLS as PROTOCOLS
from .presets import Preset as Preset
from .relax_settings import RelaxSettings as RelaxSettings
from .relax_structure import relax as relax
from .result import Relaxation as Relaxation
from .rounds import Round as Round
