"""Sets of positions and of velocities: support polygon, capture point, velocity and CoM areas, robustness.

Begin with `support_polygon` and `velocity_area`. `plane` is the geometry that they share, `ray_support` the support
polygon of a batch of contact sets. May import `numerics`, `contacts`, `one_state`, `batch`.
"""
