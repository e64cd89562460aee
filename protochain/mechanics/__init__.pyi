from . import motion as motion
from . import multibody as multibody
