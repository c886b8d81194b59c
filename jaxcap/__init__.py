"""Can this robot still stop, or is it going to fall? Zero-step capturability in multi-contact, in JAX."""

from jaxcap.batch import score as score
from jaxcap.capturability import capturability as capturability
from jaxcap.cone import CentroidalCone as CentroidalCone
from jaxcap.cone import ConeRays as ConeRays
from jaxcap.cone import centroidal_cone as centroidal_cone
from jaxcap.cone import cone_rays as cone_rays
from jaxcap.contacts import ContactSet as ContactSet
from jaxcap.contacts import rectangle as rectangle
from jaxcap.result import Capturability as Capturability
from jaxcap.result import Case as Case
from jaxcap.result import Status as Status

__version__ = "0.1.0"
