"""Robots and their logs, through Pinocchio (extra `robots`; logs also need `logs`): what was recorded to what is scored.

Begin with `models` (a robot by name or file) and `logs` (a log and its robot in, rows to score out), which goes through
`layouts` (which field is what), `readers` (bytes to fields), `motion` (conventions undone), `checks`, `touch` (contacts) and
`whole_body` (what is scored of a robot state); `torque_limits` is what its joints can bear there. `live` is a running
simulation, `appearance` is for pictures. May import `numerics`, `contacts` and `files`.
"""

try:
    from pinocchio import Model as _Model  # noqa: F401  # the PyPI project called "pinocchio" is another one, and has no Model
except ImportError as error:
    raise ImportError('jaxcap.robots needs Pinocchio: pip install "jaxcap[robots]"') from error

from jaxcap.robots.appearance import Look as Look
from jaxcap.robots.appearance import looks as looks
from jaxcap.robots.centroidal import CentroidalStates as CentroidalStates
from jaxcap.robots.centroidal import centroidal_states as centroidal_states
from jaxcap.robots.centroidal import convention_error as convention_error
from jaxcap.robots.ground import read_ground as read_ground
from jaxcap.robots.layouts import Layout as Layout
from jaxcap.robots.layouts import known_layouts as known_layouts
from jaxcap.robots.layouts import layout_of as layout_of
from jaxcap.robots.live import from_mujoco as from_mujoco
from jaxcap.robots.logs import Log as Log
from jaxcap.robots.logs import Options as Options
from jaxcap.robots.logs import States as States
from jaxcap.robots.logs import states as states
from jaxcap.robots.logs import states_of as states_of
from jaxcap.robots.models import ROBOTS as ROBOTS
from jaxcap.robots.models import Robot as Robot
from jaxcap.robots.models import anymal as anymal
from jaxcap.robots.models import load as load
from jaxcap.robots.models import load_robot as load_robot
from jaxcap.robots.models import talos as talos
from jaxcap.robots.patches import ANYMAL_FEET as ANYMAL_FEET
from jaxcap.robots.patches import TALOS_CONTACTS as TALOS_CONTACTS
from jaxcap.robots.patches import ContactPatch as ContactPatch
from jaxcap.robots.patches import Placement as Placement
from jaxcap.robots.patches import contact_placement as contact_placement
from jaxcap.robots.patches import patches_yaml as patches_yaml
from jaxcap.robots.patches import read_patches as read_patches
from jaxcap.robots.soles import find_patches as find_patches
from jaxcap.robots.torque_limits import actuation as actuation
from jaxcap.robots.torque_limits import joint_names as joint_names
from jaxcap.robots.touch import Touching as Touching
