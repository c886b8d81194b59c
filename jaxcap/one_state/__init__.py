"""The derivation, for one state: a cone and a line of travel make a polygon, the polygon is walked, the walk decides.

Begin with `capturability`, the entry; `line` (the polygon cut along the velocity, and the walk along it) and `decision`
(verdict and margins from the walk's energies) are its two halves. `polygon` is the waist: what they ask of a polygon,
`face_polygon`, `ray_polygon` and `actuated_polygon` (a robot's limits) answer it, `walk` is what these share. Arrays
carry their lanes last. May import `numerics` and `contacts`.
"""
