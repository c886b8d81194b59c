"""Can this robot still stop, or is it going to fall? Zero-step capturability in multi-contact, in JAX."""

from jaxcap.batch import score as score
from jaxcap.capturability import capturability as capturability
from jaxcap.capture_point import Baselines as Baselines
from jaxcap.capture_point import baselines as baselines
from jaxcap.capture_point import capture_point as capture_point
from jaxcap.com_area import ComArea as ComArea
from jaxcap.com_area import com_area as com_area
from jaxcap.cone import CentroidalCone as CentroidalCone
from jaxcap.cone import ConeRays as ConeRays
from jaxcap.cone import centroidal_cone as centroidal_cone
from jaxcap.cone import cone_rays as cone_rays
from jaxcap.contacts import ContactSet as ContactSet
from jaxcap.contacts import rectangle as rectangle
from jaxcap.result import Capturability as Capturability
from jaxcap.result import Case as Case
from jaxcap.result import Status as Status
from jaxcap.robustness import Robustness as Robustness
from jaxcap.robustness import robustness as robustness
from jaxcap.support_distance import hull_distance as hull_distance
from jaxcap.support_distance import support_distance as support_distance
from jaxcap.support_polygon import SupportPolygon as SupportPolygon
from jaxcap.support_polygon import support_polygon as support_polygon
from jaxcap.velocity_area import VelocityArea as VelocityArea
from jaxcap.velocity_area import headings as headings
from jaxcap.velocity_area import sphere as sphere
from jaxcap.velocity_area import velocity_area as velocity_area

__version__ = "0.1.0"
