"""What `jaxcap score --help` says above the list of options."""

from jaxcap.commands.where import WHERE
from jaxcap.files.fields import BASELINES, FIELDS, field_list

_INPUT = """Score a file of robot states: can the robot stop without moving a contact?

EXAMPLES
  jaxcap score walk.parquet --contacts feet.yaml -o scores.parquet
  jaxcap score steps.parquet -o scores.parquet      # with columns of contacts
  jaxcap score walk.csv --robot g1 -o scores.parquet     # a log: see jaxcap
                                                    # states --help
  jaxcap score runs/ --contacts feet.yaml -o scores/ --jobs 4   # many files

STATES is Parquet (.parquet), NPZ (.npz) or CSV (.csv); for each state, a row:
    com            3 numbers   centre of mass [m]
    com_velocity   3 numbers   its velocity [m/s]
  Floats or integers; in Parquet a column of lists, in NPZ an array (n, 3). Or
  one column for each axis: com_x, com_y, com_z, com_velocity_x, and so on; in
  CSV always.
  All in one inertial frame with z up, the frame of the contacts as well.
  And, if the robot's angular momentum about its CoM is to count (it comes to
  rest in proportion to the CoM's speed), one of these, spelt in the same way:
    angular_momentum           [kg m^2/s], with --mass M; jaxcap states writes
                               it
    specific_angular_momentum  the same over the mass [m^2/s]
  Other columns are carried through. The file is read in pieces and may be
  larger than memory.

CONTACTS is YAML (.yaml, .yml) or JSON (.json):
    contacts:
      - type: rectangle       # a sole or a hand: contacts at its 4 corners
        name: left_sole       # optional
        position: [0, 0.1, 0] # centre [m]
        rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
        half_length: 0.105    # along the first column of the rotation [m]
        half_width: 0.065     # along the second column [m]
        friction: 0.5
      - type: point
        position: [0.5, 0, 1]
        friction: 0.7
  The third column of the rotation is the contact's normal, pointing at the
  robot. Without a rotation the axes are x, y, z.

CONTACTS THAT DIFFER FROM ROW TO ROW
  Either CONTACTS has several sets, of which STATES chooses for each row:
    sets:
      - name: left            # optional
        contacts: [{type: point, position: [0, 0.1, 0], friction: 0.5}]
      - name: flight
        contacts: []          # no contact
    contact_set        integer, or text: the number of the set, from 0, or its
                       name; a file with contacts: is set 0
  Or STATES has the contacts, and there is no --contacts. For k contacts:
    contact_points     k x 3 numbers, or 3 k: positions [m]
    contact_frames     k x 3 x 3 numbers, or 9 k: rotations row by row, whose
                       third column is the normal, pointing at the robot
    contact_friction   k numbers, or one for all
    contact_mask       optional: k booleans, false for padding; without this
                       column, points of three NaN are padding
  In Parquet columns of lists, with another k in each row if need be; in NPZ
  arrays (n, k, 3), (n, k, 3, 3), (n, k). At most 64 contacts a row.
  A row without contacts has the case EMPTY: it is in flight.

OUT is Parquet or NPZ: all columns of STATES, and for each state
"""

_BASELINES = """
  and with --baselines, negative outside and infinite for a polygon that is
  everything or nothing:
"""

_REST = """
  The capture point needs a height of the CoM, --height. By default it is
  that above the mean of the row's contact points; where it is not positive
  there is no capture point, and both columns are NaN.
  Its metadata holds units, conventions, the names of the numbers, contacts,
  gravity, version and notes, as JSON: the key jaxcap of a Parquet schema, the
  array metadata of an NPZ. The index of a pandas frame stays what it is. OUT
  is written whole or not at all.

BAD ROWS
  A state with NaN, infinity, a null or a list that does not hold 3 numbers
  gets the status nonfinite and no figures; the others are not affected.
  Contacts that cannot be used make a bad row too: a number that is not finite,
  a frame that is not a rotation, friction that is not positive, a set that is
  not there, lists that do not match. A note says how many there are, and what
  is wrong with the first (rows from 0).

NOTES
  A line on stderr, and in the metadata, if most rows are hardly plausible: the
  CoM more than 10 m from all contacts or below all of them, contacts more than
  5 m apart, normals that all point away from the CoM. With --strict that is an
  error, and nothing is written.

TABLE
  At the end: counts of cases and statuses, quantiles of the margin (to within
  0.025 %), states per second.

ROBOT
  With --robot the torque limits of the joints that carry a contact count, in
  the posture of each row, and so does the log's angular momentum, over the
  robot's mass. Where the model has no effort limit for one of these joints,
  the momentum counts alone. A line on stderr says which, and so do the
  metadata (counted). With --point-mass neither counts.

MOMENTUM BOX
  --momentum-box BOX, with a robot or without: the rate of angular momentum
  over the mass may differ by BOX in each component, along x, y and z, from
  what braking brings about: by limbs that the robot moves. In m^2/s^2, the
  momentum_box of Python, never in N m: 10 N m, with which TALOS (90 kg)
  stopped best, is 10 / 90 = 0.11. The metadata say it (momentum_box). Zero,
  the default, is the paper's model. The columns of --baselines know nothing of
  it.

MANY FILES
  STATES may be a folder of Parquet files, however deep, or a glob in quotes
  ('data/**/*.parquet'). OUT is a folder then, and gets a file of the same name
  for each, as if it were scored alone. All have to have the same columns, and
  what is no Parquet file is an error, before anything is computed; names that
  begin with a dot or an underscore are left out.
  Files that are there are not done again. OUT/_SUMMARY.json, with counts,
  quantiles of the margin (to within 0.8 %) and the SHA-256 of the settings,
  appears when all are. Other settings, versions or inputs than before are
  refused; --force does all again. A file that fails is told by number and name
  at the end, and the others are done.
  One large Parquet file is scored in the same way if OUT is a folder, or a
  name without an extension: part-00000.parquet and so on, which one after the
  other hold what one file would (where rows have contacts of their own, to the
  last digit). A part is whole row groups, together up to 524,288 rows; a file
  of one row group is one part.
WHERE
{where}
COMPILING
  Takes seconds, once; with torque limits, half a minute: the programs are kept
  in your cache folder, or in DIR with --cache DIR, and the next run takes them
  from there. They are code: use no DIR that is written to by anyone whom you
  do not trust. --no-cache turns it off.

EXIT CODES
  0 done; 2 bad input, and one line says which; 130 interrupted.
"""

SCORE = _INPUT + field_list(FIELDS) + _BASELINES + field_list(BASELINES) + _REST.replace("{where}", WHERE)
"""Its first line also stands in `jaxcap --help`."""
