"""Pictures for papers, as Matplotlib axes; needs matplotlib (extra `plots`).

Every function draws into the axes `ax`, or into axes of a new figure, and returns them. None shows or saves anything, uses
pyplot or changes settings: sizes of text and lines are those of the figure. Colours are told apart by colour-blind readers,
and lightness alone tells them apart in grey.

Begin with `travel` (a state's line, walked: what is drawn), then `acceleration` and `phase` (one state), `kernels`
(slices of maps), `map_figure` (what `jaxcap plot` draws). May import `numerics` to `maps`, and `maps`.
"""

from jaxcap.errors import needs_extra

with needs_extra("plots", "drawing"):
    from jaxcap.plotting.acceleration import polygon as polygon
    from jaxcap.plotting.areas import velocity_area as velocity_area
    from jaxcap.plotting.areas import velocity_areas as velocity_areas
    from jaxcap.plotting.areas_of_maps import map_areas as map_areas
    from jaxcap.plotting.areas_of_maps import weakest as weakest
    from jaxcap.plotting.candidates_in_space import capture_region as capture_region
    from jaxcap.plotting.kernels import kernel_slice as kernel_slice
    from jaxcap.plotting.over_time import timeline as timeline
    from jaxcap.plotting.patches import footprint as footprint
    from jaxcap.plotting.phase import phase_portrait as phase_portrait
    from jaxcap.plotting.stance_in_space import stance as stance
