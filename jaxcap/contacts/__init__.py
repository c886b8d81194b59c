"""Where the robot touches the world: contact sets -> friction pyramids -> the centroidal cone, by faces or by rays.

Begin with `contact_set`, then `friction` (edges and wrench rays), `cone` (the two forms), `projection` (rays to faces,
on the host). `actuation` is what the robot's joints can bear at them, `actuated_cone` that of one posture by faces, through
`limbs` (vertices), `sums` (their faces) and `effort` (over places of the CoM). `conventions` holds gravity and the type of
an array. May import `numerics`.
"""
