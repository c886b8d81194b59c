"""Sets of positions and of velocities: support polygon, capture point, velocity and CoM areas, robustness, next contact.

Begin with `support_polygon`, `velocity_area` and `next_contact`; `sequences` is several next contacts, `touchdown` what the
two share. `plane` is the geometry of areas, `ray_support` the support polygon of a batch of contact sets. May import
`numerics`, `contacts`, `one_state`, `batch`.
"""
